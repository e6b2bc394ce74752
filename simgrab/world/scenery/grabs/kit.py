"""Common parts of parametric grabs: proportions, pieces of steel, and assembling bodies into a design."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import shapely
import trimesh
from trimesh.transformations import translation_matrix

from simgrab.model.geometry import Array, rotation_z
from simgrab.model.scenario.grab import Shaped
from simgrab.world.scenery import textures
from simgrab.world.scenery.grabs.design import CARGO_LEVELS, Body, Design, Heaps
from simgrab.world.scenery.grabs.slider_crank import Cylinder
from simgrab.world.scenery.meshes import shapes
from simgrab.world.scenery.meshes.paint import BARE
from simgrab.world.scenery.meshes.part import Material, Part
from simgrab.world.scenery.meshes.shapes import circle, hull, join, pin, prism, rod, solid

STEEL_KG_M3 = 7850.0
MASS_FACTOR = 0.95  # over that of the drawn solids, which overlap: a clamshell of 7.8 m³ then has 10.5 t
LUMPS_M = {"coal": 0.045, "ore": 0.028, "grain": 0.010, "bauxite": 0.024, "sulphur": 0.014}
CARGO_KG_M3 = 850.0  # coal, as the grab's size is stated for


@dataclass(frozen=True)
class Scale:
    """Sizes of a grab, in units of its kind's usual proportions."""

    # x, y, z: metres a unit, along the axes of the grab frame
    x: float
    y: float
    z: float

    @classmethod
    def of(cls, keys: Shaped, unit_m3: float, *, round_: bool = False) -> Scale:
        """Scale a kind whose usual shape holds ``unit_m3`` cubic units; ``round_`` keeps x and y alike."""
        ratios = np.array([keys.width, keys.length, keys.height])
        if round_:
            ratios[:2] = np.sqrt(keys.width * keys.length)
        ratios *= np.cbrt(keys.volume_m3 / unit_m3 / ratios.prod())
        return cls(*(float(r) for r in ratios))

    def at(self, x: float, z: float) -> tuple[float, float]:
        """Scale a point (x, z)."""
        return x * self.x, z * self.z

    @property
    def mean(self) -> float:
        """Metres a unit for round parts."""
        return float(np.cbrt(self.x * self.y * self.z))


def body(
    name: str,
    parts: Sequence[Part],
    parent: str = "",
    pin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    axis: tuple[float, float, float] = (0.0, 1.0, 0.0),
    *,
    slides: bool = False,
) -> Body:
    """Make a body of parts in their places of the closed grab; ``pin`` is in the parent's frame."""
    mass = STEEL_KG_M3 * MASS_FACTOR * sum(shapes.volume(part.mesh) for part in parts)
    return Body(name, mass, parts, parent, pin, axis, slides=slides)


def hinged(
    name: str, parts: Sequence[Part], parent: str, azimuth: float, pin: tuple[float, float],
    origin: tuple[float, float],
) -> Body:  # fmt: skip
    """Make a body that turns about a horizontal pin.

    Parameters
    ----------
    parts : sequence of Part
        Parts in their places of the closed grab, at azimuth 0.
    azimuth : float
        Azimuth to which the parts are turned about z, rad.
    pin, origin : tuple of 2 floats
        The pin (r, z) at azimuth 0, m: in the parent's frame, and in the closed grab.
    """
    c, s = float(np.cos(azimuth)), float(np.sin(azimuth))
    own = placed(turned(parts, azimuth), (origin[0] * c, origin[0] * s, origin[1]))
    return body(name, own, parent, (pin[0] * c, pin[0] * s, pin[1]), (-s, c, 0.0))


def placed(parts: Sequence[Part], origin: Sequence[float]) -> list[Part]:
    """Move parts from the closed grab into the frame of a body whose origin is there."""
    pose = translation_matrix(-np.asarray(origin))
    return [part.moved(pose) for part in parts]


def turned(parts: Sequence[Part], azimuth: float) -> list[Part]:
    """Turn parts about z, rad."""
    pose = np.eye(4)
    pose[:3, :3] = rotation_z(azimuth)
    return [part.moved(pose) for part in parts]


