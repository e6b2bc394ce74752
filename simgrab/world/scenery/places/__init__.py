"""Places: what the camera sees below the jib head."""

from __future__ import annotations

import numpy as np

from simgrab.model.scenario import Hold, Photo, Place, Plain, Quay, RandomPlace
from simgrab.world.scenery.meshes.part import Part
from simgrab.world.scenery.places.hold import hold
from simgrab.world.scenery.places.plain import photo, plain
from simgrab.world.scenery.places.quay import quay
from simgrab.world.scenery.places.water import water


def build(place: Place, *, head_height: float, rng: np.random.Generator) -> list[Part]:
    """Build a place.

    Parameters
    ----------
    head_height : float
        Rope exit above the quay's surface, metres.
    rng : numpy.random.Generator
        Lays out what differs from berth to berth: pile, stains, clutter, colours. The same state gives the same place.

    Returns
    -------
    list of Part
        In the jib frame: origin at the rope exit, x outboard, z up, m.
    """
    if isinstance(place, Quay):
        return quay(place, head_height=head_height, rng=rng)
    if isinstance(place, Hold):
        return hold(place, head_height=head_height, rng=rng)
    if isinstance(place, Plain):
        return plain(head_height=head_height)
    if isinstance(place, Photo):
        return photo(head_height=head_height)
    if isinstance(place, RandomPlace):  # of training scenes alone
        from simgrab.world.scenery.places.random_place import random_place

        return random_place(head_height=head_height, rng=rng)
    return water(place, head_height=head_height, rng=rng)
