"""Vignetting and lateral chromatic aberration: what the lens does off its axis."""

from __future__ import annotations

import math
from functools import lru_cache

import cv2
import numpy as np
from scipy.interpolate import RectBivariateSpline

from simgrab.model.geometry import Intrinsics
from simgrab.world.camera.optics.light import Light

_NODES = 65  # a side; at 1080p the spline between them is good to 1e-7


def vignetting(intrinsics: Intrinsics, stops: float) -> Light:
    """Share of the light that reaches each pixel, shape (height, width): cosⁿ of its undistorted ray's field angle.

    The corner farthest from the optical axis loses ``stops``. n is 4, the natural law of a lens without stray pupils,
    for 4·log2(1/cos) of that corner's angle: 1.07 stops for the paper's lens. Mechanical vignetting comes on top.
    """
    return np.exp2(np.float32(-stops) * _falloff(intrinsics))


@lru_cache(maxsize=2)
def _falloff(intrinsics: Intrinsics) -> Light:
    """Logarithm of the field angle's cosine, from 0 on the axis to 1 in the farthest corner."""
    w, h = intrinsics.width_px, intrinsics.height_px
    u, v = np.linspace(0, w, _NODES), np.linspace(0, h, _NODES)
    rays = intrinsics.rays(np.stack(np.meshgrid(u, v), axis=-1))
    log_cosine = np.log(rays[..., 2])
    spline = RectBivariateSpline(v, u, log_cosine / log_cosine.min())
    result: Light = spline(np.arange(h) + 0.5, np.arange(w) + 0.5).astype(np.float32)
    result.setflags(write=False)
    return result


def chromatic(light: Light, intrinsics: Intrinsics, corner_px: float) -> Light:
    """Magnify red and shrink blue of light (height, width, 3) about the principal point; green stays.

    At the corner farthest from it red moves outwards, and blue inwards, by ``corner_px``.
    """
    if corner_px == 0:
        return light
    h, w = light.shape[:2]
    x, y = intrinsics.cx_px - 0.5, intrinsics.cy_px - 0.5  # OpenCV's integer centres
    stretch = corner_px / math.hypot(max(x, w - 1 - x), max(y, h - 1 - y))
    red, green, blue = (cv2.extractChannel(light, i) for i in range(3))
    return np.asarray(cv2.merge([_magnified(red, 1 + stretch, x, y), green, _magnified(blue, 1 - stretch, x, y)]))


def _magnified(channel: Light, scale: float, x: float, y: float) -> Light:
    back = np.array([[1 / scale, 0, x - x / scale], [0, 1 / scale, y - y / scale]])
    size = channel.shape[1], channel.shape[0]
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(channel, back, size, flags=flags, borderMode=cv2.BORDER_REPLICATE))
