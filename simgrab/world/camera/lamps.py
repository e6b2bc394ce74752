"""Night: what the floodlights at the jib head add to the last light of the sky.

The lamps hang beside the camera, so their shadows lie behind what casts them. What they light is therefore what is
rendered under an even sky, times the light that arrives at its distance: no more than depth is needed.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.model.geometry import Array, Intrinsics
from simgrab.model.scenario import Light
from simgrab.world.camera.row_blocks import each_block
from simgrab.world.camera.weather.render_pass import ray_maps
from simgrab.world.scenery.meshes.jib_access import FLOODLIGHTS
from simgrab.world.scenery.model import DRAWN_SKY

REFERENCE_M = 28.0
NEAREST_M = 1.0
STEP = 2  # light changes slowly: every so many pixels it is computed

Picture = NDArray[np.float32]


def illumination(
    light: Light, depth: Picture, *, intrinsics: Intrinsics, jib_from_camera: Array, offset: Array
) -> Picture:
    """Light on what each pixel shows, over that of the sky it was rendered under, shape (height, width).

    Depth is along the optical axis, m, and the offset (3,) that of the camera's centre in the jib frame, m. The beam
    falls with the sixth power of the cosine, to half at 27 degrees, and with the square of the distance.
    """
    x_map, y_map = _coarse_rays(intrinsics)
    coarse = np.asarray(cv2.resize(depth, x_map.shape[::-1], interpolation=cv2.INTER_NEAREST))
    result = np.full(coarse.shape, light.sky / DRAWN_SKY, np.float32)
    rotation = jib_from_camera.astype(np.float32)
    each = np.float32(light.floodlights / len(FLOODLIGHTS) * REFERENCE_M**2)

    def shine(rows: slice) -> None:
        ahead = [coarse[rows] * (a * x_map[rows] + b * y_map[rows] + c) for a, b, c in rotation]
        for lamp in FLOODLIGHTS:
            x, y, z = (way + np.float32(o - p) for way, o, p in zip(ahead, offset, lamp, strict=True))
            square = np.maximum(x * x + y * y + z * z, np.float32(NEAREST_M**2))
            below = np.minimum(z, 0)
            cosine = below * below / square  # its square
            result[rows] += each * cosine * cosine * cosine / square

    each_block(len(coarse), shine)
    return np.asarray(cv2.resize(result, depth.shape[::-1], interpolation=cv2.INTER_LINEAR))


def lit(drawn: Picture, by: Picture) -> Picture:
    """Multiply light, shape (height, width, 3), by that of shape (height, width)."""
    result = np.empty_like(drawn)

    def multiply(rows: slice) -> None:
        np.multiply(drawn[rows], cv2.cvtColor(by[rows], cv2.COLOR_GRAY2RGB), out=result[rows])

    each_block(len(drawn), multiply)
    return result


@lru_cache(maxsize=2)
def _coarse_rays(intrinsics: Intrinsics) -> tuple[Picture, Picture]:
    maps = ray_maps(intrinsics)
    size = -(-intrinsics.width_px // STEP), -(-intrinsics.height_px // STEP)
    x, y = (np.asarray(cv2.resize(m, size, interpolation=cv2.INTER_AREA)) for m in (maps.x, maps.y))
    return x, y
