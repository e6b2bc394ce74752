"""Render pass in clear, dry weather: linear light, depth and ids, with the camera's pose."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from simgrab.model.geometry import Array, Intrinsics, Pose

Picture = NDArray[np.float32]
Vector = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class RenderPass:
    """A rendered frame in linear light.

    Attributes
    ----------
    light : ndarray of float32, shape (height, width, 3)
        Linear radiance; 1.0 is what the renderer's 255 stands for.
    depth : ndarray of float32, shape (height, width)
        Distance along the optical axis, m.
    ids : ndarray of uint8, shape (height, width)
        Geom group of each pixel (`simgrab.world.scenery.model`).
    intrinsics : Intrinsics
    jib_from_camera : ndarray, shape (3, 3)
        Rotation.
    centre_m : ndarray, shape (3,)
        Camera centre, jib frame.
    height_m : float
        Of the camera above the ground.
    shutter_s : float
        Exposure time.
    grab_m : ndarray, shape (3,)
        Grab centre, jib frame.
    jib_from_place : Pose or None
        Pose of what stands on the ground; None where it never moves.
    water_m : float or None
        Height of open water above the ground, which takes no snow and no puddles.
    """

    light: Picture
    depth: Picture
    ids: NDArray[np.uint8]
    intrinsics: Intrinsics
    jib_from_camera: Array
    centre_m: Array
    height_m: float
    shutter_s: float
    grab_m: Array
    jib_from_place: Pose | None = None
    water_m: float | None = None


@dataclass(frozen=True, eq=False)
class RayMaps:
    """Rays through pixel centres, scaled to unit depth: (x, y, 1). All float32, shape (height, width).

    Attributes
    ----------
    x, y : ndarray
    length : ndarray
        Metres along the ray for each metre of depth.
    """

    x: Picture
    y: Picture
    length: Picture


@lru_cache(maxsize=2)
def ray_maps(intrinsics: Intrinsics) -> RayMaps:
    """Compute the rays of a camera, once."""
    x, y = np.moveaxis(intrinsics.normalised_centres(), -1, 0)
    return RayMaps(*(part.astype(np.float32) for part in (x, y, np.sqrt(x * x + y * y + 1))))
