"""The grab's shells and arms: curved back, sides, ribs, cutting edges and lugs."""

from __future__ import annotations

from functools import cache

import numpy as np
import shapely
import trimesh
from numpy.typing import NDArray

from simgrab.world.scenery.grabs.four_rope.linkage import BEAM_Z_CLOSED, CRANK, HEAD_PIN, HINGE_X, SHELL_PIN
from simgrab.world.scenery.meshes import shapes
from simgrab.world.scenery.meshes.paint import SHELL_SIZE, Finish
from simgrab.world.scenery.meshes.part import Part
from simgrab.world.scenery.meshes.shapes import block, circle, hull, join, pin, prism, rounded

HALF_WIDTH = 1.15  # to the outside of the side plates; stiffeners and pins reach HALF_LENGTH
HALF_LENGTH = 1.2
ARM_Y = 0.95
LIP_Z = -1.66
_PLATE = 0.025
_RIB = 0.06
_GAP = 0.003  # half the gap between the closed lips
_CURVE = np.array([(_GAP, LIP_Z), (0.60, -1.53), (1.36, -1.20), (1.385, -0.02)])  # Bézier, closed, grab frame (x, z)
_HINGE = (HINGE_X, BEAM_Z_CLOSED)
_PIN = (HINGE_X + SHELL_PIN[0], BEAM_Z_CLOSED + SHELL_PIN[1])


@cache
def back_curve(count: int = 21) -> NDArray[np.float64]:
    """Return the inside of the outer shell's back plate, lip to rim, as (x, z) in the closed grab, (count, 2)."""
    t = np.linspace(0.0, 1.0, count)[:, None]
    p = _CURVE
    return np.asarray((1 - t) ** 3 * p[0] + 3 * (1 - t) ** 2 * t * p[1] + 3 * (1 - t) * t**2 * p[2] + t**3 * p[3])


def lip_corners() -> NDArray[np.float64]:
    """Return the ends of the outer shell's cutting lip in the shell's frame, shape (2, 3)."""
    x, z = np.array([_GAP, -1.698]) - np.array(_HINGE)
    return np.array([(x, HALF_WIDTH, z), (x, -HALF_WIDTH, z)])


def shell_parts(look: Finish) -> list[Part]:
    """Return the outer shell in its own frame: origin on its pin, axes as the grab's when closed."""
    parts = [
        _wrapped("back", _back(0.0, _PLATE), look),
        _wrapped("sides", _sides(), look),
        _wrapped("ribs", _ribs(), look),
        Part("stiffeners", _stiffeners(), look.body),
        Part("lugs", _lugs(), look.body),
        Part("lips", _lips(), look.lip),
        Part("pins", _pins(), look.dark),
    ]
    lining = _back(-0.006, 0.0, HALF_WIDTH - _PLATE - 0.001)
    parts.append(Part("lining", lining, look.lining, _wrap(lining)))
    to_pin = np.eye(4)
    to_pin[[0, 2], 3] = -np.array(_HINGE)
    return [part.moved(to_pin) for part in parts]


