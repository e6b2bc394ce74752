"""The air between camera and scene: fog, and rain and snow too far away to be seen one by one."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from simgrab.world.camera.weather.layer import Layer, Maker, matte
from simgrab.world.camera.weather.precipitation import Precipitation
from simgrab.world.camera.weather.render_pass import Picture, RenderPass, ray_maps
from simgrab.world.scenery.model import FAR_M

KOSCHMIEDER = 3.912  # −ln 0.02: what is left of a black thing's contrast at the visibility
TABLE_STEP_M, TABLE_END_M = 0.05, FAR_M + 1


def haze(rendered: RenderPass, visibility_m: float | None, precipitation: Sequence[Precipitation]) -> Maker:
    """Return the homogeneous part of the air.

    Light keeps exp(−∫σ ds) along its true path, and the air adds what it scatters into it (Koschmieder 1924).
    Precipitation counts from the depth on to which its particles are rendered.
    """
    fog = KOSCHMIEDER / visibility_m if visibility_m else 0.0
    total = fog + sum(p.extinction.sum() for p in precipitation)
    bright = fog + sum(p.extinction.sum() * p.brightness for p in precipitation)
    table, lengths = _beyond_reach(precipitation), ray_maps(rendered.intrinsics).length

    def block(rows: slice) -> Layer:
        depth = rendered.depth[rows]
        thickness = cv2.multiply(depth, fog)
        if precipitation:
            place = cv2.addWeighted(depth, 1 / TABLE_STEP_M, depth, 0, 0, dtype=cv2.CV_16U)
            cv2.add(thickness, cv2.LUT(place, table), dst=thickness)
        cv2.multiply(thickness, lengths[rows], dst=thickness, scale=-1.0)
        return matte(cv2.exp(thickness, dst=thickness), float(bright / total))

    return block


def _beyond_reach(precipitation: Sequence[Precipitation]) -> Picture:
    """Optical thickness of what falls beyond its reach, were the paths parallel to the axis, by depth."""
    along, table = np.arange(0, TABLE_END_M, TABLE_STEP_M), np.zeros(2**16, np.float32)  # OpenCV's size of table
    table[: len(along)] = sum(p.extinction @ np.maximum(along - p.reach_m[:, None], 0.0) for p in precipitation)
    return table
