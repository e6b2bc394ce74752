"""Files of the sensors beside the camera, in the layout of the EuRoC data set.

What a sensor reports lies below ``sensors/``, and the truth below ``sensors_truth/``, so that the first folder can be
handed on without the second.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
import pyarrow as pa
from pyarrow import csv

from simgrab.errors import ScenarioError
from simgrab.geometry import Array
from simgrab.scenario import HoistEncoder, Imu, Inclinometer, LuffEncoder, MotionSensor, Scenario, SlewEncoder
from simgrab.world.extensions import Recipe
from simgrab.world.output.tables import Writing

if TYPE_CHECKING:
    from simgrab.world.sensors.device import Rows

STAMP = "#timestamp [ns]"
_BODIES = {
    "jib-head": "jib frame: origin O, x outboard, z up",
    "camera": "camera frame: x right, y down, z forward",
    "rope": "rope frame: origin O, z up along the rope, x as the jib's without swing",
    "grab": "grab frame: origin A, z up along the rope, x across the jaws' closing line",
}


def names(scenario: Scenario) -> Iterator[str]:
    """Name the files that a dataset of the scenario has for sensors."""
    for clip in range(scenario.clip.count(scenario.frames) if scenario.sensors else 0):
        for sensor in scenario.sensors:
            yield from (f"{_folder(clip, sensor)}/{file}" for file in ("data.csv", "sensor.yaml"))
            yield _truth(clip, sensor)


def _folder(clip: int, sensor: str) -> str:
    return f"sensors/clip_{clip:03d}/{sensor}"


def _truth(clip: int, sensor: str) -> str:
    return f"sensors_truth/clip_{clip:03d}/{sensor}/truth.csv"


def check(recipe: Recipe) -> None:
    """Refuse sensors in a world whose motion is not the scenario's own physics."""
    if recipe.scenario.sensors and recipe.extensions.trajectory is not None:
        raise ScenarioError(
            "sensors", "a trajectory of yours gives poses without accelerations: leave out sensors, or the trajectory"
        )


def write(recipe: Recipe, writing: Writing) -> list[str]:
    """Write the files of all clips, one clip after another.

    Parameters
    ----------
    recipe : Recipe
    writing : callable
        See `simgrab.world.output.tables.Writing`.

    Returns
    -------
    list of str
        Names of the files.
    """
    scenario = recipe.scenario
    for clip in range(scenario.clip.count(scenario.frames) if scenario.sensors else 0):
        _write_clip(recipe.variant(scenario.span(clip).start).scenario, clip, writing)
    return list(names(scenario))


def _write_clip(scenario: Scenario, clip: int, writing: Writing) -> None:
    from simgrab.world.sensors.record import devices_of, record  # with SciPy's filters, as for the physics of frames

    devices = devices_of(scenario, clip)
    with ExitStack() as stack:

        def opened(name: str) -> BinaryIO:
            return stack.enter_context(stack.enter_context(writing(name)).open("wb"))

        tables = {}
        for name, device in devices.items():
            about = opened(f"{_folder(clip, name)}/sensor.yaml")
            about.write(yaml(scenario.sensors[name], device.body_from_sensor).encode())
            tables[name] = opened(f"{_folder(clip, name)}/data.csv"), opened(_truth(clip, name))
            for file, columns in zip(tables[name], (device.columns, device.truth_columns), strict=True):
                file.write((",".join([STAMP, *columns]) + "\n").encode())
        for name, rows in record(scenario, clip, devices):
            _append(rows, *tables[name])


def _append(rows: Rows, data: BinaryIO, truth: BinaryIO) -> None:
    """Append rows to the two tables; numbers are written so that the same ones are read back."""
    for file, values in ((data, rows.values), (truth, rows.truth)):
        columns = [pa.array(rows.stamp_ns), *(pa.array(np.ascontiguousarray(column)) for column in values.T)]
        table = pa.table(columns, names=[str(i) for i in range(len(columns))])
        csv.write_csv(table, file, csv.WriteOptions(include_header=False))


def yaml(sensor: MotionSensor, body_from_sensor: Array | None) -> str:
    """Describe a sensor as EuRoC's ``sensor.yaml`` does: by what its maker states, never by what was drawn.

    Parameters
    ----------
    sensor : MotionSensor
    body_from_sensor : ndarray, shape (4, 4), or None
        Nominal pose, T_BS.
    """
    return "\n".join(_lines(sensor, body_from_sensor)) + "\n"


def _lines(sensor: MotionSensor, body_from_sensor: Array | None) -> Iterator[str]:
    kind, _, _ = sensor.__struct_config__.tag.partition("-")  # type: ignore[union-attr]  # all of them have one
    match sensor:
        case Imu() | Inclinometer():
            assert body_from_sensor is not None
            yield f"sensor_type: {kind}"
            yield f"comment: simgrab, on the {sensor.mount}"
            yield ""
            yield f"# Sensor extrinsics wrt. the body frame: {_BODIES[sensor.mount]}."
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
        case SlewEncoder():
            yield f"resolution_deg: {_number(sensor.resolution_deg)}"
        case LuffEncoder() | HoistEncoder():
            yield f"resolution_m: {_number(sensor.resolution_m)}"


def _number(value: float) -> str:
    """Write a number so that YAML 1.1 takes it for one: with a point before the exponent."""
    mantissa, e, exponent = repr(float(value)).partition("e")
    return f"{mantissa}{'' if '.' in mantissa or not e else '.0'}{e}{exponent}"
