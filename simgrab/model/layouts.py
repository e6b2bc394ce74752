"""Digit layouts: places of the on-screen display's characters, and the unit of its digits.

Shared by the renderer of the display and its reader. Rectangles are ``x0, y0, x1, y1`` in whole pixels, half open.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, TypeAlias

import msgspec

from simgrab.errors import LayoutError
from simgrab.io import resources
from simgrab.io.parse import read_toml
from simgrab.io.resources import ASSETS, suggestion
from simgrab.io.strict import Checked, about, convert

Meta = msgspec.Meta
MOST_PX = 65_536
Place: TypeAlias = Annotated[int, Meta(ge=0, le=MOST_PX)]
Side: TypeAlias = Annotated[int, Meta(ge=1, le=MOST_PX)]
Corner: TypeAlias = tuple[Place, Place]
FourCorners: TypeAlias = Annotated[tuple[Corner, ...], Meta(min_length=4, max_length=4)]
Rectangle: TypeAlias = tuple[int, int, int, int]

FOLDER = ASSETS / "osd"
#: The clock's characters; digits and the weekday vary, their places do not.
CLOCK_PATTERN = "0000年00月00日 星期一 00:00:00"
#: Width over height of the clock's Latin characters; Chinese ones are square.
HALF_WIDTH = 0.59
#: Smaller characters cannot be distinguished, px.
LEAST_DIGIT_PX = (5, 8)
LEAST_CLOCK_PX = 8
#: Width of the decimal point's gap over that of a digit.
LEAST_POINT = 0.4


class Clock(Checked, frozen=True):
    """Place of the clock: top left corner of its line, and the line's height."""

    error = LayoutError

    x_px: Annotated[Place, about("Left end of its line.")]
    y_px: Annotated[Place, about("Top of its line.")]
    size_px: Annotated[Place, about("Height of its line.")]

    @property
    def cells(self) -> tuple[Rectangle, ...]:
        """One rectangle for each character of `CLOCK_PATTERN`, from left to right."""
        half = math.ceil(HALF_WIDTH * self.size_px)
        ends = list(itertools.accumulate((half if c.isascii() else self.size_px for c in CLOCK_PATTERN), initial=0))
        y0, y1 = self.y_px, self.y_px + self.size_px
        return tuple((self.x_px + x0, y0, self.x_px + x1, y1) for x0, x1 in itertools.pairwise(ends))


