"""Places of the sensor files in a dataset, and descriptions of the sensors in EuRoC's format.

Readings are below ``sensors/`` and the truth below ``sensors_truth/``, so that the first folder can be shared without
the second.
"""

from __future__ import annotations

from collections.abc import Iterator

import tomli_w

from simgrab.model.geometry import Array
from simgrab.model.scenario import (
    Controller,
    HoistEncoder,
    Imu,
    Inclinometer,
    Lidar,
    LuffEncoder,
    MotionSensor,
    Scenario,
    SideCamera,
    SlewEncoder,
)

STAMP = "#timestamp [ns]"
LEAST_COUNT = 1e-6  # of a column that is not rounded
_BODIES = {
    "jib-head": "jib frame: origin O, x outboard, z up",
    "camera": "camera frame: x right, y down, z forward",
    "platform": "platform frame: origin on the slewing axis at the height of the quay, x outboard, z up",
    "rope": "rope frame: origin O, z up along the rope, x as the jib's without swing",
    "grab": "grab frame: origin A, z up along the rope, x across the jaws' closing line",
}


def names(scenario: Scenario) -> Iterator[str]:
    """Name the sensor files of a dataset of the scenario."""
    for clip in range(scenario.clip_count if scenario.sensors else 0):
        for name, sensor in scenario.sensors.items():
            data, truth = tables_of(clip, name, sensor)
            yield from (data, description_of(clip, name, sensor), truth)
            if isinstance(sensor, SideCamera):
                seconds = len(scenario.span(clip)) / scenario.clip.frame_rate_hz
                yield from (f"{folder_of(clip, name)}/data/{picture_of(k)}" for k in range(sensor.count(seconds)))


def picture_of(number: int) -> str:
    """Name a picture of a side camera."""
    return f"{number:06d}.jpg"


def folder_of(clip: int, sensor: str) -> str:
    """Name the folder of a sensor's readings."""
    return f"sensors/clip_{clip:03d}/{sensor}"


def description_of(clip: int, name: str, sensor: MotionSensor) -> str:
    """Name the description of a sensor; a controller's is what `simgrab run --plc` reads."""
    return f"{folder_of(clip, name)}/{'data.toml' if isinstance(sensor, Controller) else 'sensor.yaml'}"


def tables_of(clip: int, name: str, sensor: MotionSensor) -> tuple[str, str]:
    """Name the two tables of a sensor: its readings, and the truth."""
    kind = "parquet" if isinstance(sensor, Lidar) else "csv"
    return f"{folder_of(clip, name)}/data.{kind}", f"sensors_truth/clip_{clip:03d}/{name}/truth.{kind}"


def describe(sensor: MotionSensor, body_from_sensor: Array | None, grab_kg: float) -> str:
    """Describe a sensor with the maker's figures, never with the drawn errors; `description_of` names the file.

    Parameters
    ----------
    body_from_sensor : ndarray, shape (4, 4), or None
        Nominal pose, T_BS.
    grab_kg : float
        Mass of the empty grab, for a controller's load cell.
    """
    if not isinstance(sensor, Controller):
        return "".join(f"{line}\n" for line in _yaml(sensor, body_from_sensor))
    shared = {"rate_hz": sensor.rate_hz, "lag_s": sensor.lag_s, "jitter_s": sensor.jitter_s}

    def column(name: str, unit: str, count: float, **more: object) -> dict[str, object]:
        return {"column": f"{name} [{unit}]", "unit": unit, "resolution": max(count, LEAST_COUNT)} | shared | more

    return tomli_w.dumps({
        "time": {"column": STAMP, "unit": "ns", "clock_sd_s": sensor.clock_offset_ms / 1000},
        "slew": column("slew", "deg", sensor.slew_resolution_deg, setpoint="slew_setpoint [deg/s]"),
        "radius": column(
            "radius", "m", sensor.radius_resolution_m, constant_m=0.0, setpoint="radius_setpoint [m/s]"
        ),
        "rope": column("rope_length", "m", sensor.rope_resolution_m, constant_m=0.0),
        "wind": column("wind", "m/s", sensor.wind_resolution_m_s),
        "load": column("load", "t", sensor.load_resolution_t, grab_t=round(grab_kg / 1000, 2)),
    })  # fmt: skip


