"""Night: what the floodlights at the jib head add to the last light of the sky.

The lamps hang beside the camera, so their shadows lie behind what casts them. What they light is therefore what is
drawn under an even sky, times the light that arrives at its distance: no more than depth is needed.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.geometry import Array, Intrinsics
from simgrab.scenario import Light
from simgrab.world.meshes.jib_access import FLOODLIGHTS
from simgrab.world.model import DRAWN_SKY
from simgrab.world.weather.sight import ray_maps

REFERENCE_M = 28.0
NEAREST_M = 1.0
STEP = 2  # light changes slowly: every so many pixels it is computed

Picture = NDArray[np.float32]


def illumination(
    light: Light, depth: Picture, *, intrinsics: Intrinsics, jib_from_camera: Array, offset: Array
) -> Picture:
    """Light on what each pixel shows, over that of the sky it was drawn under.

    Parameters
    ----------
    light : Light
    depth : ndarray of float32, shape (height, width)
        Along the optical axis, m.
    intrinsics : Intrinsics
    jib_from_camera : ndarray, shape (3, 3)
    offset : ndarray, shape (3,)
        Camera centre, jib frame, m.

    Returns
    -------
    ndarray of float32, shape (height, width)
        The beam falls with the sixth power of the cosine, to half at 27 degrees, and with the square of the distance.
    """
    maps, size = ray_maps(intrinsics), (-(-depth.shape[1] // STEP), -(-depth.shape[0] // STEP))
    x_map, y_map = (cv2.resize(m, size, interpolation=cv2.INTER_AREA) for m in (maps.x, maps.y))
    coarse = np.asarray(cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST))
    rays = [cv2.addWeighted(x_map, row[0], y_map, row[1], row[2]) for row in jib_from_camera.tolist()]
    ahead = [cv2.multiply(coarse, ray) for ray in rays]
    result = np.full(coarse.shape, light.sky / DRAWN_SKY, np.float32)
    for lamp in FLOODLIGHTS:
        x, y, z = (cv2.add(way, float(o - p)) for way, o, p in zip(ahead, offset, lamp, strict=True))
        down = cv2.multiply(z, z)
        square = cv2.max(cv2.addWeighted(cv2.multiply(x, x), 1, cv2.multiply(y, y), 1, 0) + down, NEAREST_M**2)
        cosine = cv2.divide(np.where(z < 0, down, np.float32(0)), square)  # its square
        beam = cv2.multiply(cosine, cv2.multiply(cosine, cosine))
        each = light.floodlights / len(FLOODLIGHTS) * REFERENCE_M**2
        cv2.accumulate(cv2.divide(beam, square, scale=each), result)
    return np.asarray(cv2.resize(result, depth.shape[::-1], interpolation=cv2.INTER_LINEAR))
