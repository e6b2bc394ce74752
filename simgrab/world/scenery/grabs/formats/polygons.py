"""Polygons as triangles."""

from __future__ import annotations

import mapbox_earcut
import numpy as np

from simgrab.io.models import MOST_FACES
from simgrab.io.parse import Refuse
from simgrab.model.geometry import Array
from simgrab.world.scenery.grabs.formats.contents import Faces

MOST_CORNERS = 5_000
"""Of one polygon."""


def check(sizes: Faces, refuse: Refuse) -> None:
    """Refuse polygons of more than `MOST_CORNERS` corners, and more triangles than `MOST_FACES`."""
    if sizes.max(initial=0) > MOST_CORNERS:
        raise refuse(f"a face has {sizes.max()} corners; the limit is {MOST_CORNERS}: split it")
    total = int(np.maximum(sizes - 2, 0).sum())
    if total > MOST_FACES:
        raise refuse(f"has {total} triangles; the limit is {MOST_FACES}: simplify it")


def triangles(points: Array, sizes: Faces) -> tuple[Faces, Faces]:
    """Split polygons, convex or concave, into triangles inside them.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        Corners of all polygons, one polygon after the other.
    sizes : ndarray of int, shape (p,)
        Number of corners of each polygon; polygons with fewer than three are left out.

    Returns
    -------
    corners : ndarray of int, shape (m, 3)
        Rows of ``points``, polygon by polygon.
    polygons : ndarray of int, shape (m,)
        Index of each triangle's polygon.
    """
    first = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)
    corners, owners = [], []
    for size in np.unique(sizes[sizes >= 3]):
        chosen = np.flatnonzero(sizes == size)
        fan = np.array([(0, i, i + 1) for i in range(1, size - 1)])
        fans = first[chosen][:, None, None] + fan
        crossed = np.cross(
            points[fans[..., 1]] - points[fans[..., 0]], points[fans[..., 2]] - points[fans[..., 0]]
        )  # (p, size - 2, 3); their sum is Newell's normal
        bent = (np.einsum("pti,pi->pt", crossed, crossed.sum(axis=1)) < 0).any(axis=1)
        corners.append(fans[~bent].reshape(-1, 3))
        owners.append(np.repeat(chosen[~bent], size - 2))
        for polygon, normal in zip(chosen[bent], crossed[bent].sum(axis=1), strict=True):
            cut = _ears(points[first[polygon] : first[polygon] + size], normal)
            corners.append(first[polygon] + cut)
            owners.append(np.full(len(cut), polygon))
    if not corners:
        return np.empty((0, 3), np.int64), np.empty(0, np.int64)
    polygons = np.concatenate(owners)
    order = np.argsort(polygons, kind="stable")
    return np.concatenate(corners)[order], polygons[order]


def _ears(points: Array, normal: Array) -> Faces:
    """Cut a polygon that is not convex, seen along its normal."""
    kept = np.delete([0, 1, 2], np.abs(normal).argmax())
    flat = np.ascontiguousarray(points[:, kept])
    cut = mapbox_earcut.triangulate_float64(flat - flat[0], np.array([len(flat)], np.uint32)).astype(np.int64)
    cut = cut.reshape(-1, 3)
    crossed = np.cross(points[cut[:, 1]] - points[cut[:, 0]], points[cut[:, 2]] - points[cut[:, 0]])
    wrong = crossed @ normal < 0
    cut[wrong] = cut[wrong, ::-1]
    return cut
