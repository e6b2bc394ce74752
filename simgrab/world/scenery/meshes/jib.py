"""The jib head: head sheaves between cheek plates, the fly-jib's trunk, a platform, the camera's bracket, floodlights.

Jib frame: origin O, the centroid of the rope exits; x outboard, z up. All steel but the floodlights stays above
`CLEAR_Z`, so that a camera hung anywhere below the sheaves looks down past it.
"""

from __future__ import annotations

from functools import cache, lru_cache
from itertools import pairwise

import numpy as np
import shapely
import trimesh

from simgrab.model.geometry import Array
from simgrab.world.scenery import textures
from simgrab.world.scenery.meshes import shapes
from simgrab.world.scenery.meshes.jib_access import bracket, floodlights, lenses, platform_frame, platform_grating
from simgrab.world.scenery.meshes.part import Material, Part
from simgrab.world.scenery.meshes.ropes import STAGGER_M, Ropes, rope_part
from simgrab.world.scenery.meshes.shapes import circle, hull, join, pin, prism, rod, rounded

SHEAVE_RADIUS = 0.40  # pitch radius: 25 rope radii
SHEAVE_Z = 0.52
CLEAR_Z = 0.05
_NOSE_X, _TAIL_X, _PANELS = -1.30, -10.2, 8  # of the trunk

_PAINT = Material("jib_paint", rgba=(0.66, 0.67, 0.66, 1.0), specular=0.2)
_YELLOW = Material("jib_yellow", rgba=(0.80, 0.62, 0.10, 1.0), specular=0.2)
_ZINC = Material("jib_zinc", rgba=(0.50, 0.52, 0.53, 1.0), specular=0.35)
_LAMP = Material("jib_lamp", rgba=(0.34, 0.35, 0.36, 1.0), specular=0.3)
_LENS = Material("jib_lens", rgba=(0.92, 0.93, 0.88, 1.0), specular=0.9, shininess=0.8, emission=0.35)


@lru_cache(maxsize=16)
def jib_parts(ropes: Ropes) -> tuple[Part, ...]:
    """Return the parts of a jib head for these ropes in the jib frame."""
    dark = Material("jib_dark", texture=textures.load("grease"), tile_m=0.6, specular=0.35)
    return (
        Part("cheeks", _cheeks(ropes), _PAINT),
        Part("guards", _guards(ropes), _YELLOW),
        Part("sheaves", _sheaves(ropes), dark),
        Part("shafts", _shafts(ropes), dark),
        *_fixed_parts(),
        *_rope_runs(ropes),
    )


@cache
def _fixed_parts() -> tuple[Part, ...]:
    """Return the parts that no rope changes."""
    return (
        Part("trunk", _trunk(), _PAINT),
        Part("platform", platform_frame(), _PAINT),
        Part("grating", platform_grating(), _ZINC),
        Part("bracket", bracket(), _ZINC),
        Part("floodlights", floodlights(), _LAMP),
        Part("lenses", lenses(), _LENS),
    )


@lru_cache(maxsize=16)
def jib_steel(ropes: Ropes) -> trimesh.Trimesh:
    """Return the jib head's parts as one mesh in the jib frame."""
    return join(part.mesh for part in jib_parts(ropes))


def _trunk() -> trimesh.Trimesh:
    """Lattice behind the head sheaves: four chords, posts, diagonals, and the box that carries the cheek plates."""
    x = np.linspace(_NOSE_X, _TAIL_X, _PANELS + 1)
    share = (x - _NOSE_X) / (_TAIL_X - _NOSE_X)
    half = 0.72 + 0.16 * share
    top = np.full_like(x, 0.78)
    low = 0.24 - 1.0 * np.sin(np.pi * np.clip(share * 0.62, 0, 1))
    pieces = [shapes.block((_NOSE_X - 0.12, -0.76, 0.16), (_NOSE_X + 0.10, 0.76, 0.86), 0.015)]
    for side in (-1.0, 1.0):
        upper, lower = (np.stack([x, side * half, z], axis=1) for z in (top, low))
        pieces += _chain(upper, 0.075) + _chain(lower, 0.085)
        pieces += [rod(upper[i], lower[i], 0.04, 8) for i in range(1, _PANELS + 1)]
        pieces += [rod((upper, lower)[i % 2][i], (lower, upper)[i % 2][i + 1], 0.045, 8) for i in range(_PANELS)]
    left, right = -half, half
    for z, radius in ((top, 0.04), (low, 0.045)):
        pieces += [rod((x[i], left[i], z[i]), (x[i], right[i], z[i]), radius, 8) for i in range(1, _PANELS + 1)]
        pieces += [
            rod((x[i], (left, right)[i % 2][i], z[i]), (x[i + 1], (right, left)[i % 2][i + 1], z[i + 1]), 0.035, 8)
            for i in range(_PANELS)
        ]
    return join(pieces)


