"""Grabs put together at random from parts of no real kind: a detector that learns them does not learn one kind.

Each has a head on ropes, something that joins it to what hangs below, and there a closed vessel, two shells, or tines
round the axis, of plates or of bars. Jaws turn about hinges in the head; struts between head and jaws follow them.
There is no reeving: the jaws open by themselves.

All is drawn closed, with the lowest point at z = 0.
"""

from __future__ import annotations

import operator
from collections.abc import Callable

import numpy as np

from simgrab.model.geometry import Array
from simgrab.model.rng import stream
from simgrab.model.scenario.grab import Assembled
from simgrab.training.assembled.dimensions import Chance, Dimensions
from simgrab.training.assembled.head import head, middle, rope_ends
from simgrab.training.assembled.jaws import jaw, strut, vessel
from simgrab.world.scenery.grabs import kit
from simgrab.world.scenery.grabs.design import Body, Design, Heaps, no_heaps
from simgrab.world.scenery.grabs.shells import edges

_SHAPES = 2**53  # distinct numbers from 0 to 1
_CLEARANCE_M = 0.03


def assembled(keys: Assembled) -> Design:
    """Return the design of a grab that is put together at random."""
    chance = Chance(stream(round(keys.shape * _SHAPES), 0, "assembled"))
    d = Dimensions.draw(keys, chance)
    steel = [*middle(d, chance), *head(d, chance, keys.ropes)]
    azimuths = [2 * np.pi * k / d.count for k in range(d.count)]
    bodies: list[Body] = []
    positions: dict[str, Callable[[float], float]] = {}
    if d.count:
        parts, found = jaw(d, chance), strut(d, chance)
        for k, azimuth in enumerate(azimuths):
            bodies.append(kit.hinged(f"jaw_{k}", parts, "head", azimuth, d.hinge, d.hinge))
            positions[f"jaw_{k}"] = operator.neg
            if found:
                bars, cylinder = found
                at = cylinder.head_pin
                bodies.append(kit.hinged(f"strut_{k}", bars, "head", azimuth, at, at))
                positions[f"strut_{k}"] = cylinder.turn
        max_jaw = float(np.radians(chance.share(25.0, 55.0)))
    else:
        steel += vessel(d, chance)
        max_jaw = 0.0
    rough = Design(
        [kit.body("head", steel), *bodies], lambda opening: {name: at(opening) for name, at in positions.items()},
        max_jaw, rope_ends(d, keys.ropes), lips=_lips(d, azimuths), heaps=_heaps(d),
    )  # fmt: skip
    return kit.standing(rough, keys.volume_m3)


def _lips(d: Dimensions, azimuths: list[float]) -> dict[str, Array]:
    """Return ends of two shells' edges, or tips of tines, each in its body's frame; none of a vessel."""
    if d.count == 2:
        return dict(zip(("jaw_0", "jaw_1"), edges(d.hinge, d.half_y), strict=True))
    return kit.tips("jaw", azimuths, d.hinge) if d.count else {}


def _heaps(d: Dimensions) -> Heaps:
    """Return what makes heaps between closed jaws of plates."""
    if not (d.count and d.plates):
        return no_heaps
    u, v = np.meshgrid(np.linspace(-1, 1, 33), np.linspace(-1, 1, 33), indexing="ij")
    if bowl := d.count > 2:
        u, v = u * np.sqrt(1 - v**2 / 2), v * np.sqrt(1 - u**2 / 2)  # a square on a disc
    r, z = np.maximum.accumulate(d.curve).T

    def form(level: float) -> tuple[Array, ...]:
        shoulder = d.depth * (0.3 + 0.55 * level)
        edge = float(np.interp(shoulder, z, r)) - 2.5 * _CLEARANCE_M
        x, y = edge * u, (edge if bowl else d.half_y - 0.06) * v
        out = np.hypot(u, v) if bowl else np.maximum(np.abs(u), np.abs(v))
        rho = np.hypot(x, y) if bowl else np.abs(x)
        return x, y, rho, shoulder + 0.14 * d.depth * (1 - out**1.7), 1 - out**4

    return kit.heaps(d.curve, _CLEARANCE_M, form)
