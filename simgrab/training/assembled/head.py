"""Heads, and what joins them to jaws or vessel, for grabs that are put together at random."""

from __future__ import annotations

import numpy as np
import shapely
import trimesh

from simgrab.model.geometry import Array
from simgrab.training.assembled.dimensions import Chance, Dimensions
from simgrab.world.scenery.grabs import kit
from simgrab.world.scenery.meshes import shapes
from simgrab.world.scenery.meshes.paint import BARE
from simgrab.world.scenery.meshes.part import Part
from simgrab.world.scenery.meshes.shapes import block, circle, hull, join, prism, rod


def middle(d: Dimensions, chance: Chance) -> list[Part]:
    """Return what joins the head to the jaws' hinges or the vessel: a column, plates or bars, and a beam."""
    (x, y), top, u = d.head_half, d.head_z[0] + 0.02 * d.size, d.size
    low = d.hinge[1] if d.count else d.depth - 0.02
    aside = max(map(abs, d.jaw_y)) if d.count == 2 else d.hinge[0]
    foot = max(d.hinge[0], 0.08 * u), aside + 0.08 * u
    beam = block((-foot[0], -foot[1], low - 0.09 * u), (foot[0], foot[1], low + 0.09 * u), 0.01)
    parts = [chance.part("beam", beam)] if d.count else []
    match int(chance.rng.integers(5)):
        case 0:
            radius = min(x, y) * chance.share(0.2, 0.9)
            parts.append(chance.part("column", rod((0, 0, low), (0, 0, top), radius, 20)))
        case 1:
            wide, long = x * chance.share(0.2, 0.9), y * chance.share(0.2, 0.9)
            parts.append(chance.part("column", block((-wide, -long, low), (wide, long, top), 0.02)))
        case 2:
            posts = [rod((sx * 0.8 * foot[0], sy * 0.8 * foot[1], low), (sx * 0.8 * x, sy * 0.8 * y, top),
                         d.size * 0.05) for sx in (-1, 1) for sy in (-1, 1)]  # fmt: skip
            parts.append(chance.part("posts", join(posts)))
        case 3:
            side = hull(shapely.box(-foot[0], low - 0.05, foot[0], low + 0.05), shapely.box(-x, top - 0.05, x, top))
            plate = prism(side, -0.012 - 0.01 * u, 0.012 + 0.01 * u)
            parts.append(chance.part("plates", shapes.at_y(plate, -0.7 * y, 0.7 * y)))
        case _:
            turns = np.arange(int(chance.rng.integers(3, 7)))
            ends = [((0.9 * foot[0] * c, 0.9 * foot[1] * s, low), (0.9 * x * c, 0.9 * y * s, top))
                    for c, s in ((np.cos(a), np.sin(a)) for a in turns * 2 * np.pi / len(turns))]  # fmt: skip
            parts.append(chance.part("bars", join(rod(a, b, u * 0.04) for a, b in ends)))
    return parts


