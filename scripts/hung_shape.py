"""How a model of any kind hangs from ropes in training: turned, scaled, rigged and coloured at random."""

from __future__ import annotations

import colorsys

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image
from trimesh.creation import box, cylinder
from trimesh.transformations import euler_matrix, random_rotation_matrix, rotation_matrix, scale_matrix
from trimesh.transformations import translation_matrix as shift
from trimesh.visual.material import PBRMaterial
from trimesh.visual.texture import TextureVisuals

Array = NDArray[np.float64]
Model = list[trimesh.Trimesh]
MOST_FACES = 20_000
TEXTURE_PX = 256
LONGEST_M = (1.5, 6.0)
GOLDEN = (1 + 5**0.5) / 2


def hang(model: Model, rng: np.random.Generator) -> tuple[Model, Array, float] | None:
    """Turn, scale and rig a model: meshes in metres, z up; ends of ropes, shape (n, 3); mass, kg. None if flat."""
    meshes = [mesh for part in model if len((mesh := part.copy()).faces)]
    if not meshes or not np.isfinite(limits := bounds(meshes)).all():
        return None
    sides = np.sort(np.ptp(limits, axis=0))
    if sides[2] <= 0 or sides[1] < 0.08 * sides[2] or sides[0] < 0.03 * sides[2]:
        return None
    meshes = _fewer(meshes, float(sides[2]))
    if sum(len(mesh.faces) for mesh in meshes) > MOST_FACES:
        return None
    turn = random_rotation_matrix(rng.random(3))
    if rng.random() < 0.9:  # upright, upside down or on a side; some lean
        turn = euler_matrix(*(np.pi / 2 * np.array(_AXES[rng.choice(6, p=_SHARES)])), 0)
        if rng.random() < 0.3:
            turn = euler_matrix(*rng.uniform(-0.35, 0.35, 2), 0) @ turn
    move(meshes, turn)
    x, y = np.linalg.eigh(np.cov(surface(meshes)[:, :2].T))[1][:, 1]  # its longer side, seen from above
    move(meshes, rotation_matrix(-np.arctan2(y, x), [0, 0, 1]))
    move(meshes, scale_matrix(1 / np.ptp(bounds(meshes), axis=0).max()))
    if rng.random() < 0.35:
        meshes += _rigging(meshes, rng)
        ends = _ends(meshes[-1:], int(rng.choice([1, 2, 4])), rng)
    else:
        ends = _ends(meshes, int(rng.choice([1, 2, 4], p=[0.3, 0.3, 0.4])), rng)
    scale = rng.uniform(*LONGEST_M) / np.ptp(bounds(meshes), axis=0).max()
    origin = np.array([*ends[:, :2].mean(axis=0), bounds(meshes)[0, 2]])
    move(meshes, scale_matrix(scale) @ shift(-origin))
    volume = float(trimesh.Trimesh(surface(meshes)).convex_hull.volume)
    colours = [colour(rng) for _ in range(3)]
    if rng.random() < 0.6:  # the others are painted, and worn
        for mesh in meshes:
            if mesh.visual.kind is None:
                paint(mesh, colours[0 if rng.random() < 0.7 else rng.integers(3)])
    return meshes, (ends - origin) * scale, round(float(np.clip(volume * rng.uniform(100, 1500), 100, 40_000)))


_AXES = ((0, 0), (1, 0), (3, 0), (0, 1), (0, 3), (2, 0))
_SHARES = (0.4, 0.17, 0.17, 0.08, 0.08, 0.1)


def bounds(meshes: Model) -> Array:
    """Lowest and highest coordinates, shape (2, 3)."""
    every = np.array([mesh.bounds for mesh in meshes])
    return np.array([every[:, 0].min(axis=0), every[:, 1].max(axis=0)])


def move(meshes: Model, pose: Array) -> None:
    """Transform meshes in place."""
    for mesh in meshes:
        mesh.apply_transform(pose)


def surface(meshes: Model, count: int = 6000) -> Array:
    """Points all over the surface, shape (n, 3); always the same ones."""
    corners = np.concatenate([np.asarray(mesh.triangles) for mesh in meshes])
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    chosen = np.searchsorted(np.cumsum(areas) / areas.sum(), (np.arange(count) + 0.5) / count)
    u, v = np.modf(np.outer([GOLDEN, GOLDEN**0.5], np.arange(count)))[0]
    u, v = np.where(u + v > 1, [1 - u, 1 - v], [u, v])[:, :, None]
    first, second, third = corners[np.minimum(chosen, len(corners) - 1)].transpose(1, 0, 2)
    return np.asarray(first + u * (second - first) + v * (third - first))


def tops(meshes: Model) -> Array:
    """Upper side of the upper half: points of the surface above which there is nothing, shape (n, 3)."""
    points = surface(meshes)
    low, high = points.min(axis=0), points.max(axis=0)
    cells = np.floor((points[:, :2] - low[:2]) / (high - low)[:2].max() * 30).astype(int)
    order = np.lexsort((-points[:, 2], cells[:, 1], cells[:, 0]))
    _, first = np.unique(cells[order], axis=0, return_index=True)
    tops = points[order[first]]
    return np.asarray(tops[tops[:, 2] > low[2] + 0.6 * (high - low)[2]])


