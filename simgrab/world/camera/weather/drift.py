"""Dust that a strong wind drives along the ground, in streamers that lie along it."""

from __future__ import annotations

import math

import cv2
import numpy as np

from simgrab.model.geometry import Array
from simgrab.world.camera.weather import noise
from simgrab.world.camera.weather.layer import Layer
from simgrab.world.camera.weather.render_pass import Picture, RenderPass, Vector
from simgrab.world.camera.weather.surface import Surface, coarse_rays

TINT: Vector = (0.66, 0.58, 0.47)  # of a dense cloud of soil and cement, as a share of a white one's
SCALE_HEIGHT_M = 1.2  # its density falls by e in so much height
SHELTERED_M = 1.0  # below the ground the wind does not reach
ACROSS_M = 24.0  # the pattern repeats after so much across the wind,
STRETCH = 10.0  # and so many times as much along it
SHARPNESS = 4.0  # exponent of the ranks: most of the dust moves in few streamers (Baas & Sherman 2005)


def drift(rendered: RenderPass, on: Surface, thickness: float, wind_m_s: Array, time_s: float, *, seed: int) -> Layer:
    """Return the dust between the camera and the ground; its glow is in units of `TINT`.

    The pattern travels with the wind (3,) of the jib frame unchanged (Taylor's hypothesis). The mean optical thickness
    is that of the whole layer, seen from straight above.
    """
    wind = wind_m_s if rendered.jib_from_place is None else rendered.jib_from_place.rotation.T @ wind_m_s  # place frame
    speed = math.hypot(wind[0], wind[1])
    east, north = (np.float32(w / speed) for w in wind[:2]) if speed else (np.float32(1), np.float32(0))
    along = on.x * east + on.y * north - np.float32(speed * time_s % (STRETCH * ACROSS_M))
    across = on.y * east - on.x * north
    pattern = noise.look_up(noise.tile(seed, 0, "weather.drift", 1.25), along / np.float32(STRETCH), across, ACROSS_M)
    streamers = np.float32(SHARPNESS + 1) * cv2.pow(pattern, SHARPNESS)  # of mean 1
    # Above a point at height h lies the share exp(−h / scale) of the layer.
    above = cv2.exp(-np.maximum(on.height, 0) / np.float32(SCALE_HEIGHT_M)) * _swept(on)
    slant = coarse_rays(rendered.intrinsics).length  # the camera looks down
    keep = cv2.exp(np.float32(-thickness) * streamers * above * slant)
    size = rendered.depth.shape[::-1]
    keep = cv2.resize(keep, size, interpolation=cv2.INTER_LINEAR)
    return Layer(keep, 1 - keep)


def _swept(on: Surface) -> Picture:
    """Where the wind takes dust along: not over open water, and not down in a hold."""
    return np.asarray(on.solid * np.clip(1 + on.height / np.float32(SHELTERED_M), 0, 1), np.float32)
