"""Lines that a pen follows to write a digit, with the variants that fonts of displays have.

A character is 1 high: y runs from −1 at its top to 0 at the baseline, x from the middle.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from simgrab.model.geometry import Array

Line = Array  # shape (n, 2): a polyline; of two equal points, a dot
Skeleton = list[Line]

DIGITS = "0123456789"
_ARC = 20  # points of an arc
_SEGMENTS = {
    "0": "abcdef", "1": "bc", "2": "abged", "3": "abgcd", "4": "fgbc", "5": "afgcd", "6": "fgedc", "7": "abc",
    "8": "abcdefg", "9": "abcfg",
}  # fmt: skip
# Rows of 5 × 7 dots, as bits; several of a digit where displays differ.
_DOTS = {
    "0": ["0e 11 13 15 19 11 0e", "0e 11 11 11 11 11 0e", "04 0a 11 11 11 0a 04"],
    "1": ["04 0c 04 04 04 04 0e", "04 0c 04 04 04 04 04", "04 0c 14 04 04 04 1f"],
    "2": ["0e 11 01 02 04 08 1f", "0e 11 01 06 08 10 1f", "0e 11 01 0e 10 10 1f"],
    "3": ["1f 02 04 02 01 11 0e", "0e 11 01 06 01 11 0e", "1f 01 02 06 01 11 0e"],
    "4": ["02 06 0a 12 1f 02 02", "11 11 11 1f 01 01 01", "08 08 0a 0a 1f 02 02"],
    "5": ["1f 10 1e 01 01 11 0e", "1f 10 10 1e 01 01 1e", "1f 10 16 19 01 11 0e"],
    "6": ["06 08 10 1e 11 11 0e", "0e 11 10 1e 11 11 0e", "02 04 08 1e 11 11 0e"],
    "7": ["1f 01 02 04 08 08 08", "1f 01 01 02 04 04 04", "1f 11 01 02 04 04 04"],
    "8": ["0e 11 11 0e 11 11 0e", "0e 0a 0a 0e 11 11 0e"],
    "9": ["0e 11 11 0f 01 02 0c", "0e 11 11 0f 01 11 0e", "0e 11 11 0f 02 04 08"],
}


class Strokes:
    """Digits of curves and lines, whose skeletons have a width. Each trait is drawn once for the font.

    The pen is half the nib's height: ends of arcs keep clear of what lies below them.
    """

    def __init__(self, rng: np.random.Generator, width: float, pen: float) -> None:
        self._rng, self._pen = rng, pen
        self._w = width / 2
        self._power = float(rng.choice([2.0, 2.4, 3.0, 5.0], p=[0.45, 0.3, 0.15, 0.1]))  # 2: an ellipse
        self._serifs = rng.random() < 0.25
        self._waist = float(rng.uniform(-0.56, -0.46))
        self._opening = float(rng.uniform(0, 45))  # degrees that ends of arcs turn less

    def digit(self, digit: str) -> Skeleton:
        """Draw the variant of a digit, and return its lines."""
        return [np.asarray(line, float) for line in getattr(self, f"_{digit}")()]

    def _chance(self, share: float) -> bool:
        return bool(self._rng.random() < share)

    def _between(self, low: float, high: float) -> float:
        return float(self._rng.uniform(low, high))

    def _arc(self, y: float, rx: float, ry: float, start: float, end: float) -> Line:
        """Part of a superellipse, angles counter-clockwise from the right, in degrees."""
        angle = np.radians(np.linspace(start, end, _ARC))
        cos, sin = np.cos(angle), np.sin(angle)
        x = rx * np.sign(cos) * abs(cos) ** (2 / self._power)
        return np.stack([x, y - ry * np.sign(sin) * abs(sin) ** (2 / self._power)], axis=1)

    def _0(self) -> Iterator[Line]:
        w = self._w
        yield self._arc(-0.5, w, 0.5, 0, 360)
        if self._chance(0.12):
            yield np.array([(-0.55 * w, -0.27), (0.55 * w, -0.73)])
        elif self._chance(0.08):
            yield np.array([(0, -0.5 - 0.04), (0, -0.5 + 0.04)])

    def _1(self) -> Iterator[Line]:
        w, foot, flag = self._w, self._chance(0.35) or self._serifs, self._chance(0.92)
        x = 0.0 if foot or not flag else self._between(0, 0.5 * w)
        yield np.array([(x, -1), (x, 0)])
        if flag:
            along = self._between(0.5, 1.1) * w
            drop = self._between(0.0, 0.1) if self._chance(0.15) else self._between(0.12, 0.32)
            yield np.array([(x, -1), (x - along, -1 + drop)])
        if foot:
            half = self._between(0.5, 0.95) * w
            yield np.array([(x - half, 0), (x + half, 0)])

    def _2(self) -> Iterator[Line]:
        w, ry = self._w, self._between(0.24, 0.32)
        end = -self._between(0, 45)
        top = self._arc(-1 + ry, w, ry, 180 - self._opening * 0.7, end)
        foot = np.array([(-w, 0.0)])
        if self._chance(0.4):  # bends into the foot
            t = np.linspace(0, 1, 10)[1:, None]
            bend = np.array([(-0.9 * w, -self._between(0.15, 0.4))])
            foot = (1 - t) ** 2 * top[-1] + 2 * t * (1 - t) * bend + t**2 * foot
        yield np.concatenate([top, foot])
        yield np.array([(-w, 0), (w, 0)])
        if self._serifs:
            yield np.array([(w, 0), (w, -0.16)])

    def _3(self) -> Iterator[Line]:
        w, waist = self._w, self._waist
        if self._chance(0.2):  # a flat top
            yield np.array([(-w, -1), (0.9 * w, -1), (-0.1 * w, waist - 0.05)])
            y, start = (waist - 0.05) / 2, 95.0
        else:
            narrow, ry = self._between(0.8, 1) * w, (waist + 1) / 2
            yield self._arc(-1 + ry, narrow, ry, 165 - self._opening, -90)
            y, start = waist / 2, 90.0
        yield self._arc(y, w, -y, start, -165 + self._opening)
        yield np.array([(-self._between(0, 0.55) * w, waist), (0, waist)])

    def _4(self) -> Iterator[Line]:
        w, bar = self._w, -self._between(0.17, 0.42)
        x = self._between(0.15, 0.85) * w
        right = self._between(max(x + 0.15 * w, 0.9 * w), 1.2 * w)
        if self._chance(0.8):
            yield np.array([(x, -1), (-w, bar), (right, bar)])
            yield np.array([(x, -1), (x, 0)])
        else:
            top = self._between(-1, 0.3) * w
            yield np.array([(top, -1), (-w, bar), (right, bar)])
            yield np.array([(x, -self._between(0.55, 1)), (x, 0)])
        if self._serifs:
            yield np.array([(x - 0.4 * w, 0), (x + 0.4 * w, 0)])

    def _5(self) -> Iterator[Line]:
        w, ry = self._w, self._between(0.29, 0.34)
        bowl = self._arc(-ry, w, ry, self._between(120, 155), -165 + self._opening)
        stem = self._between(-1, -0.7) * w
        yield np.concatenate([[(self._between(0.75, 1) * w, -1), (stem, -1)], bowl])

    def _6(self) -> Iterator[Line]:
        w, ry = self._w, self._between(0.27, 0.33)
        yield self._arc(-ry, w, ry, 0, 360)
        if self._chance(0.75):
            clear = np.degrees(np.arcsin(min((ry + 3 * self._pen) / (1 - ry), 1)))
            yield self._arc(-ry, w, 1 - ry, 180, self._between(clear, 95))
        else:
            leaves = self._arc(-ry, w, ry, 180, self._between(140, 165))
            yield np.concatenate([leaves, [(self._between(-0.1, 0.7) * w, -1)]])

    def _7(self) -> Iterator[Line]:
        w, x = self._w, self._between(-0.75, 0.15) * self._w
        yield np.array([(-w, -1), (w, -1)])
        t = np.linspace(0, 1, 12)[:, None]
        bend = self._between(-0.1, 0.5) * w if self._chance(0.4) else (w + x) / 2
        yield (1 - t) ** 2 * (w, -1) + 2 * t * (1 - t) * np.array((bend, -0.5)) + t**2 * (x, 0)
        if self._serifs or self._chance(0.1):
            yield np.array([(-w, -1), (-w, -0.82)])
        if self._chance(0.15):
            middle = (bend + (w + x) / 2) / 2
            yield np.array([(middle - 0.5 * w, -0.5), (middle + 0.5 * w, -0.5)])

    def _8(self) -> Iterator[Line]:
        w, waist = self._w, self._waist
        ry = (waist + 1) / 2
        yield self._arc(-1 + ry, self._between(0.78, 1) * w, ry, 0, 360)
        yield self._arc(waist / 2, w, -waist / 2, 0, 360)

    def _9(self) -> Iterator[Line]:
        for line in self._6():
            yield np.stack([-line[:, 0], -1 - line[:, 1]], axis=1)


def segments(rng: np.random.Generator, width: float) -> dict[str, Skeleton]:
    """Digits of seven segments."""
    w, gap = width / 2, rng.uniform(0.0, 0.08)
    lit = {digit: set(names) for digit, names in _SEGMENTS.items()}
    for digit, segment, share in (("6", "a", 0.75), ("9", "d", 0.75), ("7", "f", 0.2)):
        if rng.random() < share:
            lit[digit] = lit[digit] | {segment}
    left = rng.random() < 0.1  # of the 1's two places
    if left:
        lit["1"] = set("ef")
    ends = {
        "a": ((-w, -1), (w, -1)), "b": ((w, -1), (w, -0.5)), "c": ((w, -0.5), (w, 0)), "d": ((-w, 0), (w, 0)),
        "e": ((-w, -0.5), (-w, 0)), "f": ((-w, -1), (-w, -0.5)), "g": ((-w, -0.5), (w, -0.5)),
    }  # fmt: skip
    lines = {}
    for name, (start, end) in ends.items():
        line = np.array([start, end], float)
        along = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
        lines[name] = line + np.array([gap * along, -gap * along])
    return {digit: [lines[name] for name in sorted(names)] for digit, names in lit.items()}


def dots(rng: np.random.Generator, width: float) -> dict[str, Skeleton]:
    """Digits of 5 × 7 dots."""
    found = {}
    for digit, kinds in _DOTS.items():
        rows = [int(row, 16) for row in kinds[int(rng.integers(len(kinds)))].split()]
        lit = [((k - 2) / 4 * width, i / 6 - 1) for i, row in enumerate(rows) for k in range(5) if row >> (4 - k) & 1]
        found[digit] = [np.array([at, at]) for at in lit]
    return found
