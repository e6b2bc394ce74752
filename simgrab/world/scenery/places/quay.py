"""A working quay: bulk pile, hopper or lorry, loader and the things that lie about."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simgrab.model.scenario import Quay
from simgrab.world.scenery.meshes.part import Material, Part
from simgrab.world.scenery.places import apron, clutter, hopper, materials, sea, ship, truck
from simgrab.world.scenery.places.canvas import cloud, noise
from simgrab.world.scenery.places.heap import CARGOES, Cargo, Field, pile
from simgrab.world.scenery.places.shapes import box, join, loft, outline, pose, rectangle, sheet

LANE = 5.25  # from the seaward rail to the middle of the lane between the rails, metres


def quay(place: Quay, *, head_height: float, rng: np.random.Generator) -> list[Part]:
    """Return the quay, everything on it, the water and a moored ship, in the jib frame."""
    cargo = CARGOES[place.cargo]
    edge_y = -rng.uniform(14.5, 16.0)
    site = apron.apron(edge_y, pixels=4096, wear=place.wear, rng=rng)
    canvas = site.canvas
    water_z = -rng.uniform(2.6, 3.8)
    heap = _heap(place, cargo, site.rails_y[1], rng)
    parts = [*_receiver(place, site, cargo, rng), *_clutter(site, heap.x[-1] - 1.5, rng), *_trench(site)]
    _strew(site, place, heap, rng)
    surface = Material("apron", texture=canvas.finish(cargo), specular=0.0)
    if place.pile_height_m > 0:
        mesh = sheet(heap.x, heap.y, heap.field, bottom=-0.4)
        parts.append(Part("pile", mesh, surface, canvas.uv(mesh.vertices)))
    parts += [*apron.ground(site, surface), *apron.edge(site, water_z, rng.uniform(-3, 3))]
    style = ship.looks(rng)
    deck_z = rng.uniform(-0.5, 2.5)
    vessel = [
        *ship.hull(style, water_z - deck_z, rng=rng),
        *ship.deck(style, cargo, is_open=False, wear=place.wear, rng=rng, pixels=1536),
        *ship.topsides(style, is_open=False, rng=rng),
    ]
    berth = pose(rng.uniform(-6, 6), edge_y - 1.0 - ship.HALF_BEAM, deck_z)
    parts += [p.moved(berth) for p in vessel]
    parts += sea.sea(
        water_z, 0.25, [(-sea.FAR, edge_y - 1.0 - 2 * ship.HALF_BEAM), (edge_y - 1.0, edge_y + 0.5)], (edge_y,), rng=rng
    )
    yaw = rng.normal(0, np.radians(5))
    return [p.moved(pose(0, 0, -head_height, yaw)) for p in parts]


@dataclass(frozen=True)
class _Heap:
    """The pile: its middle, the reach of its foot beside the ridge, its grid and heights; metres, quay frame."""

    at: tuple[float, float]
    foot: float
    x: Field
    y: Field
    field: Field


def _heap(place: Quay, cargo: Cargo, rail_y: float, rng: np.random.Generator) -> _Heap:
    """Pour the pile clear of the landward rail."""
    foot = place.pile_height_m / float(np.tan(cargo.repose))
    spread = 1.2 + 0.8 * place.pile_height_m
    reach = (foot + spread / 2 + 1.5, foot + 1.5)
    step = max(0.14, reach[0] / 80)
    x, y = (np.linspace(-r, r, round(2 * r / step) + 1) for r in reach)
    field = np.maximum(pile(x, y, place.pile_height_m, cargo, spread=spread, rng=rng), -0.25)
    at = (rng.uniform(-1.2, 1.2), rail_y + 2.6 + foot + rng.uniform(0.0, 1.2))
    return _Heap(at, foot, at[0] + x, at[1] + y, field)


def _strew(site: apron.Apron, place: Quay, heap: _Heap, rng: np.random.Generator) -> None:
    """Lay cargo on the ground: solid under the pile, thinning out in a skirt, and a trail to the receiver."""
    canvas, rails_y = site.canvas, site.rails_y
    receiver_y = rails_y[0] + LANE
    if place.pile_height_m > 0:
        cover = np.clip((heap.field + 0.25) / 0.27, 0, 1.4)[:, ::-1].T
        canvas.spill(cover, (heap.x[0], heap.y[0]), (heap.x[-1], heap.y[-1]))
    n = 512
    half = apron.SIZE / 2
    y, x = np.meshgrid(np.linspace(half, -half, n), np.linspace(-half, half, n), indexing="ij")
    patchy = cloud((n, n), noise(rng, cells=16, octaves=4))
    out = np.hypot((x - heap.at[0]) / 1.4, y - heap.at[1])
    skirt = np.exp(-np.maximum(out - heap.foot, 0) / 1.6) * (place.pile_height_m > 0)
    along = np.clip((y - receiver_y) / (heap.at[1] - receiver_y), 0, 1)
    trail = 0.75 * np.exp(-(((x - heap.at[0] * along) / 1.5) ** 2)) * (y < heap.at[1]) * (y > receiver_y - 3)
    drift = np.sum([0.5 * np.exp(-(((y - rail) / 0.35) ** 2)) for rail in rails_y], axis=0)
    cover = (skirt + trail * (0.3 + 0.7 * place.wear) + drift * place.wear) * np.clip((patchy - 0.36) * 2.6, 0, 1)
    canvas.spill(np.clip(cover, 0, 0.95), (-half, -half), (half, half))


def _receiver(place: Quay, site: apron.Apron, cargo: Cargo, rng: np.random.Generator) -> list[Part]:
    """Hopper or lorry between the rails, with its hatched box, lane number and contact shadows."""
    canvas, worn = site.canvas, 0.3 + 0.45 * place.wear
    x, y, yaw = rng.uniform(-2.0, 2.0), site.rails_y[0] + LANE, rng.normal(0, 0.03)
    for end in (-4.2, 4.0):
        canvas.stripe((x - 4.3, y + end), (x + 4.3, y + end), 0.12, apron.YELLOW, wear=worn)
    for side in (-4.3, 4.3):
        canvas.stripe((x + side, y - 4.2), (x + side, y + 4.0), 0.12, apron.YELLOW, wear=worn)
    for d in np.arange(-7.6, 8.0, 0.95):  # hatching at 45 degrees, clipped to the box
        a, b = max(-4.2, d - 4.1), min(4.2, d + 3.9)
        if b - a > 0.3:
            canvas.stripe((x + a, y - d + a), (x + b, y - d + b), 0.10, apron.YELLOW, opacity=0.8, wear=worn + 0.1)
    canvas.text(f"{int(rng.integers(1, 9)):02d}", (x + 7.0, site.rails_y[1] + 4.6), 1.1, apron.WHITE, wear=worn)
    canvas.text("STOP", (x - 8.0, site.rails_y[1] + 8.9), 0.9, apron.WHITE, turned=True, wear=worn)
    for tip, back in ((-9.0, -11.2), (10.0, 12.2)):
        lane = site.rails_y[1] + 4.7
        sign = np.sign(tip - back)
        canvas.stripe((x + back, lane), (x + tip - 0.7 * sign, lane), 0.18, apron.WHITE, wear=worn)
        head = [(x + tip, lane), (x + tip - 0.9 * sign, lane + 0.4), (x + tip - 0.9 * sign, lane - 0.4)]
        canvas.paint(head, apron.WHITE, wear=worn)
    if place.receiver == "none":
        return []
    if place.receiver == "hopper":
        parts, feet = hopper.hopper(cargo, rng=rng), hopper.footprints()
        canvas.grime(_moved(outline(-3.6, -3.6, 3.6, 3.6), x, y, yaw), 0.35, blur=0.8)
    else:
        x += rng.uniform(-1, 1)
        parts, feet = truck.truck(cargo, rng=rng), truck.footprints()
        y += rng.uniform(0.2, 0.9)
    for foot in feet:
        canvas.grime(_moved(foot, x, y, yaw), 0.75, blur=0.16)
    return [p.moved(pose(x, y, 0, yaw)) for p in parts]


def _moved(corners: list[tuple[float, float]], x: float, y: float, yaw: float) -> Field:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.asarray(corners) @ np.array([[c, s], [-s, c]]) + (x, y)


def _clutter(site: apron.Apron, pile_end: float, rng: np.random.Generator) -> list[Part]:
    """Park a loader at one end of the pile, ``pile_end`` metres off; at the other a skip, drums, a stack and cones."""
    canvas = site.canvas
    side = float(rng.choice([-1, 1]))
    x, y = side * (pile_end + rng.uniform(3.6, 4.8)), rng.uniform(6.0, 8.0)
    yaw = rng.normal(0, 0.35) + (np.pi if side > 0 else 0.0)
    canvas.grime(_moved(clutter.LOADER_FOOTPRINT, x, y, yaw), 0.7, blur=0.3)
    way = np.array([(x - side * 2 + side * 9 * t, y + 2.5 * np.sin(2.2 * t)) for t in np.linspace(0, 1, 20)])
    canvas.tracks(way, 0.5, width=0.6, gauge=2.1)
    parts = [p.moved(pose(x, y, 0, yaw)) for p in clutter.loader()]
    cx, cy = -side * (pile_end + rng.uniform(2.0, 4.0)), rng.uniform(9.5, 12.5)
    drums = [(cx + 3.2, cy - 1.0), (cx + 3.9, cy - 0.8), (cx + 3.4, cy - 0.3)][: int(rng.integers(2, 4))]
    lane = site.rails_y[1] + 2.0
    tapers = [(-side * (pile_end + 0.8) + rng.normal(0, 0.1), lane + 1.6 * i) for i in range(4)]
    for at, size in (((cx, cy), 1.3), *((d, 0.3) for d in drums), *((c, 0.2) for c in tapers)):
        square = outline(at[0] - size, at[1] - size, at[0] + size, at[1] + size)
        canvas.grime(square, 0.6, blur=0.15 * size + 0.08)
    return [
        *parts,
        clutter.tarpaulin(cx, cy, rng),
        clutter.skip(cx - side * 0.5, cy - 4.6, rng.normal(0.1, 0.2)),
        clutter.pallet(cx + 3.0, cy + 1.2, rng.uniform(0, 3)),
        *clutter.barrels(drums),
        *clutter.cones(tapers),
    ]


def _trench(site: apron.Apron) -> list[Part]:
    """Cable trench with chequered covers beside the landward rail, and drain grates, lying 3 cm proud."""
    y = site.rails_y[1] + 1.25
    site.canvas.grime(outline(-24, y - 0.4, 24, y + 0.4), 0.45, blur=0.12)
    covers = []
    for x in np.arange(-36, 36, 1.2):
        plate = rectangle(1.18, 0.62, 0.0, (x, y))
        covers.append(loft([plate - [0, 0, 0.02], plate + [0, 0, 0.025], rectangle(1.14, 0.58, 0.032, (x, y))]))
    grates = []
    for x in (-15.0, -3.0, 9.0, 21.0):
        gy = site.rails_y[0] + 1.1
        site.canvas.grime(outline(x - 0.5, gy - 0.4, x + 0.5, gy + 0.4), 1.2, blur=0.1)
        grates += [box((x - 0.4, gy + s - 0.03, -0.02), (x + 0.4, gy + s + 0.03, 0.03)) for s in (-0.28, 0.28)]
        grates += [
            box((x + d - 0.012, gy - 0.27, -0.02), (x + d + 0.012, gy + 0.27, 0.025))
            for d in np.linspace(-0.38, 0.38, 12)
        ]
    return [
        Part("trench covers", join(covers), materials.painted("cover plates", (0.30, 0.285, 0.265), tile_m=3.0)),
        Part("drain grates", join(grates), materials.rusty("grate iron")),
    ]
