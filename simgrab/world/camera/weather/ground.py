"""What weather has left on the ground: water in the pores and in puddles, and snow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from simgrab.model.geometry import Array
from simgrab.model.scenario import Weather
from simgrab.world.camera.row_blocks import each_block, enlarged
from simgrab.world.camera.weather import noise
from simgrab.world.camera.weather.layer import Layer, Maker
from simgrab.world.camera.weather.render_pass import Picture, RenderPass
from simgrab.world.camera.weather.surface import STEP, Surface, surface
from simgrab.world.scenery.model import PLACE, ROPE

SPAN_M = 51.2  # noise repeats after so much
WET_ALBEDO = 0.6  # share of a porous surface's albedo that is left when it is wet (Lekner & Dorf 1988)
PUDDLE_ALBEDO = 0.3  # wet through, and mud besides
MOST_PUDDLES = 0.35  # share of the level ground
LEVEL = 0.995  # cosine of the steepest slope on which water stands
FRESNEL = 0.02  # of water at normal incidence, n = 1.33
PUDDLE_SLOPE, FILM_SLOPE = 0.05, 0.2  # rms slope of each component: a rippled puddle, a film on concrete
SNOW_ALBEDO = 0.88
STEEPEST_SNOW = (0.5, 0.8)  # cosines between which less and less snow stays
DUSTING = 0.45  # of the cover, on moving steel


@dataclass(frozen=True, eq=False)
class Lamp:
    """A lamp or the sun.

    Attributes
    ----------
    position_m : ndarray, shape (3,)
        Jib frame; the sun is very far away.
    light : float
        Linear radiance of a white matte surface that faces it from the ground below the camera.
    """

    position_m: Array
    light: float


def ground(weather: Weather, rendered: RenderPass, lamps: Sequence[Lamp], white: float, *, seed: int) -> Maker:
    """Wet the ground and lay snow on it.

    The weather has some wetness, from 0.5 on with puddles, or snow cover, or both. The unit of the layer's glow is
    ``white``, the linear brightness of the sky.
    """
    height = -(-len(rendered.depth) // STEP)
    if weather.wetness:
        puddles = noise.tile(seed, 0, "weather.puddles", 1.45)
        wet = each_block(height, partial(_wet, puddles, weather.wetness, lamps, white, rendered))
        layer = Layer(*map(np.concatenate, zip(*wet, strict=True)))
    if weather.snow_cover:
        patches = noise.tile(seed, 0, "weather.snow.cover", 1.5)
        lying = each_block(height, partial(_snow, patches, weather.snow_cover, rendered))
        cover, pattern = map(np.concatenate, zip(*lying, strict=True))
        snow = _lit(rendered, cover, pattern, white)
        layer = layer.behind(snow) if weather.wetness else snow
    return _enlarged(layer, rendered)


def _wet(
    puddles: Picture, wetness: float, lamps: Sequence[Lamp], white: float, rendered: RenderPass, rows: slice
) -> tuple[Picture, Picture]:
    """Darken porous ground, and let it mirror the sky and the lamps: `Layer.keep` and `Layer.glow`."""
    on = surface(rendered, rows)
    share = MOST_PUDDLES * max(0.0, 2 * wetness - 1)
    pattern = noise.look_up(puddles, on.x, on.y, SPAN_M)
    puddle = noise.covered(pattern, share, 0.03) * (on.up > LEVEL)
    damp = np.float32(1 - (1 - WET_ALBEDO) * min(1.0, 2 * wetness))
    keep = np.where(on.solid, damp + (PUDDLE_ALBEDO - damp) * puddle, np.float32(1))
    ground_z = rendered.centre_m[2] - rendered.height_m
    camera = _towards(rendered.centre_m, on, ground_z)
    steep = camera[2]  # cosine of the angle of incidence
    mirror = (FRESNEL + (1 - FRESNEL) * cv2.pow(1 - steep, 5)) * on.solid * np.float32(min(1.0, 2 * wetness))
    glow = mirror * (np.float32(0.5) + np.float32(0.5) * puddle)  # the film does not cover every grain
    for lamp in lamps:
        hx, hy, hz = (a + b for a, b in zip(camera, _towards(lamp.position_m, on, ground_z), strict=True))
        lean = cv2.divide(hx * hx + hy * hy, np.maximum(hz * hz, np.float32(1e-6)))
        shine = _slopes(lean, PUDDLE_SLOPE) * puddle + _slopes(lean, FILM_SLOPE) * (np.float32(0.5) - 0.5 * puddle)
        # Radiance of a lamp's mirror image over the lamp's light and the Fresnel coefficient (Cox & Munk 1954):
        # π p(slopes) / (4 cos θ cos⁴ β), β being the lean of the facet that mirrors the lamp into the camera.
        shine *= np.float32(np.pi / 4 * lamp.light / white) * np.square(1 + lean)
        glow += mirror * shine / np.maximum(steep, np.float32(0.05))
    return keep, glow


def _towards(point_m: Array, on: Surface, ground_z: float) -> tuple[Picture, Picture, Picture]:
    """Return unit vectors from the surface to a point, jib frame."""
    dx, dy = np.float32(point_m[0]) - on.jib_x, np.float32(point_m[1]) - on.jib_y
    dz = np.float32(point_m[2] - ground_z) - on.height
    inverse = 1 / np.sqrt(dx * dx + dy * dy + dz * dz)
    return dx * inverse, dy * inverse, dz * inverse


def _slopes(squared: Picture, rms: float) -> Picture:
    """Density of facets of a squared slope."""
    return np.asarray(cv2.exp(squared * np.float32(-0.5 / rms**2)) * np.float32(1 / (2 * np.pi * rms**2)))


def _snow(patches: Picture, cover: float, rendered: RenderPass, rows: slice) -> tuple[Picture, Picture]:
    """Lay snow on what faces upwards, thinly on grab and jib: share of each pixel, and the noise of its grain."""
    on = surface(rendered, rows)
    pattern = noise.look_up(patches, on.x, on.y, SPAN_M)
    low, high = STEEPEST_SNOW
    hold = np.clip((on.up - np.float32(low)) / np.float32(high - low), 0, 1)
    ids = rendered.ids[::STEP, ::STEP][rows]
    steel = (ids != PLACE) & (ids <= 3)
    lying = noise.covered(pattern, cover, 0.12) * on.solid + noise.covered(pattern, DUSTING * cover, 0.5) * steel
    return (hold * lying).astype(np.float32), pattern


def _lit(rendered: RenderPass, snow: Picture, pattern: Picture, white: float) -> Layer:
    """Light snow as the scene is lit; its grain follows a pattern."""
    # As bright as white where the picture is of mean brightness; large light and shade show on it more than small.
    (height, width), grey = snow.shape, np.empty_like(snow)

    def look(rows: slice) -> None:
        light = rendered.light[rows.start * STEP : rows.stop * STEP : STEP]
        grey[rows] = cv2.cvtColor(light, cv2.COLOR_RGB2GRAY)[:, ::STEP]

    each_block(height, look)
    size = max(1, width // 32), max(1, height // 32)
    small = cv2.GaussianBlur(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), (0, 0), 2.0)
    mean, floor = np.float32(max(float(small.mean()), 1e-6)), np.float32(0.02 * white)
    bright = cv2.pow(np.clip(small / mean, np.float32(0.05), np.float32(4)), 0.35)
    large, wide = (cv2.resize(m, (width, height)) for m in (small, bright))
    layer = Layer(np.empty_like(snow), np.empty_like(snow))

    def shine(rows: slice) -> None:
        contrast = (grey[rows] + floor) / (large[rows] + floor)
        fine = cv2.pow(np.clip(contrast, np.float32(0.1), np.float32(2)), 0.12)
        grain = np.float32(0.94) + np.float32(0.12) * pattern[rows]
        light = np.minimum(np.float32(SNOW_ALBEDO) * wide[rows] * fine * grain, np.float32(1.05))
        np.subtract(1, snow[rows], out=layer.keep[rows])
        np.multiply(snow[rows], light, out=layer.glow[rows])

    each_block(height, shine)
    return layer


def _enlarged(layer: Layer, rendered: RenderPass) -> Maker:
    """Enlarge to the picture, with edges that are soft instead of stepped, and leave the ropes alone."""
    soft = [cv2.GaussianBlur(m, (3, 3), 0) for m in (layer.keep, layer.glow)]

    def block(rows: slice) -> Layer:
        keep, glow = (enlarged(m, STEP, rows, rendered.intrinsics.width_px) for m in soft)
        ropes = rendered.ids[rows] == ROPE
        keep[ropes], glow[ropes] = 1, 0
        return Layer(keep, glow)

    return block
