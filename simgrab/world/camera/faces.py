"""Faces that characters are written in: from a font's file, or generated."""

from __future__ import annotations

import functools
import itertools
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from simgrab.errors import ScenarioError
from simgrab.io import fonts, models
from simgrab.io.resources import ASSETS
from simgrab.model.geometry import Array
from simgrab.model.rng import stream
from simgrab.model.scenario import BundledFont, Font, FontFile, GeneratedFont, Ink
from simgrab.world.camera import skeletons

BUNDLED = ASSETS / "fonts" / "wqy-microhei-osd.ttf"
_SHAPES = 2**40  # generated fonts
_EM = 1000  # font size at which glyphs are measured
_REFUSE = functools.partial(ScenarioError, "display.font.file")

Box = tuple[float, float, float, float]
Mask = NDArray[np.uint8]


class FileFace:
    """The face of a font file. A character's origin is the middle of its baseline; y points down.

    Boxes may be as wide as advances: so the bundled font fits cells.
    """

    def __init__(self, data: Path | bytes, *, advances: bool = False) -> None:
        self._sized = functools.lru_cache(maxsize=4)(functools.partial(fonts.sized, data))
        self._advances = advances

    def box(self, character: str) -> Box:
        """Left, top, right and bottom of a character, without outline, relative to the font's size."""
        x, y, font = 0, 0, self._sized(_EM)
        if self._advances:
            left, top, right, bottom = font.getbbox(character, anchor="ms")
        else:
            mask, (x, y) = font.getmask2(character, "L", anchor="ms")
            left, top, right, bottom = mask.getbbox()
        return (x + left) / _EM, (y + top) / _EM, (x + right) / _EM, (y + bottom) / _EM

    def mask(self, character: str, size: int, shape: tuple[int, int], at: tuple[float, int], outline_px: int) -> Mask:
        """Draw a character of a font size, px, grown by an outline, with its origin (x, y) in a picture: 255 within."""
        picture = Image.new("L", shape[::-1])
        ImageDraw.Draw(picture).text(
            at, character, fill=255, font=self._sized(size), anchor="ms", stroke_width=outline_px
        )
        return np.asarray(picture)


def bundled() -> FileFace:
    """Open the face of the bundled font."""
    return FileFace(BUNDLED, advances=True)


class PenFace:
    """A face that a convex nib writes along skeletons, with the methods of `FileFace`.

    Parameters
    ----------
    lines : dict
        `skeletons.Skeleton` of each character.
    nib : tuple of float
        Half width and half height, relative to the digits' height.
    power : float
        Of the nib's superellipse: 1 is a rhombus, 2 an ellipse, and the larger, the more of a rectangle.
    margin : float
        Space above and below every character, relative to the digits' height.
    """

    def __init__(
        self, lines: dict[str, skeletons.Skeleton], nib: tuple[float, float], power: float, margin: float = 0.0
    ) -> None:
        self._lines, self._nib, self._power, self._margin = lines, nib, power, margin

    def box(self, character: str) -> Box:  # noqa: D102
        points = np.concatenate(self._lines[character])
        (left, top), (right, bottom) = points.min(0) - self._nib, points.max(0) + self._nib
        return float(left), float(top) - self._margin, float(right), float(bottom) + self._margin

    def mask(self, character: str, size: int, shape: tuple[int, int], at: tuple[float, int], outline_px: int) -> Mask:  # noqa: D102
        mask = np.zeros(shape, np.uint8)
        nib = self._outline(np.array(self._nib) * size + outline_px)
        for line in self._lines[character]:
            points = line * size + at
            for ends in itertools.pairwise(points):
                swept = np.concatenate([end + nib for end in ends]).astype(np.float32)
                hull = np.round(16 * cv2.convexHull(swept)).astype(np.int32)
                cv2.fillConvexPoly(mask, hull, 255, shift=4)
        return mask

    def _outline(self, half: Array) -> Array:
        angle = np.linspace(0, 2 * np.pi, 32, endpoint=False)
        unit = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return np.asarray(half * np.sign(unit) * abs(unit) ** (2 / self._power))


