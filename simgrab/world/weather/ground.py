"""What weather has left on the ground: water in the pores and in puddles, and snow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from simgrab.world.model import PLACE, ROPE
from simgrab.world.weather import noise
from simgrab.world.weather.layer import Layer
from simgrab.world.weather.sight import Picture, Sight, Vector
from simgrab.world.weather.surface import STEP, Surface, coarse_rays

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


@dataclass(frozen=True)
class Lamp:
    """A lamp or the sun.

    Attributes
    ----------
    position_m : tuple of 3 floats
        Jib frame; the sun is very far away.
    light : float
        Linear radiance of a white matte surface that faces it from the ground below the camera.
    """

    position_m: Vector
    light: float


def wet(sight: Sight, on: Surface, wetness: float, lamps: Sequence[Lamp], white: float, *, seed: int) -> Layer:
    """Darken porous ground, and let it mirror the sky and the lamps.

    Parameters
    ----------
    sight : Sight
    on : Surface
    wetness : float
        0 to 1; from 0.5 on, puddles.
    lamps : sequence of Lamp
    white : float
        Linear brightness of the sky, which is the unit of the layer's glow.
    seed : int
    """
    share = MOST_PUDDLES * max(0.0, 2 * wetness - 1)
    pattern = noise.look_up(noise.tile(seed, 0, "weather.puddles", 1.45), on.x, on.y, SPAN_M)
    puddle = noise.covered(pattern, share, 0.03) * (on.up > LEVEL)
    damp = np.float32(1 - (1 - WET_ALBEDO) * min(1.0, 2 * wetness))
    keep = np.where(on.solid, damp + (PUDDLE_ALBEDO - damp) * puddle, np.float32(1))
    rays = coarse_rays(sight.intrinsics)
    down = sight.jib_from_camera[2].astype(np.float32)
    steep = -(down[0] * rays.x + down[1] * rays.y + down[2]) / rays.length  # cosine of the angle of incidence
    mirror = (FRESNEL + (1 - FRESNEL) * (1 - steep) ** 5) * on.solid * min(1.0, 2 * wetness)
    glow = mirror * (np.float32(0.5) + np.float32(0.5) * puddle)  # the film does not cover every grain
    for lamp in lamps:
        shine = _glint(sight, on, lamp, steep, PUDDLE_SLOPE) * puddle
        shine += _glint(sight, on, lamp, steep, FILM_SLOPE) * (1 - puddle) * np.float32(0.5)
        glow = glow + mirror * shine * np.float32(lamp.light / white)
    return _enlarged(Layer(keep, glow.astype(np.float32)), sight)


def _glint(sight: Sight, on: Surface, lamp: Lamp, steep: Picture, slope: float) -> Picture:
    """Radiance of a lamp's mirror image over the lamp's light and the Fresnel coefficient (Cox & Munk 1954).

    π p(slopes) / (4 cos θ cos⁴ β), β being the lean of the facet that mirrors the lamp into the camera.
    """
    camera_z, ground_z = sight.centre_m[2], sight.centre_m[2] - sight.height_m
    halfway = []
    for point in ((*sight.centre_m[:2], camera_z), lamp.position_m):
        dx, dy = np.float32(point[0]) - on.jib_x, np.float32(point[1]) - on.jib_y
        dz = np.float32(point[2] - ground_z) - on.height
        inverse = 1 / np.sqrt(dx * dx + dy * dy + dz * dz)
        halfway.append((dx * inverse, dy * inverse, dz * inverse))
    hx, hy, hz = (a + b for a, b in zip(*halfway, strict=True))
    squared = (hx * hx + hy * hy) / np.maximum(hz * hz, np.float32(1e-6))
    density = cv2.exp(squared * np.float32(-0.5 / slope**2)) * np.float32(1 / (2 * np.pi * slope**2))
    return np.asarray(np.float32(np.pi / 4) * density * (1 + squared) ** 2 / np.maximum(steep, np.float32(0.05)))


def snow_cover(sight: Sight, on: Surface, cover: float, white: float, *, seed: int) -> Layer:
    """Lay snow on what faces upwards: fully on the place, thinly on grab and jib.

    The snow is as bright as white is where the picture is of mean brightness; light and shade of the scene show on it,
    the large ones more than the small.
    """
    pattern = noise.look_up(noise.tile(seed, 0, "weather.snow.cover", 1.5), on.x, on.y, SPAN_M)
    low, high = STEEPEST_SNOW
    hold = np.clip((on.up - np.float32(low)) / np.float32(high - low), 0, 1)
    ids = sight.ids[::STEP, ::STEP]
    steel = (ids != PLACE) & (ids <= 3)
    lying = noise.covered(pattern, cover, 0.12) * on.solid + noise.covered(pattern, DUSTING * cover, 0.5) * steel
    snow = (hold * lying).astype(np.float32)
    return _enlarged(Layer(1 - snow, snow * _snow_light(sight, pattern, white)), sight)


def _snow_light(sight: Sight, pattern: Picture, white: float) -> Picture:
    """Radiance of snow, in units of white."""
    grey = cv2.cvtColor(np.ascontiguousarray(sight.light[::STEP, ::STEP]), cv2.COLOR_RGB2GRAY)
    height, width = grey.shape
    coarse = cv2.resize(grey, (max(1, width // 32), max(1, height // 32)), interpolation=cv2.INTER_AREA)
    large = cv2.resize(cv2.GaussianBlur(coarse, (0, 0), 2.0), (width, height), interpolation=cv2.INTER_LINEAR)
    floor = np.float32(0.02 * white)
    mean = np.float32(max(float(grey.mean()), 1e-6))
    wide = cv2.pow(np.clip(large / mean, np.float32(0.05), np.float32(4)), 0.35)
    fine = cv2.pow(np.clip((grey + floor) / (large + floor), np.float32(0.1), np.float32(2)), 0.12)
    grain = np.float32(0.94) + np.float32(0.12) * pattern
    return np.minimum(np.float32(SNOW_ALBEDO) * wide * fine * grain, np.float32(1.05))


def _enlarged(layer: Layer, sight: Sight) -> Layer:
    """Enlarge to the picture, with edges that are soft instead of stepped, and leave the ropes alone."""
    size = sight.depth.shape[::-1]
    soft = (cv2.GaussianBlur(m, (3, 3), 0) for m in (layer.keep, layer.glow))
    keep, glow = (cv2.resize(m, size, interpolation=cv2.INTER_LINEAR) for m in soft)
    ropes = sight.ids == ROPE
    keep[ropes], glow[ropes] = 1, 0
    return Layer(keep, glow)
