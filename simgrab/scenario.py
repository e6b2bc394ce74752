"""A scenario: everything that can change a number or a pixel, as frozen typed structs."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from datetime import datetime, timedelta
from typing import Annotated, Any, Literal

import msgspec
import tomli_w

from simgrab import layouts
from simgrab.distributions import Constant, Distribution, HalfNormal, Law, Uniform
from simgrab.errors import LayoutError, ScenarioError
from simgrab.geometry import (
    PAPER_FOCAL_LENGTH_MM,
    PAPER_PIXELS_PER_MM,
    Distortion,
    Intrinsics,
    focal_length_px,
    pixels_per_mm,
)
from simgrab.layouts import Layout

Meta = msgspec.Meta
Share = Annotated[float, Meta(ge=0, le=1)]
Cargo = Literal["coal", "ore", "grain"]

MOST_ALPHA_DEG = 80.0
ROPE_LENGTH_RANGE_M = (6.0, 45.0)


class Strict(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base of every table."""


class Tagged(Strict, frozen=True, tag_field="model"):
    """Base of every table that comes in kinds, told apart by ``model``."""


class PixelFocal(Tagged, frozen=True, tag="pixels"):
    """Focal length given in pixels."""

    focal_length_px: Annotated[float, Meta(ge=100, le=100_000)]

    def pixels(self, width_px: int, height_px: int) -> float:  # noqa: ARG002
        """Focal length h, px."""
        return self.focal_length_px


class LensFocal(Tagged, frozen=True, tag="lens"):
    """Lens and pixel density; the defaults are the paper's camera, h = 1644.82 px (section 4.3)."""

    focal_length_mm: Annotated[float, Meta(ge=0.5, le=500)] = PAPER_FOCAL_LENGTH_MM
    pixels_per_mm: Annotated[float, Meta(ge=10, le=5000)] = PAPER_PIXELS_PER_MM

    def pixels(self, width_px: int, height_px: int) -> float:  # noqa: ARG002
        """Focal length h, px."""
        return focal_length_px(self.focal_length_mm, self.pixels_per_mm)


class SensorFocal(Tagged, frozen=True, tag="sensor"):
    """Lens and sensor diagonal, the sensor being read out whole."""

    focal_length_mm: Annotated[float, Meta(ge=0.5, le=500)] = PAPER_FOCAL_LENGTH_MM
    sensor_diagonal_mm: Annotated[float, Meta(ge=1, le=100)] = 6.43

    def pixels(self, width_px: int, height_px: int) -> float:
        """Focal length h, px."""
        return focal_length_px(self.focal_length_mm, pixels_per_mm(width_px, height_px, self.sensor_diagonal_mm))


class Lens(Strict, frozen=True):
    """Brown–Conrady coefficients, OpenCV's order and signs."""

    k1: Annotated[float, Meta(ge=-1, le=1)] = 0.0
    k2: Annotated[float, Meta(ge=-1, le=1)] = 0.0
    p1: Annotated[float, Meta(ge=-0.1, le=0.1)] = 0.0
    p2: Annotated[float, Meta(ge=-0.1, le=0.1)] = 0.0
    k3: Annotated[float, Meta(ge=-1, le=1)] = 0.0


class Vibration(Strict, frozen=True):
    """Trembling of the jib head: each component of the tilt wanders in a narrow band about a frequency."""

    rms_deg: Annotated[float, Meta(ge=0, le=2)] = 0.0
    frequency_hz: Annotated[float, Meta(ge=0.05, le=10)] = 0.6
    damping: Annotated[float, Meta(gt=0, le=1)] = 0.1


class FixedMount(Tagged, frozen=True, tag="fixed"):
    """The tilt stays what it is, by decree."""

    vibration: Vibration = Vibration()


class LevelledMount(Tagged, frozen=True, tag="levelled"):
    """The camera hangs by gravity, damped, ``beta_deg`` off plumb: it follows what the moving jib feels as gravity."""

    frequency_hz: Annotated[float, Meta(ge=0.05, le=10)] = 0.5
    damping: Annotated[float, Meta(gt=0, le=5)] = 0.5
    vibration: Vibration = Vibration()


