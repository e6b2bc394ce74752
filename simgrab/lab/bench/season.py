"""The clips of a season: every weather, mount of the camera and offset, and two kinds of swing."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Annotated, Any

import msgspec

from simgrab.errors import BenchError
from simgrab.io.parse import shown
from simgrab.io.strict import Checked
from simgrab.model import scenes
from simgrab.model.rng import stream
from simgrab.model.scenario import (
    Controller,
    HoistEncoder,
    Imu,
    Lidar,
    LuffEncoder,
    MotionSensor,
    Scenario,
    SideCamera,
    SlewEncoder,
)

Meta = msgspec.Meta
VERSION = "1"
WEATHERS = ("calm-day", "windy-day", "night-light-snow", "heavy-snow", "rain", "fog", "dust", "glare")
MOUNTS = ("levelled", "rigid", "fixed")
OFFSETS_M = {"near": 0.2, "beside": 0.6, "far": 1.2}  # of the camera from the rope exit, across the jib
SWINGS = ("work", "alarm")
SENSORS: dict[str, dict[str, MotionSensor]] = {  # that clips may have beside the camera; no picture shows them
    "imu": {"imu0": Imu(mount="camera", noise="mems")},
    "encoders": {"slew": SlewEncoder(), "luff": LuffEncoder(), "hoist": HoistEncoder()},
    "cameras": {"side0": SideCamera(), "side1": SideCamera(position_m=(2.0, 1.5, 14.0))},
    "lidar": {"lidar0": Lidar()},
    "controller": {"plc": Controller()},
}
WIND_M_S = {"windy-day": 12.0, "heavy-snow": 8.0}  # mean; 4 in the other weathers
LEAST_TILT_DEG, MOST_TILT_DEG = 1.0, 6.0
_CYCLES = {"model": "cycles", "dig_rope_m": 22.5, "carry_rope_m": 10.0, "dig_slew_deg": 15.0}
_WORK: dict[str, dict[str, Any]] = {
    "work": {"slew_deg": -32.0},
    "alarm": {"slew_deg": -47.4, "operator": 0.81, "slew_rpm": 0.75, "abrupt_every": 1, "abrupt_s": 2.25},
}


@dataclass(frozen=True)
class SeasonClip:
    """What is particular about one clip: a bundled weather, a mount, an offset, and a kind of swing."""

    weather: str
    mount: str
    offset: str
    swing: str

    @property
    def name(self) -> str:
        """Stem of its files."""
        return f"{self.weather}-{self.mount}-{self.offset}-{self.swing}"


def full() -> tuple[SeasonClip, ...]:
    """All combinations: 144 clips."""
    return tuple(SeasonClip(*each) for each in product(WEATHERS, MOUNTS, OFFSETS_M, SWINGS))


def nightly() -> tuple[SeasonClip, ...]:
    """12 clips with every weather, every pair of mount and offset, and as many swings of each kind."""
    offsets = tuple(OFFSETS_M)
    return tuple(
        SeasonClip(WEATHERS[i % 8], MOUNTS[i % 3], offsets[i // 3 % 3], SWINGS[(i + i // 8) % 2]) for i in range(12)
    )


SUBSETS = "nightly", "full", "trial"


def check_sensors(sensors: Sequence[str]) -> None:
    """Refuse sensors that are not some of `SENSORS` in their order; raises ValueError."""
    if list(sensors) != [kind for kind in SENSORS if kind in sensors]:
        raise ValueError(f"sensors: must be some of {', '.join(SENSORS)}, in this order; got {', '.join(sensors)}")


def sensors_of(track: str, sensors: Sequence[str]) -> tuple[str, ...]:
    """Name the sensors that a track allows, of those that a season has; raises ValueError if it is no track of that.

    ``picture`` is one; the display's rope length and sensors are joined to it with +, in the order of `SENSORS`.
    """
    parts, more = track.split("+"), ("rope", *sensors)
    if parts != ["picture", *(part for part in more if part in parts)]:
        raise ValueError(
            f"track: must be 'picture', and any of {', '.join(map(repr, more))} joined with + in this order; "
            f"got {shown(track)}"
        )
    return tuple(part for part in parts if part in sensors)


def track_order(track: str) -> list[int]:
    """Sort key of a track: ``picture`` first, then with ``rope``, then with sensors in the order of `SENSORS`."""
    return [("picture", "rope", *SENSORS).index(part) for part in track.split("+")]


class Season(Checked, frozen=True):
    """What a season is made of. Seed and salt are secret until it ends."""

    error = BenchError

    name: Annotated[str, Meta(pattern=r"^[a-z0-9][a-z0-9_-]*\Z", max_length=64)] = "open"
    subset: Annotated[str, Meta(pattern=rf"^({'|'.join(SUBSETS)})\Z")] = "nightly"  # one of `SUBSETS`
    frames: Annotated[int, Meta(ge=2, le=100_000)] = 540  # of each clip; a clip with an alarm takes some 480
    # width_px, height_px: even, as videos need them
    width_px: Annotated[int, Meta(ge=320, le=4096, multiple_of=2)] = 960
    height_px: Annotated[int, Meta(ge=180, le=4096, multiple_of=2)] = 540
    seed: Annotated[int, Meta(ge=0, le=2**53)] = 0
    salt: Annotated[str, Meta(max_length=200)] = ""  # keeps the seed from being guessed from its digest
    sensors: tuple[str, ...] = ()  # of `SENSORS`, in their order; they change no picture

    def check(self) -> None:  # noqa: D102
        check_sensors(self.sensors)

    @property
    def clips(self) -> tuple[SeasonClip, ...]:
        """In the order of the targets."""
        if self.subset == "full":
            return full()
        return nightly()[:2] if self.subset == "trial" else nightly()  # one of these two has an alarm

    @property
    def commitment(self) -> str:
        """SHA-256 of all of these, which is published when the season begins."""
        known = msgspec.to_builtins(self)
        if not self.sensors:  # which seasons did not always have
            del known["sensors"]
        return hashlib.sha256(msgspec.json.encode(known)).hexdigest()

    def scenario(self, clip: SeasonClip, attempt: int = 0) -> Scenario:
        """Scenario of one clip, without sensors.

        Its seed, tilt and wind follow from the season's seed, the clip and the attempt.
        """
        rng = stream(self.seed, attempt, f"bench.{clip.name}")
        changes = {
            "seed": int(rng.integers(2**53)),
            "frames": self.frames,
            "clip.clip_frames": self.frames,
            "swing": {
                "model": "dynamic",
                "wind": {"mean_m_s": WIND_M_S.get(clip.weather, 4.0), "azimuth_deg": float(rng.uniform(-180, 180))},
                "work": _CYCLES | _WORK[clip.swing],
            },
            "camera.mount": {"model": clip.mount},
            "camera.offset_y_m": OFFSETS_M[clip.offset],
            "camera.beta_deg": float(rng.uniform(LEAST_TILT_DEG, MOST_TILT_DEG)),
            "camera.tilt_azimuth_deg": float(rng.uniform(-180, 180)),
            "display.layout": "two-by-four",
        }
        return scenes.load(clip.weather, changes, size=(self.width_px, self.height_px))

    def with_sensors(self, scenario: Scenario) -> Scenario:
        """Add the season's sensors to the scenario of a clip, whose seed their errors follow from."""
        chosen = {name: sensor for kind in self.sensors for name, sensor in SENSORS[kind].items()}
        return msgspec.structs.replace(scenario, sensors=chosen)
