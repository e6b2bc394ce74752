"""A quay-side receiving hopper: funnel with a grid, on legs, over a belt conveyor."""

from __future__ import annotations

import numpy as np
import trimesh

from simgrab.model.geometry import Array
from simgrab.world.scenery.meshes.part import Material, Part
from simgrab.world.scenery.places import materials
from simgrab.world.scenery.places.heap import Cargo
from simgrab.world.scenery.places.shapes import (
    bar,
    beam,
    box,
    join,
    ladder,
    loft,
    outline,
    pipe,
    placed,
    railing,
    rectangle,
    shell,
)
from simgrab.world.scenery.textures import load

HALF = 3.2  # half width of the mouth, metres
RIM = 7.8
TOP_M = RIM + 1.2  # of the dust shields
NECK = 3.4
PAINTS = ((0.38, 0.35, 0.24), (0.29, 0.33, 0.36), (0.29, 0.32, 0.30), (0.36, 0.35, 0.33))


def footprints() -> list[list[tuple[float, float]]]:
    """Outlines of what stands on the ground, metres, hopper frame (x along the conveyor, origin under the funnel)."""
    feet = [outline(x - 0.35, y - 0.35, x + 0.35, y + 0.35) for x in (-3.5, 3.5) for y in (-3.5, 3.5)]
    return [*feet, outline(-9, -0.7, 5, 0.7)]


def hopper(cargo: Cargo, *, rng: np.random.Generator) -> list[Part]:
    """Return the hopper's parts in its own frame: ground at z = 0, the mouth centred over the origin."""
    paint = materials.painted("hopper paint", PAINTS[int(rng.integers(len(PAINTS)))], texture="hullplate", fine=True)
    inside = materials.rusty("hopper inside")
    # The outer skin is painted and the liner bare, so that the mouth shows the wear of falling cargo.
    skin, lining = (
        shell([rectangle(side, side, z) for side, z in levels], 0.03)
        for levels in (
            ((1.3, NECK), (2 * HALF, 7.0), (2 * HALF, RIM)),
            ((1.2, NECK + 0.02), (2 * HALF - 0.07, 7.02), (2 * HALF - 0.07, RIM - 0.05)),
        )
    )
    floor = Material("hopper cargo", texture=load(cargo.texture), tile_m=cargo.tile_m, specular=0.02)
    return [
        Part("hopper skin", join([skin, *_rim(), *_ribs()]), paint),
        Part("hopper lining", lining, inside),
        Part("hopper frame", join(_frame()), paint),
        Part("hopper grid", join(_grid(rng)), materials.rusty("hopper grid steel")),
        Part("hopper cargo", _residue(rng), floor),
        Part("hopper walkway", join(_walkway()), materials.GALVANISED),
        Part("hopper rails", join(_rails()), materials.SAFETY_YELLOW),
        Part("hopper conveyor", join(_conveyor()), materials.painted("conveyor steel", (0.36, 0.37, 0.36))),
        Part("hopper belt", box((-9, -0.48, 1.10), (4.6, 0.48, 1.14)), materials.plain("belt", (0.10, 0.10, 0.10))),
    ]


def _rim() -> list[trimesh.Trimesh]:
    """Make a flanged edge round the mouth and dust shields on two sides, leaning outwards."""
    edge = HALF + 0.09
    solids = []
    for sign in (-1, 1):
        out, low, high = edge + 0.09, sign * edge - 0.09, sign * edge + 0.09
        solids.append(box((-out, low, RIM - 0.22), (out, high, RIM + 0.03)))
        solids.append(box((low, -edge + 0.09, RIM - 0.22), (high, edge - 0.09, RIM + 0.03)))
        foot, top, wide = sign * (edge + 0.05), sign * (edge + 0.60), edge + 0.3
        corners = np.array([(foot, -edge, RIM), (foot, edge, RIM), (top, wide, TOP_M), (top, -wide, TOP_M)])
        thick = np.array([0.04 * sign, 0, -0.02])
        ring = corners if sign > 0 else corners[::-1]
        solids.append(loft([ring, ring + thick]))
        for y in np.linspace(-edge + 0.2, edge - 0.2, 6):
            solids.append(beam((foot + sign * 0.07, y, RIM - 0.1), (top + sign * 0.05, y, RIM + 1.15), 0.05, 0.09))
    for solid in solids:
        solid.fix_normals()
    return solids


def _ribs() -> list[trimesh.Trimesh]:
    side = [beam((0.70, o * 0.8, NECK + 0.1), (HALF + 0.05, o * HALF * 1.3, 7.0), 0.03, 0.16) for o in (-0.66, 0, 0.66)]
    side.append(box((2.0, -2.0, 5.2), (2.12, 2.0, 5.36)))
    return [placed(solid, 0, 0, yaw=turn * np.pi / 2) for turn in range(4) for solid in side]


