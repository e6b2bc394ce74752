"""Check that grab and camera do not collide with the surroundings."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
import trimesh

from simgrab.errors import ScenarioError
from simgrab.model.geometry import Array

LEAST_ROOM_M = 0.1  # between the camera's centre and steel: the near plane
CELL_M = 0.1


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Highest point of the surroundings over a square grid around the vertical through O, place frame, m."""

    top: Array  # (N, N), indexed [y, x]; −inf where there is nothing
    half_width: float  # half the width of the square, m

    @classmethod
    def of(cls, meshes: Iterable[trimesh.Trimesh], half_width: float) -> HeightMap:
        """Make a height map of meshes; a sloping triangle counts as high as its highest corner."""
        triangles = np.concatenate([np.asarray(m.triangles) for m in meshes])
        near = (triangles[..., :2].min(axis=1) < half_width) & (triangles[..., :2].max(axis=1) > -half_width)
        triangles = triangles[near.all(axis=1)]
        height = triangles[..., 2].max(axis=1)
        size = round(2 * half_width / CELL_M)
        top = np.full((size, size), -np.inf)
        # Painted lowest first, so that the highest remains. Eight bits below the cell keep edges where they are.
        corners = np.clip((triangles[..., :2] + half_width) / CELL_M, -1e4, 1e4)
        fixed = np.round((corners - 0.5) * 256).astype(np.int32)
        order = np.argsort(height, kind="stable")
        for triangle, level in zip(fixed[order], height[order].tolist(), strict=True):
            cv2.fillConvexPoly(top, triangle, level, shift=8)
        return cls(top, half_width)

    def gap(self, points: Array) -> float:
        """Least height of points (N, 3), place frame, above the map; points beyond the map do not count."""
        cell = np.floor((points[:, :2] + self.half_width) / CELL_M).astype(int)
        inside = ((cell >= 0) & (cell < len(self.top))).all(axis=1)
        if not inside.any():
            return float("inf")
        x, y = cell[inside].T
        return float((points[inside, 2] - self.top[y, x]).min())


def room_m(point: Array, steel: trimesh.Trimesh) -> float:
    """Distance of a point (3,) from closed meshes, m; negative inside."""
    room = float(trimesh.proximity.closest_point_naive(steel, [point])[1][0])
    return -room if winding(steel, point) > 0.5 else room


def check_camera(centre: Array, steel: trimesh.Trimesh) -> None:
    """Refuse a camera (3,), jib frame, that is inside the jib's steel, or so near that it sees only steel."""
    if room_m(centre, steel) < LEAST_ROOM_M:
        raise ScenarioError(
            "camera.offset_z_m",
            f"the camera at ({centre[0]:g}, {centre[1]:g}, {centre[2]:g}) m is in the jib head's steel or less than "
            f"{LEAST_ROOM_M:g} m from it; hang it lower, e.g. offset_z_m = -0.3",
        )


def winding(mesh: trimesh.Trimesh, point: Array) -> float:
    """Winding number of closed meshes around a point: their solid angles over 4π (van Oosterom & Strackee, 1983)."""
    a, b, c = (np.asarray(mesh.triangles) - point).transpose(1, 0, 2)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    ab, bc, ca = (np.einsum("ij,ij->i", u, v) for u, v in ((a, b), (b, c), (c, a)))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    return float(np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb).sum() / (2 * np.pi))
