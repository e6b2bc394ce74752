"""Small things that lie about on a quay or a deck, and a wheel loader."""

from __future__ import annotations

import numpy as np
import trimesh

from simgrab.world.scenery.meshes.part import Part
from simgrab.world.scenery.places import materials
from simgrab.world.scenery.places.shapes import (
    across,
    bar,
    beam,
    box,
    join,
    loft,
    outline,
    placed,
    plates,
    rectangle,
    sheet,
    shell,
)
from simgrab.world.scenery.places.truck import wheel


def turned(outline: list[tuple[float, float]], *, sides: int = 14, lying: bool = False) -> trimesh.Trimesh:
    """Solid of revolution about z from (radius, z) points, bottom to top; or, lying, about x."""
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    mesh = loft([np.stack([r * np.cos(angle), r * np.sin(angle), np.full(sides, z)], 1) for r, z in outline])
    return mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (0, 1, 0))) if lying else mesh


def cones(spots: list[tuple[float, float]]) -> list[Part]:
    """Traffic cones, 0.7 m, with a white band."""
    feet = [placed(box((-0.19, -0.19, -0.01), (0.19, 0.19, 0.03)), x, y, yaw=x) for x, y in spots]
    bodies = [placed(turned([(0.15, 0.02), (0.10, 0.28), (0.03, 0.70)]), x, y) for x, y in spots]
    bands = [placed(turned([(0.105, 0.30), (0.068, 0.50)]), x, y) for x, y in spots]
    return [
        Part("cones", join([*feet, *bodies]), materials.plain("cone orange", (0.50, 0.21, 0.11))),
        Part("cone bands", join(bands), materials.plain("cone white", (0.58, 0.58, 0.55))),
    ]


def barrels(spots: list[tuple[float, float]]) -> list[Part]:
    """Oil drums with rolling hoops and a sunk lid."""
    shape = [(0.28, -0.01), (0.285, 0.28), (0.305, 0.30), (0.285, 0.32), (0.285, 0.58), (0.305, 0.60), (0.285, 0.62),
             (0.285, 0.87), (0.30, 0.89), (0.27, 0.89), (0.265, 0.86)]  # fmt: skip
    drums = join([placed(turned(shape, sides=18), x, y) for x, y in spots])
    return [Part("barrels", drums, materials.painted("drum paint", (0.17, 0.25, 0.33), tile_m=1.6))]


def pallet(x: float, y: float, yaw: float) -> Part:
    """Make a wooden pallet of boards and blocks."""
    solids = [box((-0.6, -0.5 + i * 0.15, 0.11), (0.6, -0.4 + i * 0.15, 0.135)) for i in range(7)]
    solids += [box((bx - 0.05, -0.5, 0.08), (bx + 0.05, 0.5, 0.112)) for bx in (-0.55, 0, 0.55)]
    solids += [
        box((bx - 0.05, by - 0.07, -0.01), (bx + 0.05, by + 0.07, 0.09))
        for bx in (-0.55, 0, 0.55)
        for by in (-0.43, 0, 0.43)
    ]
    mesh = placed(join(solids), x, y, yaw=yaw)
    return Part("pallet", mesh, materials.plain("old wood", (0.36, 0.31, 0.24), specular=0.02))


def tarpaulin(x: float, y: float, rng: np.random.Generator) -> Part:
    """Make a stack of something under a creased sheet."""
    gx, gy = np.linspace(-1.3, 1.3, 30), np.linspace(-1.0, 1.0, 24)
    inside = np.minimum((1.15 - np.abs(gx))[:, None], 0.85 - np.abs(gy))
    field = 0.75 * np.clip(inside / 0.16, 0, 1) ** 0.7 + 0.05 * np.sin(7 * gx[:, None] + 3 * np.sin(5 * gy)) * (
        inside > -0.1
    )
    field = np.maximum(field + rng.normal(0, 0.012, field.shape), 0.012)
    mesh = placed(sheet(gx, gy, field, bottom=-0.02), x, y, yaw=rng.uniform(0, 3))
    return Part("tarpaulin", mesh, materials.painted("tarpaulin", (0.20, 0.29, 0.27), texture="concrete", tile_m=2.0))


