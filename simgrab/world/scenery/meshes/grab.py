"""The four-rope clamshell grab: what it is made of, and where it holds on to its ropes.

Grab frame: origin A, fixed in the head's steel, at the centre of the closed grab's bounding box (2.9 × 2.4 × 3.4 m);
z up along the ropes, x across the closing line of the jaws, y along it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from functools import cache

import numpy as np

from simgrab.world.scenery.meshes import beam, head
from simgrab.world.scenery.meshes.beam import beam_parts
from simgrab.world.scenery.meshes.cargo import CARGO_LEVELS, cargo_parts
from simgrab.world.scenery.meshes.head import ROPE_X, ROPE_Y, TERMINATION_Z, head_parts
from simgrab.world.scenery.meshes.linkage import (
    BODIES,
    MAX_JAW,
    PARENTS,
    Linkage,
    body_frames,
    joint_positions,
    linkage,
    pins,
)
from simgrab.world.scenery.meshes.paint import Colour, Finish, finish
from simgrab.world.scenery.meshes.part import Material, Part
from simgrab.world.scenery.meshes.shells import arms_parts, lip_corners, shell_parts

__all__ = [
    "BODIES",
    "CARGO_LEVELS",
    "LIP_CORNERS",
    "MASSES_KG",
    "MAX_JAW",
    "PARENTS",
    "REEVING",
    "ROPE_TERMINATIONS",
    "Linkage",
    "body_frames",
    "cargo_parts",
    "closing_rope_m",
    "grab_parts",
    "joint_positions",
    "linkage",
    "pins",
    "steel",
]

_HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])

#: Where the four ropes end in the head, grab frame, metres, shape (4, 3): seen from above counter-clockwise from
#: (+x, +y). Ropes 0 and 2 hold the head in sockets; 1 and 3 enter roller guides and close the jaws.
ROPE_TERMINATIONS = np.array(
    [(sx * ROPE_X, sy * ROPE_Y, TERMINATION_Z) for sx, sy in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
)

#: Ends of each shell's cutting lip in that shell's frame, metres, each (2, 3); first the end that is at +y.
LIP_CORNERS = {
    "shell_outer": lip_corners(),
    "shell_inner": (lip_corners() * (-1.0, -1.0, 1.0))[::-1],
}

#: 10.5 t in all, without cargo.
MASSES_KG = {
    "head": 2500.0,
    "beam": 2000.0,
    "shell_outer": 2550.0,
    "shell_inner": 2550.0,
    "arms_outer": 450.0,
    "arms_inner": 450.0,
}


def _reeving() -> np.ndarray:
    """Falls of the closing ropes between the head's and the beam's sheaves: (k, 2, 3), head point and beam point."""
    falls = []
    for turn in (1.0, -1.0):
        # In at the roller guide (−x, +y), then round beam and head sheaves in turn; the end is made fast in the head.
        for lower, upper in zip(beam.SHEAVE_Y, (ROPE_Y, *head.SHEAVE_Y), strict=True):
            for side in (-1.0, 1.0):
                x = side * turn * ROPE_X
                falls.append(((x, turn * upper, head.SHEAVE_Z), (x, turn * lower, beam.SHEAVE_Z)))
    return np.array(falls)


REEVING = _reeving()


def closing_rope_m(jaw: float) -> float:
    """Length that each closing rope has paid out, on top of a holding rope's, to open the jaws by so many radians."""
    falls = (REEVING[:, 1] + body_frames(j)["beam"][:3, 3] - REEVING[:, 0] for j in (jaw, 0.0))
    opened, closed = (np.linalg.norm(fall, axis=1).sum() for fall in falls)
    return float(opened - closed) / 2  # two closing ropes share the falls


def grab_parts(
    *, paint: Colour, wear: float, residue: float, cargo: str, rng: np.random.Generator
) -> dict[str, list[Part]]:
    """Return the parts of every body, each in its body's frame.

    Parameters
    ----------
    paint : tuple of 3 floats
        Red, green and blue in [0, 1], as the renderer shows them.
    wear : float
        Share of the paint lost to rust and scratches, in [0, 1].
    residue : float
        Dust of the cargo on the steel, in [0, 1].
    cargo : str
        "coal", "ore", "grain", "bauxite" or "sulphur".
    rng : numpy.random.Generator
        Moves the patches of wear and dust; the shapes never change.

    Returns
    -------
    dict of str to list of Part
        One entry for each of `BODIES`. All grabs share their meshes: copy one before changing it.
    """
    look = finish(paint, wear, residue, cargo, rng)
    return {
        body: [replace(part, material=getattr(look, part.material.name)) for part in parts]
        for body, parts in steel().items()
    }


@cache
def steel() -> Mapping[str, Sequence[Part]]:
    """Parts of every body as `grab_parts` returns them, but unpainted: materials have a name in `Finish` alone."""
    bare = Finish(**{field.name: Material(field.name) for field in fields(Finish)})
    shell, arms = shell_parts(bare), arms_parts(bare)
    return {
        "head": head_parts(bare),
        "beam": beam_parts(bare),
        "shell_outer": shell,
        "shell_inner": [part.moved(_HALF_TURN) for part in shell],
        "arms_outer": arms,
        "arms_inner": [part.moved(_HALF_TURN) for part in arms],
    }
