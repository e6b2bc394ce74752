"""How the grab swings: independent draws, or physics."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, get_args

from simgrab.model.distributions import AnyDistribution, Constant, HalfNormal, Uniform
from simgrab.model.scenario.base import Meta, Share, Strict, Tagged

MOST_ALPHA_DEG = 80.0
ROPE_LENGTH_RANGE_M = (6.0, 45.0)
RopeLength = Annotated[float, Meta(ge=ROPE_LENGTH_RANGE_M[0], le=ROPE_LENGTH_RANGE_M[1])]
Jaw = Annotated[float, Meta(ge=0, le=90)]
Clampable = Literal["jaw_deg", "rope_length_m"]
CLAMPABLE: tuple[Clampable, ...] = get_args(Clampable)


class Alpha(Strict, frozen=True):
    """The swing angle: ``law`` gives the shape and ``sigma_deg`` the scale, √E[α²], for every law."""

    sigma_deg: Annotated[float, Meta(ge=0, le=30)] = 2.0
    law: AnyDistribution = HalfNormal()

    def check(self) -> None:  # noqa: D102
        if self.law.rms() <= 0:
            raise ValueError("the distribution must not be zero everywhere; for a still grab set sigma_deg = 0")

    @property
    def scale_deg(self) -> float:
        """Degrees a unit of the law: α = scale · |X|."""
        return self.sigma_deg / self.law.rms()


class Iid(Tagged, frozen=True, tag="iid"):
    """Independent frames: each draws its own swing, rope length, yaw, jaws and load.

    A share ``absent`` of the frames shows neither grab nor ropes. A grab that is open, or of a kind that holds no bulk,
    has no load whatever was drawn, and a grab without jaws does not open. Impossible draws of the keys that ``clamp``
    names, or of both with ``true``, are replaced by the nearest possible: jaws open as far as they go, and a rope that
    would lower the grab into what stands below is shortened. The column ``clamped`` names them.
    """

    alpha: Alpha = Alpha()
    gamma_deg: AnyDistribution = Uniform(0.0, 360.0)
    rope_length_m: AnyDistribution = Uniform(8.0, 23.0)
    yaw_deg: AnyDistribution = Uniform(-15.0, 15.0)
    jaw_deg: AnyDistribution = Constant(0.0)
    load: AnyDistribution = Constant(0.0)
    absent: Share = 0.0
    clamp: bool | Annotated[tuple[Clampable, ...], Meta(max_length=2)] = False

    @property
    def clamped(self) -> tuple[Clampable, ...]:
        """Keys of which impossible draws are replaced."""
        return (CLAMPABLE if self.clamp else ()) if isinstance(self.clamp, bool) else self.clamp


class Hang(Tagged, frozen=True, tag="hang"):
    """The crane stands still; the grab hangs on a rope of constant length."""

    rope_length_m: RopeLength = 20.0
    jaw_deg: Jaw = 0.0
    load: Share = 0.0


class Turn(Tagged, frozen=True, tag="turn"):
    """From rest, the crane begins to slew and keeps on."""

    rope_length_m: RopeLength = 20.0
    jaw_deg: Jaw = 0.0
    load: Share = 0.0
    slew_rpm: Annotated[float, Meta(ge=-3, le=3)] = 1.2
    ramp_s: Annotated[float, Meta(ge=0.5, le=60)] = 6.0
    wait_s: Annotated[float, Meta(ge=0, le=3600)] = 5.0


class Cycles(Tagged, frozen=True, tag="cycles"):
    """Working cycles: dig, hoist, slew and luff, dump, return; each cycle's depths, speeds and pauses vary.

    It digs where the jib stands ``dig_slew_deg`` off the middle of the place, and slews by ``slew_deg`` to dump.
    ``operator`` goes from 0 (smooth: the longest ramps) to 1 (rough: the shortest, and the loads still swing when the
    next move begins). Every ``abrupt_every``-th cycle (0: none) slewing out is braked within ``abrupt_s``.
    """

    dig_rope_m: RopeLength = 22.0
    carry_rope_m: RopeLength = 10.0
    dig_slew_deg: Annotated[float, Meta(ge=-180, le=180)] = 15.0
    slew_deg: Annotated[float, Meta(ge=-180, le=180)] = -32.0
    luff_m: Annotated[float, Meta(ge=-10, le=10)] = 3.0
    operator: Share = 0.3
    variation: Annotated[float, Meta(ge=0, le=0.3)] = 0.1
    hoist_m_min: Annotated[float, Meta(gt=0, le=120)] = 60.0
    hoist_m_s2: Annotated[float, Meta(gt=0, le=2)] = 0.4
    slew_rpm: Annotated[float, Meta(gt=0, le=3)] = 0.65
    luff_m_min: Annotated[float, Meta(gt=0, le=120)] = 45.0
    dig_s: Annotated[float, Meta(gt=0, le=120)] = 13.5
    dump_s: Annotated[float, Meta(gt=0, le=120)] = 5.0
    pause_s: Annotated[float, Meta(ge=0, le=300)] = 2.0
    abrupt_every: Annotated[int, Meta(ge=0, le=10_000)] = 0
    abrupt_s: Annotated[float, Meta(ge=0.1, le=10)] = 2.5

    def check(self) -> None:  # noqa: D102
        if self.carry_rope_m > self.dig_rope_m:
            raise ValueError(f"carry_rope_m ({self.carry_rope_m:g}) must not be above dig_rope_m ({self.dig_rope_m:g})")


class Wind(Strict, frozen=True):
    """Mean wind at the jib head, blowing towards an azimuth of the jib frame at t = 0, and von Karman turbulence."""

    mean_m_s: Annotated[float, Meta(ge=0, le=40)] = 0.0
    azimuth_deg: Annotated[float, Meta(ge=-360, le=360)] = 90.0
    intensity: Annotated[float, Meta(ge=0, le=0.5)] = 0.15
    scale_m: Annotated[float, Meta(ge=1, le=1000)] = 100.0


class Forcing(Strict, frozen=True):
    """Random horizontal acceleration of the grab, the same in every direction, white up to ``bandwidth_hz``."""

    rms_m_s2: Annotated[float, Meta(ge=0, le=5)] = 0.0
    bandwidth_hz: Annotated[float, Meta(gt=0, le=10)] = 0.5


class Start(Strict, frozen=True):
    """How the grab swings when a clip begins; ``roundness`` goes from 0 (in a plane) to ±1 (in a circle)."""

    alpha_deg: Annotated[float, Meta(ge=0, le=60)] = 0.0
    azimuth_deg: Annotated[float, Meta(ge=-360, le=360)] = 0.0
    roundness: Annotated[float, Meta(ge=-1, le=1)] = 0.0
    yaw_deg: Annotated[float, Meta(ge=-90, le=90)] = 0.0


class Dynamic(Tagged, frozen=True, tag="dynamic"):
    """The grab swings as physics has it, while the crane works and the wind blows.

    ``damping`` is a share of the critical one; wind drag comes on top, with the drag area Cd·A of the grab's shape
    unless ``drag_area_m2`` gives one. ``settle_s`` runs before the first frame.
    """

    work: Hang | Turn | Cycles = Cycles()
    start: Start = Start()
    wind: Wind = Wind()
    forcing: Forcing = Forcing()
    damping: Annotated[float, Meta(ge=0, le=0.5)] = 0.005
    yaw_damping: Annotated[float, Meta(ge=0, le=1)] = 0.05
    radius_m: Annotated[float, Meta(ge=10, le=50)] = 25.0
    drag_area_m2: Annotated[float, Meta(ge=0, le=50)] | None = None
    settle_s: Annotated[float, Meta(ge=0, le=3600)] = 0.0
    clamped: ClassVar[tuple[Clampable, ...]] = ()