class RigidMount(Tagged, frozen=True, tag="rigid"):
    """Bolted to the fly-jib, whose pitch follows luffing; ``beta_deg`` holds at the radius where the clip begins."""

    pitch_deg_per_m: Annotated[float, Meta(ge=-10, le=10)] = 2.0
    vibration: Vibration = Vibration()


class Camera(Strict, frozen=True):
    """The surveillance camera at the jib head: the truth, which the instrument never gets."""

    width_px: Annotated[int, Meta(ge=64, le=4096)] = 1920
    height_px: Annotated[int, Meta(ge=64, le=4096)] = 1080
    focal: PixelFocal | LensFocal | SensorFocal = LensFocal()
    principal_offset_px: tuple[float, float] = (0.0, 0.0)
    distortion: Lens = Lens()
    beta_deg: Annotated[float, Meta(ge=0, le=30)] = 3.0
    tilt_azimuth_deg: Annotated[float, Meta(ge=-360, le=360)] = 0.0
    roll_deg: Annotated[float, Meta(ge=-180, le=180)] = 0.0
    offset_x_m: Annotated[float, Meta(ge=-3, le=3)] = 0.0
    offset_y_m: Annotated[float, Meta(ge=-3, le=3)] = 0.6
    offset_z_m: Annotated[float, Meta(ge=-3, le=1)] = -0.3
    mount: LevelledMount | RigidMount | FixedMount = LevelledMount()

    @property
    def intrinsics(self) -> Intrinsics:
        """The pinhole and its lens."""
        d = self.distortion
        return Intrinsics(
            self.width_px,
            self.height_px,
            self.focal.pixels(self.width_px, self.height_px),
            self.width_px / 2 + self.principal_offset_px[0],
            self.height_px / 2 + self.principal_offset_px[1],
            Distortion(d.k1, d.k2, d.p1, d.p2, d.k3),
        )

    @property
    def offset_m(self) -> tuple[float, float, float]:
        """Camera centre minus O, jib frame, m."""
        return self.offset_x_m, self.offset_y_m, self.offset_z_m


class Alpha(Strict, frozen=True):
    """The swing angle: ``law`` gives the shape and ``sigma_deg`` the scale, √E[α²], for every law."""

    sigma_deg: Annotated[float, Meta(ge=0, le=30)] = 2.0
    law: Distribution = HalfNormal()

    def __post_init__(self) -> None:
        if self.law.rms() <= 0:
            raise ValueError("the law must not be all zeros; for a still grab set sigma_deg = 0")

    @property
    def scale_deg(self) -> float:
        """Degrees a unit of the law: α = scale · |X|."""
        return self.sigma_deg / self.law.rms()


class Iid(Tagged, frozen=True, tag="iid"):
    """Independent frames: each draws its own swing, rope length, yaw, jaws and load."""

    alpha: Alpha = Alpha()
    gamma_deg: Distribution = Uniform(0.0, 360.0)
    rope_length_m: Distribution = Uniform(8.0, 23.0)
    yaw_deg: Distribution = Uniform(-15.0, 15.0)
    jaw_deg: Distribution = Constant(0.0)
    load: Distribution = Constant(0.0)


class Hang(Tagged, frozen=True, tag="hang"):
    """The crane stands still; the grab hangs on a rope of constant length."""

    rope_length_m: Annotated[float, Meta(ge=ROPE_LENGTH_RANGE_M[0], le=ROPE_LENGTH_RANGE_M[1])] = 20.0
    jaw_deg: Annotated[float, Meta(ge=0)] = 0.0
    load: Share = 0.0


class Turn(Tagged, frozen=True, tag="turn"):
    """From rest, the crane begins to slew and keeps on."""

    rope_length_m: Annotated[float, Meta(ge=ROPE_LENGTH_RANGE_M[0], le=ROPE_LENGTH_RANGE_M[1])] = 20.0
    jaw_deg: Annotated[float, Meta(ge=0)] = 0.0
    load: Share = 0.0
    slew_rpm: Annotated[float, Meta(ge=-3, le=3)] = 1.2
    ramp_s: Annotated[float, Meta(ge=0.5, le=60)] = 6.0
    wait_s: Annotated[float, Meta(ge=0)] = 5.0


