"""A user's own grab, from a file of a 3-D model."""

from __future__ import annotations

import dataclasses
import itertools
import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import trimesh
from msgspec.structs import replace
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from simgrab.errors import ScenarioError, SimgrabError, first_line
from simgrab.io import models
from simgrab.io.models import MOST_FACES, ModelFile
from simgrab.io.parse import shown
from simgrab.model.geometry import Array, rotation_z
from simgrab.model.scenario.grab import Mesh
from simgrab.world.scenery.grabs import kit
from simgrab.world.scenery.grabs.design import Body, Design
from simgrab.world.scenery.grabs.formats import gltf, obj, ply, stl
from simgrab.world.scenery.grabs.formats.contents import Contents, Shape
from simgrab.world.scenery.grabs.looks import ShapeMaterials
from simgrab.world.scenery.grabs.loose import loose
from simgrab.world.scenery.meshes.part import Part

LEAST_SIDE_M, MOST_SIDE_M = 0.3, 15.0
FARTHEST_M = 1e8
FAR_M = 100.0  # a model so far from the file's origin is moved to it, so that no digits are lost
PLATE_M = 0.012  # of steel that is drawn as a surface without thickness
LEAST_M = 1e-6  # of a body's volume by its area
_APART_M = 0.02  # of the mean of the rope ends and A, seen from above
_UP = {  # by the file's axis that points up: rows are our axes, z up, in those of the file
    "z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)), "-z": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)), "-y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "x": ((0, 0, -1), (0, 1, 0), (1, 0, 0)), "-x": ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
}  # fmt: skip
_READERS = {"glb": gltf.read, "gltf": gltf.read, "obj": obj.read, "ply": ply.read, "stl": stl.read}


@dataclass(frozen=True, eq=False)
class Surface:
    """What is connected of a geometry."""

    solid: trimesh.Trimesh  # the steel: a closed surface's inside, and an open one as plates of `PLATE_M`
    closed: bool  # whether it is watertight
    area_m2: float


@dataclass(frozen=True, eq=False)
class Piece:
    """One geometry of a model, where it stands in the file's frame: metres, z up."""

    parts: tuple[Part, ...]  # one part, or one for each colour of its faces
    nodes: tuple[str, ...]  # names of the node that shows it and of all its ancestors
    surfaces: tuple[Surface, ...]

    @property
    def closed(self) -> bool:
        """Whether all surfaces are."""
        return all(surface.closed for surface in self.surfaces)

    @cached_property
    def solid(self) -> trimesh.Trimesh:
        """The steel of all surfaces."""
        return trimesh.util.concatenate([surface.solid for surface in self.surfaces])

    @property
    def file_faces(self) -> int:
        """How many triangles the file shows: open ones are drawn from both sides."""
        return sum(len(part.mesh.faces) for part in self.parts) // (1 if self.closed else 2)

    @property
    def vertices(self) -> Array:
        """Of all parts, shape (n, 3)."""
        return np.concatenate([np.asarray(part.mesh.vertices) for part in self.parts])

    @property
    def triangles(self) -> Array:
        """Of all parts, shape (n, 3, 3)."""
        return np.concatenate([np.asarray(part.mesh.triangles) for part in self.parts])


@dataclass(frozen=True, eq=False)
class ImportedModel:
    """A model's visible content, turned and scaled by the keys."""

    pieces: list[Piece]  # relative to `origin_m`
    origin_m: Array  # (3,), from the file's origin, metres, z up: zero but for a model that lies far from it
    contents: Contents  # content in the file's own units and axes

    @cached_property
    def loose(self) -> tuple[list[str], Array]:
        """What touches no other steel, and the sides of the rest, as `loose` gives them."""
        return loose([(piece.nodes[0], piece.triangles) for piece in self.pieces], self.origin_m)


def from_file(keys: Mesh) -> Design:
    """Return the design of a user's own grab.

    Raises `ScenarioError` if the file is invalid, cannot be a grab, or lacks a node.
    """
    return design(keys, read(keys, models.recall(keys.sha256, keys.file, _refuse)))


