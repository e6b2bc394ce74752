"""The surfaces that the picture shows: where they are in the place, and which way they face."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.model.geometry import Intrinsics
from simgrab.world.camera.weather.render_pass import Picture, RayMaps, RenderPass, ray_maps
from simgrab.world.scenery.model import GRAB, PLACE

WHOLE = slice(None)
STEP = 2  # every second pixel will do: it is enlarged again
WAVES_M = 0.4  # above open water's level that is still water


@dataclass(frozen=True, eq=False)
class Surface:
    """Every second pixel's surface point, shapes (h, w) or those of a block, float32.

    Attributes
    ----------
    x, y : ndarray
        In the frame of what it belongs to: the place's, the grab's or the jib's, so that patterns stay on it, m.
    jib_x, jib_y : ndarray
        In the jib frame, m.
    height : ndarray
        Above the ground, m.
    up : ndarray
        Upward component of its unit normal.
    solid : ndarray of bool
        Whether it belongs to the place and is not open water.
    """

    x: Picture
    y: Picture
    jib_x: Picture
    jib_y: Picture
    height: Picture
    up: Picture
    solid: NDArray[np.bool_]


@lru_cache(maxsize=2)
def coarse_rays(intrinsics: Intrinsics) -> RayMaps:
    """Return every second pixel's ray."""
    rays = ray_maps(intrinsics)
    return RayMaps(*(np.ascontiguousarray(m[::STEP, ::STEP]) for m in (rays.x, rays.y, rays.length)))


def surface(rendered: RenderPass, rows: slice = WHOLE) -> Surface:
    """Find the surfaces from depth, all or in some of every second row."""
    rays = coarse_rays(rendered.intrinsics)
    first, last, _ = rows.indices(len(rays.x))
    near = slice(max(first - 1, 0), min(last + 1, len(rays.x)))  # normals need the neighbours
    inside = slice(first - near.start, last - near.start)
    around = np.ascontiguousarray(rendered.depth[::STEP, ::STEP][near])
    rotation = rendered.jib_from_camera.astype(np.float32)
    up = _up(rays.x[near], rays.y[near], around, rotation[2])[inside]
    x, y, depth = rays.x[rows], rays.y[rows], around[inside]
    ids = rendered.ids[::STEP, ::STEP][rows]
    jib_x, jib_y, below = (depth * (r[0] * x + r[1] * y + r[2]) for r in rotation)
    jib_x, jib_y = jib_x + np.float32(rendered.centre_m[0]), jib_y + np.float32(rendered.centre_m[1])
    height = below + np.float32(rendered.height_m)
    solid = ids == PLACE
    if rendered.water_m is not None:
        solid &= height > rendered.water_m + WAVES_M
    return Surface(*_anchored(rendered, jib_x, jib_y, ids), jib_x, jib_y, height, up, solid)


def _anchored(rendered: RenderPass, x: Picture, y: Picture, ids: NDArray[np.uint8]) -> tuple[Picture, Picture]:
    if rendered.jib_from_place is None:
        place_x, place_y = x, y
    else:
        m = np.linalg.inv(rendered.jib_from_place).astype(np.float32)
        # The place turns about the vertical only.
        place_x, place_y = m[0, 0] * x + m[0, 1] * y + m[0, 3], m[1, 0] * x + m[1, 1] * y + m[1, 3]
    grab, place = ids == GRAB, ids == PLACE
    gx, gy = (np.float32(v) for v in rendered.grab_m[:2])
    return (
        np.where(place, place_x, np.where(grab, x - gx, x)),
        np.where(place, place_y, np.where(grab, y - gy, y)),
    )


def _up(x: Picture, y: Picture, depth: Picture, down: Picture) -> Picture:
    """Upward component of the normal."""
    # The inverse depth w of a plane is linear in the ray coordinates: n ∝ (w_x, w_y, w − x w_x − y w_y).
    w = cv2.divide(1.0, depth)
    wx, wy = _slope(w, x, 1), _slope(w, y, 0)
    wz = w - x * wx - y * wy
    upwards = down[0] * wx + down[1] * wy + down[2] * wz
    return np.asarray(np.abs(upwards) / np.sqrt(wx * wx + wy * wy + wz * wz))


def _slope(w: Picture, x: Picture, axis: int) -> Picture:
    """∂w/∂x along an axis: of the two one-sided differences the lesser, which does not cross an edge."""
    one = np.diff(w, axis=axis) / np.diff(x, axis=axis)
    ends = np.split(one, (1, one.shape[axis] - 1), axis=axis)
    before, after = np.concatenate([ends[0], one], axis=axis), np.concatenate([one, ends[-1]], axis=axis)
    return np.where(np.abs(before) < np.abs(after), before, after)
