"""The air between camera and scene: fog, and rain and snow too far away to be seen one by one."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from simgrab.world.model import FAR_M
from simgrab.world.weather.layer import Layer, matte
from simgrab.world.weather.precipitation import Precipitation
from simgrab.world.weather.sight import Picture, Sight, ray_maps

KOSCHMIEDER = 3.912  # −ln 0.02: what is left of a black thing's contrast at the visibility
TABLE_STEP_M, TABLE_END_M = 0.05, FAR_M + 1


def haze(sight: Sight, visibility_m: float | None, precipitation: Sequence[Precipitation]) -> Layer:
    """Return the homogeneous part of the air.

    Light keeps exp(−∫σ ds) along its true path, and the air adds what it scatters into it (Koschmieder 1924).

    Parameters
    ----------
    sight : Sight
    visibility_m : float or None
        Of the fog; None is clear air.
    precipitation : sequence of Precipitation
        Each counts from the depth on to which its particles are drawn.
    """
    fog = KOSCHMIEDER / visibility_m if visibility_m else 0.0
    thickness = cv2.multiply(sight.depth, fog)
    if precipitation:
        cv2.add(thickness, _beyond_reach(sight, precipitation), dst=thickness)
    cv2.multiply(thickness, ray_maps(sight.intrinsics).length, dst=thickness, scale=-1.0)
    total = fog + sum(p.extinction.sum() for p in precipitation)
    bright = fog + sum(p.extinction.sum() * p.brightness for p in precipitation)
    return matte(cv2.exp(thickness, dst=thickness), float(bright / total))


def _beyond_reach(sight: Sight, precipitation: Sequence[Precipitation]) -> Picture:
    """Optical thickness of what falls beyond its reach, were the paths parallel to the axis, shape (height, width)."""
    along = np.arange(0, TABLE_END_M, TABLE_STEP_M)
    table = sum(p.extinction @ np.maximum(along - p.reach_m[:, None], 0.0) for p in precipitation)
    place = np.empty(sight.depth.shape, np.uint16)
    np.multiply(sight.depth, 1 / TABLE_STEP_M, out=place, casting="unsafe")
    return np.take(np.float32(table), place)