class Cycles(Tagged, frozen=True, tag="cycles"):
    """Working cycles: dig, hoist, slew and luff, dump, return; each cycle's depths, speeds and pauses vary.

    It digs where the jib stands ``dig_slew_deg`` off the middle of the place, and slews by ``slew_deg`` to dump.
    ``operator`` goes from 0 (smooth: the longest ramps) to 1 (rough: the shortest, and the loads still swing when the
    next move begins).
    """

    dig_rope_m: Annotated[float, Meta(ge=ROPE_LENGTH_RANGE_M[0], le=ROPE_LENGTH_RANGE_M[1])] = 22.0
    carry_rope_m: Annotated[float, Meta(ge=ROPE_LENGTH_RANGE_M[0], le=ROPE_LENGTH_RANGE_M[1])] = 10.0
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

    def __post_init__(self) -> None:
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

    ``damping`` is a share of the critical one; wind drag comes on top. ``settle_s`` runs before the first frame.
    """

    work: Hang | Turn | Cycles = Cycles()
    start: Start = Start()
    wind: Wind = Wind()
    forcing: Forcing = Forcing()
    damping: Annotated[float, Meta(ge=0, le=0.5)] = 0.005
    yaw_damping: Annotated[float, Meta(ge=0, le=1)] = 0.05
    radius_m: Annotated[float, Meta(ge=10, le=50)] = 25.0
    drag_area_m2: Annotated[float, Meta(ge=0, le=50)] = 10.0
    settle_s: Annotated[float, Meta(ge=0, le=3600)] = 0.0


class Grab(Strict, frozen=True):
    """Looks of the bucket grab. ``wear`` and ``residue`` go from 0 (new, clean) to 1."""

    paint_rgb: tuple[Share, Share, Share] = (0.86, 0.52, 0.07)
    wear: Share = 0.4
    residue: Share = 0.3
    cargo: Cargo = "coal"


class Jib(Strict, frozen=True):
    """The jib head: how high the rope exit O hangs above the quay."""

    head_height_m: Annotated[float, Meta(ge=22, le=35)] = 28.0


class Plain(Tagged, frozen=True, tag="plain"):
    """An empty concrete yard: quick to build, nothing to distract."""


class Quay(Tagged, frozen=True, tag="quay"):
    """Quay apron: rails, markings, a bulk pile, and a hopper or truck to dump into."""

    cargo: Cargo = "coal"
    receiver: Literal["hopper", "truck", "none"] = "hopper"
    pile_height_m: Annotated[float, Meta(ge=0, le=5)] = 2.5
    wear: Share = 0.5


class Hold(Tagged, frozen=True, tag="hold"):
    """A bulk carrier's hold: coaming, frames, tank top, and a heap that fills it by ``fill``."""

    cargo: Cargo = "coal"
    fill: Share = 0.4
    depth_m: Annotated[float, Meta(ge=12, le=18)] = 15.0
    wear: Share = 0.5


class Water(Tagged, frozen=True, tag="water"):
    """Water beside the hull, with the quay wall opposite."""

    freeboard_m: Annotated[float, Meta(ge=2, le=8)] = 4.0
    quay_height_m: Annotated[float, Meta(ge=1.5, le=6)] = 3.0
    chop: Share = 0.3


class Light(Strict, frozen=True):
    """Sun and sky. Azimuth as all azimuths: counter-clockwise from x, seen from above."""

    sun_elevation_deg: Annotated[float, Meta(ge=10, le=90)] = 48.0
    sun_azimuth_deg: Annotated[float, Meta(ge=-360, le=360)] = 130.0
    sun: Annotated[float, Meta(ge=0, le=2)] = 1.0
    sky: Annotated[float, Meta(ge=0, le=2)] = 0.85

    def __post_init__(self) -> None:
        if self.sun == 0 and self.sky == 0:
            raise ValueError("sun and sky must not both be 0: nothing would be seen")


class Image(Strict, frozen=True):
    """How frames are drawn and stored."""

    format: Literal["jpeg", "png"] = "jpeg"
    quality: Annotated[int, Meta(ge=1, le=100)] = 95
    samples: Literal[0, 2, 4, 8] = 4
    shadow_map_px: Literal[0, 1024, 2048, 4096, 8192] = 4096
    ids: bool = False
    depth: bool = False


