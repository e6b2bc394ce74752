"""Small watertight solids that the places are made of."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from itertools import pairwise

import numpy as np
import shapely
import trimesh
from numpy.typing import ArrayLike, NDArray

from simgrab.model.geometry import Array
from simgrab.world.scenery.meshes import shapes as steel

join = steel.join


def box(low: ArrayLike, high: ArrayLike) -> trimesh.Trimesh:
    """Return the axis-aligned box between two opposite corners, metres."""
    x, y, z = np.sort(np.array([low, high], float), axis=0).T
    return loft([[[x[0], y[0], h], [x[1], y[0], h], [x[1], y[1], h], [x[0], y[1], h]] for h in z])


def bar(start: ArrayLike, end: ArrayLike, radius: float, *, sides: int = 8) -> trimesh.Trimesh:
    """Return a round bar (capped tube of ``sides`` facets) between two points, metres."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    along = (end - start) / np.linalg.norm(end - start)
    aside = np.array([0.0, -along[2], along[1]] if abs(along[0]) < 0.9 else [along[2], 0.0, -along[0]])
    aside /= np.linalg.norm(aside)
    up = np.array([along[1] * aside[2] - along[2] * aside[1], along[2] * aside[0] - along[0] * aside[2],
                   along[0] * aside[1] - along[1] * aside[0]])  # fmt: skip
    angle = (np.arange(sides) + 0.5) * (2 * np.pi / sides)
    ring = radius * (np.cos(angle)[:, None] * aside + np.sin(angle)[:, None] * up)
    return loft([start + ring, end + ring])


def beam(start: ArrayLike, end: ArrayLike, width: float, height: float) -> trimesh.Trimesh:
    """Return a rectangular beam between two points: ``height`` is its depth in the plane that holds the vertical."""
    length, axes = steel.way(start, end)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = axes[:, [2, 0, 1]], np.add(start, end) / 2
    return trimesh.creation.box((length, width, height), transform=pose)


def prism(outline: Sequence[Sequence[float]] | shapely.Polygon, low: float, high: float) -> trimesh.Trimesh:
    """Extrude an outline in the xy plane (metres; a polygon may have holes) from z = low to z = high."""
    return steel.prism(shapely.Polygon(outline), low, high, "z")


def profile(outline: Sequence[Sequence[float]], start: ArrayLike, end: ArrayLike) -> trimesh.Trimesh:
    """Extrude an outline of (sideways, up) points along a level line; sideways is to the left of the way, metres."""
    return steel.profile(shapely.Polygon(outline), start, end)


def across(outline: Sequence[Sequence[float]], y0: float, y1: float) -> trimesh.Trimesh:
    """Extrude a side view, given as (x, z) points, from y0 to y1."""
    return profile([(-x, z) for x, z in outline], (0, y0, 0), (0, y1, 0))


def plates(outline: Sequence[Sequence[float]], middles: Iterable[float], half: float) -> list[trimesh.Trimesh]:
    """Extrude a side view to plates about some y, each ``half`` to either side."""
    return [across(outline, y - half, y + half) for y in middles]


def loft(rings: Sequence[ArrayLike]) -> trimesh.Trimesh:
    """Join rings of equally many points (counter-clockwise seen from the last ring) and cap both ends."""
    points = np.array(rings, float)
    vertices = np.concatenate([*points, points[[0, -1]].mean(axis=1)])
    return steel.solid(vertices, _loft_faces(*points.shape[:2]))


@lru_cache(maxsize=64)
def _loft_faces(rings: int, sides: int) -> NDArray[np.int64]:
    numbers = np.arange(rings * sides).reshape(rings, sides)
    bottom, top = (np.full(sides, rings * sides + end) for end in (0, 1))
    first, last = numbers[0], numbers[-1]
    caps = [np.stack([np.roll(first, -1), first, bottom], 1), np.stack([last, np.roll(last, -1), top], 1)]
    faces = np.concatenate([steel.walls(numbers), *caps])
    faces.setflags(write=False)
    return faces