Face = FileFace | PenFace


def face(font: Font) -> Face:
    """Open the face of a font; a generated one must have a shape."""
    match font:
        case BundledFont():
            return bundled()
        case FontFile():
            return FileFace(models.recall(font.sha256, font.file, _REFUSE).data)
        case GeneratedFont():
            return _generated(font)


def ink(font: Font) -> Ink:
    """Give the colours of a font; those of a generated one are drawn where they are not given."""
    return font.ink or _drawn_ink(_stream(font, "ink"))


def _stream(font: Font, name: str) -> np.random.Generator:
    assert isinstance(font, GeneratedFont)
    assert font.shape is not None
    return stream(round(font.shape * _SHAPES), 0, f"font.{name}")


def _generated(font: GeneratedFont) -> PenFace:
    rng = _stream(font, "face")
    style = str(rng.choice(["strokes", "segments", "dots"], p=[0.76, 0.12, 0.12]))
    style = style if font.style == "any" else font.style
    width = rng.uniform(0.36, 0.72)
    if style == "segments":
        lines = skeletons.segments(rng, width)
        half = rng.uniform(0.035, 0.085)
        nib, power = (half, half), float(rng.choice([1, 2, 12]))
    elif style == "dots":
        lines = skeletons.dots(rng, width)
        filled = rng.uniform(0.7, 1.15)
        nib, power = (filled * width / 8, filled / 12), float(rng.choice([2, 12]))
    else:
        half = min(rng.uniform(0.025, 0.14), 0.2 * width)
        flat = rng.uniform(0.35, 1.0) if rng.random() < 0.4 else rng.uniform(0.85, 1.1)
        nib, power = (half, min(half * flat, 0.105)), float(rng.choice([2, 4, 12]))
        strokes = skeletons.Strokes(rng, width, nib[1])
        lines = {digit: strokes.digit(digit) for digit in skeletons.DIGITS}
    lines["."] = [np.array([(0, -nib[1])] * 2)]
    slant = rng.uniform(-0.05, 0.25) if rng.random() < 0.35 else 0.0
    margin = rng.uniform(0, 0.2) if rng.random() < 0.5 else 0.0
    shear = np.array([slant, 0])
    slanted = {c: [line - shear * (line[:, 1:] + 0.5) for line in some] for c, some in lines.items()}
    return PenFace(slanted, nib, power, margin)


def _drawn_ink(rng: np.random.Generator) -> Ink:
    """Colours that can be told apart: light on dark or dark on light, outlined or on a plate."""
    light, dark = _colour(rng, rng.uniform(0.55, 1.0)), _colour(rng, rng.uniform(0.0, 0.2))
    if rng.random() < 0.5:  # most displays
        light, dark = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)
    fill, behind = (dark, light) if rng.random() < 0.15 else (light, dark)
    plate = rng.uniform(0.6, 1.0) if rng.random() < 0.35 else 0.0
    outline = rng.uniform(0.02, 0.1) if not plate or rng.random() < 0.5 else 0.0
    return Ink(fill_rgb=fill, outline_rgb=behind, outline=outline, plate_rgb=behind, plate=plate)


def _colour(rng: np.random.Generator, luma: float) -> tuple[float, float, float]:
    """Draw a colour of a luma (ITU-R BT.601), grey or not."""
    weights = np.array([0.299, 0.587, 0.114])
    rgb = np.ones(3) if rng.random() < 0.4 else rng.choice([0.1, 0.5, 1.0], 3)
    rgb = rgb / (rgb @ weights) * luma
    for _ in range(3):  # what a channel cannot hold goes to the others
        rgb = rgb.clip(0, 1)
        rgb = rgb + (luma - rgb @ weights)
    red, green, blue = (float(value) for value in rgb.clip(0, 1))
    return red, green, blue
