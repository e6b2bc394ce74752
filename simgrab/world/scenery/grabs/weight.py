"""Mass and moments of inertia of a grab, for any opening of the jaws and any load."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import trimesh

from simgrab.model.geometry import Array

Row = tuple[float, ...]


class Mass(NamedTuple):
    """Mass, kg; height of its centre in the grab frame, m; moments of inertia about it, kg m²."""

    mass: float
    centre_z: float
    inertia: tuple[float, float, float]


@dataclass(frozen=True)
class Weight:
    """Mass properties, interpolated between known openings and fills. Offsets from the axes are neglected.

    Attributes
    ----------
    empty_kg, cargo_kg : float
        Mass of the empty grab, and of a full load.
    jaws : sequence of rows
        Opening, rad; height of the empty grab's centre of mass, m; moments of inertia about it, kg m².
    loads : sequence of rows
        Fill; height of the cargo's centre, m; moments of inertia over its mass, m². Empty without cargo.
    """

    empty_kg: float
    cargo_kg: float
    jaws: Sequence[Row]
    loads: Sequence[Row]

    def at(self, jaw: float, load: float) -> Mass:
        """Interpolate the mass for an opening, rad, and a fill, 0 to 1."""
        own_z, *own = _between(jaw, self.jaws)
        cargo_z, *shape = _between(load, self.loads) if self.loads else (0.0, 0.0, 0.0, 0.0)
        cargo = self.cargo_kg * load
        total = self.empty_kg + cargo
        z = (self.empty_kg * own_z + cargo * cargo_z) / total
        aside = self.empty_kg * (own_z - z) ** 2 + cargo * (cargo_z - z) ** 2
        x, y, about = (a + cargo * b for a, b in zip(own, shape, strict=True))
        return Mass(total, z, (x + aside, y + aside, about))


def spread(mesh: trimesh.Trimesh, mass: float) -> trimesh.Trimesh:
    """Return a mesh over whose volume a mass, kg, is spread evenly."""
    solid = mesh.copy()
    solid.density = mass / solid.volume
    return solid


def together(solids: Sequence[tuple[trimesh.Trimesh, Array]]) -> tuple[float, Array, Array]:
    """Mass, centre of mass and inertia about it of solids, each with its pose."""
    masses = np.array([solid.mass for solid, _ in solids])
    centres = np.array([pose[:3, :3] @ solid.center_mass + pose[:3, 3] for solid, pose in solids])
    centre = masses @ centres / masses.sum()
    inertia = np.zeros((3, 3))
    for (solid, pose), mass, own in zip(solids, masses, centres, strict=True):
        d = own - centre
        inertia += pose[:3, :3] @ solid.moment_inertia @ pose[:3, :3].T + mass * (d @ d * np.eye(3) - np.outer(d, d))
    return float(masses.sum()), centre, inertia


def _between(value: float, nodes: Sequence[Row]) -> Sequence[float]:
    """Interpolate linearly between rows that begin with their abscissa; beyond the ends the last row applies."""
    if len(nodes) == 1:
        return nodes[0][1:]
    value = min(max(value, nodes[0][0]), nodes[-1][0])
    k = min(bisect_right(nodes, (value, math.inf)), len(nodes) - 1)
    low, high = nodes[k - 1], nodes[k]
    share = (value - low[0]) / (high[0] - low[0])
    return [a + share * (b - a) for a, b in zip(low[1:], high[1:], strict=True)]
