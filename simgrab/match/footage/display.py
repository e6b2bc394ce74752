"""Where the display's digits stand: two numbers of four characters, white with a dark outline, found and read."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.errors import LayoutError
from simgrab.instrument.read import Reader
from simgrab.match.footage.footage import Footage
from simgrab.model.layouts import LEAST_CLOCK_PX, LEAST_DIGIT_PX, Clock, Layout

LEAST_SEEN = 3  # times, among frames and contrasts, that a character is seen
MOST_BESIDE = 11  # characters at one level: more are a clock
MOST_PAIRS, MOST_NUMBERS = 40, 80
ROW = 8  # steps on both sides of a number in which other characters make it a part of a longer text
WHITE, ABOVE = 190, (45, 70, 100)  # levels: of a stroke, and by how much its surroundings are darker
FINE = 2  # pictures are enlarged so much: strokes may be a pixel wide
WIDEST_STROKE = 0.02  # of the picture's height
TALLEST = 0.12  # of the picture's height
LEAST_READ = 0.7  # share of cells that the reader must be sure of
SIZES = (1.1, 1.2, 1.3, 1.4)  # heights of cells over that of digits
Box = tuple[float, float, float, float]


@dataclass(frozen=True)
class DisplayMatch:
    """Where digits stand, or why none were found."""

    layout: Layout | None  # in the picture's size
    reason: str  # empty where there is a layout
    read: float  # share of digits' cells that the reader was sure of

    def mask(self, height: int, width: int) -> NDArray[np.bool_]:
        """Pixels of the display, with a margin, shape (height, width)."""
        result = np.zeros((height, width), bool)
        if self.layout is not None:
            clock = self.layout.clock.cells
            for x0, y0, x1, y1 in (*self.layout.cells, (*clock[0][:2], *clock[-1][2:])):
                result[max(y0 - 4, 0) : y1 + 4, max(x0 - 4, 0) : x1 + 4] = True
        return result


def display(footage: Footage) -> DisplayMatch:
    """Find the display's digits."""
    lines = _lines(_common([box for above in ABOVE for frame in footage.few for box in _boxes(frame, above)]))
    best = DisplayMatch(None, "no two numbers of four digits stand in it", 0.0)
    reader = Reader()
    for hoist, closing in _pairs(lines, footage.size[0])[:MOST_PAIRS]:
        for layout in _layouts(hoist, closing, lines, footage.size):
            read = "".join(reader.read(frame, layout).text for frame in footage.few)
            digits = sum(character.isdigit() for character in read)
            share = digits / max(digits + read.count("?"), 1)
            if share > best.read:
                best = DisplayMatch(layout, "", share)
        if best.read >= LEAST_READ:
            break
    if best.read < LEAST_READ:
        reason = best.reason or f"what looks like digits could be read in {best.read:.0%} of its cells alone"
        return DisplayMatch(None, reason, best.read)
    return best


def _boxes(frame: NDArray[np.uint8], above: int) -> list[Box]:
    """Boxes of bright characters, whose strokes stand so many levels out of their surroundings."""
    fine = np.asarray(cv2.resize(frame, None, fx=FINE, fy=FINE, interpolation=cv2.INTER_CUBIC), np.uint8)
    side = 2 * round(FINE * WIDEST_STROKE * frame.shape[0] / 2) + 1
    ridge = cv2.morphologyEx(fine, cv2.MORPH_TOPHAT, np.ones((side, side), np.uint8))
    strokes = (ridge >= above) & (fine >= 90)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(strokes.astype(np.uint8), connectivity=8)
    brightest = np.zeros(count, np.uint8)
    np.maximum.at(brightest, labels[strokes], fine[strokes])
    stats = stats[1:][brightest[1:] >= WHITE]
    boxes = []
    for x, y, w, h, area in stats.tolist():
        tall = FINE * LEAST_DIGIT_PX[1] * 0.7 <= h <= FINE * TALLEST * frame.shape[0]
        if tall and 0.12 * h <= w <= 1.15 * h and area >= 0.12 * w * h:
            boxes.append((x / FINE, y / FINE, (x + w) / FINE, (y + h) / FINE))
    return boxes


