"""How the grab hangs on its ropes: as one body with them, level on four ropes, or as a second pendulum."""

from __future__ import annotations

from typing import Annotated

from simgrab.model.scenario.base import Share, Strict, Tagged, about


class Waves(Strict, frozen=True):
    """Transverse waves of the ropes between exits and grab, which sensors on the rope feel. ``modes = 0`` is none.

    Each mode is a string mode of the ropes' tension and mass, with ``damping`` as a share of its critical one. The
    swing itself excites them, and a horizontal acceleration of the rope exits, white up to ``bandwidth_hz``.
    """

    modes: Annotated[int, about("Number of string modes; 0 is none.", ge=0, le=20)] = 0
    damping: Annotated[float, about("Share of each mode's critical damping.", gt=0, le=0.5)] = 0.01
    exit_rms_m_s2: Annotated[float, about("RMS of the exits' acceleration along x and y, each.", ge=0, le=10)] = 0.05
    bandwidth_hz: Annotated[float, about("Frequency up to which it is white noise.", gt=0, le=10)] = 5.0


class Hanging(Tagged, frozen=True):
    """What all suspensions have."""

    waves: Annotated[Waves, about("Transverse waves of the ropes, for sensors on the rope.")] = Waves()


class OneBody(Hanging, frozen=True, tag="one-body"):
    """Grab and ropes are one rigid body: the grab leans as OA does."""


class FourRopes(Hanging, frozen=True, tag="four-rope"):
    """Taut ropes hold the head: it leans by ``tilt_ratio`` times the angle at which the ropes lean, the same way.

    The ropes lean from O to the middle of their ends. With the distance s of two ropes at their exits and e at the
    head, small angles give a ratio of 1 − s/e: 0 for a parallelogram, 1 for ropes that meet in O, negative for ropes
    that converge downwards.
    """

    tilt_ratio: Annotated[float, about("Lean of the head over that of its ropes: 0 stays level.", ge=-0.5, le=1)] = 0.0


class DoublePendulum(Hanging, frozen=True, tag="double-pendulum"):
    """The grab is a second pendulum: it turns freely about the middle of its rope ends, as below a single hook.

    It needs physics.
    """

    damping: Annotated[Share, about("Damping of the grab against the ropes, as a share of critical damping.")] = 0.02


Suspension = OneBody | FourRopes | DoublePendulum
