"""The cover glass before the lens: drops, dirt and snow on it, far out of focus and in place for a whole clip."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from simgrab.model.geometry import Array, Intrinsics
from simgrab.model.rng import stream
from simgrab.model.scenario import Weather
from simgrab.world.camera.row_blocks import each_block, enlarged
from simgrab.world.camera.weather import noise
from simgrab.world.camera.weather.layer import Layer, Maker, matte
from simgrab.world.camera.weather.render_pass import Picture, Vector
from simgrab.world.camera.weather.streaks import APERTURE_M

GLASS_M = 0.05  # from the lens to the glass
COARSE = 8  # pixels of the picture for each of the masks', which are blurred more than that anyway
DIRT_OPACITY, SNOW_OPACITY = 0.75, 0.95
DIRT: Vector = (0.30, 0.26, 0.21)  # lit from outside, as a share of white
SNOW_LIGHT = 0.75  # lit from below and through the snow
DIRT_SPAN_M = 0.06
DROP_SPREAD = 0.45  # standard deviation of the logarithm of a drop's diameter
REFRACTION = 2.5  # a drop shows the scene upside down, from so much farther out
SKY_AT_RIM = 0.3  # a drop's rim bends light in from the horizon
REFRACTED_BLUR = 1.6  # coarse pixels


@dataclass(frozen=True, eq=False)
class Glass:
    """What lies on the glass.

    Attributes
    ----------
    drops : ndarray of float32, shape (h, w)
        Share of each coarse pixel's light that comes through a drop.
    source : ndarray of float32, shape (h, w, 2)
        Coarse pixel that drops show, for each coarse pixel.
    sky : ndarray of float32, shape (h, w)
        Share of the sky in what drops show.
    dirt, snow : ndarray of float32, shape (height, width)
        Share of light that is kept out.
    """

    drops: Picture
    source: Picture
    sky: Picture
    dirt: Picture
    snow: Picture

    def put_drops(self, light: Picture, keep: Picture, white: Vector) -> None:
        """Put the drops before a picture (height, width, 3) and the share of light that was kept: both change."""
        shown = cv2.multiply(self._refracted(light, white), cv2.cvtColor(self.drops, cv2.COLOR_GRAY2RGB))

        def refract(rows: slice) -> None:
            for columns in self._wet(rows):
                at, coarse = (rows, columns), slice(columns.start // COARSE, -(-columns.stop // COARSE))
                width = columns.stop - columns.start
                through = 1 - enlarged(self.drops[:, coarse], COARSE, rows, width)
                block = cv2.multiply(light[at], cv2.cvtColor(through, cv2.COLOR_GRAY2RGB))
                np.add(block, enlarged(shown[:, coarse], COARSE, rows, width), out=light[at])
                keep[at] *= through

        each_block(len(keep), refract)

    def _wet(self, rows: slice) -> Iterator[slice]:
        """Columns of the picture in which drops are seen in some of its rows, with a coarse pixel around them."""
        near = self.drops[max(rows.start // COARSE - 1, 0) : -(-rows.stop // COARSE) + 1]
        wet = np.asarray(cv2.dilate(near.any(axis=0).astype(np.uint8), np.ones((3, 1), np.uint8))).ravel()
        edges = np.flatnonzero(np.diff(wet, prepend=0, append=0)) * COARSE
        for start, stop in zip(edges[0::2].tolist(), edges[1::2].tolist(), strict=True):
            yield slice(start, min(stop, self.dirt.shape[1]))

    def _refracted(self, light: Picture, white: Vector) -> Picture:
        """Return what drops show, in coarse pixels."""
        h, w = self.source.shape[:2]
        coarse = cv2.GaussianBlur(cv2.resize(light, (w, h), interpolation=cv2.INTER_AREA), (0, 0), REFRACTED_BLUR)
        shown = cv2.remap(coarse, self.source, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
        shown = cv2.GaussianBlur(shown, (0, 0), 1.0)
        return matte(1 - self.sky).over(shown, white)


def lying(part: Picture, brightness: float) -> Maker:
    """Return dirt or snow that keeps out a share of the light, shape (height, width)."""

    def block(rows: slice) -> Layer | None:
        return matte(1 - part[rows], brightness) if part[rows].any() else None

    return block


@lru_cache(maxsize=2)
def glass(weather: Weather, intrinsics: Intrinsics, *, seed: int, clip: int) -> Glass:
    """Dirty the glass of one clip."""
    size = intrinsics.width_px, intrinsics.height_px
    w, h = (-(-n // COARSE) for n in size)
    focal = intrinsics.f_px / COARSE
    aperture = _disc(APERTURE_M / GLASS_M * focal)
    drops, source, sky = _drops(weather, (h, w), focal, stream(seed, clip, "weather.lens.drops"))
    dirt, snow = _dirt(weather.lens_dirt, (h, w), focal, seed, clip), _rim(weather.lens_snow, (h, w), focal, seed, clip)

    def blurred(mask: Picture, opacity: float) -> Picture:
        spread = cv2.filter2D(mask * np.float32(opacity), cv2.CV_32F, aperture, borderType=cv2.BORDER_REFLECT)
        return np.clip(spread, 0, 1)

    def seen(mask: Picture) -> Picture:
        return enlarged(mask, COARSE, slice(0, size[1]), size[0])

    dirt, snow = blurred(dirt, DIRT_OPACITY), blurred(snow, SNOW_OPACITY)
    return Glass(blurred(drops, 1.0), source, sky, seen(dirt), seen(snow))


def _disc(diameter: float) -> Picture:
    """Return the blur of a point on the glass: the aperture's own shape, antialiased, of sum 1."""
    half = int(np.ceil(diameter / 2))
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    disc = np.clip(diameter / 2 - np.hypot(x, y) + 0.5, 0, 1)
    return np.asarray(disc / disc.sum(), np.float32)