def _common(found: Sequence[Box]) -> list[Box]:
    """Boxes that several pictures show, each the median of its own."""
    groups: list[list[Box]] = []
    for box in found:
        height = box[3] - box[1]
        for group in groups:
            other = group[0]
            apart = [abs(box[i] + box[i + 2] - other[i] - other[i + 2]) / height for i in (0, 1)]
            if apart[0] <= 0.7 and apart[1] <= 0.4 and 0.8 <= height / (other[3] - other[1]) <= 1.25:
                group.append(box)
                break
        else:
            groups.append([box])
    result = []
    for group in groups:
        if len(group) >= LEAST_SEEN:  # a digit that changes is as wide as the widest
            low, middle, high = np.quantile(group, (0.1, 0.5, 0.9), axis=0)
            result.append((float(low[0]), float(middle[1]), float(high[2]), float(middle[3])))
    return result


def _lines(boxes: list[Box]) -> list[list[Box]]:
    """Lines of characters of one height, each from left to right."""
    boxes = sorted(boxes)
    lines: list[list[Box]] = []
    for box in boxes:
        for line in lines:
            last = line[-1]
            g = last[3] - last[1]
            if _level(last, box, 0.2) and 0 < box[0] - last[0] <= 2.6 * g and box[0] >= last[2] - 0.5:
                line.append(box)
                break
        else:
            lines.append([box])
    return lines


@dataclass(frozen=True)
class _Number:
    """Four characters at an even pitch, how uneven their steps are, and other characters of their row."""

    boxes: tuple[Box, Box, Box, Box]
    uneven: float
    others: frozenset[Box]

    def unlike(self, *rest: Box) -> float:
        """Say how unlike a number they are, where the rest are those of the other number."""
        return self.uneven + len(self.others.difference(rest))

    @property
    def height(self) -> float:
        """Of the tallest character."""
        return max(y1 - y0 for _, y0, _, y1 in self.boxes)


def _numbers(boxes: Sequence[Box]) -> list[_Number]:
    """Find four characters at an even pitch, with a wider gap for a point perhaps, the most even ones first."""
    found = []
    for a in boxes:
        height = a[3] - a[1]
        near = sorted(box for box in boxes if _level(a, box, 0.2) and abs(box[0] - a[0]) <= 2 * ROW * height)
        alike = [box for box in near if _level(a, box, 0.1, 1.15)]
        row = [box for box in near if 0 < box[0] - a[0] <= 7 * height]
        for b in row:
            first = _centre(b) - _centre(a)
            if not 0.4 * height <= first <= 1.5 * height:
                continue
            for c, d in itertools.combinations(row, 2):
                middle, last = _centre(c) - _centre(b), _centre(d) - _centre(c)
                uneven = abs(last - first) / height
                if uneven <= 0.5 and 0.7 * min(first, last) <= middle <= 2.2 * max(first, last):
                    four = (a, b, c, d)
                    low, high = _centre(a) - ROW * first, _centre(d) + ROW * first
                    others = frozenset(box for box in alike if box not in four and low <= _centre(box) <= high)
                    found.append(_Number(four, uneven, others))
    return sorted(found, key=_Number.unlike)[:MOST_NUMBERS]


def _centre(box: Box) -> float:
    return (box[0] + box[2]) / 2


def _level(box: Box, other: Box, most: float, ratio: float = 1.33) -> bool:
    """Whether boxes are about as tall, and their middles at one level within a share of the taller's height."""
    heights = box[3] - box[1], other[3] - other[1]
    apart = abs(box[1] + box[3] - other[1] - other[3]) / 2
    return max(heights) <= ratio * min(heights) and apart <= most * max(heights)


def _pairs(lines: list[list[Box]], width: int) -> list[tuple[Sequence[Box], Sequence[Box]]]:
    """Two numbers, side by side or one above the other, those most like numbers first."""
    boxes = [box for line in lines for box in line]
    numbers = _numbers([box for line in lines if _beside(line[0], lines) <= MOST_BESIDE for box in line])
    result = list[tuple[float, Sequence[Box], Sequence[Box]]]()
    for one, two in itertools.permutations(numbers, 2):
        (a, b), height = (one.boxes, two.boxes), one.height
        if not 0.8 <= height / two.height <= 1.25 or set(a) & set(b):
            continue
        beside = abs(a[0][1] - b[0][1]) <= 0.3 * height and 0 < b[0][0] - a[3][2] <= 0.3 * width
        above = all(abs(_centre(p) - _centre(q)) <= 0.4 * height for p, q in zip(a, b, strict=True))
        if beside or (above and 0 < b[0][1] - a[0][1] <= 4 * height):
            result.append((one.unlike(*b) + two.unlike(*a), a, b))
    # A character of a number may be lost in what lies behind it: two that stand below others will do.
    for one in numbers:
        a, height = one.boxes, one.height
        near = [box for box in boxes if any(abs(_centre(box) - _centre(p)) <= 0.25 * height for p in a)]
        drops = Counter(round(box[1] - a[0][1]) for box in near if 1.05 * height < box[1] - a[0][1] <= 3 * height)
        for drop, count in drops.items():
            if count >= 2:
                below = [(x0, y0 + drop, x1, y1 + drop) for x0, y0, x1, y1 in a]
                result.append((2 * one.unlike() + 6 - min(count, 4), a, below))
        result += [(2 * one.unlike(*seen) + 6 - len(seen), *pair) for seen, pair in _partners(one, boxes, width)]
    return [(a, b) for _, a, b in sorted(result, key=lambda pair: pair[0])]


