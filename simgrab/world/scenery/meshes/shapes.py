"""Steel shapes: plates, profiles, pins and discs as watertight meshes, metres."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Literal

import numpy as np
import shapely
import trimesh
from numpy.typing import ArrayLike, NDArray

Axis = Literal["x", "y", "z"]


def prism(polygon: shapely.Polygon, low: float, high: float, axis: Axis = "y") -> trimesh.Trimesh:
    """Extrude a polygon from ``low`` to ``high`` along an axis.

    The polygon's two coordinates are (y, z), (x, z) or (x, y) for the axes x, y and z.
    """
    mesh = trimesh.creation.extrude_polygon(polygon, high - low)
    p = np.asarray(mesh.vertices)
    along = p[:, 2] + low
    columns = {"x": (along, p[:, 0], p[:, 1]), "y": (p[:, 0], along, p[:, 1]), "z": (p[:, 0], p[:, 1], along)}
    faces = np.asarray(mesh.faces)
    # (x, z, y) is left-handed: turn the faces round.
    return solid(np.stack(columns[axis], axis=1), faces[:, ::-1] if axis == "y" else faces)


def solid(vertices: ArrayLike, faces: ArrayLike) -> trimesh.Trimesh:
    """Return a mesh whose vertices stay unchanged: none merged, none dropped."""
    return trimesh.Trimesh(np.asarray(vertices, float), np.asarray(faces), process=False)


def outward(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Turn the faces of a closed mesh outwards, in place, where they face inwards."""
    if volume(mesh) < 0:
        mesh.invert()
    return mesh


def volume(mesh: trimesh.Trimesh) -> float:
    """Return the volume of a closed mesh, without the moments that `trimesh` computes along with it."""
    a, b, c = np.asarray(mesh.vertices)[mesh.faces].transpose(1, 2, 0)
    u, v = b - a, c - b
    return float(((u[1] * v[2] - u[2] * v[1]) * (a[0] + b[0] + c[0])).sum() / 6)


def convex(points: ArrayLike) -> trimesh.Trimesh:
    """Return the convex hull of points, shape (n, 3)."""
    mesh: trimesh.Trimesh = trimesh.convex.convex_hull(np.asarray(points, float))
    return mesh


def block(low: Sequence[float], high: Sequence[float], bevel: float = 0.006) -> trimesh.Trimesh:
    """Return a box between two corners, its edges bevelled."""
    lo, hi = np.array(low, float), np.array(high, float)
    signs = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, -1).T
    corners = np.where(signs == 0, lo, hi)
    inwards = np.where(signs == 0, 1.0, -1.0) * bevel
    points = [corners + inwards * (np.arange(3) != keep) for keep in range(3)]
    return convex(np.concatenate(points))


def rod(start: ArrayLike, end: ArrayLike, radius: float, sections: int = 10) -> trimesh.Trimesh:
    """Return a round bar between two points."""
    ends = np.stack([np.asarray(start, float), np.asarray(end, float)])
    bar: trimesh.Trimesh = trimesh.creation.cylinder(radius=radius, segment=ends, sections=sections)
    return bar


def pin(x: float, z: float, y_low: float, y_high: float, radius: float, head: float = 0.0) -> trimesh.Trimesh:
    """Return a pin along y; with ``head`` > 0 its two ends carry keeper discs that far out of the radius."""
    pieces = [rod((x, y_low, z), (x, y_high, z), radius, 12)]
    if head > 0:
        thick = 0.014
        pieces += [rod((x, y, z), (x, y + thick, z), radius + head, 12) for y in (y_low, y_high - thick)]
    return join(pieces)


def profile(section: shapely.Polygon, start: ArrayLike, end: ArrayLike) -> trimesh.Trimesh:
    """Run a section from one point to another; its second coordinate points upwards, its origin on the line."""
    length, axes = way(start, end)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = axes, start
    return trimesh.creation.extrude_polygon(section, length).apply_transform(pose)


def way(start: ArrayLike, end: ArrayLike) -> tuple[float, NDArray[np.float64]]:
    """Return the length of a way that is not vertical, and unit vectors to the left, upwards and along it: columns."""
    along = np.subtract(end, start)
    length = float(np.linalg.norm(along))
    along = along / length
    left = np.cross((0.0, 0.0, 1.0), along)
    left /= np.linalg.norm(left)
    return length, np.stack([left, np.cross(along, left), along], axis=1)


def i_section(height: float, width: float, web: float, flange: float) -> shapely.Polygon:
    """Return an I section centred on the origin."""
    h, w, t = height / 2, width / 2, web / 2
    half = [(t, -h + flange), (w, -h + flange), (w, -h)]
    right = [(w, h), (w, h - flange), (t, h - flange), *half]
    return shapely.Polygon(right + [(-x, z) for x, z in reversed(right)])


def turned(outline: Sequence[tuple[float, float]], sections: int) -> trimesh.Trimesh:
    """Turn a closed (radius, z) outline about the z axis."""
    return outward(trimesh.creation.revolve(np.array([*outline, outline[0]], float), sections=sections))


