"""What the grab weighs and how it resists being turned, for any opening of the jaws and any load."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

# Of the empty grab of `simgrab.world.meshes`, about axes through its centre of mass; a test computes them again.
MASS_KG = 10_500.0
_JAW = np.radians([0.0, 13.75, 27.5, 41.25, 55.0])
_CENTRE_Z_M = np.array([-0.0711, -0.1839, -0.2909, -0.3729, -0.4095])
_INERTIA_KG_M2 = np.array(
    [
        [15975.0, 14975.0, 11729.0],
        [17111.0, 17646.0, 13265.0],
        [18104.0, 20187.0, 14811.0],
        [18740.0, 22077.0, 16066.0],
        [18779.0, 22824.0, 16774.0],
    ]
)
# The cargo of the full grab: 24 t in all.
CARGO_KG = 13_500.0
_LOAD = np.array([0.25, 0.5, 0.75, 1.0])
_CARGO_Z_M = np.array([-1.236, -1.047, -0.875, -0.738])
_CARGO_INERTIA_M2 = np.array(
    [[0.406, 0.248, 0.596], [0.450, 0.385, 0.708], [0.498, 0.497, 0.774], [0.544, 0.587, 0.811]]
)


class Mass(NamedTuple):
    """Mass, kg; height of its centre in the grab frame, m; moments of inertia about it, kg m²."""

    mass: float
    centre_z: float
    inertia: tuple[float, float, float]


def mass_of(jaw: float, load: float) -> Mass:
    """Mass properties at an opening of the jaws (rad) and a fill (0 to 1); off-axis terms below 0.1 % are left out."""
    own_z = float(np.interp(jaw, _JAW, _CENTRE_Z_M))
    own = [float(np.interp(jaw, _JAW, column)) for column in _INERTIA_KG_M2.T]
    cargo = CARGO_KG * load
    cargo_z = float(np.interp(load, _LOAD, _CARGO_Z_M))
    total = MASS_KG + cargo
    z = (MASS_KG * own_z + cargo * cargo_z) / total
    aside = MASS_KG * (own_z - z) ** 2 + cargo * (cargo_z - z) ** 2
    held = [cargo * float(np.interp(load, _LOAD, column)) for column in _CARGO_INERTIA_M2.T]
    x, y, about = (a + b for a, b in zip(own, held, strict=True))
    return Mass(total, z, (x + aside, y + aside, about))