def design(keys: Mesh, reading: ImportedModel) -> Design:
    """Make a design from a model's visible content."""
    found, origin = reading.pieces, reading.origin_m
    points = np.concatenate([piece.vertices for piece in found])
    low, high = points.min(axis=0), points.max(axis=0)
    _check_size(high - low, keys.scale, reading)
    _check_points(keys, low + origin, high + origin)
    keys = _from(keys, origin)
    ends = _rope_ends(keys, low, high)
    axis = ends[:, :2].mean(axis=0)
    centre = np.array([*axis, (low[2] + high[2]) / 2] if keys.centre_m is None else keys.centre_m)
    apart = float(np.linalg.norm(axis - centre[:2]))
    if apart > _APART_M:
        raise ScenarioError(
            "grab.rope_ends_m", f"their middle lies {apart:.2f} m beside centre_m, seen from above; the ropes' axis "
            "runs through A",
        )  # fmt: skip
    if ends[:, 2].min() <= centre[2]:
        raise ScenarioError(
            "grab.rope_ends_m", f"must lie above the grab's centre, whose z is {centre[2] + origin[2]:.3f} m; points "
            "are in metres from the file's origin, z up",
        )  # fmt: skip
    bodies = _bodies(keys, found, centre)
    most = max((abs(math.radians(jaw.open_deg)) for jaw in keys.jaws), default=0.0)

    def positions(opening: float) -> Mapping[str, float]:
        share = opening / most if most else 0.0
        return {f"jaw_{i}": share * (jaw.stroke_m or math.radians(jaw.open_deg)) for i, jaw in enumerate(keys.jaws)}

    lips = {"head": np.array(keys.lips_m) - centre} if keys.lips_m else {}
    lips |= {f"jaw_{i}": np.array(jaw.lips_m) - jaw.hinge_m for i, jaw in enumerate(keys.jaws) if jaw.lips_m}
    return Design(bodies, positions, most, ends - centre, lips=lips, drag_area_m2=keys.drag_area_m2)


def _from(keys: Mesh, origin: Array) -> Mesh:
    """Express the keys' points from another origin."""

    def moved(*points: tuple[float, float, float]) -> tuple[tuple[float, float, float], ...]:
        return tuple(_point(np.array(point) - origin) for point in points)

    if not origin.any():
        return keys
    jaws = [replace(jaw, hinge_m=moved(jaw.hinge_m)[0], lips_m=moved(*jaw.lips_m)) for jaw in keys.jaws]
    centre = None if keys.centre_m is None else moved(keys.centre_m)[0]
    return replace(keys, rope_ends_m=moved(*keys.rope_ends_m), lips_m=moved(*keys.lips_m), centre_m=centre,
                   jaws=tuple(jaws))  # fmt: skip


def _refuse(problem: str) -> SimgrabError:
    return ScenarioError("grab.file", problem)


def _check_size(size: Array, scale: float, reading: ImportedModel) -> None:
    longest = float(size.max())
    stated = " × ".join(f"{side:.3g}" for side in size)
    if not LEAST_SIDE_M <= longest <= MOST_SIDE_M:
        found, sides = reading.loose
        longest = float(sides.max())
        if found and LEAST_SIDE_M <= longest <= MOST_SIDE_M:
            rest = " × ".join(f"{side:.3g}" for side in sides)
            raise ScenarioError("grab.file", f"{'; '.join(found[:3])}. Remove it from the file: the grab would be "
                                f"{stated} m with it, and {rest} m without")  # fmt: skip
        likely = {unit: s for unit, s in UNITS.items() if 3 * LEAST_SIDE_M <= longest / scale * s <= MOST_SIDE_M}
        fits = [f"{unit} (scale = {s:g})" for unit, s in likely.items()]
        hint = f"; it would fit in {' or '.join(fits)}" if fits else ""
        raise ScenarioError("grab.scale", f"the grab would be {stated} m; its longest side must be "
                            f"{LEAST_SIDE_M:g} to {MOST_SIDE_M:g} m{hint}")  # fmt: skip
    if size.min() < 1e-3:
        raise ScenarioError("grab.file", f"the grab would be flat: {stated} m")


