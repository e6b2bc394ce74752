"""How the grab's bodies move with the jaws: a slider-crank on either side, in closed form.

The ropes hold the head. The beam slides below it along z; each shell turns about a pin in the beam, and the arms,
pinned to the head and to the shells' outer corners, keep their length. Opening therefore lowers the beam.

Signs: an angle is a rotation about +y (x towards −z). The outer side is +x; the inner side's angles are the negatives.
Every body's frame is parallel to the grab frame when the jaws are closed, with its origin on its own pin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Pose = NDArray[np.float64]

MAX_JAW = float(np.radians(55.0))
BODIES = ("head", "beam", "shell_outer", "shell_inner", "arms_outer", "arms_inner")
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

_ARM = (HINGE_X + SHELL_PIN[0] - HEAD_PIN[0], BEAM_Z_CLOSED + SHELL_PIN[1] - HEAD_PIN[1])
ARM_LENGTH = float(np.hypot(*_ARM))

#: Origin of each body in its parent's frame when the jaws are closed, metres: the anchor of its joint.
pins: dict[str, tuple[float, float, float]] = {
    "beam": (0.0, 0.0, BEAM_Z_CLOSED),
    "shell_outer": (HINGE_X, 0.0, 0.0),
    "shell_inner": (-HINGE_X, 0.0, 0.0),
    "arms_outer": (HEAD_PIN[0], 0.0, HEAD_PIN[1]),
    "arms_inner": (-HEAD_PIN[0], 0.0, HEAD_PIN[1]),
}


@dataclass(frozen=True)
class Linkage:
    """Where the moving bodies are.

    Attributes
    ----------
    beam_z : float
        z of the beam's origin (the height of the shells' pins) in the grab frame, metres.
    shell_angle, arm_angle : float
        Rotation of the outer shell and of the outer arms about +y, radians; 0 when closed.
    """

    beam_z: float
    shell_angle: float
    arm_angle: float


def linkage(jaw: float) -> Linkage:
    """Solve the linkage for a jaw opening.

    Parameters
    ----------
    jaw : float
        Rotation of each shell from closed, radians, in [0, `MAX_JAW`].

    Returns
    -------
    Linkage
    """
    if not 0.0 <= jaw <= MAX_JAW:
        raise ValueError(f"jaw is {jaw!r} rad; it must lie in [0, {MAX_JAW:.4f}]")
    c, s = np.cos(jaw), np.sin(jaw)
    x, z = SHELL_PIN
    reach = HINGE_X + x * c - z * s - HEAD_PIN[0]
    drop = np.sqrt(ARM_LENGTH**2 - reach**2)
    beam_z = HEAD_PIN[1] - drop - (x * s + z * c)
    arm_angle = np.arctan2(_ARM[0], -_ARM[1]) - np.arctan2(reach, drop)
    return Linkage(float(beam_z), -float(jaw), float(arm_angle))


def joint_positions(jaw: float) -> dict[str, float]:
    """Return the joints' positions for a jaw opening; all are 0 when the jaws are closed.

    "beam" slides along +z, metres; the others hinge about +y, radians.
    """
    state = linkage(jaw)
    return {
        "beam": state.beam_z - BEAM_Z_CLOSED,
        "shell_outer": state.shell_angle,
        "shell_inner": -state.shell_angle,
        "arms_outer": state.arm_angle,
        "arms_inner": -state.arm_angle,
    }


def body_frames(jaw: float) -> dict[str, Pose]:
    """Return grab_from_body, shape (4, 4), for every one of `BODIES`."""
    positions = joint_positions(jaw)
    frames: dict[str, Pose] = {"head": np.eye(4)}
    for body, parent in PARENTS.items():
        local = np.eye(4)
        local[:3, 3] = pins[body]
        if body == "beam":
            local[2, 3] += positions[body]
        else:
            c, s = np.cos(positions[body]), np.sin(positions[body])
            local[:3, :3] = [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]
        frames[body] = frames[parent] @ local
    return frames