def standing(design: Design, volume_m3: float) -> Design:
    """Move a design whose closed grab stands on z = 0, and holds a volume: A comes to half its height.

    Heights of the head, its pins, terminations, ends of ropes in the head and heaps are above z = 0.
    """
    heights = np.concatenate(list(design.points(0.0).values()))[:, 2]
    down = np.array([0.0, 0.0, -(float(heights.min()) + float(heights.max())) / 2])
    pose = translation_matrix(down)
    head, *others = design.bodies
    shifted = [replace(head, parts=[part.moved(pose) for part in head.parts])]
    for one in others:
        x, y, z = one.pin
        shifted.append(replace(one, pin=(x, y, z + float(down[2]))) if one.parent == head.name else one)

    def lowered(cargo: str, rng: np.random.Generator) -> list[Part]:
        return [part.moved(pose) for part in design.heaps(cargo, rng)]

    none = np.zeros(3)
    falls = design.falls + [down if design.falls_from == head.name else none, none]
    return replace(
        design, bodies=shifted, terminations=design.terminations + down, falls=falls, leads=design.leads + [down, none],
        heaps=lowered, cargo_kg=volume_m3 * CARGO_KG_M3,
    )  # fmt: skip


def widest(positions: Callable[[float], object], most: float) -> float:
    """Return the widest opening up to ``most``, rad, for which a linkage has a position."""
    for jaw in np.arange(most, 0.2, -np.radians(1.0)):
        try:
            positions(float(jaw))
        except ValueError:
            continue
        return float(jaw)
    raise ValueError("the linkage does not open")


def ends(count: int, half_x: float, half_y: float, z: float) -> Array:
    """Return the ends of 1, 2 or 4 ropes, shape (count, 3)."""
    at = {
        1: [(0.0, 0.0)],
        2: [(0.0, half_y), (0.0, -half_y)],
        4: [(half_x, half_y), (-half_x, half_y), (-half_x, -half_y), (half_x, -half_y)],
    }[count]
    return np.array([(x, y, z) for x, y in at])


def ends_over(count: int, half_x: float, half_y: float, deck: float, size: float) -> Array:
    """Return `ends` as high over a deck as sockets are, or the `shackle` of a single rope for a grab of a size."""
    return ends(count, half_x, half_y, deck + (5.4 * shackle_radius(size) if count == 1 else 0.42))


def closing(count: int) -> tuple[int, ...]:
    """Return the indices of the closing ropes: none of one, the second of two, every other of four."""
    return tuple(range(1, count, 2))


def socket(end: Array, height: float) -> trimesh.Trimesh:
    """Return a rope's socket below its end, on a pin between two cheeks that stand ``height`` below."""
    x, y, z = (float(v) for v in end)
    cone = [(0.004, -0.16), (0.058, -0.16), (0.062, -0.14), (0.040, -0.02), (0.030, 0.0), (0.004, 0.0)]
    top = shapes.turned(cone, 12)
    top.apply_translation((x, y, z))
    fork = prism(
        hull(circle(x, z - 0.26, 0.05), shapely.box(x - 0.045, z - 0.17, x + 0.045, z - 0.14)), y - 0.05, y + 0.05
    )
    foot = shapely.box(x - 0.09, z - height, x + 0.09, z - height + 0.05)
    cheeks = [prism(hull(circle(x, z - 0.26, 0.06), foot), y + o - 0.012, y + o + 0.012) for o in (-0.075, 0.075)]
    return join([top, fork, *cheeks, pin(x, z - 0.26, y - 0.10, y + 0.10, 0.026, 0.012)])


def guide(end: Array, height: float) -> trimesh.Trimesh:
    """Return the cage and funnel through which a closing rope enters the head at its end, ``height`` above the deck."""
    x, y, z = (float(v) for v in end)
    low = z - height
    plates = [
        shapes.block((x - 0.12, y + o - 0.008, low), (x + 0.12, y + o + 0.008, z - 0.04), 0.003) for o in (-0.1, 0.1)
    ]
    plates += [
        shapes.block((x + o - 0.008, y - 0.1, low), (x + o + 0.008, y + 0.1, z - 0.04), 0.003) for o in (-0.112, 0.112)
    ]
    ring = [(0.045, -0.055), (0.115, -0.02), (0.125, 0.02), (0.118, 0.022), (0.108, -0.01), (0.035, -0.042)]
    mouth = shapes.turned(ring, 16)
    mouth.apply_translation((x, y, z - 0.03))
    return join([*plates, mouth])