def _check_points(keys: Mesh, low: Array, high: Array) -> None:
    points = {"rope_ends_m": keys.rope_ends_m, "lips_m": keys.lips_m}
    points |= {"centre_m": () if keys.centre_m is None else (keys.centre_m,)}
    for i, jaw in enumerate(keys.jaws):
        points |= {f"jaws.{i}.hinge_m": (jaw.hinge_m,), f"jaws.{i}.lips_m": jaw.lips_m}
    for key, given in points.items():
        for point in given:
            away = float(np.linalg.norm(np.clip(point, low, high) - point))
            if away > MOST_SIDE_M:
                where = ", ".join(f"{x:g}" for x in point)
                raise ScenarioError(f"grab.{key}", f"({where}) lies {away:.4g} m from the model; points are in metres "
                                    "from the file's origin, z up")  # fmt: skip


#: Metres a unit.
UNITS = {"millimetres": 1e-3, "centimetres": 1e-2, "inches": 0.0254, "feet": 0.3048, "metres": 1.0, "kilometres": 1e3}


def _rope_ends(keys: Mesh, low: Array, high: Array) -> Array:
    """Compute the ends of the ropes in the file's frame, counter-clockwise seen from above."""
    if keys.rope_ends_m:
        ends = np.array(keys.rope_ends_m)
        about = ends[:, :2] - ends[:, :2].mean(axis=0)
        order = np.argsort(np.mod(np.arctan2(about[:, 1], about[:, 0]), 2 * np.pi), kind="stable")
        return np.asarray(ends[order])
    middle = (low + high) / 2 if keys.centre_m is None else np.array(keys.centre_m)
    half = (high - low) / 2
    return kit.ends(keys.ropes, 0.2 * half[0], 0.35 * half[1], float(high[2])) + [middle[0], middle[1], 0.0]


def _bodies(keys: Mesh, found: list[Piece], centre: Array) -> list[Body]:
    moving = {jaw.node: i for i, jaw in enumerate(keys.jaws)}
    known = sorted({node for piece in found for node in piece.nodes})
    for i, jaw in enumerate(keys.jaws):
        if jaw.node not in known:
            names = ", ".join(shown(name) for name in known[:12]) + (", …" if len(known) > 12 else "")
            raise ScenarioError(f"grab.jaws.{i}.node", f"the file shows no node {shown(jaw.node)}; it has {names}")
    groups: dict[int, list[Piece]] = {i: [] for i in range(-1, len(keys.jaws))}
    above: dict[int, int] = {}  # the jaw that a jaw hangs on, by number; -1 for the head
    for piece in found:
        chain = [moving[node] for node in piece.nodes if node in moving]
        groups[chain[0] if chain else -1].append(piece)
        above |= dict(itertools.pairwise([*chain, -1]))
    for i, group in groups.items():
        if not group:
            if i < 0:
                raise ScenarioError("grab.jaws", "every part belongs to a jaw; the ropes need a part to hold")
            raise ScenarioError(f"grab.jaws.{i}.node", "all parts of this node belong to other jaws")
    solids = {i: trimesh.util.concatenate([piece.solid for piece in group]) for i, group in groups.items()}
    total = sum(kit.STEEL_KG_M3 * float(solid.volume) for solid in solids.values())
    per_m3 = kit.STEEL_KG_M3 * (1.0 if keys.mass_kg is None else keys.mass_kg / total)

    def body(i: int, name: str, origin: Array) -> Body:
        parts = [part for piece in groups[i] for part in piece.parts]
        return Body(name, per_m3 * float(solids[i].volume), kit.placed(parts, origin.tolist()),
                    own_solid=solids[i].copy().apply_translation(-origin))  # fmt: skip

    made = {-1: body(-1, "head", centre)}
    while len(made) < len(groups):
        for i, jaw in enumerate(keys.jaws):
            if i in made or above[i] not in made:
                continue
            hinge = np.array(jaw.hinge_m)
            base = centre if above[i] < 0 else np.array(keys.jaws[above[i]].hinge_m)
            axis = np.array(jaw.axis) / math.hypot(*jaw.axis)
            made[i] = dataclasses.replace(
                body(i, f"jaw_{i}", hinge), parent=made[above[i]].name, pin=_point(hinge - base), axis=_point(axis),
                slides=bool(jaw.stroke_m),
            )  # fmt: skip
    return list(made.values())


def _point(vector: Array) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in vector)
    return x, y, z


