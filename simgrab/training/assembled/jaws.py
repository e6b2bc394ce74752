"""Jaws of plates or bars, their levers and struts, and closed vessels, for grabs that are put together at random.

A jaw is drawn closed, in the plane y = 0 of its azimuth. Numbers of the curve's points are those of its 17.
"""

from __future__ import annotations

import numpy as np
import shapely
import trimesh

from simgrab.model.geometry import Array
from simgrab.training.assembled.dimensions import CURVE_POINTS, Chance, Dimensions
from simgrab.world.scenery.grabs import kit
from simgrab.world.scenery.grabs.shells import GAP_M, polygons
from simgrab.world.scenery.grabs.slider_crank import Cylinder
from simgrab.world.scenery.meshes import shapes
from simgrab.world.scenery.meshes.paint import BARE
from simgrab.world.scenery.meshes.part import Part
from simgrab.world.scenery.meshes.shapes import circle, hull, join, pin, prism, rod


def jaw(d: Dimensions, chance: Chance) -> list[Part]:
    """Return a shell, tongs or a tine with its lever."""
    parts = _tine(d, chance) if d.count > 2 else _shell(d, chance) if d.plates else _tongs(d, chance)
    return [*parts, _lever(d, chance)]


def strut(d: Dimensions, chance: Chance) -> tuple[list[Part], Cylinder] | None:
    """Return cylinders or bars from the head to a jaw, and how they turn; None for some grabs."""
    hx, hz = d.hinge
    r, z = d.curve[chance.rng.integers(8, CURVE_POINTS)]
    start = chance.share(0.0, 1.0) * d.head_half[0], d.head_z[0] + chance.share(0.0, 0.05) * d.size
    wanted, radius, stem = chance.happens(0.7), d.size * chance.share(0.025, 0.09), chance.share(0.4, 1.0)
    length = float(np.hypot(r - start[0], z - start[1]))
    if not wanted or length < 0.3:
        return None
    cylinder = Cylinder(d.hinge, start, (float(r - hx), float(z - hz)))
    a, b = np.array([start[0], 0.0, start[1]]), np.array([r, 0.0, z])
    middle = a + 0.6 * (b - a)
    one = join([rod(a, middle, radius, 12), rod(middle, b, stem * radius, 12)])
    at = d.jaw_y if d.count == 2 else (0.0,)
    return [chance.part("strut", shapes.at_y(one, *at))], cylinder


def vessel(d: Dimensions, chance: Chance) -> list[Part]:
    """Return a closed vessel: bowl, drum, cone, box, or anything between."""
    sides = int(chance.rng.choice([4, 4, 6, 8, 16, 24]))
    heights = np.sort(chance.rng.random(int(chance.rng.integers(1, 5)))) * d.depth
    heights = np.concatenate([[0.0], heights, [d.depth]])
    heights = np.maximum.accumulate(heights + 0.01 * np.arange(len(heights)))
    radii = d.half * chance.rng.uniform(0.35, 1.0, len(heights))
    outline = [(0.01, 0.0), *zip(radii, heights, strict=True), (0.01, float(heights[-1]))]
    parts = [chance.part("vessel", d.turned(outline, sides), BARE.shell)]
    for i in range(int(chance.rng.integers(0, 4))):
        z, high = chance.share(0.05, 0.9) * d.depth, d.size * chance.share(0.03, 0.15)
        r = float(np.interp(z + high / 2, heights, radii)) + d.size * chance.share(0.01, 0.1)
        ring = d.turned([(0.01, z), (r, z), (r, z + high), (0.01, z + high)], sides)
        parts.append(chance.part(f"ring_{i}", ring, BARE.hazard))
    return parts


def _shell(d: Dimensions, chance: Chance) -> list[Part]:
    """Return one of two shells."""
    hl, t, line = d.half_y, 0.012 + 0.01 * d.size, d.curve
    parts = [chance.part("back", _band(d, 0.0, t, -hl, hl), BARE.shell)]
    if chance.happens(0.8):
        side = shapely.Polygon([*map(tuple, line), (GAP_M, chance.share(0.5, 1.0) * d.depth)]).buffer(0)
        side = side.intersection(shapely.box(GAP_M, -9.0, 9.0, 9.0))
        parts.append(chance.part("sides", shapes.mirrored_y(join(prism(p, hl - t, hl) for p in polygons(side))),
                                BARE.shell))  # fmt: skip
    if chance.happens(0.5):
        ribs = _band(d, t - 0.003, t + d.size * chance.share(0.03, 0.12), -0.015, 0.015, 2, 16)
        parts.append(chance.part("ribs", shapes.at_y(ribs, *np.linspace(-0.9, 0.9, chance.rng.integers(2, 9)) * hl)))
    if chance.happens(0.5):
        first = int(chance.rng.integers(3, 13))
        parts.append(chance.part("belt", _band(d, t - 0.003, t + 0.06 * d.size, -hl, hl, first, first + 3)))
    if chance.happens(0.7):
        parts.append(chance.part("lips", _band(d, -0.008, t + 0.03, -hl - 0.01, hl + 0.01, 0, 4), BARE.lip))
    if chance.happens(0.3):
        (w, top), inner = line[-1], chance.share(0.3, 0.7)
        roof = shapely.LineString([(w, top), (inner * w, top + chance.share(0.0, 0.3) * d.size)])
        parts.append(chance.part("roof", prism(roof.buffer(t, cap_style="flat"), -hl, hl)))
    return parts