def _chain(points: Array, radius: float) -> list[trimesh.Trimesh]:
    """Make a chord through points, each piece a little longer than its panel so that the joints close."""
    pieces = []
    for a, b in pairwise(points):
        reach = (b - a) / np.linalg.norm(b - a) * 0.02
        pieces.append(rod(a - reach, b + reach, radius, 10))
    return pieces


def _axes(ropes: Ropes) -> list[tuple[float, float]]:
    """Return the head sheaves' (x, y): each rope drops on its sheave's outboard side."""
    return [(x - SHEAVE_RADIUS, y) for x, y, _ in ropes.exits]


def _sheaves(ropes: Ropes) -> trimesh.Trimesh:
    groove, axes = ropes.radius_m * 1.1, _axes(ropes)
    head = [shapes.sheave((x, y, SHEAVE_Z), SHEAVE_RADIUS, groove, 40) for x, y in axes]
    tail = [shapes.sheave((_TAIL_X, y, SHEAVE_Z), SHEAVE_RADIUS, groove, 40) for _, y in axes]
    return join([*head, *tail])


def _shafts(ropes: Ropes) -> trimesh.Trimesh:
    head = [pin(x, SHEAVE_Z, y - 0.075, y + 0.075, 0.055, 0.03) for x, y in _axes(ropes)]
    return join([*head, pin(_TAIL_X, SHEAVE_Z, -0.95, 0.95, 0.06, 0.03)])


def _cheeks(ropes: Ropes) -> trimesh.Trimesh:
    """Return the plates on either side of each sheave, and the tubes that tie them together."""
    at = [x for x, _ in _axes(ropes)]
    front, rear = max(at), min(at)
    outline = rounded(
        hull(circle(front, SHEAVE_Z, 0.24), circle(rear, SHEAVE_Z, 0.30), shapely.box(-1.4, 0.16, -1.2, 0.86)), 0.03
    )
    plate = prism(outline, -0.011, 0.011)
    bosses = [pin(float(x), SHEAVE_Z, -0.02, 0.02, 0.11) for x in (front, rear)]
    one = join([plate, *bosses])
    ties = [rod((-1.17, -0.62, z), (-1.17, 0.62, z), 0.045) for z in (0.24, 0.78)]
    half = STAGGER_M / 2
    if len(ropes.exits) == 1:
        return join([shapes.at_y(one, -half - 0.005, half), *ties])
    pair = shapes.at_y(one, -2 * half - 0.005, 0.0, 2 * half)  # two sheaves share the plate between them
    middle = round(max(y for _, y, _ in ropes.exits) - half, 9)
    return join([shapes.at_y(pair, -middle, middle), *ties])


def _guards(ropes: Ropes) -> trimesh.Trimesh:
    """Return the bars and hoops that keep the ropes in their grooves."""
    outer, inner = SHEAVE_RADIUS + 0.085, SHEAVE_RADIUS + 0.070
    pieces = []
    for x, y in _axes(ropes):
        ring = circle(x, SHEAVE_Z, outer, 10).difference(circle(x, SHEAVE_Z, inner, 10))
        corner = hull(shapely.MultiPoint([(x, SHEAVE_Z), (x + 0.9, SHEAVE_Z + 0.35), (x + 0.2, SHEAVE_Z + 0.9)]))
        hoop = ring.intersection(corner)
        pieces.append(prism(hoop, y - 0.05, y + 0.05))
        bars = ((x + 0.33, SHEAVE_Z + 0.36), (x + 0.13, SHEAVE_Z + 0.465))
        pieces += [rod((px, y - 0.07, pz), (px, y + 0.07, pz), 0.01, 8) for px, pz in bars]
    return join(pieces)


def _rope_runs(ropes: Ropes) -> list[Part]:
    """Return the ropes from the tops of the head sheaves to the trunk's tail."""
    parts = []
    for i, (x, y) in enumerate(_axes(ropes)):
        along = np.array([[0, 0, -1, x], [0, 1, 0, y], [1, 0, 0, SHEAVE_Z + SHEAVE_RADIUS], [0, 0, 0, 1]], float)
        parts.append(rope_part(x - _TAIL_X, f"run_{i}", ropes.radius_m).moved(along))
        bend = shapes.bent_rod(SHEAVE_RADIUS, ropes.radius_m)  # from the sheave's top to its outboard side
        bend.apply_translation((x, y, SHEAVE_Z))
        parts.append(Part(f"bend_{i}", bend, parts[0].material))
    return parts
