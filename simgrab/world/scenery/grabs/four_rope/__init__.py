"""The four-rope clamshell grab with arms: 2.9 × 2.4 × 3.4 m closed, 10.5 t empty and 24 t full."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from math import radians

import numpy as np

from simgrab.model.geometry import Array
from simgrab.world.scenery.grabs.design import Body, Design
from simgrab.world.scenery.grabs.four_rope import beam, head
from simgrab.world.scenery.grabs.four_rope.beam import beam_parts
from simgrab.world.scenery.grabs.four_rope.cargo import cargo_parts
from simgrab.world.scenery.grabs.four_rope.head import ROPE_X, ROPE_Y, TERMINATION_Z, head_parts
from simgrab.world.scenery.grabs.four_rope.linkage import MAX_JAW, PARENTS, joint_positions, pins
from simgrab.world.scenery.grabs.four_rope.shells import arms_parts, lip_corners, shell_parts
from simgrab.world.scenery.grabs.weight import Weight
from simgrab.world.scenery.meshes.paint import BARE
from simgrab.world.scenery.meshes.part import Part

_HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])

#: Ropes 0 and 2 hold the head in sockets; 1 and 3 enter roller guides and close the jaws.
_TERMINATIONS = np.array([(sx * ROPE_X, sy * ROPE_Y, TERMINATION_Z) for sx, sy in ((1, 1), (-1, 1), (-1, -1), (1, -1))])

_MASSES_KG = {
    "head": 2500.0,
    "beam": 2000.0,
    "shell_outer": 2550.0,
    "shell_inner": 2550.0,
    "arms_outer": 450.0,
    "arms_inner": 450.0,
}

# Worked out of the meshes and rounded; a test does it again.
_WEIGHT = Weight(
    10_500.0,
    13_500.0,
    jaws=[
        (radians(0.0), -0.0711, 15975.0, 14975.0, 11729.0),
        (radians(13.75), -0.1839, 17111.0, 17646.0, 13265.0),
        (radians(27.5), -0.2909, 18104.0, 20187.0, 14811.0),
        (radians(41.25), -0.3729, 18740.0, 22077.0, 16066.0),
        (radians(55.0), -0.4095, 18779.0, 22824.0, 16774.0),
    ],
    loads=[
        (0.25, -1.236, 0.406, 0.248, 0.596),
        (0.50, -1.047, 0.450, 0.385, 0.708),
        (0.75, -0.875, 0.498, 0.497, 0.774),
        (1.00, -0.738, 0.544, 0.587, 0.811),
    ],
)


@cache
def four_rope() -> Design:
    """Return the grab; its meshes are shared."""
    lips = lip_corners()
    return Design(
        bodies=[
            Body(
                name, _MASSES_KG[name], parts, PARENTS.get(name, ""), pins.get(name, (0.0, 0.0, 0.0)),
                (0.0, 0.0, 1.0) if name == "beam" else (0.0, 1.0, 0.0), slides=name == "beam",
            )
            for name, parts in _steel().items()
        ],
        positions=joint_positions,
        max_jaw=MAX_JAW,
        terminations=_TERMINATIONS,
        closing=(1, 3),
        falls=_reeving(),
        falls_from="head",
        falls_to="beam",
        lips={"shell_outer": lips, "shell_inner": (lips * (-1.0, -1.0, 1.0))[::-1]},
        heaps=cargo_parts,
        cargo_kg=13_500.0,
        weight=_WEIGHT,
        drag_area_m2=10.0,
    )  # fmt: skip


def _reeving() -> Array:
    """Falls of the closing ropes between the head's and the beam's sheaves: (k, 2, 3), head point and beam point."""
    falls = []
    for turn in (1.0, -1.0):
        # In at the roller guide (−x, +y), then round beam and head sheaves in turn; the end is made fast in the head.
        for lower, upper in zip(beam.SHEAVE_Y, (ROPE_Y, *head.SHEAVE_Y), strict=True):
            for side in (-1.0, 1.0):
                x = side * turn * ROPE_X
                falls.append(((x, turn * upper, head.SHEAVE_Z), (x, turn * lower, beam.SHEAVE_Z)))
    return np.array(falls)


def _steel() -> Mapping[str, Sequence[Part]]:
    shell, arms = shell_parts(BARE), arms_parts(BARE)
    return {
        "head": head_parts(BARE),
        "beam": beam_parts(BARE),
        "shell_outer": shell,
        "shell_inner": [part.moved(_HALF_TURN) for part in shell],
        "arms_outer": arms,
        "arms_inner": [part.moved(_HALF_TURN) for part in arms],
    }
