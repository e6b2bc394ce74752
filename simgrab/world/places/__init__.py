"""Places: what the camera sees below the jib head."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simgrab.scenario import Hold, Quay, Water
from simgrab.world.meshes.part import Part
from simgrab.world.places.hold import hold
from simgrab.world.places.quay import quay
from simgrab.world.places.water import water

REACH = 9.0  # a grab swings no further from the vertical, metres


@dataclass(frozen=True)
class Place:
    """The surroundings of one scenario.

    Attributes
    ----------
    parts : list of Part
        In the jib frame: origin at the rope exit, x outboard, z up, metres.
    top_z : float
        Highest z of anything solid within `REACH` of the vertical through the origin, metres, jib frame.
    """

    parts: list[Part]
    top_z: float


def build(place: Quay | Hold | Water, *, head_height: float, rng: np.random.Generator) -> Place:
    """Build a place.

    Parameters
    ----------
    place : Quay, Hold or Water
    head_height : float
        Rope exit above the quay's surface, metres.
    rng : numpy.random.Generator
        Lays out what differs from berth to berth: pile, stains, clutter, colours. The same state gives the same place.
    """
    if isinstance(place, Quay):
        parts = quay(place, head_height=head_height, rng=rng)
    elif isinstance(place, Hold):
        parts = hold(place, head_height=head_height, rng=rng)
    else:
        parts = water(place, head_height=head_height, rng=rng)
    return Place(parts, top_z(parts))


def top_z(parts: list[Part], reach: float = REACH) -> float:
    """Highest z of any triangle that comes within ``reach`` of the z axis (a bound: of its corners), metres."""
    best = -np.inf
    for part in parts:
        corners = np.asarray(part.mesh.triangles)
        flat = corners[..., :2]
        low, high = flat.min(axis=1), flat.max(axis=1)
        # The nearest point of each triangle's bounding rectangle is no farther than the triangle itself.
        nearest = np.linalg.norm(np.clip(0.0, low, high), axis=1)
        if (nearest < reach).any():
            best = max(best, float(corners[nearest < reach][..., 2].max()))
    return best
