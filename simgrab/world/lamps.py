"""Night: what the floodlights at the jib head add to the last light of the sky.

The lamps hang beside the camera, so their shadows lie behind what casts them. What they light is therefore what is
drawn under an even sky, times the light that arrives at its distance: no more than depth is needed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simgrab.geometry import Array, Intrinsics
from simgrab.scenario import Light
from simgrab.world.meshes.jib_access import FLOODLIGHTS
from simgrab.world.model import DRAWN_SKY

REFERENCE_M = 28.0
BEAM_POWER = 6  # the beam falls with this power of the cosine: to half at 27 degrees
NEAREST_M = 1.0

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
    """
    v, u = np.indices(depth.shape, np.float32)
    ideal = intrinsics.undistort(np.stack([u, v], axis=-1) + 0.5) if not intrinsics.distortion.is_null else None
    x = ((u + 0.5 if ideal is None else ideal[..., 0]) - intrinsics.cx_px) / intrinsics.f_px
    y = ((v + 0.5 if ideal is None else ideal[..., 1]) - intrinsics.cy_px) / intrinsics.f_px
    ray = [(x * r[0] + y * r[1] + r[2]).astype(np.float32) for r in jib_from_camera.astype(np.float32)]
    result = np.full(depth.shape, light.sky / DRAWN_SKY, np.float32)
    for lamp in FLOODLIGHTS:
        way = [depth * axis + np.float32(o - p) for axis, o, p in zip(ray, offset, lamp, strict=True)]
        square = np.maximum(way[0] ** 2 + way[1] ** 2 + way[2] ** 2, NEAREST_M**2)
        down = np.maximum(-way[2], 0) ** 2 / square
        result += np.float32(light.floodlights / len(FLOODLIGHTS) * REFERENCE_M**2) * down ** (BEAM_POWER // 2) / square
    return result
