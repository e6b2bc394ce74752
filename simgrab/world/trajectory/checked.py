"""Check a moment that a user's trajectory returned."""

from __future__ import annotations

import math
from dataclasses import replace

from simgrab.model.scenario import MOST_ALPHA_DEG, ROPE_LENGTH_RANGE_M, DoublePendulum, Scenario, Suspension
from simgrab.world.scenery.grabs import design_of
from simgrab.world.scenery.grabs.design import Design
from simgrab.world.trajectory.hanging import hung
from simgrab.world.trajectory.moment import GrabState, JibState, Moment, Tilt


def checked(moment: Moment, scenario: Scenario, frame: int) -> Moment:
    """Check a user's moment, and make its numbers Python's.

    Raises
    ------
    TypeError, ValueError, AttributeError
        If it is no moment that a frame can show.
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
        _within("time", moment.time, due - 0.499 / rate, due + 0.499 / rate)
    design = design_of(scenario.grab)
    now = _instant(moment, design, scenario.suspension)
    ahead = None
    if moment.ahead is not None:
        if now.time is None or moment.ahead.time is None:
            raise ValueError("a moment ahead needs times, and so does the moment itself")
        _within("ahead.time", moment.ahead.time, now.time + 1e-6, now.time + 1.0)
        ahead = _instant(moment.ahead, design, scenario.suspension)
    return replace(
        now, frame=frame, clip=None if now.time is None else clip, present=bool(moment.present), ahead=ahead,
        shown=moment.shown if scenario.display_layout else None,
    )  # fmt: skip


def _instant(moment: Moment, design: Design, suspension: Suspension) -> Moment:
    """Moment of Python's numbers within bounds; what it is ahead of is left out."""
    grab, tilt, jib = moment.grab, moment.tilt, moment.jib
    turn = (-1e3, 1e3)
    grab = GrabState(
        alpha=_within("alpha", grab.alpha, 0.0, math.radians(MOST_ALPHA_DEG)),
        azimuth=_within("azimuth", grab.azimuth, *turn),
        rope_length=_within("rope_length", grab.rope_length, *ROPE_LENGTH_RANGE_M),
        yaw=_within("yaw", grab.yaw, *turn),
        jaw=_within("jaw", grab.jaw, 0.0, design.max_jaw),
        load=_within("load", grab.load, 0.0, 1.0 if design.holds_cargo else 0.0),
        head=None if grab.head is None else (
            _within("head[0]", grab.head[0], -math.pi / 2, math.pi / 2), _within("head[1]", grab.head[1], *turn)
        ),
    )  # fmt: skip
    if grab.head is None:
        grab = hung(grab, suspension, float(design.terminations[0, 2]))
    elif not isinstance(suspension, DoublePendulum):
        raise ValueError('head must be None: with this suspension it follows; suspension.model = "double-pendulum"')
    tilt = Tilt(
        _within("tilt.beta", tilt.beta, 0.0, math.pi / 2), _within("tilt.azimuth", tilt.azimuth, *turn),
        _within("tilt.roll", tilt.roll, *turn),
    )  # fmt: skip
    if jib is not None:
        jib = JibState(
            _within("jib.slew", jib.slew, *turn), _within("jib.radius", jib.radius, 0.1, 1e3),
            _within("jib.luffed", jib.luffed, *turn),
        )  # fmt: skip
    x, y, z = (_within("apparent_gravity", value, *turn) for value in moment.apparent_gravity)
    still = Moment.still(moment.frame, grab, tilt)  # gamma follows from the two azimuths
    time = None if moment.time is None else float(moment.time)
    return replace(still, time=time, jib=jib, apparent_gravity=(x, y, z))


def _within(name: str, value: float, least: float, most: float) -> float:
    number = float(value)
    if not least <= number <= most:  # NaN is within no bounds
        raise ValueError(f"{name} is {number:g}, not within {least:g} … {most:g}")
    return number
