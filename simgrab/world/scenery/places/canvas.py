"""A large picture of the ground on which markings, dirt and spilt cargo are painted before it becomes a texture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial, wraps
from typing import Any, TypeVar, cast

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from simgrab.model.geometry import Array
from simgrab.world.scenery.meshes.part import Paint
from simgrab.world.scenery.places.heap import Cargo
from simgrab.world.scenery.textures import load

Picture = NDArray[np.uint8]
Plane = NDArray[np.float32]
Colour = tuple[int, int, int]
COARSE = 2  # dirt and spill are kept at half the resolution: both are soft


def noise(rng: np.random.Generator, *, cells: float, octaves: int = 3) -> list[Plane]:
    """Draw what `cloud` makes smooth, with ``cells`` cells across in its coarsest octave."""
    sides = [max(2, round(cells * 2**octave)) for octave in range(octaves)]
    return [rng.random((n, n), dtype=np.float32) for n in sides]


def cloud(shape: tuple[int, int], drawn: Sequence[Plane]) -> Plane:
    """Smooth noise in [0, 1], mean 0.5, that repeats seamlessly, of what `noise` has drawn."""
    total = np.zeros(shape, np.float32)
    weight, norm = 1.0, 0.0
    for octave in drawn:
        n = len(octave)
        small = np.pad(octave, 2, mode="wrap")
        step = [n / s for s in shape[::-1]]  # cells a pixel
        grid = np.array([[step[0], 0, 1.5 + step[0] / 2], [0, step[1], 1.5 + step[1] / 2]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        total += weight * cv2.warpAffine(cv2.GaussianBlur(small, (3, 3), 0.5), grid, shape[::-1], flags=flags)
        norm += weight
        weight *= 0.6
    return np.clip(0.5 + (total / norm - 0.5) * 1.4, 0, 1).astype(np.float32)


def tiled(tile: Picture, rows: int, columns: int) -> Picture:
    """Repeat a tile over so many pixels."""
    repeat = -(-rows // tile.shape[0]), -(-columns // tile.shape[1]), 1
    return np.ascontiguousarray(np.tile(tile, repeat)[:rows, :columns])


def shrunk(tile: Picture, scale: float) -> Picture:
    """Scale a picture down evenly."""
    return np.asarray(cv2.resize(tile, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)


def toned(picture: Picture, drawn: Sequence[Plane], level: int, span: int, norm: int) -> Picture:
    """Multiply a square picture by smooth noise: level ± span/2 over norm, of what `noise` has drawn."""
    tone = (level + span * (cloud((256, 256), drawn) - 0.5)).astype(np.uint8)
    tone = np.asarray(cv2.resize(tone, picture.shape[:2]))
    return np.asarray(cv2.multiply(picture, cv2.merge([tone] * 3), scale=1 / norm), np.uint8)


_Window = tuple[slice, slice]


def _filled(corners: Array, side: int, margin: int, value: np.uint8 | np.float32) -> tuple[_Window, NDArray[Any]]:
    """Fill a polygon (pixels) with a value: a window around it, within a square picture, and its mask there.

    OpenCV smooths the edges of bytes alone.
    """
    low = np.maximum(np.floor(corners.min(0)).astype(int) - margin, 0)
    high = np.maximum(np.minimum(np.ceil(corners.max(0)).astype(int) + margin, side), low)
    mask = np.zeros(tuple(high[::-1] - low[::-1]), value.dtype)
    if mask.size:
        cv2.fillPoly(mask, [np.round((corners - low - 0.5) * 16).astype(np.int32)], float(value), cv2.LINE_AA, 4)
    return np.s_[low[1] : high[1], low[0] : high[0]], mask


_Method = TypeVar("_Method", bound=Callable[..., None])
_Scattered = tuple[tuple[int, int, int, int], list[Plane], Picture]
"""The window of coarse pixels that holds cargo, its unevenness and its grit."""


def _later(paint: _Method) -> _Method:
    """Keep the calls of a method, for when the picture is asked for."""

    @wraps(paint)
    def record(self: Canvas, *args: Any, **kwargs: Any) -> None:
        self._strokes.append(partial(paint, self, *args, **kwargs))

    return cast(_Method, record)


class Canvas:
    """A square picture of level ground, seen from above, painted in metres.

    Random numbers are drawn when a stroke is ordered. It is painted when the finished picture is asked for.

    Parameters
    ----------
    base : callable
        Paints what lies below all strokes, shape (pixels, pixels, 3).
    size : float
    pixels : int
        Of a side.
    rng : numpy.random.Generator

    Attributes
    ----------
    size : float
        Side, metres; the ground's (0, 0) is the middle of the picture.
    per_m : float
        Pixels a metre.
    """

    def __init__(self, base: Paint, size: float, pixels: int, *, rng: np.random.Generator) -> None:
        self.size = size
        self.per_m = pixels / size
        n = pixels // COARSE
        self._spill = np.zeros((n, n), np.float32)  # cover by cargo, 0 to 1 and more
        self._strokes: list[Callable[[], object]] = []
        self._prepare(base, n, noise(rng, cells=n / 60, octaves=5))
        self._rng = rng

    def uv(self, xy: ArrayLike) -> Array:
        """Texture coordinates of ground points (metres), mirrored beyond the picture's border; shape (N, 2)."""
        share = np.asarray(xy, float)[:, :2] / self.size + 0.5
        folded = np.abs(share - 2 * np.round(share / 2))
        return np.asarray(folded)

    def pixels(self, xy: ArrayLike, scale: float = 1.0) -> Array:
        """Continuous (column, row) of ground points, shape (N, 2)."""
        p = np.atleast_2d(np.asarray(xy, float))
        return np.stack([p[:, 0] + self.size / 2, self.size / 2 - p[:, 1]], 1) * self.per_m * scale

    @_later
    def _prepare(self, base: Paint, n: int, wear: list[Plane]) -> None:
        self.picture = base()
        self._dirt = np.zeros((n, n), np.float32)  # optical depth of grime
        self._wear = cv2.resize(cloud((n, n), wear), self.picture.shape[:2])

    @_later
    def paint(self, outline: ArrayLike, colour: Colour, *, opacity: float = 1.0, wear: float) -> None:
        """Fill a polygon (metres) with road paint; ``wear`` in [0, 1] is the share that has come off."""
        window, mask = _filled(self.pixels(outline), len(self.picture), 3, np.uint8(255))
        if mask.size:
            alpha = mask.astype(np.float32) * (opacity / 255) * self._left(window, wear)
            fill = np.full((*mask.shape, 3), colour, np.uint8)
            below = np.ascontiguousarray(self.picture[window])
            self.picture[window] = cv2.blendLinear(below, fill, 1 - alpha, alpha)

    def _left(self, window: _Window, wear: float) -> Plane:
        """Return the share of road paint that is left in a window."""
        return np.clip((self._wear[window] - wear * 0.9) * 5 + 0.25, 0.04, 1.0)

    def stripe(
        self, start: ArrayLike, end: ArrayLike, width: float, colour: Colour, *, opacity: float = 1.0, wear: float
    ) -> None:
        """Paint a straight line of a given width (metres)."""
        a, b = np.asarray(start, float), np.asarray(end, float)
        side = np.array([a[1] - b[1], b[0] - a[0]])
        side *= width / 2 / np.linalg.norm(side)
        self.paint([a - side, b - side, b + side, a + side], colour, opacity=opacity, wear=wear)

    @_later
    def text(
        self, words: str, at: ArrayLike, height: float, colour: Colour, *, turned: bool = False, wear: float
    ) -> None:
        """Stencil block letters centred at a point (metres); ``turned`` reads along y."""
        scale = height * self.per_m / 21
        (width, tall), _ = cv2.getTextSize(words, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)
        stroke = max(2, round(height * self.per_m * 0.13))
        mask = np.zeros((tall + 4 * stroke, width + 4 * stroke), np.uint8)
        cv2.putText(
            mask, words, (2 * stroke, tall + 2 * stroke), cv2.FONT_HERSHEY_SIMPLEX, scale, 255, stroke, cv2.LINE_AA
        )
        mask = np.rot90(mask).copy() if turned else mask
        column, row = np.round(self.pixels(at)[0] - np.array(mask.shape[::-1]) / 2).astype(int)
        if min(column, row) < 0 or max(column + mask.shape[1], row + mask.shape[0]) > len(self.picture):
            return
        window = np.s_[row : row + mask.shape[0], column : column + mask.shape[1]]
        alpha = mask[..., None] / 255.0 * self._left(window, wear)[..., None]
        self.picture[window] = self.picture[window] * (1 - alpha) + np.array(colour) * alpha

    @_later
    def grime(self, outline: ArrayLike, depth: float, *, blur: float) -> None:
        """Darken a polygon (metres) softly by an optical depth; ``blur`` is the width of its edge, metres."""
        sigma = blur * self.per_m / COARSE
        window, mask = _filled(self.pixels(outline, 1 / COARSE), len(self._dirt), int(3 * sigma) + 2, np.float32(depth))
        if mask.size:
            self._dirt[window] += cv2.GaussianBlur(mask, (0, 0), max(sigma, 0.3))

    def tracks(self, way: ArrayLike, depth: float, *, width: float, gauge: float = 2.0) -> None:
        """Two tyre tracks along a polyline (metres)."""
        self._tracks(way, depth, width, gauge, noise(self._rng, cells=14, octaves=2))

    @_later
    def _tracks(self, way: ArrayLike, depth: float, width: float, gauge: float, broken: list[Plane]) -> None:
        points = np.asarray(way, float)
        along = np.gradient(points, axis=0)
        side = np.stack([-along[:, 1], along[:, 0]], 1) / np.linalg.norm(along, axis=1, keepdims=True)
        mask = np.zeros_like(self._dirt, np.uint8)
        for offset in (-gauge / 2, gauge / 2):
            for shift, weight in ((0.0, width), (0.1 * width, 0.5 * width)):
                line = np.round(self.pixels(points + side * (offset + shift), 1 / COARSE) * 16).astype(np.int32)
                thick = max(1, round(weight * self.per_m / COARSE))
                cv2.polylines(mask, [line], False, 255 if weight < width else 150, thick, cv2.LINE_AA, 4)
        patchy = cv2.resize(0.35 + 0.65 * cloud((512, 512), broken), mask.shape)
        self._dirt += cv2.GaussianBlur(mask, (0, 0), 1.2).astype(np.float32) * (depth / 255) * patchy

    def blot(self, at: ArrayLike, radius: float, depth: float) -> None:
        """Stain with a ragged edge: oil, damp, or soot (metres, optical depth)."""
        angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
        reach = np.ones(40)
        for wave in range(2, 8):
            reach += self._rng.normal(0, 0.45 / wave) * np.cos(wave * angle + self._rng.uniform(0, 6.3))
        outline = np.asarray(at) + radius * np.clip(reach, 0.3, 2)[:, None] * np.stack(
            [np.cos(angle), np.sin(angle)], 1
        )
        self.grime(outline, 0.65 * depth, blur=0.07 * radius)
        self.grime(np.asarray(at) + 0.7 * (outline - np.asarray(at)), 0.5 * depth, blur=0.14 * radius)

    def mottle(self, depth: float) -> None:
        """Darken everything unevenly: dust and damp at the scale of metres, up to an optical depth."""
        self._mottle(depth, noise(self._rng, cells=9, octaves=5))

    @_later
    def _mottle(self, depth: float, drawn: list[Plane]) -> None:
        n = len(self._dirt) // 4
        patchy = cloud((n, n), drawn)
        self._dirt += cv2.resize(depth * np.clip((patchy - 0.42) * 2, 0, 1), self._dirt.shape[::-1])

    def glance(self, pixels: int) -> Paint:
        """Return what paints the dirty picture so far at a lower resolution."""

        @cache
        def look() -> Picture:
            small = cv2.resize(self.picture, (pixels, pixels), interpolation=cv2.INTER_AREA)
            dirt = cv2.resize(self._dirt, (pixels, pixels), interpolation=cv2.INTER_AREA)
            return np.asarray(small * np.exp(-dirt[..., None]), np.uint8)

        def seen() -> Picture:
            self._paint_strokes()
            return look()

        self._strokes.append(look)
        return seen

    def _paint_strokes(self) -> None:
        """Paint what was ordered and is not painted yet."""
        strokes, self._strokes = self._strokes, []
        for stroke in strokes:
            stroke()

    def spill(self, cover: Array, low: ArrayLike, high: ArrayLike) -> None:
        """Strew cargo: ``cover`` (rows along −y, columns along x) stretched over a rectangle given in metres."""
        left, bottom = np.round(self.pixels(low, 1 / COARSE)[0]).astype(int)
        right, top = np.round(self.pixels(high, 1 / COARSE)[0]).astype(int)
        full = cv2.resize(cover.astype(np.float32), (right - left, bottom - top))
        n = len(self._spill)
        x0, x1, y0, y1 = max(left, 0), min(right, n), max(top, 0), min(bottom, n)
        if x0 < x1 and y0 < y1:
            self._spill[y0:y1, x0:x1] = np.maximum(
                self._spill[y0:y1, x0:x1], full[y0 - top : y1 - top, x0 - left : x1 - left]
            )

    def finish(self, cargo: Cargo | None = None) -> Paint:
        """Return what paints all, with dirt and the cargo that was spilt."""
        scattered = None if cargo is None else self._scattered()
        return cache(lambda: self._finished(cargo, scattered))

    def _finished(self, cargo: Cargo | None, scattered: _Scattered | None) -> Picture:
        self._paint_strokes()
        base = self.picture
        n = len(base)
        broken = cv2.resize(self._wear, self._dirt.shape[::-1])
        depth = cv2.convertScaleAbs(self._dirt * (0.45 + 1.1 * broken), alpha=100)
        lut = np.exp(-np.arange(256)[:, None] / 100 * np.array((1, 1.04, 1.1))) * 255
        shade = cv2.LUT(cv2.merge([depth] * 3), lut.astype(np.uint8)[None])
        shade = cv2.resize(shade, (n, n))
        picture = cv2.multiply(base, shade, scale=1 / 255)
        del self.picture, self._dirt, self._wear  # a world keeps its textures, not what they were made of
        if cargo is None or scattered is None:
            return np.asarray(picture, np.uint8)
        tile = shrunk(load(cargo.texture), self.per_m / (1024 / cargo.tile_m))
        (top, bottom, left, right), drawn, grit = scattered
        coarse = np.s_[top:bottom, left:right]
        fine = np.s_[COARSE * top : COARSE * bottom, COARSE * left : COARSE * right]
        shape = COARSE * (bottom - top), COARSE * (right - left)
        laid = tiled(tile, *shape)
        uneven = cloud((shape[0] // 8, shape[1] // 8), drawn)
        uneven = cv2.resize((205 + 85 * (uneven - 0.5)).astype(np.uint8), shape[::-1])
        laid = cv2.multiply(laid, cv2.merge([uneven] * 3), scale=1 / 205)
        window = self._spill[coarse]
        # Loose lumps thin out one by one rather than fade.
        grit = cv2.GaussianBlur(grit, (0, 0), 1.1)
        threshold = 0.55 * broken[coarse] + (grit * 0.006 - 0.45)
        thinned = np.clip((window * 1.35 - threshold) * 4.0, 0, 1) * np.clip(window * 4, 0, 1)
        alpha = cv2.resize(thinned.astype(np.float32), shape[::-1])
        picture[fine] = cv2.blendLinear(np.ascontiguousarray(picture[fine]), laid, 1 - alpha, alpha)
        return np.asarray(picture, np.uint8)

    def _scattered(self) -> _Scattered | None:
        """Draw how cargo lies; None without any."""
        if not self._spill.any():
            return None
        rows, columns = np.nonzero(self._spill.any(1))[0], np.nonzero(self._spill.any(0))[0]
        top, bottom, left, right = int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1
        uneven = noise(self._rng, cells=9, octaves=4)
        return (top, bottom, left, right), uneven, self._rng.integers(0, 256, (bottom - top, right - left), np.uint8)
