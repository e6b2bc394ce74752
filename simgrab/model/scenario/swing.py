"""How the grab swings: independent draws, or physics."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, get_args

from simgrab.model.distributions import AnyDistribution, Constant, HalfNormal, Uniform
from simgrab.model.scenario.base import Azimuth, Meta, Share, Strict, Tagged, about

MOST_ALPHA_DEG = 80.0
ROPE_LENGTH_RANGE_M = (6.0, 45.0)
RopeLength = Annotated[
    float,
    about("Distance from the rope exit O to the grab centre A.", ge=ROPE_LENGTH_RANGE_M[0], le=ROPE_LENGTH_RANGE_M[1]),
]
Jaw = Annotated[float, about("Opening of the jaws: 0 is closed.", ge=0, le=90)]
Load = Annotated[Share, about("Load as a share of a full grab.")]
DragArea = Annotated[float, Meta(ge=0, le=50)]
Clampable = Literal["jaw_deg", "rope_length_m"]
Clamp = bool | Annotated[tuple[Clampable, ...], Meta(max_length=2)]
CLAMPABLE: tuple[Clampable, ...] = get_args(Clampable)


class Alpha(Strict, frozen=True):
    """The swing angle: ``law`` gives the shape and ``sigma_deg`` the scale, √E[α²], for every law."""

    sigma_deg: Annotated[float, about("Scale: √E[α²], for every distribution.", ge=0, le=30)] = 2.0
    law: Annotated[AnyDistribution, about("Shape of α's distribution; its scale has no effect.")] = HalfNormal()

    def check(self) -> None:  # noqa: D102
        if self.law.rms() < 1e-100:  # of less, `scale_deg` would overflow
            raise ValueError("the distribution must not be zero everywhere; for a still grab set sigma_deg = 0")

    @property
    def scale_deg(self) -> float:
        """Degrees a unit of the law: α = scale · |X|."""
        return self.sigma_deg / self.law.rms()


class Iid(Tagged, frozen=True, tag="iid"):
    """Independent frames: each draws its own swing, rope length, yaw, jaws and load.

    With the probability ``absent`` a frame shows neither grab nor ropes. A grab that is open, or of a kind that holds
    no bulk, has no load whatever was drawn, and a grab without jaws does not open. Impossible draws of the keys that
    ``clamp`` names, or of both with ``true``, are replaced by the nearest possible: jaws open as far as they go, and a
    rope that would lower the grab into what stands below is shortened. The column ``clamped`` names them.
    """

    alpha: Annotated[Alpha, about("The swing angle α.")] = Alpha()
    gamma_deg: Annotated[AnyDistribution, about("Azimuth of the swing minus that of the camera's tilt.")] = Uniform(
        0.0, 360.0
    )
    rope_length_m: Annotated[AnyDistribution, about("From the rope exit O to the grab centre A; 6 to 45.")] = Uniform(
        8, 23
    )
    yaw_deg: Annotated[AnyDistribution, about("Turn of the grab about the rope; at 0 x is outboard.")] = Uniform(
        -15, 15
    )
    jaw_deg: Annotated[AnyDistribution, about("Opening of the jaws: 0 is closed.")] = Constant(0.0)
    load: Annotated[AnyDistribution, about("Load as a share of a full grab.")] = Constant(0.0)
    absent: Annotated[Share, about("Probability of a frame without grab and ropes.")] = 0.0
    clamp: Annotated[Clamp, about("Keys of which impossible draws become the nearest possible; `true`: both.")] = False

    @property
    def clamped(self) -> tuple[Clampable, ...]:
        """Keys of which impossible draws are replaced."""
        return (CLAMPABLE if self.clamp else ()) if isinstance(self.clamp, bool) else self.clamp


class Hang(Tagged, frozen=True, tag="hang"):
    """The crane stands still; the grab hangs on a rope of constant length."""

    rope_length_m: RopeLength = 20.0
    jaw_deg: Jaw = 0.0
    load: Load = 0.0


class Turn(Tagged, frozen=True, tag="turn"):
    """From rest, the crane begins to slew and keeps on."""

    rope_length_m: RopeLength = 20.0
    jaw_deg: Jaw = 0.0
    load: Load = 0.0
    slew_rpm: Annotated[float, about("Final slewing speed; its sign is the direction.", ge=-3, le=3)] = 1.2
    ramp_s: Annotated[float, about("Time to reach the final speed.", ge=0.5, le=60)] = 6.0
    wait_s: Annotated[float, about("Time at rest before slewing begins.", ge=0, le=3600)] = 5.0


class Cycles(Tagged, frozen=True, tag="cycles"):
    """Working cycles: dig, hoist, slew and luff, dump, return; each cycle's depths, speeds and pauses vary.

    With a rough ``operator`` loads still swing when the next move begins. It is slewing out that is braked abruptly.
    """

    dig_rope_m: Annotated[RopeLength, about("Rope length at which the grab digs.")] = 22.0
    carry_rope_m: Annotated[RopeLength, about("Rope length at which the grab is carried.")] = 10.0
    dig_slew_deg: Annotated[float, about("Slew angle of digging, from the place's middle.", ge=-180, le=180)] = 15.0
    slew_deg: Annotated[float, about("Slewing from digging to dumping.", ge=-180, le=180)] = -32.0
    luff_m: Annotated[float, about("Change of radius from digging to dumping, outwards.", ge=-10, le=10)] = 3.0
    operator: Annotated[Share, about("Handling: 0 is smooth, with long ramps; 1 is rough, with short ones.")] = 0.3
    variation: Annotated[float, about("Relative variation of depths, speeds and pauses.", ge=0, le=0.3)] = 0.1
    hoist_m_min: Annotated[float, about("Hoisting speed.", gt=0, le=120)] = 60.0
    hoist_m_s2: Annotated[float, about("Hoisting acceleration.", gt=0, le=2)] = 0.4
    slew_rpm: Annotated[float, about("Slewing speed.", gt=0, le=3)] = 0.65
    luff_m_min: Annotated[float, about("Luffing speed.", gt=0, le=120)] = 45.0
    dig_s: Annotated[float, about("Time for digging.", gt=0, le=120)] = 13.5
    dump_s: Annotated[float, about("Time for dumping.", gt=0, le=120)] = 5.0
    pause_s: Annotated[float, about("Pause between moves.", ge=0, le=300)] = 2.0
    abrupt_every: Annotated[int, about("Cycles from one abrupt braking to the next; 0: none.", ge=0, le=10_000)] = 0
    abrupt_s: Annotated[float, about("Time of an abrupt braking.", ge=0.1, le=10)] = 2.5

    def check(self) -> None:  # noqa: D102
        if self.carry_rope_m > self.dig_rope_m:
            raise ValueError(f"carry_rope_m ({self.carry_rope_m:g}) must not be above dig_rope_m ({self.dig_rope_m:g})")


class Wind(Strict, frozen=True):
    """Mean wind at the jib head, blowing towards an azimuth of the jib frame at t = 0, and von Karman turbulence."""

    mean_m_s: Annotated[float, about("Mean wind at the jib head.", ge=0, le=40)] = 0.0
    azimuth_deg: Annotated[float, about("Azimuth that the wind blows towards at time 0.", ge=-360, le=360)] = 90.0
    intensity: Annotated[float, about("Turbulence: standard deviation over mean.", ge=0, le=0.5)] = 0.15
    scale_m: Annotated[float, about("Length scale of the von Karman turbulence.", ge=1, le=1000)] = 100.0


class Forcing(Strict, frozen=True):
    """Random horizontal acceleration of the grab, the same in every direction, white up to ``bandwidth_hz``."""

    rms_m_s2: Annotated[float, about("RMS of the acceleration.", ge=0, le=5)] = 0.0
    bandwidth_hz: Annotated[float, about("Frequency up to which it is white noise.", gt=0, le=10)] = 0.5


class Start(Strict, frozen=True):
    """How the grab swings when a clip begins; ``roundness`` goes from 0 (in a plane) to ±1 (in a circle)."""

    alpha_deg: Annotated[float, about("Swing angle at the beginning.", ge=0, le=60)] = 0.0
    azimuth_deg: Annotated[Azimuth, about("Azimuth of the swing, from outboard.")] = 0.0
    roundness: Annotated[float, about("0 swings in a plane, 1 or -1 in a circle.", ge=-1, le=1)] = 0.0
    yaw_deg: Annotated[float, about("Turn of the grab about the rope.", ge=-90, le=90)] = 0.0


class Dynamic(Tagged, frozen=True, tag="dynamic"):
    """The grab swings as physics has it, while the crane works and the wind blows."""

    work: Annotated[Hang | Turn | Cycles, about("What the crane does.")] = Cycles()
    start: Annotated[Start, about("How the grab swings when a clip begins.")] = Start()
    wind: Annotated[Wind, about("Wind on the grab.")] = Wind()
    forcing: Annotated[Forcing, about("Random horizontal acceleration of the grab.")] = Forcing()
    damping: Annotated[float, about("Damping of the swing over critical; wind drag is added.", ge=0, le=0.5)] = 0.005
    yaw_damping: Annotated[Share, about("Damping of the yaw over critical.")] = 0.05
    radius_m: Annotated[float, about("Working radius of the jib head when a clip begins.", ge=10, le=50)] = 25.0
    drag_area_m2: Annotated[DragArea | None, about("Drag coefficient times area; by default from the shape.")] = None
    settle_s: Annotated[float, about("Time simulated before the first frame of a clip.", ge=0, le=3600)] = 0.0
    clamped: ClassVar[tuple[Clampable, ...]] = ()