def _partners(
    one: _Number, boxes: Sequence[Box], width: int
) -> Iterator[tuple[list[Box], tuple[Sequence[Box], Sequence[Box]]]]:
    """Complete numbers beside one, of which three characters are seen: these, and both numbers."""
    a, height = one.boxes, one.height
    row = [box for box in boxes if box not in a and _level(a[0], box, 0.15)]
    tried = set[int]()
    for q, p in itertools.product(row, a):
        shift = _centre(q) - _centre(p)
        if round(shift) in tried or not a[3][2] - a[0][0] < abs(shift) <= 0.3 * width:
            continue
        tried.add(round(shift))
        seen = [box for box in row if any(abs(_centre(box) - _centre(r) - shift) <= 0.2 * height for r in a)]
        if len(seen) == 3:
            other = [(x0 + shift, y0, x1 + shift, y1) for x0, y0, x1, y1 in a]
            yield seen, (a, other) if shift > 0 else (other, a)


def _beside(box: Box, lines: list[list[Box]]) -> int:
    """Count the characters in a row with one: at its level, none far from the next."""
    height = box[3] - box[1]
    level = [
        other
        for line in lines
        for other in line
        if 0.75 <= (other[3] - other[1]) / height <= 1.33 and abs(other[1] + other[3] - box[1] - box[3]) <= 0.6 * height
    ]
    level.sort()
    apart = [i + 1 for i, (a, b) in enumerate(itertools.pairwise(level)) if b[0] - a[2] > 2.5 * height]
    ends = [0, *apart, len(level)]
    return next((b - a for a, b in itertools.pairwise(ends) if box in level[a:b]), 0)


def _clock(lines: list[list[Box]], size: tuple[int, int]) -> Clock | None:
    """Find the clock: the longest line of characters."""
    best = max(lines, key=lambda line: _beside(line[0], lines), default=[])
    if not best or _beside(best[0], lines) <= MOST_BESIDE:
        return None
    top, bottom = min(box[1] for box in best), max(box[3] for box in best)
    height = max(round(1.12 * (bottom - top)), LEAST_CLOCK_PX)
    clock = Clock(max(round(best[0][0] - 0.1 * height), 0), max(round(top - 0.06 * height), 0), height)
    return clock if clock.cells[-1][2] <= size[0] and clock.cells[-1][3] <= size[1] else None


def _layouts(
    hoist: Sequence[Box], closing: Sequence[Box], lines: list[list[Box]], size: tuple[int, int]
) -> list[Layout]:
    """Layouts whose cells hold the characters of two numbers."""
    boxes = [*hoist, *closing]
    height = float(np.median([y1 - y0 for _, y0, _, y1 in boxes]))
    centres = [[_centre(box) for box in number] for number in (hoist, closing)]
    pitch = float(np.median([c[k + 1] - c[k] for c in centres for k in (0, 2)]))
    point = all(c[2] - c[1] > 1.2 * pitch for c in centres)
    result = []
    for scale in SIZES:
        h = max(round(scale * height), LEAST_DIGIT_PX[1])
        w = max(min(int(pitch - 0.5), round(0.68 * h)), LEAST_DIGIT_PX[0])
        corners = list[tuple[tuple[int, int], ...]]()
        for number, at in zip((hoist, closing), centres, strict=True):
            middle = float(np.median([(y0 + y1) / 2 for _, y0, _, y1 in number]))
            corners.append(tuple((max(round(x - w / 2), 0), max(round(middle - h / 2), 0)) for x in at))
        clock = _clock(lines, size) or Clock(0, 0, LEAST_CLOCK_PX)
        try:
            result.append(Layout(size[0], size[1], clock, w, h, corners[0], corners[1], 2, point))
        except LayoutError:
            continue
    return result