def arms_parts(look: Finish) -> list[Part]:
    """Return the two outer arms and their tie in their own frame: origin on their pin in the head."""
    start, end = np.array(HEAD_PIN), np.array(_PIN)
    along = (end - start) / CRANK.arm_m
    across = np.array([along[1], -along[0]])

    def at(s: float, t: float) -> tuple[float, float]:
        x, z = start + s * along + t * across
        return float(x), float(z)

    eyes = [circle(*HEAD_PIN, 0.085), circle(*_PIN, 0.085)]
    taper = ((0.0, 0.05), (0.25, 0.075), (0.95, 0.075), (CRANK.arm_m, 0.05))
    bar = hull(shapely.MultiPoint([at(s, side * t) for s, t in taper for side in (-1, 1)]))
    outline = shapely.union_all([bar, *eyes])
    inner = shapely.Polygon([at(s, 0.055 * t) for s, t in ((0.2, 1), (1.0, 1), (1.0, -1), (0.2, -1))])
    web = prism(rounded(outline, 0.0, 0.05), -0.014, 0.014)
    flanges = [prism(outline.difference(inner).intersection(bar.buffer(0.002)), -0.055, 0.055)]
    bosses = [pin(*place, -0.065, 0.065, 0.088) for place in (HEAD_PIN, _PIN)]
    arms = shapes.at_y(join([web, *flanges, *bosses]), -ARM_Y, ARM_Y)
    x, z = at(0.52 * CRANK.arm_m, 0.0)
    tie = shapes.rod((x, -ARM_Y, z), (x, ARM_Y, z), 0.045)
    gussets = [
        prism(
            hull(circle(x, z, 0.075), shapely.Polygon([at(s, t) for s in (0.35, 0.9) for t in (-0.03, 0.03)][:3])),
            y,
            y + 0.02,
        )
        for y in (-ARM_Y + 0.055, ARM_Y - 0.075)
    ]
    pins = shapes.at_y(pin(*_PIN, -0.115, 0.115, 0.035, 0.018), -ARM_Y, ARM_Y)
    to_pin = np.eye(4)
    to_pin[[0, 2], 3] = -start
    parts = [
        Part("arms", arms, look.body),
        Part("tie", join([tie, *gussets]), look.body),
        Part("arm_pins", pins, look.dark),
    ]
    return [part.moved(to_pin) for part in parts]


