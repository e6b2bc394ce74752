"""A three-axle tipper lorry with its load."""

from __future__ import annotations

import numpy as np
import trimesh

from simgrab.world.scenery.meshes.part import Material, Part
from simgrab.world.scenery.places import materials
from simgrab.world.scenery.places.heap import Cargo, cones, roughened, warped
from simgrab.world.scenery.places.shapes import across, bar, beam, box, join, loft, outline, plates, sheet
from simgrab.world.scenery.textures import load

PAINTS = ((0.40, 0.16, 0.13), (0.20, 0.29, 0.40), (0.56, 0.55, 0.52), (0.24, 0.34, 0.26), (0.52, 0.39, 0.16))
AXLES = (3.05, -1.45, -2.80)
WIDTH = 2.5
REAR, FRONT, FLOOR, SIDE = -4.0, 1.55, 1.22, 2.60  # the bed


def wheel(x: float, y: float, radius: float, width: float) -> tuple[trimesh.Trimesh, trimesh.Trimesh]:
    """Tyre (rounded shoulders) and hub of a wheel whose foot presses 1 cm into the ground."""
    angle = np.linspace(0, 2 * np.pi, 20, endpoint=False)
    rings = [
        np.stack([x + r * np.cos(angle), np.full(20, y + s), radius - 0.01 + r * np.sin(angle)], 1)
        for s, r in zip(width * np.array([-0.5, -0.4, 0.4, 0.5]), radius * np.array([0.8, 1, 1, 0.8]), strict=True)
    ]
    tyre = loft(rings)
    tyre.fix_normals()
    height, half = radius - 0.01, width / 2
    return tyre, bar((x, y - half - 0.015, height), (x, y + half + 0.015, height), 0.5 * radius, sides=12)


def footprints() -> list[list[tuple[float, float]]]:
    """Outlines of the shadow that the lorry keeps under itself, metres, its own frame."""
    tyres = [outline(x - 0.4, y - 0.3, x + 0.4, y + 0.3) for x in AXLES for y in (-1.0, 1.0)]
    return [*tyres, outline(-4.1, -1.1, 4.0, 1.1)]


def truck(cargo: Cargo, *, rng: np.random.Generator) -> list[Part]:
    """Return the lorry in its own frame: x forward, y to its left, ground at z = 0, origin under its middle."""
    colour = PAINTS[int(rng.integers(len(PAINTS)))]
    cab = materials.painted("truck paint", colour, tile_m=3.0)
    bed = materials.painted("truck bed paint", materials.dull(colour, 0.75), tile_m=3.0)
    tyres, hubs = zip(*_wheels(), strict=True)
    tail = [box((-4.25, s * 1.0 - 0.16, 0.58), (-4.11, s * 1.0 + 0.16, 0.72)) for s in (-1, 1)]
    front = [box((4.0, s * 0.9 - 0.2, 0.84), (4.10, s * 0.9 + 0.2, 1.04)) for s in (-1, 1)]
    load_material = Material("truck load", texture=load(cargo.texture), tile_m=cargo.tile_m, specular=0.02)
    return [
        Part("truck cab", join(_cab()), cab),
        Part("truck windows", join(_windows()), materials.GLASS),
        Part("truck bed", join(_bed()), bed),
        Part("truck chassis", join(_chassis()), materials.plain("truck black", (0.13, 0.13, 0.13))),
        Part("truck tyres", join(tyres), materials.RUBBER),
        Part("truck hubs", join(hubs), materials.plain("truck hub", (0.34, 0.32, 0.30))),
        Part("truck lamps", join(tail), materials.plain("tail lamp", (0.42, 0.07, 0.05))),
        Part("truck headlamps", join(front), materials.plain("headlamp", (0.72, 0.72, 0.68), specular=0.5)),
        Part("truck load", _load(cargo, rng), load_material),
    ]


def _cab() -> list[trimesh.Trimesh]:
    body = [(1.95, 0.95), (4.02, 0.75), (4.10, 1.55), (3.92, 2.62), (3.72, 2.86), (2.6, 2.95), (1.95, 2.80)]
    solids = [across(body, -1.2, 1.2), across([(3.85, 2.66), (4.12, 2.62), (4.12, 2.67), (3.85, 2.72)], -1.15, 1.15)]
    deflector = [(2.15, 2.85), (3.25, 2.90), (2.85, 3.18), (2.2, 3.30)]
    solids.append(across(deflector, -0.85, 0.85))
    wing = [(2.4, 0.95), (2.55, 1.2), (3.55, 1.2), (3.7, 0.95)]
    for side in (-1, 1):  # front wings over the wheels, steps, mirrors
        solids += plates(wing, [side * 1.2], 0.06)
        solids += [bar((3.75, side * 1.15, z), (4.0, side * 1.42, z), 0.018, sides=5) for z in (2.45, 1.95)]
        solids.append(box((3.95, side * 1.30, 1.80), (4.03, side * 1.54, 2.5)))
    return solids


