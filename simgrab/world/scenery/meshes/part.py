"""A part: one watertight shape with its material, and its conversion to a MuJoCo mesh."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray

from simgrab.model.geometry import Array
from simgrab.world.scenery.meshes.shapes import join, solid

Texture = NDArray[np.uint8]
Paint = Callable[[], Texture]
Corners = tuple[Array, Array, Array]
CREASE_ANGLE = np.radians(35.0)  # edges sharper than this keep their facets


@dataclass(frozen=True, eq=False)
class Material:
    """Look of a surface in MuJoCo's classic renderer."""

    name: str  # unique within a model
    rgba: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)  # colour, multiplied with the texture, if any
    # (H, W, 3), repeats; its first row is the top of the picture (v = 1); or a function that paints it, see
    # `picture`, and gives the same array each time
    texture: Texture | Paint | None = field(default=None, repr=False)
    tile_m: float = 1.0  # side of one tile of the texture, metres, where UVs are metric (see `Part.uv`)
    # specular, shininess, emission: in [0, 1]
    specular: float = 0.2
    shininess: float = 0.2
    emission: float = 0.0
    # whether it casts shadows; level ground below everything else could cast one on itself alone, by rounding
    shades: bool = True

    @property
    def picture(self) -> Texture | None:
        """The texture. It is painted on first use, so that shapes alone, as a LiDAR needs them, take little time."""
        return self.texture() if callable(self.texture) else self.texture


@dataclass(frozen=True, eq=False)
class Part:
    """One shape, fixed in the frame of one body."""

    name: str
    mesh: trimesh.Trimesh  # metres, in the body's frame, outward-facing
    material: Material
    # (V, 2), texture coordinates of the mesh's vertices in tiles; None projects the texture along the axis that each
    # face looks along, in metres divided by `material.tile_m`
    uv: Array | None = None

    def moved(self, transform: Array, name: str | None = None) -> Part:
        """Return the part moved by a rigid 4×4 transform; a given ``uv`` moves along, a projected one is made again."""
        mesh = solid(trimesh.transform_points(self.mesh.vertices, transform), self.mesh.faces)
        return Part(name or self.name, mesh, self.material, self.uv)


def add_parts(spec: mujoco.MjSpec, body: mujoco.MjsBody, parts: Iterable[Part], *, group: int, prefix: str) -> None:
    """Add parts to a body as visual geoms, one per material of `add_materials`: no collision, no mass.

    Parameters
    ----------
    group : int
        MuJoCo geom group, which identifies what a pixel belongs to.
    prefix : str
        Unique name stem of the geoms and meshes.
    """
    several, by_material = list(parts), dict[str, list[Corners]]()
    for part, corners in zip(several, _corners(several), strict=True):
        by_material.setdefault(part.material.name, []).append(corners)
    for name, same in by_material.items():
        mesh = spec.add_mesh(name=f"{prefix}/{name}", file=f"{prefix}/{name}.msh")
        spec.assets[mesh.file] = _msh(same)
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # for rendering only: sheets are allowed
        body.add_geom(
            name=f"{prefix}/{name}",
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=mesh.name,
            material=name,
            group=group,
            contype=0,
            conaffinity=0,
            mass=0,
        )


def _corners(parts: Sequence[Part]) -> Iterator[Corners]:
    """Positions, normals and UVs of each part's face corners: (3F, 3), (3F, 3), (3F, 2). Facets keep their sharp edges.

    All parts are computed together, in half the time that they take one by one.
    """
    if not parts:
        return
    mesh = join(part.mesh for part in parts)
    faces = np.asarray(mesh.faces)
    positions = np.asarray(mesh.vertices)[faces].reshape(-1, 3)
    normals = _corner_normals(np.asarray(mesh.vertices).tobytes(), faces.tobytes())
    axis = np.abs(np.asarray(mesh.face_normals)).argmax(axis=1).repeat(3)
    # Look along x: (y, z); along y: (x, z); along z: (x, y).
    across = np.take_along_axis(positions, np.array([[1, 2], [0, 2], [0, 1]])[axis], axis=1)
    end = 0
    for part in parts:
        own = slice(end, end := end + part.mesh.faces.size)
        uv = across[own] / part.material.tile_m if part.uv is None else part.uv[part.mesh.faces].reshape(-1, 2)
        yield positions[own], normals[own], uv


def _msh(corners: Sequence[Corners]) -> bytes:
    """Mesh of unshared corners, as MuJoCo's MSH file: arrays given to `MjsMesh` are copied number by number."""
    arrays = [np.concatenate([c[i] for c in corners]) for i in range(3)]
    count = len(arrays[0])
    header = np.array([count, count, count, count // 3], "<i4")
    faces = np.arange(count, dtype="<i4")
    return b"".join([header.tobytes(), *(a.astype("<f4").tobytes() for a in arrays), faces.tobytes()])


def add_materials(spec: mujoco.MjSpec, materials: Iterable[Material], *, textured: bool) -> None:
    """Add materials, and with ``textured`` their textures, for MuJoCo's own renderer."""
    for material in materials:
        own = spec.add_material(
            name=material.name, rgba=material.rgba, specular=material.specular, shininess=material.shininess,
            emission=material.emission,
        )  # fmt: skip
        picture = material.picture if textured else None
        if picture is not None:
            height, width, channels = picture.shape
            texture = spec.add_texture(
                name=material.name, type=mujoco.mjtTexture.mjTEXTURE_2D, width=width, height=height, nchannel=channels
            )
            texture.data = picture[::-1].tobytes()
            own.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = material.name


@lru_cache(maxsize=64)  # bodies of a grab, and a place that several worlds share
def _corner_normals(vertices: bytes, triangles: bytes) -> Array:
    """Average, at every face corner, the normals of the smoothly joined faces around it, weighted by angle."""
    faces = np.frombuffer(triangles, np.int64).reshape(-1, 3)
    mesh = trimesh.Trimesh(np.frombuffer(vertices).reshape(-1, 3), faces, process=False)
    face_normals = np.asarray(mesh.face_normals)
    smooth = mesh.face_adjacency[mesh.face_adjacency_angles < CREASE_ANGLE]
    labels = trimesh.graph.connected_component_labels(smooth, node_count=len(faces))
    # One accumulator per (vertex, smooth patch).
    keys = faces.astype(np.int64) * (labels.max() + 1) + labels[:, None]
    unique, inverse = np.unique(keys.ravel(), return_inverse=True)
    total = np.zeros((len(unique), 3))
    weights = np.asarray(mesh.face_angles).ravel()[:, None]
    np.add.at(total, inverse, face_normals.repeat(3, axis=0) * weights)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    normals = np.where(length > 1e-12, total / np.maximum(length, 1e-12), [0.0, 0.0, 1.0])
    result = normals[inverse]
    result.setflags(write=False)
    return np.asarray(result)