def _yaml(sensor: MotionSensor, body_from_sensor: Array | None) -> Iterator[str]:
    """Lines of EuRoC's ``sensor.yaml``."""
    kind, _, _ = sensor.__struct_config__.tag.partition("-")  # type: ignore[union-attr]  # all of them have one
    match sensor:
        case Imu() | Inclinometer() | Lidar() | SideCamera():
            assert body_from_sensor is not None
            mount = "platform" if isinstance(sensor, Lidar) else sensor.mount
            yield f"sensor_type: {kind}"
            yield f"comment: simgrab, on the {mount}"
            yield ""
            yield f"# Sensor extrinsics wrt. the body frame: {_BODIES[mount]}."
            yield "T_BS:"
            yield "  cols: 4"
            yield "  rows: 4"
            rows = (", ".join(_number(value) for value in row) for row in body_from_sensor)
            yield f"  data: [{(',' + chr(10) + ' ' * 9).join(rows)}]"
        case SlewEncoder() | LuffEncoder() | HoistEncoder():
            yield "sensor_type: encoder"
            yield f"comment: simgrab, {kind}"
    yield f"rate_hz: {_number(sensor.rate_hz)}"
    yield ""
    match sensor:
        case Imu():
            yield "# inertial sensor noise model parameters (static)"
            errors = sensor.errors
            for name, unit in (
                ("gyroscope_noise_density", "rad / s / sqrt(Hz)"), ("gyroscope_random_walk", "rad / s^2 / sqrt(Hz)"),
                ("accelerometer_noise_density", "m / s^2 / sqrt(Hz)"),
                ("accelerometer_random_walk", "m / s^3 / sqrt(Hz)"),
            ):  # fmt: skip
                yield f"{name}: {_number(getattr(errors, name))}  # [ {unit} ]"
        case Inclinometer():
            yield f"bandwidth_hz: {_number(sensor.bandwidth_hz)}"
            yield f"noise_deg: {_number(sensor.noise_deg)}"
            yield f"resolution_deg: {_number(sensor.resolution_deg)}"
        case SideCamera():
            f, half = _number(sensor.focal_length_px), (sensor.width_px / 2, sensor.height_px / 2)
            yield f"resolution: [{sensor.width_px}, {sensor.height_px}]"
            yield "camera_model: pinhole"
            yield "# fu, fv, cu, cv; (0, 0) is the outer corner of the top-left pixel"
            yield f"intrinsics: [{f}, {f}, {_number(half[0])}, {_number(half[1])}]"
            yield "distortion_model: radial-tangential"
            yield "distortion_coefficients: [0.0, 0.0, 0.0, 0.0]"
        case Lidar():
            for name in ("elevation_deg", "azimuth_deg", "range_m"):
                yield f"{name}: [{', '.join(_number(value) for value in getattr(sensor, name))}]"
            yield f"rings: {sensor.rings}"
            yield f"columns: {sensor.columns}"
            for name in ("range_noise_m", "angle_noise_deg", "resolution_m"):
                yield f"{name}: {_number(getattr(sensor, name))}"
        case SlewEncoder():
            yield f"resolution_deg: {_number(sensor.resolution_deg)}"
        case LuffEncoder() | HoistEncoder():
            yield f"resolution_m: {_number(sensor.resolution_m)}"


def _number(value: float) -> str:
    """Write a number so that YAML 1.1 takes it for one: with a point before the exponent."""
    mantissa, e, exponent = repr(float(value)).partition("e")
    return f"{mantissa}{'' if '.' in mantissa or not e else '.0'}{e}{exponent}"