def read(keys: Mesh, model: ModelFile) -> ImportedModel:
    """Read a model as keys turn and scale it; raises `ScenarioError` if it cannot be read, or cannot be a grab."""
    contents = _contents(model)
    turn = np.eye(4)
    up = usual_up(model) if keys.up == "auto" else keys.up
    turn[:3, :3] = keys.scale * rotation_z(math.radians(keys.yaw_deg)) @ np.array(_UP[up], float)
    total = sum(len(shape.faces) for shape in contents.shapes)
    if total > MOST_FACES:
        raise _refuse(f"{model.name}: has {total} triangles; the limit is {MOST_FACES}: simplify it")
    placed = [(shape, _placed(shape, turn @ shape.pose, model.name)) for shape in contents.shapes if len(shape.faces)]
    if not placed:
        raise _refuse(f"{model.name}: shows no triangles")
    middle = np.concatenate([np.stack([points.min(axis=0), points.max(axis=0)]) for _, points in placed])
    origin = np.rint((middle.min(axis=0) + middle.max(axis=0)) / 2)
    if np.abs(origin).max() < FAR_M:
        origin = np.zeros(3)
    materials = ShapeMaterials(lambda problem: _refuse(f"{model.name}: {problem}"), painted=keys.finish == "paint")
    found = [piece for shape, points in placed if (piece := _piece(shape, points - origin, materials))]
    if not found:
        raise _refuse(f"{model.name}: shows no triangles")
    return ImportedModel(found, origin, contents)


def usual_up(model: ModelFile) -> str:
    """Give the axis that points up in files of a model's format."""
    return "y" if model.format in ("glb", "gltf") else "z"


def _contents(model: ModelFile) -> Contents:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # NumPy's, of what is refused later
            return _READERS[model.format](model, lambda problem: _refuse(f"{model.name}: {problem}"))
    except SimgrabError:
        raise
    except MemoryError:
        raise _refuse(f"{model.name}: takes more memory than there is") from None
    except Exception as problem:  # a file may have any value in any place
        raise _refuse(f"{model.name}: is not a valid {model.format.upper()} file ({first_line(problem)})") from None


def _placed(shape: Shape, pose: Array, name: str) -> Array:
    """Give the vertices of a shape in the file's frame, metres, z up."""
    with np.errstate(invalid="ignore", over="ignore"):  # refused below, but where no face uses it
        points = np.asarray(shape.vertices, float) @ pose[:3, :3].T + pose[:3, 3]
    used = points[np.unique(shape.faces)]
    if not np.isfinite(used).all():
        raise _refuse(f"{name}: {shown(shape.nodes[0])} has coordinates that are not finite numbers")
    if np.abs(used).max() > FARTHEST_M:
        raise _refuse(f"{name}: {shown(shape.nodes[0])} reaches {np.abs(used).max():.3g} m from the file's origin: "
                      "check scale, or move the model to its origin")  # fmt: skip
    return points


def _piece(shape: Shape, vertices: Array, materials: ShapeMaterials) -> Piece | None:
    steel = trimesh.Trimesh(vertices, shape.faces, process=False)
    kept = np.asarray(steel.area_faces) > 1e-12
    if not kept.any():
        return None
    merged = trimesh.Trimesh(vertices, shape.faces[kept], process=False)
    merged.merge_vertices(merge_tex=True, merge_norm=True)
    surfaces, outwards = _surfaces(merged)
    closed = all(surface.closed for surface in surfaces)
    parts = []
    turned, inwards = shape.faces.copy(), np.flatnonzero(kept)[~outwards]
    turned[inwards] = turned[inwards, ::-1]
    for number, (faces, material, uv) in enumerate(materials.of(shape)):
        chosen = kept & faces
        if not chosen.any():
            continue
        used, inverse = np.unique(turned[chosen], return_inverse=True)
        triangles = inverse.reshape(-1, 3)
        if not closed:  # drawn from either side
            triangles = np.concatenate([triangles, triangles[:, ::-1] + len(used)])
            used = np.tile(used, 2)
        mesh = trimesh.Trimesh(vertices[used], triangles, process=False)
        parts.append(Part(f"{shape.nodes[0]}/{number}", mesh, material, None if uv is None else uv[used]))
    return Piece(tuple(parts), shape.nodes, surfaces)