def head(d: Dimensions, chance: Chance, ropes: int) -> list[Part]:
    """Return the head: its body, what is attached to it, and what its ropes end in.

    Some ropes run into guides, as closing ropes do, although nothing is closed by them.
    """
    (x, y), (low, high), u = d.head_half, d.head_z, d.size
    parts = [chance.part("body", _body(d, chance))]
    for i in range(int(chance.rng.integers(0, 7))):
        parts.append(chance.part(f"attachment_{i}", _attachment(d, chance), BARE.dark))
    if chance.happens(0.2):
        corners = [(sx * x, sy * y) for sx, sy in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
        parts.append(chance.part("rail", kit.rail(corners, high - 0.02, chance.share(0.3, 0.8)), BARE.hazard))
    if chance.happens(0.15):
        parts.append(chance.part("ladder", kit.ladder(0.0, 0.17, y + 0.06, low - 0.4 * u, high), BARE.hazard))
    if chance.happens(0.4):
        wide = 0.4 * x
        parts.append(kit.plate_part("number", (-wide, -0.9 * y, high - 0.01), (wide, -0.9 * y + wide, high + 0.012)))
    if ropes == 1:
        parts.append(Part("shackle", kit.shackle(high, kit.shackle_radius(d.size)), BARE.dark))
        return parts
    for i, end in enumerate(rope_ends(d, ropes)):
        holder = kit.guide if i in kit.closing(ropes) else kit.socket
        parts.append(Part(f"end_{i}", holder(end, 0.44), BARE.dark))
    return parts


def rope_ends(d: Dimensions, ropes: int) -> Array:
    """Return where the ropes end, shape (ropes, 3), m."""
    half = min(0.5 * d.head_half[0], 0.5), min(0.6 * d.head_half[1], 0.8)
    return kit.ends_over(ropes, *half, d.head_z[1], d.size)


def _body(d: Dimensions, chance: Chance) -> trimesh.Trimesh:
    """Return a frame, block, drum, wedge, pair of plates or cross."""
    (x, y), (low, high), u = d.head_half, d.head_z, d.size
    match int(chance.rng.integers(6)):
        case 0:
            wide = u * chance.share(0.05, 0.16)
            beams = [((-x - wide, sy * y - wide), (x + wide, sy * y + wide)) for sy in (-1, 1)]
            beams += [((sx * x - wide, -y), (sx * x + wide, y)) for sx in (-1, 0, 1)]
            return join(block((*a, low), (*b, high)) for a, b in beams)
        case 1:
            return block((-x, -y, low), (x, y, high), 0.02)
        case 2:
            ring = [(0.01, low), (x, low), (x * chance.share(0.6, 1.0), high), (0.01, high)]
            return d.turned(ring, int(chance.rng.choice([6, 8, 24])))
        case 3:
            slope = hull(shapely.box(-x, low, x, low + 0.05), shapely.box(-0.5 * x, high - 0.05, 0.5 * x, high))
            return prism(slope, -y, y)
        case 4:
            gap = chance.share(0.3, 0.9) * y
            plates = [block((-x, s * gap - 0.03 * u, low), (x, s * gap + 0.03 * u, high)) for s in (-1, 1)]
            ties = [rod((sx * 0.8 * x, -gap, 0.5 * (low + high)), (sx * 0.8 * x, gap, 0.5 * (low + high)), 0.05 * u)
                    for sx in (-1, 1)]  # fmt: skip
            return join([*plates, *ties, block((-0.4 * x, -gap, low), (0.4 * x, gap, high))])
        case _:
            cross = [block((-x, -0.2 * y, low), (x, 0.2 * y, high)), block((-0.2 * x, -y, low), (0.2 * x, y, high))]
            return join(cross)


def _attachment(d: Dimensions, chance: Chance) -> trimesh.Trimesh:
    """Return a box, a drum, a sheave or a lug, that stands on the head or hangs at its side."""
    (x, y), (low, high), u = d.head_half, d.head_z, d.size
    at = np.array([chance.share(-0.9, 0.9) * x, chance.share(-0.9, 0.9) * y, high if chance.happens(0.75) else low])
    half = u * chance.rng.uniform(0.04, 0.28, 3)
    match int(chance.rng.integers(4)):
        case 0:
            return block((at - half).tolist(), (at + half).tolist(), 0.01)
        case 1:
            way = np.eye(3)[chance.rng.integers(3)]
            return rod(at - half * way, at + half * way, float(half.min()), 14)
        case 2:
            return shapes.sheave((at[0], at[1], at[2]), float(u * chance.share(0.1, 0.25)), 0.017)
        case _:
            lug = hull(circle(0, 0.6 * half[2], half[0] / 2), shapely.box(-half[0], -half[2], half[0], 0))
            return prism(lug, -0.02, 0.02).apply_translation(at)
