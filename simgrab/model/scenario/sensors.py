"""Sensors beside the camera: inertial measurement units, inclinometers, the crane's encoders, LiDARs, cameras."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from simgrab.errors import ScenarioError
from simgrab.model.scenario.base import Azimuth, Meta, Share, Strict, Tagged, about

Mounting = Annotated[
    Literal["jib-head", "camera", "platform", "rope", "grab"],
    about(
        "Where it is: in O, in the camera's housing, in the slewing axis, on the rope 1 m below O, on the grab's head."
    ),
]
ImuClass = Literal["adis16448", "mems", "none"]
Density = Annotated[float, Meta(ge=0, le=10)]
Spread = Annotated[float, Meta(ge=0, le=1000)]
Bias = Annotated[Spread, about("Standard deviation of the bias at turn-on, for each axis, drawn once a clip.")]
Scale = Annotated[float, about("Standard deviation of the scale error, drawn once a clip.", ge=0, le=0.5)]
AxisScale = Annotated[Scale, about("Standard deviation of the scale error, for each axis, drawn once a clip.")]
Misalignment = Annotated[
    float, about("Standard deviation by which each axis leans towards each of the other two.", ge=0, le=10)
]
Range = Annotated[float, Meta(gt=0, le=1e5)]
Largest = Annotated[Range | None, about("Largest reading; without limit unless given.")]
Count = Annotated[float, about("Size of a count; 0 for none.", ge=0, le=100)]
ClockOffset = Annotated[Spread, about("Standard deviation of the clock's offset, drawn once a clip.")]
ClockDrift = Annotated[Spread, about("Standard deviation of the clock's drift, drawn once a clip.")]
SlowRate = Annotated[float, about("Readings a second.", ge=0.1, le=1000)]
AngleCount = Annotated[float, about("Size of a count.", ge=0, le=10)]
LengthCount = Annotated[float, about("Size of a count.", ge=0, le=1)]
ZeroError = Annotated[float, about("Standard deviation of the zero point, drawn once a clip.", ge=0, le=10)]
Interval = tuple[float, float]
Point = tuple[float, float, float]


class Clocked(Tagged, frozen=True):
    """What slow sensors have: a clock of their own. Standard deviations of draws made once a clip."""

    clock_offset_ms: ClockOffset = 5.0
    clock_drift_ppm: ClockDrift = 20.0


class ImuNoise(Strict, frozen=True):
    """Errors of an IMU. What is not given is 0 or, for a range, without limit.

    Noise densities and random walks are those of Kalibr's model, with the names and units of EuRoC's ``sensor.yaml``.
    Readings beyond ``range`` stay at it.
    """

    gyroscope_noise_density: Annotated[Density, about("Density of white noise, rad/s/√Hz.")] = 0.0
    gyroscope_random_walk: Annotated[Density, about("Random walk of the bias, rad/s²/√Hz.")] = 0.0
    gyroscope_bias_deg_s: Bias = 0.0
    gyroscope_scale_error: AxisScale = 0.0
    gyroscope_misalignment_deg: Misalignment = 0.0
    gyroscope_range_deg_s: Largest = None
    gyroscope_resolution_deg_s: Count = 0.0
    accelerometer_noise_density: Annotated[Density, about("Density of white noise, m/s²/√Hz.")] = 0.0
    accelerometer_random_walk: Annotated[Density, about("Random walk of the bias, m/s³/√Hz.")] = 0.0
    accelerometer_bias_m_s2: Bias = 0.0
    accelerometer_scale_error: AxisScale = 0.0
    accelerometer_misalignment_deg: Misalignment = 0.0
    accelerometer_range_m_s2: Largest = None
    accelerometer_resolution_m_s2: Count = 0.0
    clock_offset_ms: ClockOffset = 0.0
    clock_drift_ppm: ClockDrift = 0.0


# Of adis16448 and mems; sources: docs/sensors.md.
_FIGURES = {
    "gyroscope_noise_density": (1.6968e-4, 8.727e-5),
    "gyroscope_random_walk": (1.9393e-5, 9.97e-7),
    "gyroscope_bias_deg_s": (0.5, 6.67),
    "gyroscope_scale_error": (0.003, 0.01),
    "gyroscope_misalignment_deg": (0.2, 0.38),
    "gyroscope_range_deg_s": (1000.0, 250.0),
    "gyroscope_resolution_deg_s": (0.04, 7.63e-3),
    "accelerometer_noise_density": (2.0e-3, 3.923e-3),
    "accelerometer_random_walk": (3.0e-3, 1.248e-5),
    "accelerometer_bias_m_s2": (0.196, 0.163),
    "accelerometer_scale_error": (0.003, 0.01),
    "accelerometer_misalignment_deg": (0.2, 0.38),
    "accelerometer_range_m_s2": (176.5, 19.61),
    "accelerometer_resolution_m_s2": (8.172e-3, 5.985e-4),
    "clock_offset_ms": (1.0, 5.0),
    "clock_drift_ppm": (20.0, 50.0),
}
IMU_CLASSES = {
    "adis16448": ImuNoise(**{key: figure for key, (figure, _) in _FIGURES.items()}),
    "mems": ImuNoise(**{key: figure for key, (_, figure) in _FIGURES.items()}),
    "none": ImuNoise(),
}


class Imu(Tagged, frozen=True, kw_only=True, tag="imu"):
    """An inertial measurement unit: angular rate and specific force in its own frame."""

    mount: Mounting
    noise: Annotated[ImuClass | ImuNoise, about("Class of sensor, or a table of errors.")] = "adis16448"
    rate_hz: Annotated[float, about("Readings a second.", ge=1, le=2000)] = 200.0

    @property
    def errors(self) -> ImuNoise:
        """The table of errors, also where a class is named."""
        return IMU_CLASSES[self.noise] if isinstance(self.noise, str) else self.noise


class Inclinometer(Clocked, frozen=True, kw_only=True, tag="inclinometer"):
    """Angles of the sensor's x and y axes above the plane that apparent gravity makes level, behind a slow filter."""

    mount: Mounting
    rate_hz: SlowRate = 10.0
    bandwidth_hz: Annotated[float, about("Corner frequency of the first-order low-pass.", ge=0.01, le=100)] = 1.0
    noise_deg: Annotated[float, about("Standard deviation of the noise of a reading.", ge=0, le=10)] = 0.01
    zero_error_deg: ZeroError = 0.05
    resolution_deg: AngleCount = 0.01