def _surfaces(mesh: trimesh.Trimesh) -> tuple[tuple[Surface, ...], NDArray[np.bool_]]:
    """Return the surfaces of a mesh, and which faces look outwards, if known."""
    labels, turned = _orientation(mesh)
    labels = _joined(mesh, labels)
    outwards, found = np.ones(len(mesh.faces), bool), []
    order = np.argsort(labels, kind="stable")
    for own_faces in np.split(order, np.flatnonzero(np.diff(labels[order])) + 1):
        one = trimesh.Trimesh(mesh.vertices, mesh.faces[own_faces], process=False)
        closed = _closed(one)
        if not closed:
            one.faces = np.where(turned[own_faces, None], one.faces[:, ::-1], one.faces)
            closed = _closed(one)
            outwards[own_faces] = ~(turned[own_faces] & closed)
        corners = np.asarray(one.triangles) - one.triangles[0, 0]
        volume = float(np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) / 6
        # A sheet whose back is a second surface is closed too, and holds nothing.
        if closed and abs(volume) > LEAST_M * float(one.area):
            if volume < 0:
                outwards[own_faces] ^= True
                one.invert()
            found.append(Surface(one, True, float(one.area)))
        else:
            one.update_faces(one.unique_faces())
            found.append(Surface(_plates(one), False, float(one.area)))
    return tuple(found), outwards


def _closed(mesh: trimesh.Trimesh) -> bool:
    """Return whether as many faces pass each edge forwards as backwards: two where nothing else touches it."""
    forwards = np.where(mesh.edges[:, 0] < mesh.edges[:, 1], 1, -1)
    return not np.bincount(mesh.edges_unique_inverse, forwards).any()


def _joined(mesh: trimesh.Trimesh, labels: NDArray[np.int32]) -> NDArray[np.int32]:
    """Join pieces that only edges of more than two faces close, as where two plates touch along an edge."""
    edges, faces = mesh.edges_unique_inverse, len(mesh.faces)
    total = np.bincount(edges)
    own, count = np.unique(labels[mesh.edges_face].astype(np.int64) * len(total) + edges, return_counts=True)
    piece, edge = np.divmod(own, len(total))
    meets = (count % 2 == 1) & (total[edge] > 2)
    links = coo_array(
        (np.ones(meets.sum(), bool), (piece[meets], faces + edge[meets])), shape=2 * (faces + len(total),)
    )
    return np.asarray(connected_components(links, directed=False)[1])[labels]


def _orientation(mesh: trimesh.Trimesh) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Return the piece that each face belongs to, by number, and whether its winding is against that of the first face.

    The latter means nothing for a piece that is one-sided, such as a Möbius strip.
    """
    pairs, n = mesh.face_adjacency, len(mesh.faces)
    start, end = mesh.face_adjacency_edges.T[..., None]
    forwards = [((mesh.faces[side] == start) & (np.roll(mesh.faces[side], -1, axis=1) == end)).any(axis=1)
                for side in pairs.T]  # fmt: skip
    # Every face is there twice, as it is and turned: neighbours that agree are in one component.
    across = np.where(forwards[0] == forwards[1], n, 0)
    first, second = np.concatenate([pairs, pairs + n]).T
    second = (second + np.tile(across, 2)) % (2 * n)
    links = coo_array((np.ones(len(first), bool), (first, second)), shape=(2 * n, 2 * n))
    as_is, turned = connected_components(links, directed=False)[1].reshape(2, n)
    return np.minimum(as_is, turned), as_is > turned


def _plates(sheet: trimesh.Trimesh) -> trimesh.Trimesh:
    """Give every triangle the thickness `PLATE_M`."""
    corners, normals = np.asarray(sheet.triangles), np.asarray(sheet.face_normals)[:, None, :] * PLATE_M / 2
    vertices = np.concatenate([corners + normals, corners - normals], axis=1).reshape(-1, 3)
    prism = np.array([(0, 1, 2), (5, 4, 3), (0, 3, 4), (0, 4, 1), (1, 4, 5), (1, 5, 2), (2, 5, 3), (2, 3, 0)])
    faces = (prism[None] + 6 * np.arange(len(corners))[:, None, None]).reshape(-1, 3)
    return trimesh.Trimesh(vertices, faces, process=False)
