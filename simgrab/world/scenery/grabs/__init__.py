"""Grabs: what they are made of, how their jaws move, what they weigh."""

from __future__ import annotations

from functools import lru_cache

import msgspec

from simgrab.model.scenario import Grab
from simgrab.model.scenario.grab import Assembled, Clamshell, FourRope, Looks, Mesh, OrangePeel, Scissors
from simgrab.world.scenery.grabs.assembled import assembled
from simgrab.world.scenery.grabs.clamshell import clamshell
from simgrab.world.scenery.grabs.design import Design
from simgrab.world.scenery.grabs.four_rope import four_rope
from simgrab.world.scenery.grabs.from_file import from_file
from simgrab.world.scenery.grabs.orange_peel import orange_peel
from simgrab.world.scenery.grabs.scissors import scissors

_ANY = Looks()


def design_of(grab: Grab) -> Design:
    """Return the design of a scenario's grab. Grabs that differ in looks alone share it, and its meshes."""
    looks = {name: getattr(_ANY, name) for name in Looks.__struct_fields__}
    return _design(msgspec.structs.replace(grab, **looks))


@lru_cache(maxsize=16)
def _design(grab: Grab) -> Design:
    match grab:
        case FourRope():
            return four_rope()
        case Clamshell():
            return clamshell(grab)
        case OrangePeel():
            return orange_peel(grab)
        case Scissors():
            return scissors(grab)
        case Assembled():
            return assembled(grab)
        case Mesh():
            return from_file(grab)