def skip(x: float, y: float, yaw: float) -> Part:
    """Make an open waste skip with ribs."""
    tub = shell([rectangle(2.4, 1.4, 0.05), rectangle(3.4, 1.7, 1.3)], 0.04)
    floor = box((-1.2, -0.7, -0.02), (1.2, 0.7, 0.12))
    ribs = [
        beam((bx, s * 0.71, 0.06), (bx * 1.35, s * 0.87, 1.25), 0.08, 0.06) for bx in (-0.9, 0.0, 0.9) for s in (-1, 1)
    ]
    rim = [beam((-1.72, s * 0.86, 1.3), (1.72, s * 0.86, 1.3), 0.08, 0.08) for s in (-1, 1)]
    mesh = placed(join([tub, floor, *ribs, *rim]), x, y, yaw=yaw)
    return Part("skip", mesh, materials.painted("skip paint", (0.33, 0.36, 0.30), tile_m=2.5))


def loader() -> list[Part]:
    """Make a wheel loader, bucket on the ground, in its own frame: x forward, ground at z = 0; 7.4 m long."""
    yellow = materials.painted("loader yellow", (0.46, 0.385, 0.20), tile_m=3.0)
    hood = across([(-3.3, 0.9), (-1.0, 0.9), (-1.0, 2.25), (-2.9, 2.1), (-3.3, 1.8)], -0.85, 0.85)
    weight = across([(-3.6, 0.6), (-3.0, 0.6), (-3.0, 1.5), (-3.5, 1.5)], -1.15, 1.15)
    front = across([(-0.5, 0.8), (1.7, 0.7), (1.6, 1.5), (0.3, 1.9), (-0.3, 1.4)], -0.5, 0.5)
    arm = [(0.4, 1.55), (0.7, 1.95), (2.6, 1.0), (3.0, 0.45), (2.8, 0.3), (2.3, 0.75)]
    arms = plates(arm, (-0.55, 0.55), 0.09)
    guard = [(-2.75, 1.55), (-2.5, 1.75), (-1.3, 1.75), (-1.05, 1.55), (-1.3, 1.68), (-2.5, 1.68)]
    wings = plates(guard, (-1.1, 1.1), 0.3)
    bowl = [(2.75, 1.25), (2.68, 0.35), (3.0, -0.01), (3.9, -0.01), (3.9, 0.05), (3.05, 0.07)]
    bowl += [(2.76, 0.4), (2.84, 1.28)]
    cheek = [(2.75, 1.25), (2.68, 0.35), (3.0, 0.0), (3.85, 0.0), (3.3, 0.9)]
    bucket = [across(bowl, -1.4, 1.4), *plates(cheek, (-1.4, 1.4), 0.02)]
    cab = loft([rectangle(1.45, 1.5, 1.5, (-0.6, 0)), rectangle(1.25, 1.4, 2.9, (-0.65, 0))])
    pillars = [
        bar((x, s * 0.76, 1.5), (x * 0.9 - 0.06, s * 0.71, 2.95), 0.05, sides=6) for x in (-1.31, 0.13) for s in (-1, 1)
    ]
    roof = box((-1.42, -0.82, 2.9), (0.12, 0.82, 3.05))
    black = [
        bar((-2.3, -0.45, 2.0), (-2.3, -0.45, 2.75), 0.07),
        box((-3.31, -0.6, 1.1), (-3.27, 0.6, 1.75)),
        box((-2.6, -0.6, 2.05), (-1.5, 0.6, 2.27)),
        *(bar((0.5, s * 0.25, 1.3), (2.7, s * 0.25, 0.9), 0.09) for s in (-1, 1)),
        bar((-2, -1.0, 0.78), (-2, 1.0, 0.78), 0.15), bar((1.2, -1.0, 0.78), (1.2, 1.0, 0.78), 0.15),
        box((-1.2, -0.4, 0.6), (-0.2, 0.4, 1.3)),
    ]  # fmt: skip
    tyres, hubs = zip(*(wheel(x, y, 0.80, 0.60) for x in (-1.95, 1.25) for y in (-1.05, 1.05)), strict=True)
    return [
        Part("loader body", join([hood, weight, front, *arms, *wings, *hubs, roof, *pillars]), yellow),
        Part("loader bucket", join(bucket), materials.rusty("loader bucket steel")),
        Part("loader cab", cab, materials.GLASS),
        Part("loader black", join(black), materials.plain("loader black", (0.12, 0.12, 0.12))),
        Part("loader tyres", join(tyres), materials.RUBBER),
    ]


LOADER_FOOTPRINT = outline(-3.5, -1.3, 3.8, 1.3)
