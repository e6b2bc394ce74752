"""Draw the display into a picture: white characters with a black outline, each in its own cell."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from simgrab.layouts import CLOCK_PATTERN, Layout, Rectangle
from simgrab.utilities.resources import ASSETS
from simgrab.world.trajectory.display import Shown

FONT = ASSETS / "fonts" / "wqy-microhei-osd.ttf"
DIGITS = "0123456789"
CHINESE = "年月日星期一二三四五六"
OUTLINE = 1 / 20  # of the font's size
FINE = 4  # glyphs are rendered so many times larger and averaged, which leaves nothing to hints
_EM = 1000  # font size at which glyphs are measured


@dataclass(frozen=True, eq=False)
class _Glyph:
    """A rendered character: it makes ``(pixel · keep + add) / 255``. Both (h, w, 1), uint16."""

    keep: NDArray[np.uint16]
    add: NDArray[np.uint16]

    def torn(self, below: _Glyph, row: int) -> _Glyph:
        """Return this glyph above a row and another from there on."""
        return _Glyph(
            np.concatenate([self.keep[:row], below.keep[row:]]), np.concatenate([self.add[:row], below.add[row:]])
        )


class _Pen:
    """A font at the largest size at which characters, outline included, fit their cells.

    Parameters
    ----------
    cells : sequence of (str, int, int)
        Characters with the width and height of their cells, px. The heights are the same.
    """

    def __init__(self, cells: Sequence[tuple[str, int, int]]) -> None:
        boxes = [(_font(_EM).getbbox(c, anchor="ms"), width) for characters, width, _ in cells for c in characters]
        top = min(box[1] for box, _ in boxes) / _EM - OUTLINE
        bottom = max(box[3] for box, _ in boxes) / _EM + OUTLINE
        height = cells[0][2]
        size = height / (bottom - top)
        for box, width in boxes:
            size = min(size, width / 2 / (max(-box[0], box[2]) / _EM + OUTLINE))
        self._fine_size = int(size * FINE)
        self._baseline = height / 2 - size * (top + bottom) / 2

    def draw(self, character: str, width: int, height: int) -> _Glyph:
        """Draw a character amid a cell of a size in px."""
        fill, ink = (self._coverage(character, width, height, outlined) for outlined in (False, True))
        ink = np.maximum(ink, fill)
        return _Glyph(255 - ink, 255 * fill + 127)  # 127 rounds the division

    def _coverage(self, character: str, width: int, height: int, outlined: bool) -> NDArray[np.uint16]:
        fine = Image.new("L", (width * FINE, height * FINE))
        ImageDraw.Draw(fine).text(
            (width * FINE / 2, round(self._baseline * FINE)),
            character,
            fill=255,
            font=_font(self._fine_size),
            anchor="ms",
            stroke_width=max(1, round(OUTLINE * self._fine_size)) if outlined else 0,
        )
        blocks = np.asarray(fine, np.float64).reshape(height, FINE, width, FINE)
        return blocks.mean(axis=(1, 3)).round().astype(np.uint16)[..., None]


def _font(size: int) -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(str(FONT), size, layout_engine=ImageFont.Layout.BASIC)


class Overlay:
    """The display's characters, rendered once for one size of picture.

    Parameters
    ----------
    layout : Layout
        Fitted to the picture.

    Examples
    --------
    >>> from simgrab import layouts
    >>> layout = layouts.load("two-by-four")
    >>> text = Shown("2022年01月26日 星期三 14:05:37", "2015 2100", "2015 2100", None)
    >>> int(Overlay(layout).blend(np.zeros((1080, 1920, 3), np.uint8), text).max())
    255
    """

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        size = layout.clock.size_px
        widths = {c: x1 - x0 for c, (x0, _, x1, _) in zip(CLOCK_PATTERN, layout.clock.cells, strict=True)}
        cells = [(DIGITS + ":", widths["0"], size), (CHINESE, size, size)]
        self._clock = _glyphs(cells)
        cells = [(DIGITS, layout.digit_width_px, layout.digit_height_px)]
        cells += [(".", x1 - x0, y1 - y0) for x0, y0, x1, y1 in layout.points[:1]]
        self._numbers = _glyphs(cells)

    def blend(self, rgb: NDArray[np.uint8], shown: Shown) -> NDArray[np.uint8]:
        """Lay the display over a picture.

        Parameters
        ----------
        rgb : ndarray of uint8, shape (height, width, 3)
            Of the layout's size. BGR will do as well.
        shown : Shown

        Returns
        -------
        ndarray of uint8, shape (height, width, 3)
            A copy; pixels outside the characters' cells are as they were.
        """
        expected = (self.layout.height_px, self.layout.width_px, 3)
        if rgb.shape != expected or rgb.dtype != np.uint8:
            raise ValueError(f"the picture must be uint8 of shape {expected}, got {rgb.dtype} of shape {rgb.shape}")
        result = rgb.copy()
        for (x0, y0, x1, y1), glyph in self._placed(shown):
            box = result[y0:y1, x0:x1]
            box[...] = (box * glyph.keep + glyph.add) // 255
        return result

    def _placed(self, shown: Shown) -> Iterator[tuple[Rectangle, _Glyph]]:
        """Glyphs of a text and where they go."""
        for cell, character in zip(self.layout.clock.cells, shown.clock_text, strict=True):
            if character != " ":
                yield cell, self._clock[character]
        numbers = self._numbers
        texts = ([c for c in text if c in DIGITS] for text in (shown.rope_text, shown.rope_text_below))
        for cell, above, below in zip(self.layout.cells, *texts, strict=True):
            row = cell[3] if shown.torn_row_px is None else shown.torn_row_px
            row = min(max(row - cell[1], 0), self.layout.digit_height_px)
            yield cell, numbers[above].torn(numbers[below], row)
        for cell in self.layout.points:
            yield cell, numbers["."]


def _glyphs(cells: Sequence[tuple[str, int, int]]) -> dict[str, _Glyph]:
    pen = _Pen(cells)
    return {c: pen.draw(c, width, height) for characters, width, height in cells for c in characters}