class SlewEncoder(Clocked, frozen=True, tag="slew-encoder"):
    """Encoder of the slewing angle; the default counts 8192 a turn."""

    rate_hz: SlowRate = 20.0
    resolution_deg: AngleCount = 0.0439453125
    zero_error_deg: ZeroError = 0.1


class LuffEncoder(Clocked, frozen=True, tag="luff-encoder"):
    """Encoder of the luffing gear, read as the radius from the slewing axis to O."""

    rate_hz: SlowRate = 20.0
    resolution_m: LengthCount = 0.01
    zero_error_m: ZeroError = 0.05
    scale_error: Scale = 0.0


class HoistEncoder(Clocked, frozen=True, tag="hoist-encoder"):
    """Encoder of the hoisting drum, read as the rope length |OA|."""

    rate_hz: SlowRate = 20.0
    resolution_m: LengthCount = 0.005
    zero_error_m: ZeroError = 0.05
    scale_error: Scale = 0.001


class Controller(Clocked, frozen=True, tag="controller"):
    """The crane's controller: slewing angle, radius, their setpoints, rope length |OA|, wind and load, for `run --plc`.

    A row states the values of ``lag_s`` before its time stamp, on average.
    """

    rate_hz: SlowRate = 10.0
    lag_s: Annotated[float, about("Mean delay of the time stamp.", ge=0, le=10)] = 0.1
    jitter_s: Annotated[float, about("Its standard deviation; no row overtakes another.", ge=0, le=10)] = 0.01
    dropout: Annotated[Share, about("Share of the time without readings.")] = 0.0
    dropout_s: Annotated[float, about("Duration of a loss; several may follow each other.", ge=0.01, le=600)] = 1.0
    slew_resolution_deg: AngleCount = 0.1
    slew_zero_error_deg: ZeroError = 0.5
    radius_resolution_m: LengthCount = 0.01
    radius_zero_error_m: ZeroError = 0.05
    rope_resolution_m: LengthCount = 0.01
    rope_zero_error_m: ZeroError = 0.05
    rope_scale_error: Scale = 0.001
    wind_resolution_m_s: LengthCount = 0.1
    wind_scale_error: Scale = 0.03
    load_resolution_t: LengthCount = 0.1
    load_scale_error: Scale = 0.02
    clock_offset_ms: ClockOffset = 300.0


