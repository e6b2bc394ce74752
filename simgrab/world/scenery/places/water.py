"""Open water between a ship's side and the quay wall."""

from __future__ import annotations

import numpy as np

from simgrab.model.scenario import Water
from simgrab.world.scenery.meshes.part import Material, Part
from simgrab.world.scenery.places import apron, clutter, fittings, materials, sea, ship
from simgrab.world.scenery.places.shapes import join, pipe, placed, pose


def water(place: Water, *, head_height: float, rng: np.random.Generator) -> list[Part]:
    """Return water, ship (at larger y) and quay (at smaller y) in the jib frame."""
    level = -place.quay_height_m
    deck_z = level + place.freeboard_m
    side, wall = rng.uniform(4.5, 6.5), -rng.uniform(6.0, 8.0)
    style = ship.looks(rng)
    vessel = [
        *ship.deck(style, None, is_open=False, wear=0.5, rng=rng),
        *ship.topsides(style, is_open=False, rng=rng),
        *ship.hull(style, level - deck_z, rng=rng),
    ]
    along = rng.uniform(-9, 9)
    parts = [p.moved(pose(along, side + ship.HALF_BEAM, deck_z)) for p in vessel]
    first = rng.uniform(-3, 3)
    quay = apron.apron(-wall, pixels=3072, wear=0.5, rng=rng)
    shore = [
        *apron.ground(quay, Material("apron", texture=quay.canvas.finish(), specular=0.0)),
        *apron.edge(quay, level, first),
    ]
    bollard_y = -wall + 4.2
    spots = [(s * rng.uniform(1.5, 7), bollard_y + rng.uniform(0.5, 2)) for s in (-1, 1)]
    shore += [*clutter.barrels([spots[0], (spots[0][0] + 0.75, spots[0][1] + 0.1)]), clutter.pallet(*spots[1], 0.4)]
    # The quay frame looks landward along y; here land lies at smaller y.
    parts += [p.moved(pose(0, 0, 0, np.pi)) for p in shore]
    parts += sea.sea(
        level, place.chop, [(wall - 0.5, side), (side + 2 * ship.HALF_BEAM, sea.FAR)], (side, wall), rng=rng
    )
    parts.append(_mooring(-(first + 4.0), side, deck_z, wall, rng))
    parts.append(_floats(side, level, rng))
    yaw = rng.normal(0, np.radians(5))
    return [p.moved(pose(0, 0, -head_height, yaw)) for p in parts]


def _mooring(bollard_x: float, side: float, deck_z: float, wall: float, rng: np.random.Generator) -> Part:
    """Two mooring lines with their sag, from bitts at the ship's edge to a bollard on the quay."""
    lead = bollard_x + float(rng.choice([-1, 1]) * rng.uniform(8, 12))
    lines = []
    for x in (lead - 0.5, lead + 0.5):
        start = np.array([x, side + 0.9, deck_z + 0.45])
        end = np.array([bollard_x, wall - 1.0, 0.42])
        share = np.linspace(0, 1, 17)[:, None]
        way = start + (end - start) * share - np.array([0, 0, 1.0]) * 4 * 0.45 * share * (1 - share)
        lines.append(pipe(list(way), 0.035, sides=6))
    bitts = placed(fittings.bitts(), lead, side + 0.9, deck_z)
    return Part("mooring lines", join([*lines, bitts]), materials.plain("hawser", (0.40, 0.38, 0.30), specular=0.0))


def _floats(side: float, level: float, rng: np.random.Generator) -> Part:
    """Pneumatic fenders that float along the hull."""
    bodies = []
    for x in (rng.uniform(-9, -6), rng.uniform(5, 8)):
        outline = [(0.15, -1.5), (0.55, -1.3), (0.75, -0.9), (0.78, 0.0), (0.75, 0.9), (0.55, 1.3), (0.15, 1.5)]
        bodies.append(placed(clutter.turned(outline, sides=18, lying=True), x, side - 0.80, level + 0.25))
        for z in np.linspace(-1.1, 1.1, 5):
            hoop = [(0.70, z - 0.07), (0.83, z - 0.04), (0.83, z + 0.04), (0.70, z + 0.07)]
            bodies.append(placed(clutter.turned(hoop, sides=16, lying=True), x, side - 0.80, level + 0.25))
    return Part("floating fenders", join(bodies), materials.RUBBER)
