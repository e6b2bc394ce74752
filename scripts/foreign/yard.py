"""A yard of its own for Blender: photographs as ground, and containers, vehicles, heaps, pipes and people on it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from scripts.foreign.surfaces import Surfaces

HALF_WIDTH_M = 150.0
REACH = 0.85  # of the depth: how far from the optical axis things stand
RADII_M = (6.5, 4.5, 5.0, 4.5, 2.0, 0.6, 2.0)  # of what stands there, in the order of `Yard.build`
TINTS = ((0.9, 0.88, 0.84), (0.8, 0.62, 0.45), (0.6, 0.63, 0.68), (0.95, 0.85, 0.65), (0.45, 0.42, 0.40))
LIVERY = (
    (0.5, 0.05, 0.03), (0.03, 0.12, 0.35), (0.05, 0.25, 0.12), (0.75, 0.35, 0.03), (0.6, 0.6, 0.58), (0.2, 0.1, 0.05),
    (0.7, 0.55, 0.05), (0.05, 0.05, 0.055),
)  # fmt: skip


class Yard:
    """Builds a yard. What stands there stays below the grab: it hides none of it from a camera above.

    Parameters
    ----------
    bpy : module
    rng : numpy.random.Generator
    photographs : str
        Archive of pictures, each of shape (height, width, 3), uint8.
    """

    def __init__(self, bpy: Any, rng: np.random.Generator, photographs: str) -> None:
        self._bpy, self._rng, self._surfaces = bpy, rng, Surfaces(bpy, rng)
        with np.load(Path(photographs)) as file:
            self._images = [blender_image(bpy, name, file[name][::-1], "sRGB") for name in sorted(file.files)]
        self._liveries = [self._surfaces.steel(LIVERY[i]) for i in rng.permutation(len(LIVERY))[:5]]
        self._dark = self._surfaces.steel((0.02, 0.02, 0.022))
        self._metal = self._surfaces.metal((0.5, 0.5, 0.5))

    def build(self, jib_from_camera: Any, *, ground: float, ceiling: float) -> None:
        """Build it where a camera of some pose, shape (4, 4), looks; ``ground`` and ``ceiling`` are z, m."""
        rng = self._rng
        image = self._images[int(rng.integers(len(self._images)))]
        tint = TINTS[int(rng.integers(len(TINTS)))]
        soil = self._surfaces.photograph(image, tint, float(rng.uniform(1.5, 5.0)), wet=rng.random() < 0.4)
        self._box((0, 0, ground - 0.5), (2 * HALF_WIDTH_M, 2 * HALF_WIDTH_M, 1.0), 0.0, soil)
        pose, depth, tallest = jib_from_camera, float(jib_from_camera[2, 3]) - ground, max(ceiling - ground, 0.0)
        middle = pose[:3, 3] + pose[:3, 2] * depth / max(-pose[2, 2], 0.3)
        self._patches(middle, ground, depth)
        kinds = [self._container, self._vehicle, self._heap, self._pipes, self._drums, self._person, self._slabs]
        weights = np.array([2, 2, 2, 2, 2, 3, 2], float) * rng.uniform(0.2, 1.0, 7)
        taken = list[tuple[float, float, float]]()
        for kind in rng.choice(7, size=int(rng.integers(20, 48)), p=weights / weights.sum()):
            angle, far = rng.uniform(0, 2 * math.pi), depth * REACH * math.sqrt(rng.random())
            x, y, radius = middle[0] + far * math.cos(angle), middle[1] + far * math.sin(angle), RADII_M[kind]
            if all(math.hypot(x - a, y - b) > radius + r for a, b, r in taken):
                taken.append((x, y, radius))
                kinds[kind]((x, y, ground), tallest)

    def _patches(self, middle: Any, ground: float, depth: float) -> None:
        """Lay strips and patches of other ground, and lines of paint."""
        rng = self._rng
        for number in range(int(rng.integers(1, 4))):
            image = self._images[int(rng.integers(len(self._images)))]
            soil = self._surfaces.photograph(image, TINTS[int(rng.integers(len(TINTS)))], float(rng.uniform(1.0, 4.0)))
            at = middle[:2] + rng.normal(0, 0.4 * depth, 2)
            self._box(
                (*at, ground + 0.01 * (number + 1)), (*rng.uniform(4, 30, 2), 0.02), rng.uniform(0, math.pi), soil
            )
        turn, white = rng.uniform(0, math.pi), self._surfaces.mineral((0.7, 0.68, 0.6))
        for number in range(int(rng.integers(0, 6))):
            side = np.array((-math.sin(turn), math.cos(turn)))
            at = middle[:2] + side * (number - 2.5) * rng.uniform(2.5, 4.0)
            self._box((*at, ground + 0.045), (rng.uniform(10, 50), 0.15, 0.01), turn, white)

    def _container(self, at: Any, tallest: float) -> None:
        if tallest < 2.7:
            return
        rng, length, turn = self._rng, float(self._rng.choice([6.06, 12.19])), self._rng.uniform(0, math.pi)
        paint = self._livery()
        self._box((at[0], at[1], at[2] + 1.30), (length, 2.44, 2.6), turn, paint)
        along = (math.cos(turn), math.sin(turn))
        for offset in np.arange(-length / 2 + 0.2, length / 2, 0.28):  # corrugation of sides and roof
            where = (at[0] + along[0] * offset, at[1] + along[1] * offset, at[2] + 1.3)
            self._box(where, (0.11, 2.5, 2.64), turn, paint)
        if tallest > 5.4 and rng.random() < 0.3:
            self._box((at[0], at[1], at[2] + 3.95), (length, 2.44, 2.6), turn, self._livery())

    def _vehicle(self, at: Any, tallest: float) -> None:
        rng, turn = self._rng, self._rng.uniform(0, 2 * math.pi)
        if tallest < 3.2:
            return
        length, paint = float(rng.uniform(3.6, 8.5)), self._livery()
        c, s = math.cos(turn), math.sin(turn)

        def there(x: float, y: float, z: float) -> tuple[float, float, float]:
            return at[0] + c * x - s * y, at[1] + s * x + c * y, at[2] + z

        self._box(there(0, 0, 0.8), (length, 1.9, 0.5), turn, self._dark)
        self._box(there(0.36 * length, 0, 1.7), (0.24 * length, 2.2, 1.7), turn, paint, 0.12)
        self._box(there(0.485 * length, 0, 2.0), (0.02, 1.9, 0.7), turn, self._dark)
        self._box(there(-0.12 * length, 0, 1.55), (0.66 * length, 2.3, 1.1), turn, self._livery(), 0.05)
        for x in (-0.36 * length, -0.2 * length, 0.34 * length):
            for y in (-0.95, 0.95):
                self._rod(there(x, y - 0.15, 0.5), there(x, y + 0.15, 0.5), 0.5, self._dark)

    def _heap(self, at: Any, tallest: float) -> None:
        rng = self._rng
        radius = float(rng.uniform(1.5, 6.0))
        height = min(radius * float(rng.uniform(0.35, 0.6)), tallest)
        if height < 0.3:
            return
        rings, n = 14, 40
        r, a = np.meshgrid(np.linspace(0, 1, rings), np.arange(n) * 2 * math.pi / n, indexing="ij")
        rough = 1 + 0.12 * rng.standard_normal((rings, n))
        z = height * np.clip(1 - r, 0, 1) ** 1.1 * np.clip(rough, 0.7, 1.0)
        x, y = radius * r * np.cos(a) * (1 + 0.1 * np.sin(3 * a)), radius * r * np.sin(a)
        points = np.stack([x + at[0], y + at[1], z + at[2]], -1).reshape(-1, 3)
        quads = ((i, j, (j + 1) % n) for i in range(rings - 1) for j in range(n))
        faces = [(n * i + j, n * i + n + j, n * i + n + k, n * i + k) for i, j, k in quads]
        image, tint = self._images[int(rng.integers(len(self._images)))], TINTS[int(rng.integers(len(TINTS)))]
        material = (self._surfaces.photograph(image, tint, 1.2) if rng.random() < 0.5
                    else self._surfaces.loose(tuple(map(float, rng.uniform(0.02, 0.4) * np.array(tint)))))  # fmt: skip
        mesh = self._bpy.data.meshes.new("heap")
        mesh.from_pydata(points.tolist(), [], faces)
        mesh.materials.append(material)
        self._bpy.context.scene.collection.objects.link(self._bpy.data.objects.new("heap", mesh))

    def _pipes(self, at: Any, tallest: float) -> None:
        rng, turn = self._rng, self._rng.uniform(0, math.pi)
        radius, length = float(rng.uniform(0.1, 0.5)), float(rng.uniform(3, 9))
        material = self._livery() if rng.random() < 0.6 else self._metal
        for row in range(3):
            if (2 * row + 2) * radius > tallest:
                return
            for number in range(4 - row):
                aside = (number - (3 - row) / 2) * 2.05 * radius
                x, y = at[0] - math.sin(turn) * aside, at[1] + math.cos(turn) * aside
                z, half = at[2] + radius * (1 + 1.75 * row), length / 2
                start, end = ((x + k * half * math.cos(turn), y + k * half * math.sin(turn), z) for k in (-1, 1))
                self._rod(start, end, radius, material)

    def _drums(self, at: Any, tallest: float) -> None:
        if tallest < 0.95:
            return
        for _ in range(int(self._rng.integers(1, 9))):
            x, y = self._rng.normal(0, 0.9, 2)
            self._rod((at[0] + x, at[1] + y, at[2]), (at[0] + x, at[1] + y, at[2] + 0.9), 0.29, self._livery())

    def _person(self, at: Any, tallest: float) -> None:
        if tallest < 1.85:
            return
        vest = self._surfaces.mineral(
            ((0.8, 0.35, 0.02), (0.55, 0.75, 0.05), (0.1, 0.1, 0.15))[int(self._rng.integers(3))]
        )
        x, y, z = at
        for aside in (-0.1, 0.1):
            self._rod((x + aside, y, z), (x + aside, y, z + 0.85), 0.09, self._dark)
        self._rod((x, y, z + 0.8), (x, y, z + 1.5), 0.2, vest)
        self._rod((x - 0.28, y, z + 0.9), (x - 0.2, y, z + 1.45), 0.06, vest)
        self._rod((x + 0.28, y, z + 0.9), (x + 0.2, y, z + 1.45), 0.06, vest)
        self._rod((x, y, z + 1.52), (x, y, z + 1.78), 0.12, self._livery())

    def _slabs(self, at: Any, tallest: float) -> None:
        rng, turn = self._rng, self._rng.uniform(0, math.pi)
        x, y, each = (float(v) for v in rng.uniform((0.8, 0.8, 0.12), (3.0, 2.5, 0.5)))
        image = self._images[int(rng.integers(len(self._images)))]
        material = self._surfaces.photograph(image, TINTS[int(rng.integers(len(TINTS)))], 1.0)
        for number in range(int(rng.integers(1, 6))):
            if (number + 1) * each > tallest:
                return
            self._box(
                (*at[:2], at[2] + (number + 0.5) * each), (x, y, each - 0.03), turn + rng.normal(0, 0.03), material
            )

    def _livery(self) -> Any:
        return self._liveries[int(self._rng.integers(len(self._liveries)))]

    def _box(self, centre: Any, sides: Any, turn: float, material: Any, bevel: float = 0.0) -> Any:
        x, y, z = (float(side) / 2 for side in sides)
        corners = [(i * x, j * y, k * z) for k in (-1, 1) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        faces = [(3, 2, 1, 0), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
        return self._put(corners, faces, centre, (0.0, 0.0, float(turn)), material, bevel)

    def _rod(self, start: Any, end: Any, radius: float, material: Any) -> Any:
        import mathutils  # type: ignore[import-not-found]

        along = mathutils.Vector(end) - mathutils.Vector(start)
        count, half = 18, along.length / 2
        ring = [(radius * math.cos(a), radius * math.sin(a)) for a in np.arange(count) * 2 * math.pi / count]
        corners = [(x, y, k * half) for k in (-1, 1) for x, y in ring]
        faces: list[tuple[int, ...]] = [(i, (i + 1) % count, count + (i + 1) % count, count + i) for i in range(count)]
        faces += [tuple(range(count - 1, -1, -1)), tuple(range(count, 2 * count))]
        turn = along.to_track_quat("Z", "Y").to_euler()
        middle = tuple((mathutils.Vector(end) + mathutils.Vector(start)) / 2)
        return self._put(corners, faces, middle, turn, material, 0.0)

    def _put(self, corners: Any, faces: Any, centre: Any, turn: Any, material: Any, bevel: float) -> Any:
        mesh = self._bpy.data.meshes.new("thing")
        mesh.from_pydata(corners, [], faces)
        mesh.materials.append(material)
        thing = self._bpy.data.objects.new("thing", mesh)
        thing.location, thing.rotation_euler = tuple(map(float, centre)), turn
        if bevel:
            modifier = thing.modifiers.new("bevel", "BEVEL")
            modifier.width, modifier.segments = bevel, 2
        self._bpy.context.scene.collection.objects.link(thing)
        return thing


def blender_image(bpy: Any, name: str, picture: Any, colours: str) -> Any:
    """Make Blender's image of RGB, uint8 of shape (height, width, 3), the first row the bottom.

    ``colours`` is its colour space: "sRGB" or "Non-Color".
    """
    height, width = picture.shape[:2]
    made = bpy.data.images.new(name, width, height)
    made.colorspace_settings.name = colours
    rgba = np.ones((height, width, 4), np.float32)
    rgba[..., :3] = picture / np.float32(255)
    made.pixels.foreach_set(rgba.ravel())
    return made