def _tongs(d: Dimensions, chance: Chance) -> list[Part]:
    """Return curved bars side by side, joined across."""
    hl, wide = d.half_y, d.size * chance.share(0.03, 0.10)
    bar = _band(d, 0.0, d.size * chance.share(0.06, 0.22), -wide, wide)
    across = [rod((r, -hl, z), (r, hl, z), d.size * chance.share(0.03, 0.08))
              for r, z in d.curve[chance.rng.integers(6, CURVE_POINTS, chance.rng.integers(1, 4))]]  # fmt: skip
    return [
        chance.part("bars", shapes.at_y(bar, *np.linspace(-hl, hl, int(chance.rng.integers(2, 7)))), BARE.shell),
        chance.part("across", join(across)),
    ]


def _tine(d: Dimensions, chance: Chance) -> list[Part]:
    """Return a tine: a plate of revolution with a spine, or a narrow claw."""
    t, sector = 0.014 + 0.006 * d.size, np.pi / d.count
    wide, share = d.size * chance.share(0.06, 0.2), chance.share(0.4, 0.98)

    def half_angle(r: Array, z: Array) -> Array:  # noqa: ARG001
        closed = sector - np.arcsin(np.minimum(GAP_M / r, 0.5))
        if d.plates:
            return np.asarray(share * closed)
        return np.asarray(np.minimum(np.arcsin(np.minimum(wide / r, 1.0)), 0.9 * closed))

    around = np.linspace(-1, 1, 9)
    high = d.size * chance.share(0.04, 0.16)
    half = d.size * chance.share(0.02, 0.07)
    parts = [
        chance.part("back", kit.petal(d.curve, 0.0, t, half_angle, around), BARE.shell),
        chance.part("spine", _band(d, t - 0.003, t + high, -half, half, 1), BARE.shell),
        chance.part("tip", _band(d, -0.004, t + 0.8 * high, -1.2 * half, 1.2 * half, 0, 5), BARE.lip),
    ]
    if chance.happens(0.4):
        r, z = d.curve[chance.rng.integers(8, 16)]
        reach = max(r * np.tan(0.7 * sector), 0.05)
        parts.append(chance.part("belt", rod((r, -reach, z), (r, reach, z), 0.04 * d.size + 0.01)))
    return parts


def _lever(d: Dimensions, chance: Chance) -> Part:
    """Return plates from the jaw's rim to its hinge, which may reach beyond it as a lever."""
    (hx, hz), line, u = d.hinge, d.curve, d.size
    eye = u * chance.share(0.06, 0.16)
    foot = shapely.MultiPoint(line[[-1, -int(chance.rng.integers(3, 9))]])
    plates = [hull(circle(hx, hz, eye), foot)]
    if chance.happens(0.4):
        room = d.head_z[0] - hz
        end = hx + chance.share(-1.2, 0.6) * d.half, hz + chance.share(0.1, 0.9) * room
        plates.append(hull(circle(hx, hz, eye), circle(*end, 0.6 * eye)))
    thick = 0.015 + 0.015 * u
    plate = join(prism(piece, -thick, thick) for piece in polygons(shapely.union_all(plates)))
    at = d.jaw_y if d.count == 2 else (-0.05 * u, 0.05 * u)
    pins = pin(hx, hz, min(at) - 2 * thick, max(at) + 2 * thick, 0.5 * eye)
    return chance.part("lever", join([shapes.at_y(plate, *at), pins]))


def _band(
    d: Dimensions, inner: float, outer: float, low: float, high: float, first: int = 0, last: int | None = None
) -> trimesh.Trimesh:
    """Return the strip along the curve, between two offsets, from y = ``low`` to ``high``."""
    strip = kit.band(d.curve, inner, outer, first, last).buffer(0)
    return join(prism(piece, low, high) for piece in polygons(strip))