def sheave(centre: ArrayLike, pitch_radius: float, rope_radius: float, sections: int = 16) -> trimesh.Trimesh:
    """Return a grooved sheave about the y axis; a rope's centre line runs on its pitch radius."""
    bottom, rim, half = pitch_radius - rope_radius, pitch_radius + 1.6 * rope_radius, 2.4 * rope_radius
    inner, hub = bottom - 1.0 * rope_radius, max(0.25 * pitch_radius, 0.045)
    boss, web = half * 1.15, half * 0.4
    side = [(hub * 0.5, boss), (hub, boss), (hub, web), (inner, web), (inner, half), (rim, half)]
    groove = (bottom, 0.3 * half)
    outline = [*side, groove, *[(r, -o) for r, o in reversed([*side, groove])]]
    mesh = turned(outline, sections)
    p = np.asarray(mesh.vertices)
    return solid(np.stack([p[:, 0], p[:, 2], -p[:, 1]], axis=1) + np.asarray(centre, float), mesh.faces)


def join(meshes: Iterable[trimesh.Trimesh]) -> trimesh.Trimesh:
    """Put closed meshes into one, vertices unmerged, so that it stays watertight."""
    several = [(np.asarray(mesh.vertices), np.asarray(mesh.faces)) for mesh in meshes]
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in several)])
    faces = [faces + start for (_, faces), start in zip(several, starts, strict=False)]
    return solid(np.concatenate([vertices for vertices, _ in several]), np.concatenate(faces))


def walls(rings: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the triangles between closed rings of points, given by their numbers (k, n), each joined to the next."""
    i, j = rings, np.roll(rings, -1, axis=1)
    ways = np.stack([i[:-1], j[:-1], j[1:]], axis=-1), np.stack([i[:-1], j[1:], i[1:]], axis=-1)
    return np.stack(ways, axis=1).reshape(-1, 3)


def grid(n: int, m: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the triangles of a grid of n × m points, row by row, and the points of its rim, counter-clockwise."""
    i = np.arange(n * m).reshape(n, m)
    a, b, c, d = (quarter.ravel() for quarter in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    rim = np.concatenate([i[:-1, 0], i[-1, :-1], i[:0:-1, -1], i[0, :0:-1]])
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]), rim


def at_y(mesh: trimesh.Trimesh, *places: float) -> trimesh.Trimesh:
    """Repeat a mesh, moved along y to each of the places."""
    return join(mesh.copy().apply_translation((0.0, y, 0.0)) for y in places)


def mirrored_y(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return the mesh with its mirror image in y = 0."""
    vertices = np.asarray(mesh.vertices) * (1.0, -1.0, 1.0)
    return join([mesh, solid(vertices, np.asarray(mesh.faces)[:, ::-1])])


def half_turn(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return the mesh turned by 180° about the z axis."""
    return solid(np.asarray(mesh.vertices) * (-1.0, -1.0, 1.0), mesh.faces)


def rounded(polygon: shapely.Polygon, radius: float) -> shapely.Polygon:
    """Round the convex corners of a polygon to a radius, metres."""
    return polygon.buffer(-radius, quad_segs=4).buffer(radius, quad_segs=4).simplify(0.001)


def hull(*shapes: shapely.Geometry) -> shapely.Polygon:
    """Return the convex hull of shapes in a plane: a plate around eyes and welds."""
    return shapely.convex_hull(shapely.union_all(list(shapes)))


def circle(x: float, z: float, radius: float, quarter: int = 5) -> shapely.Polygon:
    """Return a disc in a plane, ``quarter`` edges to the right angle."""
    return shapely.Point(x, z).buffer(radius, quad_segs=quarter)


def bent_rod(bend_radius: float, radius: float) -> trimesh.Trimesh:
    """Return a quarter of a round bar about the y axis through the origin, from +x to +z."""
    steps, sections = 10, 8
    angle = np.linspace(0.0, np.pi / 2, steps + 1)[:, None]
    turn = np.arange(sections) * 2 * np.pi / sections
    reach = bend_radius + radius * np.cos(turn)
    across = np.broadcast_to(radius * np.sin(turn), (steps + 1, sections))
    tube = np.stack([reach * np.cos(angle), across, reach * np.sin(angle)], axis=-1).reshape(-1, 3)
    i = np.arange(len(tube)).reshape(-1, sections)
    j = np.roll(i, -1, axis=1)
    sides = [np.stack([j[:-1], j[1:], i[:-1]], axis=-1), np.stack([j[1:], i[1:], i[:-1]], axis=-1)]
    k = np.arange(1, sections - 1)
    ends = [np.stack([0 * k, k + 1, k], axis=1), np.stack([0 * k, k, k + 1], axis=1) + i[-1, 0]]
    return solid(tube, np.concatenate([*(side.reshape(-1, 3) for side in sides), *ends]))
