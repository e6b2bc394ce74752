"""Pins of the four-rope grab's bodies, and how the jaws move them."""

from __future__ import annotations

import math

from simgrab.world.scenery.grabs.slider_crank import SliderCrank

MAX_JAW = math.radians(55.0)
PARENTS = {
    "beam": "head",
    "shell_outer": "beam",
    "shell_inner": "beam",
    "arms_outer": "head",
    "arms_inner": "head",
}

HINGE_X = 0.17  # shell pin in the beam
BEAM_Z_CLOSED = 0.10
HEAD_PIN = (0.62, 1.05)  # arm pin in the head, (x, z)
SHELL_PIN = (1.13, -0.04)  # arm pin in the outer shell's frame, (x, z)
CRANK = SliderCrank((HINGE_X, BEAM_Z_CLOSED), HEAD_PIN, SHELL_PIN)

#: Origin of each body in its parent's frame when the jaws are closed, metres: the anchor of its joint.
pins: dict[str, tuple[float, float, float]] = {
    "beam": (0.0, 0.0, BEAM_Z_CLOSED),
    "shell_outer": (HINGE_X, 0.0, 0.0),
    "shell_inner": (-HINGE_X, 0.0, 0.0),
    "arms_outer": (HEAD_PIN[0], 0.0, HEAD_PIN[1]),
    "arms_inner": (-HEAD_PIN[0], 0.0, HEAD_PIN[1]),
}


def joint_positions(jaw: float) -> dict[str, float]:
    """Return the joints' positions for a jaw opening, rad; all are 0 when the jaws are closed.

    "beam" slides along +z, metres; the others hinge about +y, radians.
    """
    state = CRANK.at(jaw)
    return {
        "beam": state.beam_z - BEAM_Z_CLOSED,
        "shell_outer": state.jaw_angle,
        "shell_inner": -state.jaw_angle,
        "arms_outer": state.arm_angle,
        "arms_inner": -state.arm_angle,
    }