def holders(ends: Array, roped: bool, guide_m: float, socket_m: float) -> list[Part]:
    """Return the fittings of several ropes: guides for closing ropes, if there are any, and sockets."""
    closes = closing(len(ends)) if roped else ()
    return [
        Part(f"guide_{i}", guide(end, guide_m), BARE.dark)
        if i in closes
        else Part(f"socket_{i}", socket(end, socket_m), BARE.dark)
        for i, end in enumerate(ends)
    ]


def link(start: tuple[float, float], end: tuple[float, float], eye: float, bar: float) -> shapely.Polygon:
    """Return the outline of a bar between two eyes, whose half width is the share ``bar`` of their radius."""
    whole = hull(circle(*start, bar * eye), circle(*end, bar * eye))
    return shapely.union_all([whole, circle(*start, eye), circle(*end, eye)])


def cylinder_parts(
    cylinder: Cylinder, radius: float, shares: tuple[float, float], collar_m: float, max_jaw: float, *y: float
) -> tuple[list[Part], list[Part]]:
    """Return barrel and piston rod of hydraulic cylinders, closed, in planes of constant y.

    Parameters
    ----------
    radius, collar_m : float
        Radius of the barrel, and how long its collar is, m.
    shares : tuple of 2 floats
        Longest barrel, by the shortest distance of the pins up to ``max_jaw``, and by the distance in the closed grab.
    """
    start = np.array(cylinder.head_pin)
    end = np.add(cylinder.hinge, cylinder.jaw_pin)
    length = cylinder.length_m(0.0)
    shortest = min(cylinder.length_m(j) for j in np.linspace(0.0, max_jaw, 30))
    reach = min(shares[0] * shortest, shares[1] * length) / length

    def at(share: float) -> tuple[float, float, float]:
        r, z = start + share * (end - start)
        return float(r), 0.0, float(z)

    tube = [rod(at(0.0), at(reach), radius, 14), rod(at(reach - collar_m), at(reach), 1.12 * radius, 14)]
    tube.append(pin(start[0], start[1], -1.3 * radius, 1.3 * radius, radius))
    stem = [rod(at(0.3 * reach), at(1.0), 0.5 * radius, 12), pin(end[0], end[1], -radius, radius, 0.9 * radius)]
    barrel = Part("barrel", shapes.at_y(join(tube), *y), BARE.body)
    return [barrel], [Part("piston", shapes.at_y(join(stem), *y), BARE.lip)]


def shackle(z: float, radius: float) -> trimesh.Trimesh:
    """Return a swivel and shackle, and the hook block above them, on the axis from ``z`` upwards; 5.5 radii high."""
    stem = rod((0, 0, z), (0, 0, z + 1.2 * radius), 0.45 * radius, 14)
    angle = np.linspace(-2.2, 2.2, 9)
    arc = np.stack([0.75 * radius * np.sin(angle), 0 * angle, z + 1.9 * radius + 0.9 * radius * np.cos(angle)], axis=1)
    bow = join(rod(a, b, 0.2 * radius, 8) for a, b in pairwise(arc))
    block = shapes.block(
        (-0.55 * radius, -0.9 * radius, z + 2.6 * radius),
        (0.55 * radius, 0.9 * radius, z + 5.2 * radius),
        0.15 * radius,
    )
    wheel = shapes.sheave((0.0, 0.0, z + 4.2 * radius), 1.15 * radius, 0.018)
    return join([stem, bow, block, wheel])


def shackle_radius(size: float) -> float:
    """Return the radius of a `shackle` for a grab of a size, in units of its kind's proportions, m."""
    return 0.07 + 0.06 * size