def _frame() -> list[trimesh.Trimesh]:
    solids = []
    for x in (-3.5, 3.5):
        for y in (-3.5, 3.5):
            for web in (-0.15, 0.15):
                solids.append(box((x - 0.16, y + web - 0.015, -0.02), (x + 0.16, y + web + 0.015, 7.64)))
            solids.append(box((x - 0.012, y - 0.14, -0.02), (x + 0.012, y + 0.14, 7.64)))
            solids.append(box((x - 0.32, y - 0.32, -0.03), (x + 0.32, y + 0.32, 0.04)))
    for sign in (-3.5, 3.5):
        for z in (3.0, 7.2):
            solids.append(box((-3.5, sign - 0.1, z - 0.15), (3.5, sign + 0.1, z + 0.15)))
            solids.append(box((sign - 0.1, -3.38, z - 0.15), (sign + 0.1, 3.38, z + 0.15)))
        for foot in (-3.35, 3.35):
            solids.append(bar((sign, foot, 3.1), (sign, -foot, 7.0), 0.06))
            solids.append(bar((foot, sign, 3.1), (-foot, sign, 7.0), 0.06))
    solids.append(loft([rectangle(1.0, 0.8, 1.5), rectangle(1.3, 1.3, NECK + 0.05)]))
    return solids


def _grid(rng: np.random.Generator) -> list[trimesh.Trimesh]:
    """Screen bars: heavy beams one way, flat bars the other, some of them bent."""
    reach = HALF - 0.08
    solids = [box((x - 0.08, -reach, 6.72), (x + 0.08, reach, 7.0)) for x in (-1.6, 0.0, 1.6)]
    for y in np.arange(-reach + 0.3, reach, 0.40):
        sag = rng.normal(0, 0.02)
        for x0, x1, z0, z1 in ((-reach, 0.0, 7.06, 7.06 - abs(sag)), (0.0, reach, 7.06 - abs(sag), 7.06)):
            solids.append(beam((x0, y, z0), (x1, y + sag, z1), 0.035, 0.14))
    return solids


def _residue(rng: np.random.Generator) -> trimesh.Trimesh:
    """Fill in what is left in the funnel, drawn down in the middle."""
    low, level = NECK + 0.05, rng.uniform(4.7, 5.5)
    foot, wall = (0.60 + (z - NECK) / (7.0 - NECK) * (HALF - 0.67) for z in (low, level))
    rings = [_square(foot * 0.96 * 0.99, low, rng, jitter=0.0), _square(wall * 0.99, level, rng, jitter=0.0)]
    lower = ((0.15, 0.8), (0.5, 0.5), (0.85, 0.2))
    return loft([*rings, *(_square(wall * share * 0.99, level - down, rng, jitter=0.06) for down, share in lower)])


def _square(half: float, z: float, rng: np.random.Generator, *, jitter: float) -> Array:
    angle = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    direction = np.stack([np.cos(angle), np.sin(angle)], 1)
    xy = half * direction / np.abs(direction).max(axis=1, keepdims=True)
    return np.column_stack([xy * (1 + rng.normal(0, jitter, (32, 1))), z + rng.normal(0, jitter, 32)])


def _walkway() -> list[trimesh.Trimesh]:
    """Grating along one side below the rim, and a caged ladder to it."""
    out = HALF + 0.2
    solids = [box((-out, -out - 0.9, 6.45), (out, -out, 6.49))]
    solids += [box((-out, y, 6.43), (out, y + 0.03, 6.53)) for y in (-out - 0.9, -out - 0.03)]
    solids += [beam((x, -3.5, 5.7), (x, -out - 0.8, 6.4), 0.08, 0.1) for x in (-3.4, 0.0, 3.4)]
    solids.append(ladder((out + 0.35, -out - 0.45, -0.02), (out + 0.35, -out - 0.45, 7.4), side=(0, 1, 0)))
    return solids


def _rails() -> list[trimesh.Trimesh]:
    out = HALF + 0.2
    solids = [railing([(-out, -out, 6.49), (-out, -out - 0.88, 6.49), (out, -out - 0.88, 6.49)], spacing=1.2)]
    for z in np.arange(2.6, 7.4, 0.8):
        angle = np.linspace(-np.pi / 2, np.pi / 2, 7)
        hoop = [(out + 0.35 + 0.65 * np.cos(a), -out - 0.45 + 0.24 * np.sin(a), z) for a in angle]
        solids.append(pipe(hoop, 0.02, sides=5))
    return solids


def _conveyor() -> list[trimesh.Trimesh]:
    """Belt frame below the neck, on trestles."""
    solids = [box((-9, s * 0.58 - 0.04, 0.85), (4.8, s * 0.58 + 0.04, 1.20)) for s in (-1, 1)]
    for x in np.arange(-8.6, 4.8, 2.2):
        solids += [box((x - 0.05, s * 0.56 - 0.05, -0.03), (x + 0.05, s * 0.56 + 0.05, 0.9)) for s in (-1, 1)]
        solids.append(bar((x, -0.55, 1.04), (x, 0.55, 1.04), 0.055))
    return solids
