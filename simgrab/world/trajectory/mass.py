"""What the grab weighs and how it resists being turned, for any opening of the jaws and any load."""

from __future__ import annotations

import math
from bisect import bisect_right
from typing import NamedTuple

# Of the empty grab of `simgrab.world.scenery.meshes`, about axes through its centre of mass; a test recomputes them.
MASS_KG = 10_500.0
# Opening (rad), height of the centre (m), and moments of inertia (kg m²).
_JAW_NODES: list[tuple[float, ...]] = [
    (math.radians(0.0), -0.0711, 15975.0, 14975.0, 11729.0),
    (math.radians(13.75), -0.1839, 17111.0, 17646.0, 13265.0),
    (math.radians(27.5), -0.2909, 18104.0, 20187.0, 14811.0),
    (math.radians(41.25), -0.3729, 18740.0, 22077.0, 16066.0),
    (math.radians(55.0), -0.4095, 18779.0, 22824.0, 16774.0),
]
# The cargo of the full grab, 24 t in all: fill, height of its centre (m), and moments of inertia over its mass (m²).
CARGO_KG = 13_500.0
_LOAD_NODES: list[tuple[float, ...]] = [
    (0.25, -1.236, 0.406, 0.248, 0.596),
    (0.50, -1.047, 0.450, 0.385, 0.708),
    (0.75, -0.875, 0.498, 0.497, 0.774),
    (1.00, -0.738, 0.544, 0.587, 0.811),
]


class Mass(NamedTuple):
    """Mass, kg; height of its centre in the grab frame, m; moments of inertia about it, kg m²."""

    mass: float
    centre_z: float
    inertia: tuple[float, float, float]


def mass_of(jaw: float, load: float) -> Mass:
    """Mass properties at an opening of the jaws (rad) and a fill (0 to 1); off-axis terms below 0.1 % are left out."""
    own_z, *own = _between(jaw, _JAW_NODES)
    cargo_z, *shape = _between(load, _LOAD_NODES)
    cargo = CARGO_KG * load
    total = MASS_KG + cargo
    z = (MASS_KG * own_z + cargo * cargo_z) / total
    aside = MASS_KG * (own_z - z) ** 2 + cargo * (cargo_z - z) ** 2
    x, y, about = (a + cargo * b for a, b in zip(own, shape, strict=True))
    return Mass(total, z, (x + aside, y + aside, about))


def _between(value: float, nodes: list[tuple[float, ...]]) -> list[float]:
    """Interpolate linearly between rows that begin with their abscissa; beyond the ends the last row holds."""
    value = min(max(value, nodes[0][0]), nodes[-1][0])
    k = min(bisect_right(nodes, (value, math.inf)), len(nodes) - 1)
    low, high = nodes[k - 1], nodes[k]
    share = (value - low[0]) / (high[0] - low[0])
    return [a + share * (b - a) for a, b in zip(low[1:], high[1:], strict=True)]
