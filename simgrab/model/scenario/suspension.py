"""How the grab hangs on its ropes: as one body with them, level on four ropes, or as a second pendulum."""

from __future__ import annotations

from typing import Annotated

from simgrab.model.scenario.base import Meta, Share, Strict, Tagged


class Waves(Strict, frozen=True):
    """Transverse waves of the ropes between exits and grab, which sensors on the rope feel. ``modes = 0`` is none.

    Each mode is a string mode of the ropes' tension and mass, with ``damping`` as a share of its critical one. The
    swing itself excites them, and a horizontal acceleration of the rope exits, white up to ``bandwidth_hz``.
    """

    modes: Annotated[int, Meta(ge=0, le=20)] = 0
    damping: Annotated[float, Meta(gt=0, le=0.5)] = 0.01
    exit_rms_m_s2: Annotated[float, Meta(ge=0, le=10)] = 0.05
    bandwidth_hz: Annotated[float, Meta(gt=0, le=10)] = 5.0


class Hanging(Tagged, frozen=True):
    """What all suspensions have."""

    waves: Waves = Waves()


class OneBody(Hanging, frozen=True, tag="one-body"):
    """Grab and ropes are one rigid body: the grab leans as OA does."""


class FourRopes(Hanging, frozen=True, tag="four-rope"):
    """Taut ropes hold the head: it leans by ``tilt_ratio`` times the angle at which the ropes lean, the same way.

    The ropes lean from O to the middle of their ends. With the distance s of two ropes at their exits and e at the
    head, small angles give a ratio of 1 − s/e: 0 for a parallelogram, 1 for ropes that meet in O, negative for ropes
    that converge downwards.
    """

    tilt_ratio: Annotated[float, Meta(ge=-0.5, le=1)] = 0.0


class DoublePendulum(Hanging, frozen=True, tag="double-pendulum"):
    """The grab is a second pendulum: it turns freely about the middle of its rope ends, as below a single hook.

    ``damping`` is that of the grab against the ropes, as a share of the critical one. It needs physics.
    """

    damping: Share = 0.02


Suspension = OneBody | FourRopes | DoublePendulum
