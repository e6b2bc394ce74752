"""Grabs: their parts, the motion of their jaws, and their mass."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import msgspec

from simgrab.errors import ScenarioError
from simgrab.model.scenario import Grab
from simgrab.model.scenario.grab import GrabAppearance
from simgrab.runtime import modules
from simgrab.world.scenery.grabs.design import Design

#: By ``model`` of a scene's ``[grab]``: the module, imported when such a grab is drawn, and its function that makes a
#: `Design` of the keys.
FAMILIES = {
    "four-rope": ("simgrab.world.scenery.grabs.four_rope", "four_rope"),
    "clamshell": ("simgrab.world.scenery.grabs.clamshell", "clamshell"),
    "orange-peel": ("simgrab.world.scenery.grabs.orange_peel", "orange_peel"),
    "scissors": ("simgrab.world.scenery.grabs.scissors", "scissors"),
    "assembled": ("simgrab.training.assembled", "assembled"),
    "mesh": ("simgrab.world.scenery.grabs.from_file", "from_file"),
}

_ANY = GrabAppearance()


def design_of(grab: Grab) -> Design:
    """Return the design of a scenario's grab. Grabs that differ in appearance alone share it, and its meshes.

    Raises `ScenarioError` if the family's module is not installed, or a user's own grab cannot be read.
    """
    shared = {name: getattr(_ANY, name) for name in GrabAppearance.__struct_fields__}
    return _design(msgspec.structs.replace(grab, **shared))


@lru_cache(maxsize=16)
def _design(grab: Grab) -> Design:
    kind = str(grab.__struct_config__.tag)
    try:
        family: Callable[[Grab], Design] = modules.find(*FAMILIES[kind])
    except ModuleNotFoundError as problem:
        raise ScenarioError("grab.model", f"{kind!r} is not installed: {problem}") from None
    return family(grab)
