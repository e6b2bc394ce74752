"""Draw the display into a picture: characters with an outline, each in its own cell."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgrab.model.layouts import CLOCK_PATTERN, Layout, Rectangle
from simgrab.model.scenario import Ink
from simgrab.world.camera.faces import Face, Mask, bundled
from simgrab.world.trajectory.display import Shown

DIGITS = "0123456789"
CHINESE = "年月日星期一二三四五六"
FINE = 4  # glyphs are rendered so many times larger and averaged, which leaves nothing to hints
_FULL = 255


@dataclass(frozen=True, eq=False)
class _Glyph:
    """A rendered character: it makes ``(pixel · keep + add) / 255``. Of shapes (h, w, 1) and (h, w, 3), uint16."""

    keep: NDArray[np.uint16]
    add: NDArray[np.uint16]

    def torn(self, below: _Glyph, row: int) -> _Glyph:
        """Return this glyph above a row and another from there on."""
        return _Glyph(
            np.concatenate([self.keep[:row], below.keep[row:]]), np.concatenate([self.add[:row], below.add[row:]])
        )


class _Pen:
    """A face at the largest size at which characters fit their cells, whose width and height, px, go with them."""

    def __init__(self, face: Face, ink: Ink, cells: Sequence[tuple[str, int, int]]) -> None:
        self._face, self._ink = face, ink
        boxes = [(face.box(c), width) for characters, width, _ in cells for c in characters]
        top = min(box[1] for box, _ in boxes) - ink.outline
        bottom = max(box[3] for box, _ in boxes) + ink.outline
        height = cells[0][2]
        size = height / (bottom - top)
        for box, width in boxes:
            size = min(size, width / 2 / (max(-box[0], box[2]) + ink.outline))
        self._fine_size = int(size * FINE)
        self._baseline = height / 2 - size * (top + bottom) / 2

    def draw(self, character: str, width: int, height: int) -> _Glyph:
        """Draw a character amid a cell of a size in px."""
        outline_px = max(1, round(self._ink.outline * self._fine_size)) if self._ink.outline else 0
        fill, covered = (self._coverage(character, width, height, grown) for grown in (0, outline_px))
        covered = np.maximum(covered, fill)
        coloured = fill * _bytes(self._ink.fill_rgb) + (covered - fill) * _bytes(self._ink.outline_rgb)
        return _Glyph(_FULL - covered, coloured + 127)  # 127 rounds the division

    def _coverage(self, character: str, width: int, height: int, outline_px: int) -> NDArray[np.uint16]:
        origin = width * FINE / 2, round(self._baseline * FINE)
        fine: Mask = self._face.mask(character, self._fine_size, (height * FINE, width * FINE), origin, outline_px)
        blocks = fine.astype(np.float64).reshape(height, FINE, width, FINE)
        return blocks.mean(axis=(1, 3)).round().astype(np.uint16)[..., None]


def _bytes(rgb: tuple[float, float, float]) -> NDArray[np.uint16]:
    return (_FULL * np.array(rgb)).round().astype(np.uint16)


class Overlay:
    """The display's characters, rendered once for one size of picture.

    Parameters
    ----------
    layout : Layout
        Fitted to the picture.
    face : Face, optional
        Of the rope lengths; the bundled font's unless given.
    ink : Ink, optional
        Of the rope lengths; white with a black outline unless given.

    Examples
    --------
    >>> from simgrab import layouts
    >>> layout = layouts.load("two-by-four")
    >>> text = Shown("2022年01月26日 星期三 14:05:37", "2015 2100", "2015 2100", None)
    >>> int(Overlay(layout).blend(np.zeros((1080, 1920, 3), np.uint8), text).max())
    255
    """

    def __init__(self, layout: Layout, face: Face | None = None, ink: Ink | None = None) -> None:
        self.layout = layout
        self._ink = ink or Ink()
        own = bundled()
        size = layout.clock.size_px
        widths = {c: x1 - x0 for c, (x0, _, x1, _) in zip(CLOCK_PATTERN, layout.clock.cells, strict=True)}
        cells = [(DIGITS + ":", widths["0"], size), (CHINESE, size, size)]
        self._clock = _glyphs(_Pen(own, Ink(), cells), cells)
        cells = [(DIGITS, layout.digit_width_px, layout.digit_height_px)]
        cells += [(".", x1 - x0, y1 - y0) for x0, y0, x1, y1 in layout.points[:1]]
        self._numbers = _glyphs(_Pen(face or own, self._ink, cells), cells)

    def blend(self, rgb: NDArray[np.uint8], shown: Shown) -> NDArray[np.uint8]:
        """Lay the display over a picture, uint8 of the layout's size and shape (height, width, 3).

        Returns a copy; pixels outside the characters' cells, and the plates, are as they were.
        """
        expected = (self.layout.height_px, self.layout.width_px, 3)
        if rgb.shape != expected or rgb.dtype != np.uint8:
            raise ValueError(f"the picture must be uint8 of shape {expected}, got {rgb.dtype} of shape {rgb.shape}")
        result = rgb.copy()
        for x0, y0, x1, y1 in self._plates():
            box, alpha = result[y0:y1, x0:x1], round(_FULL * self._ink.plate)
            box[...] = (box.astype(np.uint16) * (_FULL - alpha) + alpha * _bytes(self._ink.plate_rgb) + 127) // _FULL
        for (x0, y0, x1, y1), glyph in self._placed(shown):
            box = result[y0:y1, x0:x1]
            box[...] = (box * glyph.keep + glyph.add) // _FULL
        return result

    def _plates(self) -> Iterator[Rectangle]:
        """Where plates lie: behind the digits of each number."""
        for number in (self.layout.cells[:4], self.layout.cells[4:]) if self._ink.plate else ():
            x0, y0, _, _ = np.min(number, axis=0).tolist()
            _, _, x1, y1 = np.max(number, axis=0).tolist()
            yield x0, y0, x1, y1

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


def _glyphs(pen: _Pen, cells: Sequence[tuple[str, int, int]]) -> dict[str, _Glyph]:
    return {c: pen.draw(c, width, height) for characters, width, height in cells for c in characters}