def _windows() -> list[trimesh.Trimesh]:
    screen = [(4.075, 1.78), (4.11, 1.78), (3.955, 2.58), (3.92, 2.58)]
    pane = [(2.75, 1.75), (3.85, 1.75), (3.72, 2.5), (2.8, 2.55)]
    return [across(screen, -1.05, 1.05), *plates(pane, (-1.2, 1.2), 0.015)]


def _bed() -> list[trimesh.Trimesh]:
    wall, half = 0.05, WIDTH / 2
    solids = [box((REAR, -half + wall, FLOOR - 0.06), (FRONT, half - wall, FLOOR))]
    for side in (-1, 1):
        inner, outer = side * (half - wall), side * half
        solids.append(box((REAR, inner, FLOOR - 0.05), (FRONT, outer, SIDE)))
        solids.append(box((REAR, side * half - 0.07, SIDE - 0.02), (FRONT, side * half + 0.07, SIDE + 0.10)))
        for x in np.linspace(REAR + 0.15, FRONT - 0.15, 9):
            solids.append(box((x - 0.05, outer, FLOOR), (x + 0.05, outer + side * 0.07, SIDE)))
    solids.append(box((FRONT, -half, FLOOR - 0.05), (FRONT + wall, half, SIDE + 0.25)))
    roof = [(FRONT, SIDE + 0.20), (FRONT + 0.75, 3.02), (FRONT + 0.75, 3.07), (FRONT, SIDE + 0.26)]
    back = [(REAR, FLOOR), (REAR + 0.05, FLOOR), (REAR - 0.10, SIDE), (REAR - 0.15, SIDE)]
    gate = [(REAR - 0.02, FLOOR), (REAR + 0.02, FLOOR), (REAR - 0.13, SIDE), (REAR - 0.20, SIDE)]
    solids += [across(roof, -half, half), across(back, -half + wall, half - wall)]
    solids += plates(gate, np.linspace(-0.95, 0.95, 5), 0.05)
    solids += [
        beam((x, -half, FLOOR - 0.12), (x, half, FLOOR - 0.12), 0.10, 0.14) for x in np.linspace(REAR + 0.2, FRONT, 8)
    ]
    return solids


def _chassis() -> list[trimesh.Trimesh]:
    solids = [box((-4.05, s * 0.42 - 0.06, 0.72), (3.9, s * 0.42 + 0.06, 1.10)) for s in (-1, 1)]
    solids += [bar((x, -1.05, 0.51), (x, 1.05, 0.51), 0.10) for x in AXLES]
    solids.append(box((3.95, -1.22, 0.38), (4.14, 1.22, 0.78)))  # front bumper
    solids.append(box((-4.22, -1.15, 0.45), (-4.12, 1.15, 0.60)))  # under-run bar
    solids += [box((-4.2, s * 0.5 - 0.05, 0.5), (-3.95, s * 0.5 + 0.05, 1.0)) for s in (-1, 1)]
    solids.append(bar((0.2, 0.95, 0.80), (1.4, 0.95, 0.80), 0.30, sides=14))  # fuel tank
    solids += [bar((0.3, -0.95, z), (1.5, -0.95, z), 0.13) for z in (0.72, 0.98)]  # air tanks
    solids += [box((x, s * 0.4, 0.78), (x + 0.08, s * 0.95, 0.86)) for x in (0.5, 1.2) for s in (-1, 1)]
    solids.append(bar((1.78, -1.0, 0.8), (1.78, -1.0, 3.15), 0.07))  # exhaust
    flap = np.array([(-0.62, 0.75), (-0.4, 1.13), (0.4, 1.13), (0.62, 0.75), (0.45, 1.08), (-0.45, 1.08)])
    return solids + [
        plate for side in (-1.0, 1.0) for x in AXLES[1:] for plate in plates((flap + (x, 0)).tolist(), [side], 0.28)
    ]


def _wheels() -> list[tuple[trimesh.Trimesh, trimesh.Trimesh]]:
    front = [wheel(AXLES[0], side * 1.02, 0.53, 0.32) for side in (-1, 1)]
    return front + [wheel(x, y, 0.53, 0.29) for x in AXLES[1:] for y in (-1.12, -0.78, 0.78, 1.12)]


def _load(cargo: Cargo, rng: np.random.Generator) -> trimesh.Trimesh:
    """Grab drops heaped in the bed, kept inside its walls."""
    x, y = np.arange(REAR + 0.04, FRONT, 0.1), np.linspace(-1.2, 1.2, 25)
    drops = np.array([[rng.uniform(REAR + 1, FRONT - 1), rng.normal(0, 0.15), rng.uniform(2.5, 3.0)] for _ in range(3)])
    field = np.maximum(cones(*warped(x, y, rng), drops, float(np.tan(cargo.repose))), 1.55)
    field = roughened(field, 0.1, 0.6 * cargo.rough, rng)
    gap = np.minimum(np.minimum(x - x[0], x[-1] - x)[:, None], 1.2 - np.abs(y))
    field = np.minimum(field, 2.42 + gap * np.tan(cargo.repose))
    return sheet(x, y, field, bottom=FLOOR + 0.02)