class Layout(Checked, frozen=True):
    """A digit layout for one size of picture; `scaled` converts it to another size.

    All eight digits' cells have the same size, and so have a reader's crops. With 2 decimals a number is centimetres,
    up to 99.99 m.
    """

    error = LayoutError

    width_px: Annotated[Side, about("Width of the image in which the layout was measured.")]
    height_px: Annotated[Side, about("Height of that image.")]
    clock: Annotated[Clock, about("Place of the clock.")]
    digit_width_px: Annotated[Place, about("Width of a digit's cell.")]
    digit_height_px: Annotated[Place, about("Height of a digit's cell.")]
    hoist_px: Annotated[FourCorners, about("Top left corners of the hoisting rope's four digits.")]
    closing_px: Annotated[FourCorners, about("Top left corners of the closing rope's four digits.")]
    decimals: Annotated[int, about("How many of the four digits are decimals of a metre.", ge=1, le=3)] = 2
    point: Annotated[bool, about("Whether a decimal point stands before the decimals.")] = False

    def check(self) -> None:  # noqa: D102
        size, least = f"{self.width_px} x {self.height_px} px", LEAST_DIGIT_PX
        if self.digit_width_px < least[0] or self.digit_height_px < least[1]:
            raise ValueError(
                f"digits of {self.digit_width_px} x {self.digit_height_px} px in an image of {size} "
                f"cannot be read: at least {least[0]} x {least[1]} px is needed"
            )
        if self.clock.size_px < LEAST_CLOCK_PX:
            raise ValueError(
                f"a clock {self.clock.size_px} px high in an image of {size} cannot be read: "
                f"at least {LEAST_CLOCK_PX} px is needed"
            )
        for name, corners in (("hoist_px", self.hoist_px), ("closing_px", self.closing_px)):
            if any(left[0] >= right[0] for left, right in itertools.pairwise(corners)):
                raise ValueError(f"{name}: digits must come from left to right")
        self._check_places(size)

    def _check_places(self, size: str) -> None:
        """Refuse characters outside the picture or over each other."""
        clock = self.clock.cells
        named = [("clock", (*clock[0][:2], *clock[-1][2:]))]
        for name, cells in (("hoist_px", self.cells[:4]), ("closing_px", self.cells[4:])):
            named += [(f"{name}.{i}", cell) for i, cell in enumerate(cells)]
        for name, (_, _, x1, y1) in named:
            if x1 > self.width_px or y1 > self.height_px:
                raise ValueError(f"{name} reaches ({x1}, {y1}), outside the picture of {size}")
        for (a, first), (b, second) in itertools.combinations(named, 2):
            if _overlap(first, second):
                raise ValueError(f"{a} and {b} overlap")
        for x0, _, x1, _ in self.points:
            if x1 - x0 < LEAST_POINT * self.digit_width_px:
                raise ValueError(f"point: a gap of {x1 - x0} px before the decimals is too small for the point")

    @property
    def cells(self) -> tuple[Rectangle, ...]:
        """The eight digits' rectangles: hoist rope, then closing rope, each from left to right."""
        w, h = self.digit_width_px, self.digit_height_px
        return tuple((x, y, x + w, y + h) for x, y in (*self.hoist_px, *self.closing_px))

    @property
    def points(self) -> tuple[Rectangle, ...]:
        """The decimal points' rectangles, as `cells` and equally large; none without points."""
        if not self.point:
            return ()
        first = 4 - self.decimals
        numbers = (self.hoist_px, self.closing_px)
        starts = [number[first - 1][0] + self.digit_width_px for number in numbers]
        width = min(number[first][0] - x0 for number, x0 in zip(numbers, starts, strict=True))
        tops = (number[first][1] for number in numbers)
        return tuple((x, y, x + width, y + self.digit_height_px) for x, y in zip(starts, tops, strict=True))

    def scaled(self, width_px: int, height_px: int) -> Layout:
        """Fit the layout to a picture of another size.

        Raises
        ------
        LayoutError
            If its characters would be too small to read.
        """
        sx, sy = width_px / self.width_px, height_px / self.height_px

        def place(corner: Corner) -> Corner:
            return _nearest(corner[0] * sx), _nearest(corner[1] * sy)

        clock_x, clock_y = place((self.clock.x_px, self.clock.y_px))
        return Layout(
            width_px,
            height_px,
            Clock(clock_x, clock_y, int(self.clock.size_px * min(sx, sy))),
            # Cut off, not rounded: neighbours that touch must not come to overlap.
            int(self.digit_width_px * sx),
            int(self.digit_height_px * sy),
            tuple(map(place, self.hoist_px)),
            tuple(map(place, self.closing_px)),
            self.decimals,
            self.point,
        )

    def text(self, hoist_m: float, closing_m: float) -> str:
        """Write two rope lengths as the display does: to the nearest step, and clipped to 0000 … 9999.

        Examples
        --------
        >>> load("two-by-four").text(20.151, 21.0), load("four-point-four").text(-1.0, 123.0)
        ('2015 2100', '00.00 99.99')
        """
        numbers = (f"{min(max(round(m * 10**self.decimals), 0), 9999):04d}" for m in (hoist_m, closing_m))
        return self.written("".join(numbers))

    def written(self, digits: str) -> str:
        """Write the eight characters of the digits' cells as the display does: ``"20.15 21.00"``."""
        cut = 4 - self.decimals
        return " ".join(f"{n[:cut]}.{n[cut:]}" if self.point else n for n in (digits[:4], digits[4:]))

    def lengths(self, text: str) -> tuple[float, float]:
        """Hoist and closing rope, m, from the display's text or from its eight digits alone."""
        digits = "".join(c for c in text if c.isdigit())
        if len(digits) != 8:
            raise ValueError(f"a display shows 8 digits, got {text!r}")
        return self.length(digits[:4]), self.length(digits[4:])

    def length(self, number: str) -> float:
        """One rope, m, from the four digits of its number, with a point or without."""
        return int(number.replace(".", "")) / 10**self.decimals


def _nearest(x: float) -> int:
    return math.floor(x + 0.5)  # not round(): halves to even would bring touching cells to overlap


def _overlap(a: Sequence[int], b: Sequence[int]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def names() -> list[str]:
    """Names of the bundled layouts."""
    return resources.names(FOLDER)


@cache
def load(name: str) -> Layout:
    """Read a bundled layout; raises `LayoutError` with one line that lists them, or names file and key."""
    if name not in names():
        raise LayoutError(f"no layout {name!r}{suggestion(name, names())}; there are: {', '.join(names())}")
    return read(FOLDER / f"{name}.toml")


def read(path: str | Path) -> Layout:
    """Read a layout's TOML file; raises `LayoutError` with one line that names file and key."""
    return convert(read_toml(path, LayoutError, "layout"), Layout, LayoutError, path)