def ladder(x: float, half_width: float, y: float, low: float, high: float) -> trimesh.Trimesh:
    """Return a ladder in a plane of constant y."""
    sides = [rod((x + s * half_width, y, low), (x + s * half_width, y, high), 0.018, 8) for s in (-1, 1)]
    rungs = [
        rod((x - half_width, y, z), (x + half_width, y, z), 0.013, 8) for z in np.arange(low + 0.1, high - 0.02, 0.28)
    ]
    return join([*sides, *rungs])


def rail(corners: Sequence[tuple[float, float]], z: float, height: float) -> trimesh.Trimesh:
    """Return a hand rail round the corners (x, y) of a deck at a height."""
    closed = [*corners, corners[0]]
    posts = [rod((x, y, z - 0.01), (x, y, z + height), 0.018, 8) for x, y in corners]
    bars = [
        rod((*a, z + share * height), (*b, z + share * height), 0.016, 8)
        for a, b in pairwise(closed)
        for share in (0.55, 1.0)
    ]
    return join([*posts, *bars])


def plate_part(name: str, low: Sequence[float], high: Sequence[float]) -> Part:
    """Return a number plate that lies flat between two corners, read from −y."""
    mesh = shapes.block(low, high, 0.002)
    p = np.asarray(mesh.vertices)
    span = np.subtract(high, low)
    uv = np.stack([(p[:, 0] - low[0]) / span[0], (p[:, 1] - low[1]) / span[1]], axis=1)
    return Part(name, mesh, BARE.plate, uv)


def wrap(name: str, mesh: trimesh.Trimesh, material: Material, *, top: float, around: float) -> Part:
    """Give a shell's part UVs that run from its lip at z = 0 to its rim at ``top``, and once round ``around`` m."""
    p = np.asarray(mesh.vertices)
    v = np.clip((p[:, 2] + 0.15 * np.abs(p[:, 0])) / (1.1 * top), 0.01, 0.99)
    return Part(name, mesh, material, np.stack([(p[:, 1] + 0.7 * p[:, 0]) / around, v], axis=1))


def curve(points: Sequence[tuple[float, float]], count: int = 17) -> Array:
    """Return a cubic Bézier curve, shape (count, 2)."""
    t = np.linspace(0.0, 1.0, count)[:, None]
    a, b, c, d = np.asarray(points, float)
    return np.asarray((1 - t) ** 3 * a + 3 * (1 - t) ** 2 * t * b + 3 * (1 - t) * t**2 * c + t**3 * d)