def shell(rings: Sequence[ArrayLike], thickness: float) -> trimesh.Trimesh:
    """Return an open vessel: walls through rectangular rings (as in `loft`), offset inwards, metres.

    The walls are closed at the first and the last ring by a lip, so that the vessel is a watertight solid.
    """
    outer = np.array(rings, float)
    inner = outer - np.sign(outer - outer.mean(axis=1, keepdims=True)) * [thickness, thickness, 0.0]
    loop = np.concatenate([outer, inner[::-1]])
    numbers = np.arange(loop.size // 3).reshape(loop.shape[:2])
    return steel.solid(loop.reshape(-1, 3), steel.walls(np.vstack([numbers, numbers[:1]])))


def rectangle(width: float, depth: float, z: float, centre: tuple[float, float] = (0.0, 0.0)) -> Array:
    """Corners of a level rectangle, counter-clockwise from above, shape (4, 3), metres."""
    x, y = width / 2, depth / 2
    return np.array([[-x, -y, z], [x, -y, z], [x, y, z], [-x, y, z]]) + [*centre, 0.0]


def outline(x0: float, y0: float, x1: float, y1: float) -> list[tuple[float, float]]:
    """Corners of a rectangle on the ground, from one to the opposite one."""
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


def pipe(points: Sequence[ArrayLike], radius: float, *, sides: int) -> trimesh.Trimesh:
    """Join round bars along a polyline, with a ball at every inner corner."""
    p = [np.asarray(q, float) for q in points]
    balls = [trimesh.creation.icosphere(1, radius).apply_translation(corner) for corner in p[1:-1]]
    return join([*(bar(a, b, radius, sides=sides) for a, b in pairwise(p)), *balls])


def railing(points: Sequence[ArrayLike], *, spacing: float) -> trimesh.Trimesh:
    """Handrail, 1.1 m, along a polyline of foot points: posts, a top rail and two middle rails, metres."""
    height = 1.1
    p = [np.asarray(q, float) for q in points]
    solids = []
    for a, b in pairwise(p):
        count = max(2, round(float(np.linalg.norm(b - a)) / spacing) + 1)
        solids += [bar(foot - [0, 0, 0.02], foot + [0, 0, height], 0.025, sides=5) for foot in np.linspace(a, b, count)]
        for level, radius in ((1.0, 0.024), (0.66, 0.016), (0.33, 0.016)):
            solids.append(bar(a + [0, 0, height * level], b + [0, 0, height * level], radius, sides=5))
    return join(solids)


def ladder(foot: ArrayLike, top: ArrayLike, *, side: ArrayLike = (1, 0, 0)) -> trimesh.Trimesh:
    """Straight ladder with two stringers and rungs 0.3 m apart; the unit vector ``side`` is along the rungs."""
    foot, top = np.asarray(foot, float), np.asarray(top, float)
    half = 0.225 * np.asarray(side, float)
    solids = [bar(foot + half, top + half, 0.025, sides=6), bar(foot - half, top - half, 0.025, sides=6)]
    count = int(np.linalg.norm(top - foot) / 0.3)
    for share in (np.arange(count) + 0.5) / count:
        at = foot + (top - foot) * share
        solids.append(bar(at - half, at + half, 0.014, sides=5))
    return join(solids)


def pose(x: float, y: float, z: float = 0.0, yaw: float = 0.0) -> Array:
    """4×4 transform: turn by ``yaw`` radians about z, then move."""
    matrix = trimesh.transformations.rotation_matrix(yaw, (0, 0, 1))
    matrix[:3, 3] = x, y, z
    return np.asarray(matrix, float)


def placed(mesh: trimesh.Trimesh, x: float, y: float, z: float = 0.0, yaw: float = 0.0) -> trimesh.Trimesh:
    """Copy of a mesh turned by ``yaw`` and moved."""
    copy = mesh.copy()
    copy.apply_transform(pose(x, y, z, yaw))
    return copy


def sheet(x: ArrayLike, y: ArrayLike, z: ArrayLike, *, bottom: float) -> trimesh.Trimesh:
    """Close a height field with a skirt and a flat bottom.

    Parameters
    ----------
    x : ndarray, shape (N,)
    y : ndarray, shape (M,)
        Grid lines, ascending, metres.
    z : ndarray, shape (N, M)
        Heights, metres, all above ``bottom``.
    """
    x, y, z = np.asarray(x, float), np.asarray(y, float), np.asarray(z, float)
    n, m = len(x), len(y)
    top = np.stack([*np.meshgrid(x, y, indexing="ij"), np.broadcast_to(z, (n, m))], axis=-1).reshape(-1, 3)
    upper, rim = steel.grid(n, m)
    low = n * m + np.arange(len(rim))
    nxt, low_nxt = np.roll(rim, -1), np.roll(low, -1)
    centre = np.full(len(rim), n * m + len(rim))
    skirt = [np.stack(t, 1) for t in ((rim, low, low_nxt), (rim, low_nxt, nxt), (low, centre, low_nxt))]
    under = np.column_stack([top[rim][:, :2], np.full(len(rim), bottom)])
    middle = [[(x[0] + x[-1]) / 2, (y[0] + y[-1]) / 2, bottom]]
    return steel.solid(np.concatenate([top, under, middle]), np.concatenate([upper, *skirt]))
