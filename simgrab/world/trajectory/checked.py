"""Check a moment that a user's trajectory returned."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, TypeVar

from simgrab.model.scenario import MOST_ALPHA_DEG, ROPE_LENGTH_RANGE_M, DoublePendulum, Scenario, Suspension
from simgrab.world.scenery.grabs import design_of
from simgrab.world.scenery.grabs.design import Design
from simgrab.world.trajectory.hanging import hung
from simgrab.world.trajectory.moment import GrabState, JibState, Moment, Tilt

State = TypeVar("State", GrabState, JibState, Tilt)
_TURN = (-1e3, 1e3)  # bounds of angles, rad, and of accelerations, m/s²
_OFF_TIME = 0.499  # of a frame's duration: a time must belong to its own frame
_AHEAD_S = (1e-6, 1.0)  # of the moment ahead, after this one


def checked(moment: Moment, scenario: Scenario, frame: int) -> Moment:
    """Check a user's moment, and convert its numbers to Python's.

    Raises `TypeError`, `ValueError`, `AttributeError` if it is not a `Moment`, or a value in it is out of bounds.
    """
    if not isinstance(moment, Moment):
        raise TypeError(f"must return a Moment, got {type(moment).__name__}")
    if moment.frame != frame:
        raise ValueError(f"must return the moment of this frame, got that of frame {moment.frame}")
    if (moment.time is None) != (moment.jib is None):
        raise ValueError("time and jib must be given together")
    clip, rate = scenario.clip.of(frame), scenario.clip.frame_rate_hz
    if moment.time is not None:
        due = (frame - scenario.span(clip).start) / rate
        _within("time", moment.time, due - _OFF_TIME / rate, due + _OFF_TIME / rate)
    design = design_of(scenario.grab)
    now = _instant(moment, design, scenario.suspension)
    ahead = None
    if moment.ahead is not None:
        if now.time is None or moment.ahead.time is None:
            raise ValueError("a moment with ahead needs a time, and so does ahead itself")
        _within("ahead.time", moment.ahead.time, *(now.time + after for after in _AHEAD_S))
        ahead = _instant(moment.ahead, design, scenario.suspension)
    return replace(now, frame=frame, clip=None if now.time is None else clip, present=bool(moment.present), ahead=ahead)


def _instant(moment: Moment, design: Design, suspension: Suspension) -> Moment:
    """Moment with Python's numbers within bounds, without its ``ahead``."""
    grab = _bounded(
        "", moment.grab, alpha=(0.0, math.radians(MOST_ALPHA_DEG)), azimuth=_TURN, rope_length=ROPE_LENGTH_RANGE_M,
        yaw=_TURN, jaw=(0.0, design.max_jaw), load=(0.0, 1.0 if design.holds_cargo else 0.0),
    )  # fmt: skip
    if grab.head is None:
        grab = hung(grab, suspension, float(design.terminations[0, 2]))
    elif isinstance(suspension, DoublePendulum):
        lean, azimuth = grab.head
        head = _within("head[0]", lean, -math.pi / 2, math.pi / 2), _within("head[1]", azimuth, *_TURN)
        grab = replace(grab, head=head)
    else:
        raise ValueError('head must be None with this suspension; set suspension.model = "double-pendulum"')
    tilt = _bounded("tilt.", moment.tilt, beta=(0.0, math.pi / 2), azimuth=_TURN, roll=_TURN)
    jib = moment.jib and _bounded("jib.", moment.jib, slew=_TURN, radius=(0.1, 1e3), luffed=_TURN)
    x, y, z = (_within("apparent_gravity", value, *_TURN) for value in moment.apparent_gravity)
    still = Moment.still(moment.frame, grab, tilt)  # which computes gamma from both azimuths
    time = None if moment.time is None else float(moment.time)
    return replace(still, time=time, jib=jib, apparent_gravity=(x, y, z))


def _bounded(table: str, state: State, **bounds: tuple[float, float]) -> State:
    numbers: dict[str, Any] = {
        name: _within(f"{table}{name}", getattr(state, name), *ends) for name, ends in bounds.items()
    }
    return replace(state, **numbers)


def _within(name: str, value: float, least: float, most: float) -> float:
    number = float(value)
    if not least <= number <= most:  # NaN is within no bounds
        raise ValueError(f"{name} is {number:g}, not within {least:g} … {most:g}")
    return number