def _ends(meshes: Model, ropes: int, rng: np.random.Generator) -> Array:
    """Choose where ropes end, shape (ropes, 3): on the upper side, about the vertical through the middle."""
    upper, middle = tops(meshes), surface(meshes).mean(axis=0)
    half = np.ptp(bounds(meshes), axis=0)[:2] / 2 * rng.uniform(0.25, 0.9, 2)
    corners = {1: [(0, 0)], 2: [(1, 0), (-1, 0)] if rng.random() < 0.6 else [(0, 1), (0, -1)],
               4: [(1, 1), (-1, 1), (-1, -1), (1, -1)]}[ropes]  # fmt: skip
    wanted = middle[:2] + np.array(corners) * half
    return np.array([upper[(np.linalg.norm(upper[:, :2] - at, axis=1) - 0.3 * upper[:, 2]).argmin()] for at in wanted])


def _rigging(meshes: Model, rng: np.random.Generator) -> Model:
    """Slings and, last, the block that they hang from."""
    count = int(rng.choice([2, 3, 4]))
    upper, (low, high) = tops(meshes), bounds(meshes)
    middle = surface(meshes).mean(axis=0)
    angle = 2 * np.pi * np.arange(count) / count + rng.choice([0, np.pi / count])
    reach = (high - low)[:2] / 2 * rng.uniform(0.5, 0.95)
    wanted = middle[:2] + np.stack([np.cos(angle), np.sin(angle)], 1) * reach
    feet = [upper[np.linalg.norm(upper[:, :2] - at, axis=1).argmin()] for at in wanted]
    apex = np.array([*np.mean(feet, axis=0)[:2], high[2] + rng.uniform(0.25, 0.9)])
    size = rng.uniform(0.05, 0.16, 3)
    block = box(size) if rng.random() < 0.6 else cylinder(size[0], height=size[2] * 2, sections=20)
    block.apply_translation([*apex[:2], apex[2] + size[2] / 2])
    return [*(beam(apex, foot, rng.uniform(0.004, 0.012)) for foot in feet), block]


def _fewer(meshes: Model, longest: float) -> Model:
    """Bring parts of one colour together; without a texture, vertices that are close too if there are too many."""
    textured, by_colour = [], dict[bytes, Model]()
    for mesh in meshes:
        image, rgb = _look(mesh)
        mesh.visual = TextureVisuals(mesh.visual.uv, material=_textured(image)) if image is not None else None
        if image is not None:
            textured.append(mesh)
        else:
            by_colour.setdefault(b"" if rgb is None else np.asarray(rgb, np.float64).tobytes(), []).append(mesh)
    merged = {key: trimesh.util.concatenate(group) for key, group in by_colour.items()}
    for step in (400, 200, 120, 70, 45):
        if sum(len(mesh.faces) for mesh in merged.values()) <= MOST_FACES:
            break
        clustered = {key: _clustered(mesh, longest / step) for key, mesh in merged.items()}
        merged = {key: mesh for key, mesh in clustered.items() if len(mesh.faces)}
    for key, mesh in merged.items():
        if key:
            paint(mesh, np.frombuffer(key))
    return [mesh for mesh in (*textured, *merged.values()) if len(mesh.faces)]


def _clustered(mesh: trimesh.Trimesh, cell: float) -> trimesh.Trimesh:
    """Put the vertices in each cell of a grid together in their mean."""
    cells = np.round((mesh.vertices - mesh.bounds[0]) / cell).astype(np.int64) @ [2**40, 2**20, 1]
    _, cluster, count = np.unique(cells, return_inverse=True, return_counts=True)
    sums = [np.bincount(cluster, weights=mesh.vertices[:, k]) for k in range(3)]
    fewer = trimesh.Trimesh(np.stack(sums, 1) / count[:, None], cluster[mesh.faces], process=False)
    fewer.update_faces(fewer.nondegenerate_faces() & fewer.unique_faces())
    return fewer


def _look(mesh: trimesh.Trimesh) -> tuple[Image.Image | None, Array | None]:
    """Texture, or colour as linear red, green and blue from 0 to 1, of a mesh; neither if it has none."""
    visual = mesh.visual
    material = getattr(visual, "material", None)
    image = getattr(material, "image", None) or getattr(material, "baseColorTexture", None)
    if image is not None and getattr(visual, "uv", None) is not None:
        return image, None
    if material is None and visual.kind is None:
        return None, None
    rgba = np.asarray(material.main_color if material is not None else visual.main_color)
    return None, (rgba[:3] / 255.0) ** 2.2


def _textured(image: Image.Image) -> PBRMaterial:
    small = image.convert("RGB")
    small.thumbnail((TEXTURE_PX, TEXTURE_PX))
    return PBRMaterial(baseColorTexture=small)


def paint(mesh: trimesh.Trimesh, rgb: Array) -> None:
    """Give a mesh one colour: linear red, green and blue from 0 to 1."""
    mesh.visual = TextureVisuals(material=PBRMaterial(baseColorFactor=[*np.round(rgb * 255).astype(int), 255]))


def colour(rng: np.random.Generator) -> Array:
    """Draw a colour of any hue, from grey to saturated: linear red, green and blue from 0 to 1, shape (3,)."""
    return np.array(colorsys.hsv_to_rgb(rng.random(), rng.uniform(0, 0.9), rng.uniform(0.08, 0.95))) ** 2.2


def beam(start: Array, end: Array, radius: float, sections: int = 8) -> trimesh.Trimesh:
    """Make a round beam between two points; square with four ``sections``."""
    return cylinder(radius, segment=np.array([start, end], float), sections=sections)