def _offset(distance: float, count: int = 21) -> NDArray[np.float64]:
    """Return the back curve moved outwards."""
    curve = back_curve(count)
    tangent = np.gradient(curve, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return np.asarray(curve + distance * np.stack([tangent[:, 1], -tangent[:, 0]], axis=1))


def _strip(inner: float, outer: float, first: int, last: int) -> shapely.Polygon:
    """Return the band between two offsets of the back curve, from one of its 21 points to another."""
    band = np.concatenate([_offset(inner)[first : last + 1], _offset(outer)[first : last + 1][::-1]])
    band[:, 0] = np.maximum(band[:, 0], _GAP)
    return shapely.Polygon(band)


def _back(inner: float, outer: float, half_width: float = HALF_WIDTH) -> trimesh.Trimesh:
    return prism(_strip(inner, outer, 0, 20), -half_width, half_width)


def _side_outline() -> shapely.Polygon:
    """Return the side plate: back curve, hollowed top edge, and the ear that hangs on the pin."""
    top = [(1.385, -0.02), (1.20, 0.0), (0.95, -0.12), (0.66, -0.24), (0.42, -0.20), (0.26, -0.02), (_GAP, -0.02)]
    body = shapely.Polygon([*map(tuple, back_curve()), *top[1:]])
    ear = hull(circle(*_HINGE, 0.13), shapely.box(0.05, -0.25, 0.36, -0.2))
    inside = shapely.box(_GAP, -2.0, 2.0, 1.0)
    return rounded(shapely.union_all([body, ear]), 0.0, 0.12).intersection(inside)


def _sides() -> trimesh.Trimesh:
    outline = _side_outline()
    plate = prism(outline, HALF_WIDTH - _PLATE, HALF_WIDTH)
    frame = outline.difference(rounded(outline.buffer(-0.085), 0.04))
    edging = prism(frame.intersection(shapely.box(0.0, -1.5, 2.0, 1.0)), HALF_WIDTH, HALF_WIDTH + 0.018)
    ribs = [
        _side_rib((0.26, 0.0), (1.02, -1.12)),
        _side_rib((0.2, -0.06), (0.50, -1.50)),
        _side_rib((0.42, -0.34), (1.34, -0.62)),
    ]
    return shapes.mirrored_y(join([plate, edging, *ribs]))


def _side_rib(start: tuple[float, float], end: tuple[float, float]) -> trimesh.Trimesh:
    """Return a flat bar on edge, welded on the side plate, its free edge bevelled."""
    a, b = np.array(start), np.array(end)
    normal = np.array([-(b - a)[1], (b - a)[0]]) / np.linalg.norm(b - a) * 0.014
    corners = [a + normal, b + normal, b - normal, a - normal]
    low = [(x, HALF_WIDTH - 0.004, z) for x, z in corners]
    high = [
        (x + s * 0.05 * (b - a)[0], HALF_LENGTH, z + s * 0.05 * (b - a)[1])
        for (x, z), s in zip(corners, (1, -1, -1, 1), strict=True)
    ]
    return shapes.convex(low + high)


def _ribs() -> trimesh.Trimesh:
    rib = prism(_strip(_PLATE - 0.003, _PLATE + _RIB - 0.02, 2, 19), -0.014, 0.014)
    edge = prism(_strip(_PLATE - 0.003, _PLATE + 0.012, 1, 20), 1.08, HALF_WIDTH)
    return join([shapes.at_y(rib, -0.9, -0.54, -0.18, 0.18, 0.54, 0.9), shapes.mirrored_y(edge)])


def _stiffeners() -> trimesh.Trimesh:
    """Return the rim's box, the angle round the back at half height, and the corner gussets inside."""
    rim = rounded(shapely.box(1.375, -0.21, 1.45, -0.015), 0.022)
    belt = _strip(_PLATE - 0.003, _PLATE + 0.055, 11, 12)
    corner = shapely.Polygon([(1.38, -0.03), (1.38, -0.30), (1.14, -0.03)])
    gussets = [prism(corner, y - 0.01, y + 0.01) for y in (-0.45, 0.0, 0.45)]
    return join([prism(rim, -HALF_WIDTH, HALF_WIDTH), prism(belt, -HALF_WIDTH + 0.005, HALF_WIDTH - 0.005), *gussets])


def _lugs() -> trimesh.Trimesh:
    foot = shapely.Polygon([(1.38, -0.55), (1.38, -0.1), (1.08, -0.08), (1.20, -0.3)])
    plate = prism(hull(circle(*_PIN, 0.10), foot), -0.016, 0.016)
    boss = pin(*_PIN, -0.023, 0.023, 0.072)
    lug = join([plate, boss])
    ear = pin(HINGE_X, BEAM_Z_CLOSED, HALF_WIDTH - 0.045, HALF_WIDTH + 0.03, 0.105)
    return join([shapes.at_y(lug, *(s * ARM_Y + o for s in (-1, 1) for o in (-0.09, 0.09))), shapes.mirrored_y(ear)])


def _lips() -> trimesh.Trimesh:
    tip = shapely.union_all(
        [_strip(-0.008, 0.04, 0, 5), shapely.Polygon([(_GAP, LIP_Z + 0.05), (_GAP, LIP_Z - 0.039), (0.1, LIP_Z)])]
    )
    lip = prism(tip.intersection(shapely.box(_GAP, -1.7, 1.0, 0.0)), -HALF_WIDTH - 0.012, HALF_WIDTH + 0.012)
    flank = shapely.Polygon(
        [(_GAP, -0.06), (_GAP, LIP_Z - 0.02), (0.30, LIP_Z + 0.045), (0.13, LIP_Z + 0.2), (0.10, -0.10), (0.07, -0.06)]
    )
    side = prism(flank, HALF_WIDTH - _PLATE - 0.008, HALF_WIDTH + 0.024)
    return join([lip, shapes.mirrored_y(side)])


def _pins() -> trimesh.Trimesh:
    hinge = pin(HINGE_X, BEAM_Z_CLOSED, HALF_WIDTH - 0.09, HALF_LENGTH, 0.055, 0.02)
    keeper = block(
        (HINGE_X - 0.09, HALF_WIDTH + 0.028, BEAM_Z_CLOSED - 0.02),
        (HINGE_X + 0.09, HALF_WIDTH + 0.04, BEAM_Z_CLOSED + 0.02),
        0.003,
    )
    return shapes.mirrored_y(join([hinge, keeper]))


def _wrapped(name: str, mesh: trimesh.Trimesh, look: Finish) -> Part:
    return Part(name, mesh, look.shell, _wrap(mesh))


def _wrap(mesh: trimesh.Trimesh) -> NDArray[np.float64]:
    """Return UVs for the shell's texture: v = how far from the lip, so that wear follows height."""
    p = np.asarray(mesh.vertices)
    v = (p[:, 2] - LIP_Z + 0.25 * p[:, 0]) / (SHELL_SIZE[1] * 0.86)
    u = (p[:, 1] + 0.7 * p[:, 0]) / SHELL_SIZE[0]
    return np.stack([u, np.clip(v, 0.01, 0.99)], axis=1)