def offset(line: Array, distance: float) -> Array:
    """Move a line (n, 2) to its right-hand side, seen along it."""
    tangent = np.gradient(line, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return np.asarray(line + distance * np.stack([tangent[:, 1], -tangent[:, 0]], axis=1))


def band(line: Array, inner: float, outer: float, first: int = 0, last: int | None = None) -> shapely.Polygon:
    """Return the strip between two offsets of a line, from one of its points to another, at x ≥ 0.003."""
    cut = slice(first, last)
    ring = np.concatenate([offset(line, inner)[cut], offset(line, outer)[cut][::-1]])
    ring[:, 0] = np.maximum(ring[:, 0], 0.003)
    return shapely.Polygon(ring)


def strip(
    line: Array, offsets: tuple[float, float], y: tuple[float, float], first: int = 0,
    last: int | None = None,
) -> trimesh.Trimesh:  # fmt: skip
    """Return the plate that a `band` sweeps from one y to another."""
    return prism(band(line, *offsets, first, last), *y)


def access(
    keys: Shaped, corners: Sequence[tuple[float, float]], z: float, rail_m: float, at: tuple[float, float, float]
) -> list[Part]:
    """Return a rail round the corners (x, y) of a deck, and a ladder, if the keys ask for them.

    ``at`` is y, low and high. Heights are in m.
    """
    parts = [Part("rail", rail(corners, z, rail_m), BARE.hazard)] if keys.guards else []
    return [*parts, Part("ladder", ladder(0.0, 0.17, *at), BARE.hazard)] if keys.ladder else parts


def tips(stem: str, azimuths: Sequence[float], hinge: tuple[float, float]) -> dict[str, Array]:
    """Return the tips of the tines, at most four, each in its body's frame, shape (1, 3).

    Parameters
    ----------
    stem : str
        Bodies are called ``stem_0``, ``stem_1`` ….
    azimuths : sequence of float
        Azimuths of all tines, rad.
    hinge : tuple of 2 floats
        In the closed grab, (r, z), m.
    """
    count = len(azimuths)
    picked = sorted({round(k * count / 4) for k in range(4)}) if count > 3 else range(3)
    found = {}
    for k in picked:
        c, s = np.cos(azimuths[k]), np.sin(azimuths[k])
        r = 0.012 - hinge[0]
        found[f"{stem}_{k}"] = np.array([(r * c, r * s, -hinge[1])])
    return found


def petal(
    line: Array, inner: float, outer: float, half_angle: Callable[[Array, Array], Array], around: Array
) -> trimesh.Trimesh:
    """Return a closed plate of revolution between two offsets of a line (r, z), m, about azimuth 0.

    Parameters
    ----------
    line : ndarray, shape (n, 2)
    inner, outer : float
        Offsets to the right-hand side, seen along the line, m.
    half_angle : callable
        Returns half of the angle that the plate covers, rad, from the line's radii and the heights of the offset line,
        both of shape (n, 1).
    around : ndarray, shape (m,)
        Positions of the plate's points, in shares of that angle.
    """
    grids = []
    for distance in (outer, inner):
        at = offset(line, distance)
        r, z = np.maximum(at[:, :1], 0.012), np.maximum(at[:, 1:], 0.0)
        angle = half_angle(np.maximum(line[:, :1], 0.012), z) * around
        grids.append(np.stack([r * np.cos(angle), r * np.sin(angle), np.broadcast_to(z, angle.shape)], axis=-1))
    return shapes.outward(heap(*grids))


def lumps(rng: np.random.Generator, shape: tuple[int, int], size: float) -> Array:
    """Return the roughness of a heap's surface, m: lumps of two sizes."""
    fine, coarse = rng.standard_normal(shape), rng.standard_normal(shape)
    for axis in (0, 1):
        for _ in range(3):
            coarse = (np.roll(coarse, 1, axis) + coarse + np.roll(coarse, -1, axis)) / 3
    return np.asarray(size * (0.6 * fine + 1.2 * coarse / coarse.std()))


def heaps(inside: Array, clearance: float, form: Callable[[float], tuple[Array, ...]]) -> Heaps:
    """Return the function that makes heaps of cargo in closed jaws.

    Parameters
    ----------
    inside : ndarray, shape (n, 2)
        Inside of the jaws from lip to rim, (r, z), m.
    clearance : float
        Between heap and jaws, m.
    form : callable
        Returns, for a fill, arrays of a grid's shape: its points' x and y, m, their distances r from the axis or the
        closing line, the height of the smooth heap, m, and the share of its roughness.
    """
    reach, heights = np.maximum.accumulate(inside[:, 0]) - clearance, np.maximum.accumulate(inside[:, 1])

    def make(cargo: str, rng: np.random.Generator) -> list[Part]:
        material = Material(f"grab_{cargo}", texture=textures.load(cargo), tile_m=1.4, specular=0.05, shininess=0.1)
        made = []
        for level in CARGO_LEVELS:
            x, y, r, smooth, share = form(level)
            crest = smooth + lumps(rng, r.shape, LUMPS_M[cargo]) * share
            low = np.minimum(np.interp(r, reach, heights) + clearance, crest - 0.02)
            mesh = heap(*(np.stack([x, y, z], axis=-1) for z in (crest, low)))
            made.append(Part(f"cargo_{round(100 * level)}", mesh, material))
        return made

    return make


def heap(top: Array, bottom: Array) -> trimesh.Trimesh:
    """Close the space between two grids of points, shapes (n, m, 3), the second below the first."""
    upper, rim = shapes.grid(*top.shape[:2])
    after, down = np.roll(rim, -1), top.shape[0] * top.shape[1]
    skirt = [np.stack(way, -1) for way in ((rim, rim + down, after + down), (rim, after + down, after))]
    return solid(np.concatenate([top, bottom]).reshape(-1, 3), np.concatenate([upper, upper[:, ::-1] + down, *skirt]))
