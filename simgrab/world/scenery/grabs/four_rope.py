"""The default grab: a clamshell of fixed shape, 2.9 × 2.4 × 3.4 m closed, 10.5 t empty and 24 t full."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from simgrab.model.scenario.grab import Clamshell, FourRope
from simgrab.world.scenery.grabs.clamshell import clamshell
from simgrab.world.scenery.grabs.design import Design

SHAPE = Clamshell(volume_m3=7.665, width=0.833, length=0.823, plate_work=0.65)
_ROPES_M = (0.20, 0.50)  # half the spread of the ropes, across and along the closing line
_IN_SOCKET_M = 0.06  # how far the ropes end below the top of their sockets
_MASSES_KG = {
    "head": 2500.0, "beam": 2000.0, "shell_outer": 2550.0, "shell_inner": 2550.0, "arms_outer": 450.0,
    "arms_inner": 450.0,
}  # fmt: skip


@cache
def four_rope(_keys: FourRope = FourRope()) -> Design:  # noqa: B008 - immutable
    """Return the grab; its meshes are shared."""
    design = clamshell(SHAPE, ropes_m=_ROPES_M)
    return replace(
        design,
        bodies=[replace(body, mass_kg=_MASSES_KG[body.name]) for body in design.bodies],
        max_jaw=float(np.radians(55.0)),
        terminations=design.terminations - (0.0, 0.0, _IN_SOCKET_M),
        cargo_kg=13_500.0,
        drag_area_m2=10.0,
    )
