"""Lean of a grab's head that taut ropes hold: pure kinematics, for any swing."""

from __future__ import annotations

import math
from dataclasses import replace

from simgrab.model.scenario import FourRopes, Suspension
from simgrab.world.trajectory.moment import GrabState

_ITERATIONS, _CLOSE = 60, 1e-16


def rope_lean(alpha: float, share: float, ratio: float, *, of_ropes: bool = False) -> float:
    """Angle λ between the ropes and gravity, rad, if OA swings by α and the head leans by a ratio of λ.

    In the triangle of O, the middle T of the rope ends, and A, the sine rule gives
    sin(λ − α)/|TA| = sin((1 − ratio)·λ)/|OA| = sin(α − ratio·λ)/|OT|.

    Parameters
    ----------
    alpha : float
        Between OA and gravity, rad.
    share : float
        |TA|/|OA|, or |TA|/|OT|; less than 1.
    of_ropes : bool
        Whether the share is that of |OT|.
    """
    lean = alpha
    for _ in range(_ITERATIONS):  # contracts by the share each time
        opening = alpha - ratio * lean if of_ropes else (1 - ratio) * lean
        before, lean = lean, alpha + math.asin(share * math.sin(opening))
        if abs(lean - before) <= _CLOSE:
            break
    return lean


def hung(grab: GrabState, suspension: Suspension, end_height: float) -> GrabState:
    """Lean the head of a grab by its suspension, if that is four ropes that end at a height in the grab's frame, m."""
    if not isinstance(suspension, FourRopes):
        return grab
    ratio = suspension.tilt_ratio
    lean = rope_lean(grab.alpha, end_height / grab.rope_length, ratio)
    return replace(grab, head=(ratio * lean, grab.azimuth))