class Clip(Strict, frozen=True):
    """Time and the video: how frames follow each other, and what coding and network do to them.

    A scenario's ``frames`` are cut into clips of ``clip_frames``, each with a motion of its own; 0 makes it one. The
    camera takes frame k of a clip at k / ``frame_rate_hz``. A share ``drop_share`` of the frames is lost and leaves a
    gap. Of the others a share ``repeat_share`` comes too late to be coded: the picture last sent is sent again in its
    place. ``jitter_ms`` is the standard deviation of the time stamps, of which none overtakes the one before. The first
    frame of a clip is always sent, at time 0. ``bit_rate_mbit_s`` is kept but for a buffer of two seconds; every
    ``gop_frames`` pictures begin with a key frame.
    """

    frame_rate_hz: Annotated[float, Meta(ge=0.01, le=120)] = 9.0
    clip_frames: Annotated[int, Meta(ge=0)] = 0
    bit_rate_mbit_s: Annotated[float, Meta(gt=0, le=200)] = 4.0
    gop_frames: Annotated[int, Meta(ge=1, le=1000)] = 50
    drop_share: Annotated[float, Meta(ge=0, le=0.9)] = 0.0
    repeat_share: Annotated[float, Meta(ge=0, le=0.9)] = 0.0
    jitter_ms: Annotated[float, Meta(ge=0, le=1000)] = 0.0

    def count(self, frames: int) -> int:
        """Return the number of clips that so many frames make."""
        return math.ceil(frames / (self.clip_frames or frames))

    def of(self, frame: int) -> int:
        """Return the clip that a frame is of."""
        return frame // self.clip_frames if self.clip_frames else 0

    def span(self, clip: int, frames: int) -> range:
        """Frames of one clip, in order; the last clip may be shorter."""
        length = self.clip_frames or frames
        return range(clip * length, min((clip + 1) * length, frames))


class Display(Strict, frozen=True):
    """The on-screen display: clock, and the rope lengths as the crane's controller knows them.

    ``layout`` is a bundled layout's name or a layout's own table; "none" shows nothing. The controller refreshes the
    numbers ``refresh_hz`` times a second with values ``lag_s`` old; the picture is read out over ``readout_s``, and a
    refresh that falls in between tears it. The lengths shown are |OA|, and that plus what the closing rope pays out to
    open the jaws, each less ``constant_m``. The clock shows ``start`` when time begins.
    """

    layout: str | Layout = "none"
    start: str = "2022-01-26T14:05:37"
    lag_s: Annotated[float, Meta(ge=0, le=10)] = 0.5
    refresh_hz: Annotated[float, Meta(gt=0, le=100)] = 5.0
    readout_s: Annotated[float, Meta(ge=0, le=1)] = 0.03
    constant_m: Annotated[float, Meta(ge=-10, le=10)] = 2.5

    def __post_init__(self) -> None:
        if isinstance(self.layout, str) and self.layout not in ("none", *layouts.names()):
            raise ValueError(
                f"layout must be one of: none, {', '.join(layouts.names())}, or a layout's table; got {self.layout!r}"
            )
        try:
            local = self.started.tzinfo is None
        except ValueError:
            local = False
        if not local:
            raise ValueError(f"start must be a local date and time such as 2022-01-26T14:05:37, got {self.start!r}")
        if self.readout_s * self.refresh_hz > 1:
            raise ValueError(
                f"readout_s must not exceed the {1 / self.refresh_hz:g} s between refreshes: a picture tears once"
            )

    @property
    def started(self) -> datetime:
        """Date and time when time begins."""
        return datetime.fromisoformat(self.start)

    def layout_in(self, width_px: int, height_px: int) -> Layout | None:
        """Fit the layout to a picture, None where nothing is shown; raises `LayoutError` where that is too small."""
        if self.layout == "none":
            return None
        layout = layouts.load(self.layout) if isinstance(self.layout, str) else self.layout
        return layout.scaled(width_px, height_px)


class Labels(Strict, frozen=True):
    """Which frames get a detection box: those that show at least this fraction of the grab's silhouette."""

    least_visible_fraction: Share = 0.1


class Splits(Strict, frozen=True):
    """Shares of the seeded draw into train, val and test."""

    train: Share = 0.8
    val: Share = 0.1
    test: Share = 0.1

    def __post_init__(self) -> None:
        if not math.isclose(self.train + self.val + self.test, 1.0, abs_tol=1e-9):
            raise ValueError(f"train + val + test must be 1, got {self.train + self.val + self.test:g}")