class Lidar(Clocked, frozen=True, tag="lidar"):
    """A scanner on the slewing platform that measures distances along a grid of beams, all at once.

    The beams are evenly spaced in elevation above the horizontal and azimuth from outboard. In rain, snow and fog they
    are intercepted. Sideways is y of the jib frame.
    """

    position_m: Annotated[Point, about("Outboard of the slewing axis, sideways, above the quay.")] = (2.0, 1.5, 14.0)
    elevation_deg: Annotated[Interval, about("Lowest and highest beam.")] = (-32.0, 40.0)
    azimuth_deg: Annotated[Interval, about("Azimuth of the first and last beam, from outboard.")] = (-14.0, 10.0)
    rings: Annotated[int, about("Number of elevations.", ge=1, le=256)] = 64
    columns: Annotated[int, about("Number of azimuths.", ge=1, le=4096)] = 97
    rate_hz: Annotated[float, about("Scans a second.", ge=0.1, le=100)] = 10.0
    range_m: Annotated[tuple[float, float], about("Shortest and longest distance that is measured.")] = (0.5, 100.0)
    range_noise_m: Annotated[float, about("Standard deviation of a distance.", ge=0, le=1)] = 0.02
    angle_noise_deg: Annotated[float, about("Standard deviation of a beam's elevation and azimuth.", ge=0, le=5)] = 0.02
    resolution_m: Annotated[float, about("Size of a count of the distance.", ge=0, le=1)] = 0.004
    dropout: Annotated[Share, about("Share of beams that get lost in clear air.")] = 0.01
    false_echo: Annotated[Share, about("Share of intercepted beams that report a point in the air.")] = 0.3

    def check(self) -> None:  # noqa: D102
        for key, least, most in (("elevation_deg", -90, 90), ("azimuth_deg", -180, 180), ("range_m", 0, 1000)):
            low, high = getattr(self, key)
            if not least <= low < high <= most:
                raise ScenarioError(key, f"must rise, within {least} … {most}; got {low:g} and {high:g}")
        if max(map(abs, self.position_m)) > 100:
            raise ScenarioError("position_m", "must be within 100 m of the slewing axis at the quay")


class SideCamera(Tagged, frozen=True, tag="camera"):
    """A further camera, whose pictures stand upright and show neither weather nor errors of lens and sensor.

    On the slewing ``platform``, ``position_m`` is from the slewing axis at the quay; at the ``jib-head`` it is from O.
    It runs with the clock of the frames.
    """

    mount: Annotated[Literal["platform", "jib-head"], about("The slewing platform or the jib head.")] = "platform"
    position_m: Annotated[Point, about("From the axis at the quay or from O: outboard, sideways, up.")] = (
        2.0,
        -1.5,
        14.0,
    )
    azimuth_deg: Annotated[Azimuth, about("Azimuth of the optical axis, from outboard.")] = 0.0
    elevation_deg: Annotated[float, about("Direction of the optical axis above the horizontal.", ge=-89, le=89)] = 10.0
    width_px: Annotated[int, about("Width of the picture.", ge=64, le=4096)] = 1280
    height_px: Annotated[int, about("Height of the picture.", ge=64, le=4096)] = 960
    focal_length_px: Annotated[float, about("Focal length in pixels.", ge=100, le=100_000)] = 700.0
    rate_hz: Annotated[float, about("Pictures a second.", ge=0.1, le=200)] = 9.0

    def check(self) -> None:  # noqa: D102
        if max(map(abs, self.position_m)) > 100:
            raise ScenarioError("position_m", "must be within 100 m of what it is mounted on")

    def count(self, seconds: float) -> int:
        """Return the number of pictures in a clip of some seconds."""
        number = math.ceil(seconds * self.rate_hz)
        while number and (number - 1) / self.rate_hz >= seconds:
            number -= 1
        return number + (number / self.rate_hz < seconds)


Encoder = SlewEncoder | LuffEncoder | HoistEncoder
MotionSensor = Imu | Inclinometer | SlewEncoder | LuffEncoder | HoistEncoder | Controller | Lidar | SideCamera
