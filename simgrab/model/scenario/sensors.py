"""Sensors beside the camera: inertial measurement units, inclinometers, the crane's encoders, LiDARs, cameras."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from simgrab.errors import ScenarioError
from simgrab.model.scenario.base import Meta, Share, Strict, Tagged

Mounting = Literal["jib-head", "camera", "platform", "rope", "grab"]
Density = Annotated[float, Meta(ge=0, le=10)]
Spread = Annotated[float, Meta(ge=0, le=1000)]
Error = Annotated[float, Meta(ge=0, le=0.5)]
SlowRate = Annotated[float, Meta(ge=0.1, le=1000)]


class Clocked(Tagged, frozen=True):
    """What slow sensors have: a clock of their own. Standard deviations of draws made once a clip."""

    clock_offset_ms: Spread = 5.0
    clock_drift_ppm: Spread = 20.0


class ImuNoise(Strict, frozen=True):
    """Errors of an IMU. What is not given is 0 or, for a range, without limit.

    Noise densities and random walks are those of Kalibr's model, with the names and units of EuRoC's ``sensor.yaml``:
    rad/s/√Hz and rad/s²/√Hz, m/s²/√Hz and m/s³/√Hz. ``bias``, ``scale_error``, ``misalignment`` and ``clock`` are
    standard deviations of draws made once a clip: for each axis, and for the clock. ``misalignment_deg`` turns every
    sensitive axis towards each of the other two. Readings beyond ``range`` stay at it; ``resolution`` is that of a
    count.
    """

    gyroscope_noise_density: Density = 0.0
    gyroscope_random_walk: Density = 0.0
    gyroscope_bias_deg_s: Spread = 0.0
    gyroscope_scale_error: Error = 0.0
    gyroscope_misalignment_deg: Annotated[float, Meta(ge=0, le=10)] = 0.0
    gyroscope_range_deg_s: Annotated[float, Meta(gt=0, le=1e5)] | None = None
    gyroscope_resolution_deg_s: Annotated[float, Meta(ge=0, le=100)] = 0.0
    accelerometer_noise_density: Density = 0.0
    accelerometer_random_walk: Density = 0.0
    accelerometer_bias_m_s2: Spread = 0.0
    accelerometer_scale_error: Error = 0.0
    accelerometer_misalignment_deg: Annotated[float, Meta(ge=0, le=10)] = 0.0
    accelerometer_range_m_s2: Annotated[float, Meta(gt=0, le=1e5)] | None = None
    accelerometer_resolution_m_s2: Annotated[float, Meta(ge=0, le=100)] = 0.0
    clock_offset_ms: Spread = 0.0
    clock_drift_ppm: Spread = 0.0


# Sources of the figures: docs/sensors.md.
NO_NOISE = ImuNoise()
ADIS16448 = ImuNoise(
    gyroscope_noise_density=1.6968e-4,
    gyroscope_random_walk=1.9393e-5,
    gyroscope_bias_deg_s=0.5,
    gyroscope_scale_error=0.003,
    gyroscope_misalignment_deg=0.2,
    gyroscope_range_deg_s=1000.0,
    gyroscope_resolution_deg_s=0.04,
    accelerometer_noise_density=2.0e-3,
    accelerometer_random_walk=3.0e-3,
    accelerometer_bias_m_s2=0.196,
    accelerometer_scale_error=0.003,
    accelerometer_misalignment_deg=0.2,
    accelerometer_range_m_s2=176.5,
    accelerometer_resolution_m_s2=8.172e-3,
    clock_offset_ms=1.0,
    clock_drift_ppm=20.0,
)
MEMS = ImuNoise(
    gyroscope_noise_density=8.727e-5,
    gyroscope_random_walk=9.97e-7,
    gyroscope_bias_deg_s=6.67,
    gyroscope_scale_error=0.01,
    gyroscope_misalignment_deg=0.38,
    gyroscope_range_deg_s=250.0,
    gyroscope_resolution_deg_s=7.63e-3,
    accelerometer_noise_density=3.923e-3,
    accelerometer_random_walk=1.248e-5,
    accelerometer_bias_m_s2=0.163,
    accelerometer_scale_error=0.01,
    accelerometer_misalignment_deg=0.38,
    accelerometer_range_m_s2=19.61,
    accelerometer_resolution_m_s2=5.985e-4,
    clock_offset_ms=5.0,
    clock_drift_ppm=50.0,
)
IMU_CLASSES = {"adis16448": ADIS16448, "mems": MEMS, "none": NO_NOISE}


class Imu(Tagged, frozen=True, kw_only=True, tag="imu"):
    """An inertial measurement unit: angular rate and specific force in its own frame.

    ``mount`` is where it is: at the ``jib-head`` in O, in the ``camera``'s housing, on the slewing ``platform`` in its
    axis, on the ``rope`` 1 m below O, or on the ``grab``'s head. ``noise`` names a class of sensors ("adis16448",
    "mems", "none"), or is a table of errors.
    """

    mount: Mounting
    noise: Literal["adis16448", "mems", "none"] | ImuNoise = "adis16448"
    rate_hz: Annotated[float, Meta(ge=1, le=2000)] = 200.0

    @property
    def errors(self) -> ImuNoise:
        """The table of errors, also where a class is named."""
        return IMU_CLASSES[self.noise] if isinstance(self.noise, str) else self.noise


class Inclinometer(Clocked, frozen=True, kw_only=True, tag="inclinometer"):
    """Angles of the sensor's x and y axes above the plane that apparent gravity makes level, behind a slow filter.

    The filter is a low-pass of first order at ``bandwidth_hz``. ``noise_deg`` is that of a reading; ``zero_error_deg``
    is the standard deviation of a draw made once a clip.
    """

    mount: Mounting
    rate_hz: SlowRate = 10.0
    bandwidth_hz: Annotated[float, Meta(ge=0.01, le=100)] = 1.0
    noise_deg: Annotated[float, Meta(ge=0, le=10)] = 0.01
    zero_error_deg: Annotated[float, Meta(ge=0, le=10)] = 0.05
    resolution_deg: Annotated[float, Meta(ge=0, le=10)] = 0.01


class SlewEncoder(Clocked, frozen=True, tag="slew-encoder"):
    """Encoder of the slewing angle; the default counts 8192 a turn."""

    rate_hz: SlowRate = 20.0
    resolution_deg: Annotated[float, Meta(ge=0, le=10)] = 0.0439453125
    zero_error_deg: Annotated[float, Meta(ge=0, le=10)] = 0.1


class LuffEncoder(Clocked, frozen=True, tag="luff-encoder"):
    """Encoder of the luffing gear, read as the radius from the slewing axis to O."""

    rate_hz: SlowRate = 20.0
    resolution_m: Annotated[float, Meta(ge=0, le=1)] = 0.01
    zero_error_m: Annotated[float, Meta(ge=0, le=10)] = 0.05
    scale_error: Error = 0.0


class HoistEncoder(Clocked, frozen=True, tag="hoist-encoder"):
    """Encoder of the hoisting drum, read as the rope length |OA|."""

    rate_hz: SlowRate = 20.0
    resolution_m: Annotated[float, Meta(ge=0, le=1)] = 0.005
    zero_error_m: Annotated[float, Meta(ge=0, le=10)] = 0.05
    scale_error: Error = 0.001


class Lidar(Clocked, frozen=True, tag="lidar"):
    """A scanner on the slewing platform that measures distances along a grid of beams, all at once.

    ``position_m`` is outboard of the slewing axis, sideways (y of the jib frame), and above the quay. The beams are
    evenly spaced in elevation above the horizontal and azimuth from outboard. A share ``dropout`` gets lost. In rain,
    snow and fog beams are intercepted; of these, a share ``false_echo`` reports a point in the air.
    """

    position_m: tuple[float, float, float] = (2.0, 1.5, 14.0)
    elevation_deg: tuple[float, float] = (-32.0, 40.0)
    azimuth_deg: tuple[float, float] = (-14.0, 10.0)
    rings: Annotated[int, Meta(ge=1, le=256)] = 64
    columns: Annotated[int, Meta(ge=1, le=4096)] = 97
    rate_hz: Annotated[float, Meta(ge=0.1, le=100)] = 10.0
    range_m: tuple[float, float] = (0.5, 100.0)
    range_noise_m: Annotated[float, Meta(ge=0, le=1)] = 0.02
    angle_noise_deg: Annotated[float, Meta(ge=0, le=5)] = 0.02
    resolution_m: Annotated[float, Meta(ge=0, le=1)] = 0.004
    dropout: Share = 0.01
    false_echo: Share = 0.3

    def check(self) -> None:  # noqa: D102
        for key, least, most in (("elevation_deg", -90, 90), ("azimuth_deg", -180, 180), ("range_m", 0, 1000)):
            low, high = getattr(self, key)
            if not least <= low < high <= most:
                raise ScenarioError(key, f"must rise, within {least} … {most}; got {low:g} and {high:g}")
        if max(map(abs, self.position_m)) > 100:
            raise ScenarioError("position_m", "must be within 100 m of the slewing axis at the quay")


class SideCamera(Tagged, frozen=True, tag="camera"):
    """A further camera, whose pictures stand upright and show neither weather nor errors of lens and sensor.

    On the slewing ``platform``, ``position_m`` is outboard of the slewing axis, sideways (y of the jib frame), and
    above the quay; at the ``jib-head`` it is from O. ``azimuth_deg`` is that of its optical axis from outboard,
    counter-clockwise, and ``elevation_deg`` that above the horizontal. It runs with the clock of the frames.
    """

    mount: Literal["platform", "jib-head"] = "platform"
    position_m: tuple[float, float, float] = (2.0, -1.5, 14.0)
    azimuth_deg: Annotated[float, Meta(ge=-360, le=360)] = 0.0
    elevation_deg: Annotated[float, Meta(ge=-89, le=89)] = 10.0
    width_px: Annotated[int, Meta(ge=64, le=4096)] = 1280
    height_px: Annotated[int, Meta(ge=64, le=4096)] = 960
    focal_length_px: Annotated[float, Meta(ge=100, le=100_000)] = 700.0
    rate_hz: Annotated[float, Meta(ge=0.1, le=200)] = 9.0

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
MotionSensor = Imu | Inclinometer | SlewEncoder | LuffEncoder | HoistEncoder | Lidar | SideCamera