def _drops(
    weather: Weather, shape: tuple[int, int], focal: float, rng: np.random.Generator
) -> tuple[Picture, Picture, Picture]:
    """Masks of drops in focus, where what they show lies, and how much of the sky they show."""
    h, w = shape
    mask, sky = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    y, x = np.mgrid[0:h, 0:w].astype(np.float32)
    source = np.stack([x, y], axis=-1)
    scale = focal / GLASS_M / 1000
    for _ in range(weather.lens_drops):
        cx, cy = rng.uniform(0, w), rng.uniform(0, h)
        a = weather.lens_drop_mm / 2 * rng.lognormal(0, DROP_SPREAD) * scale
        b, angle = a * rng.uniform(0.75, 1.0), rng.uniform(0, np.pi)
        far = _ellipse(x - cx, y - cy, a, b, angle)
        mask = np.maximum(mask, np.float32(np.clip((1 - far) * b + 0.5, 0, 1)))
        # The blurred drop reaches beyond itself by half an aperture.
        near = far < 1 + APERTURE_M / 2 / GLASS_M * focal / b
        sky[near] = SKY_AT_RIM * np.minimum(far[near], 1.2) ** 3
        source[near] = (cx, cy) - REFRACTION * (np.stack([x - cx, y - cy], axis=-1)[near])
    sky = cv2.GaussianBlur(sky, (0, 0), 1.0)
    return mask, source.astype(np.float32), sky


def _ellipse(x: Picture, y: Picture, a: float, b: float, angle: float) -> Array:
    """Distance from the middle, 1 on the ellipse."""
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(np.hypot((c * x + s * y) / a, (c * y - s * x) / b))


def _dirt(share: float, shape: tuple[int, int], focal: float, seed: int, clip: int) -> Picture:
    if not share:
        return np.zeros(shape, np.float32)
    return _covered(_glass_noise("weather.lens.dirt", shape, focal, seed, clip), share, 0.1)


def _rim(share: float, shape: tuple[int, int], focal: float, seed: int, clip: int) -> Picture:
    """Snow from the rim inwards, more of it on one side."""
    if not share:
        return np.zeros(shape, np.float32)
    h, w = shape
    y, x = np.mgrid[-1 : 1 : h * 1j, -1 : 1 : w * 1j]
    angle = stream(seed, clip, "weather.lens.snow.side").uniform(0, 2 * np.pi)
    out = np.maximum(np.abs(x), np.abs(y)) + 0.35 * (np.cos(angle) * x + np.sin(angle) * y)
    return _covered(0.5 * _glass_noise("weather.lens.snow", shape, focal, seed, clip) - out, share, 0.04)


def _glass_noise(name: str, shape: tuple[int, int], focal: float, seed: int, clip: int) -> Picture:
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float32) * np.float32(GLASS_M / focal)
    return noise.look_up(noise.tile(seed, clip, name, 1.6), x, y, DIRT_SPAN_M)


def _covered(field: Picture, share: float, softness: float) -> Picture:
    """Cover the share of the glass in view, not of a larger one, where a field is least."""
    return noise.covered(noise.ranked(field, within=0.5), share, softness)