class Scenario(Strict, frozen=True):
    """One scene, whole. Two scenarios with the same `digest` give the same dataset."""

    name: Annotated[str, Meta(pattern=r"^[a-z0-9][a-z0-9_-]*$", max_length=64)] = "custom"
    description: str = ""
    seed: Annotated[int, Meta(ge=0, le=2**53)] = 0
    frames: Annotated[int, Meta(ge=1, le=10_000_000)] = 64
    camera: Camera = Camera()
    swing: Iid | Dynamic = Iid()
    grab: Grab = Grab()
    jib: Jib = Jib()
    place: Quay | Hold | Water | Plain = Quay()
    light: Light = Light()
    image: Image = Image()
    clip: Clip = Clip()
    display: Display = Display()
    labels: Labels = Labels()
    splits: Splits = Splits()

    def __post_init__(self) -> None:
        if isinstance(self.swing, Iid):
            _within("swing.rope_length_m", self.swing.rope_length_m, *ROPE_LENGTH_RANGE_M)
            _within("swing.load", self.swing.load, 0.0, 1.0)
            _within("swing.jaw_deg", self.swing.jaw_deg, 0.0, math.inf)
            if self.camera.mount.vibration.rms_deg > 0:
                raise ScenarioError(
                    "camera.mount.vibration", 'independent frames know no time; swing.model = "dynamic"'
                )
        _check_lens(self.camera.intrinsics)
        self._check_display()

    def _check_display(self) -> None:
        try:
            self.display.layout_in(self.camera.width_px, self.camera.height_px)
            self.display.started + timedelta(seconds=self.frames / self.clip.frame_rate_hz)
        except LayoutError as problem:
            raise ScenarioError("display.layout", str(problem)) from None
        except OverflowError:
            raise ScenarioError("display.start", "its clock ends with the year 9999, before the last frame") from None

    def digest(self) -> str:
        """SHA-256 of the canonical JSON of everything in the scenario."""
        return hashlib.sha256(msgspec.json.encode(self, order="deterministic")).hexdigest()

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, as `from_dict` takes it."""
        return dict(msgspec.json.decode(msgspec.json.encode(self)))

    def to_toml(self) -> str:
        """Return a scene file with every key filled in."""
        return tomli_w.dumps(_without_none(self.to_dict()))


def _without_none(value: Any) -> Any:
    """TOML knows no null: an absent key says the same."""
    if isinstance(value, dict):
        return {k: _without_none(v) for k, v in value.items() if v is not None}
    return value


def _within(key: str, law: Law, low: float, high: float) -> None:
    least, most = law.support()
    if least < low or most > high:
        raise ScenarioError(key, f"draws must stay within {low:g} … {high:g}, this law spans {least:g} … {most:g}")


def _check_lens(intrinsics: Intrinsics) -> None:
    """Refuse a lens that folds within the picture."""
    w, h = intrinsics.width_px, intrinsics.height_px
    border = [(x, y) for x in (0, w / 2, w) for y in (0, h / 2, h)]
    if any(map(math.isnan, intrinsics.undistort(border).ravel())):
        raise ScenarioError("camera.distortion", "the lens folds the picture: no ray reaches its corners")


def schema() -> dict[str, Any]:
    """JSON schema of a scenario file, for editors."""
    return _open_base(msgspec.json.schema(Scenario))


def _open_base(schema: dict[str, Any]) -> dict[str, Any]:
    properties = schema["$defs"]["Scenario"]["properties"]
    properties["base"] = {"type": "string", "description": "Bundled scene that this file departs from."}
    return schema


def merged(base: Mapping[str, Any], change: Mapping[str, Any]) -> dict[str, Any]:
    """Merge nested tables, ``change`` winning; a table of another ``model`` or ``dist`` replaces the old one whole."""
    result = dict(base)
    for key, value in change.items():
        old = result.get(key)
        if isinstance(old, Mapping) and isinstance(value, Mapping) and not _other_kind(old, value):
            result[key] = merged(old, value)
        else:
            result[key] = value
    return result


def _other_kind(old: Mapping[str, Any], new: Mapping[str, Any]) -> bool:
    return any(tag in new and new[tag] != old.get(tag) for tag in ("model", "dist"))
