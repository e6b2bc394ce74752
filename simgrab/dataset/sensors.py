"""Files of the sensors beside the camera, in the layout of the EuRoC data set.

What a sensor reports lies below ``sensors/``, and the truth below ``sensors_truth/``, so that the first folder can be
handed on without the second.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from typing import BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from pyarrow import csv

from simgrab.dataset.tables import Writing
from simgrab.errors import ScenarioError
from simgrab.model.geometry import Array
from simgrab.model.scenario import (
    HoistEncoder,
    Imu,
    Inclinometer,
    Lidar,
    LuffEncoder,
    MotionSensor,
    Scenario,
    SideCamera,
    SlewEncoder,
    Variant,
)
from simgrab.world.extensions import Recipe

STAMP = "#timestamp [ns]"
CAMERA_BYTES, LIDAR_BYTES = 650_000_000, 400_000_000
"""What a camera of 1280x960 px and a LiDAR, each with a world of its own, add to a process; 610 and 354 MB measured."""
Append = Callable[[NDArray[np.int64], Array], None]
"""Appends rows to a table: their time stamps, ns, and values (n, columns)."""
_BODIES = {
    "jib-head": "jib frame: origin O, x outboard, z up",
    "camera": "camera frame: x right, y down, z forward",
    "platform": "platform frame: origin on the slewing axis at the height of the quay, x outboard, z up",
    "rope": "rope frame: origin O, z up along the rope, x as the jib's without swing",
    "grab": "grab frame: origin A, z up along the rope, x across the jaws' closing line",
}


def names(scenario: Scenario) -> Iterator[str]:
    """Name the files that a dataset of the scenario has for sensors."""
    for clip in range(scenario.clip.count(scenario.frames) if scenario.sensors else 0):
        for name, sensor in scenario.sensors.items():
            data, truth = _tables(clip, name, sensor)
            yield from (data, f"{_folder(clip, name)}/sensor.yaml", truth)
            if isinstance(sensor, SideCamera):
                seconds = len(scenario.span(clip)) / scenario.clip.frame_rate_hz
                yield from (f"{_folder(clip, name)}/data/{_picture(k)}" for k in range(sensor.count(seconds)))


def _picture(number: int) -> str:
    return f"{number:06d}.jpg"


def _folder(clip: int, sensor: str) -> str:
    return f"sensors/clip_{clip:03d}/{sensor}"


def _tables(clip: int, name: str, sensor: MotionSensor) -> tuple[str, str]:
    """Name the two tables of a sensor: what it reports, and the truth."""
    kind = "parquet" if isinstance(sensor, Lidar) else "csv"
    return f"{_folder(clip, name)}/data.{kind}", f"sensors_truth/clip_{clip:03d}/{name}/truth.{kind}"


def check(recipe: Recipe) -> None:
    """Refuse sensors in a world whose motion is not the scenario's own physics."""
    if recipe.scenario.sensors and recipe.extensions.trajectory is not None:
        raise ScenarioError(
            "sensors", "a trajectory of yours gives poses without accelerations: leave out sensors, or the trajectory"
        )


def memory_bytes(scenario: Scenario) -> int:
    """Estimate the memory that `write` takes beside that of a process that renders the frames."""
    bytes_of = {SideCamera: CAMERA_BYTES, Lidar: LIDAR_BYTES}
    return sum(bytes_of.get(type(sensor), 0) for sensor in scenario.sensors.values())


def write(recipe: Recipe, writing: Writing, recorded: Callable[[], None] = lambda: None) -> list[str]:
    """Write the files of all clips, one clip after another.

    Parameters
    ----------
    recipe : Recipe
    writing : callable
        See `simgrab.dataset.tables.Writing`.
    recorded : callable, optional
        Called whenever some seconds of a sensor are recorded.

    Returns
    -------
    list of str
        Names of the files.
    """
    scenario = recipe.scenario
    for clip in range(scenario.clip.count(scenario.frames) if scenario.sensors else 0):
        _write_clip(recipe.variant(scenario.span(clip).start), clip, writing, recorded)
    return list(names(scenario))


def _write_clip(variant: Variant, clip: int, writing: Writing, recorded: Callable[[], None]) -> None:
    from simgrab.world.sensors.record import devices_of, record  # with SciPy's filters, as for the physics of frames

    devices, scenario = devices_of(variant, clip, renders=True), variant.scenario
    with ExitStack() as stack:

        def opened(name: str) -> BinaryIO:
            return stack.enter_context(stack.enter_context(writing(name)).open("wb"))

        tables: dict[str, list[Append]] = {}
        for name, device in devices.items():
            stack.callback(device.close)
            sensor = scenario.sensors[name]
            about = opened(f"{_folder(clip, name)}/sensor.yaml")
            about.write(yaml(sensor, device.body_from_sensor).encode())
            kind = _parquet if isinstance(sensor, Lidar) else _csv
            data, truth = _tables(clip, name, sensor)
            first = _listing if isinstance(sensor, SideCamera) else kind
            tables[name] = [
                first(stack, opened(data), device.columns),
                kind(stack, opened(truth), device.truth_columns),
            ]
        for name, rows in record(scenario, clip, devices):
            for append, values in zip(tables[name], (rows.values, rows.truth), strict=True):
                append(rows.stamp_ns, values)
            for number, picture in zip(rows.values[:, 0].tolist(), rows.pictures, strict=False):
                with writing(f"{_folder(clip, name)}/data/{_picture(int(number))}") as path:
                    path.write_bytes(picture)
            recorded()


def _listing(_stack: ExitStack, file: BinaryIO, _columns: Sequence[str]) -> Append:
    """Begin a table of pictures, by their file's name."""
    file.write(f"{STAMP},filename\n".encode())

    def append(stamp_ns: NDArray[np.int64], values: Array) -> None:
        rows = zip(stamp_ns.tolist(), values[:, 0].tolist(), strict=True)
        file.write("".join(f"{stamp},{_picture(int(number))}\n" for stamp, number in rows).encode())

    return append


def _csv(_stack: ExitStack, file: BinaryIO, columns: Sequence[str]) -> Append:
    """Begin a table of text; numbers are written so that the same ones are read back."""
    file.write((",".join([STAMP, *columns]) + "\n").encode())

    def append(stamp_ns: NDArray[np.int64], values: Array) -> None:
        arrays = [pa.array(stamp_ns), *(pa.array(np.ascontiguousarray(column)) for column in values.T)]
        table = pa.table(arrays, names=[str(i) for i in range(len(arrays))])
        csv.write_csv(table, file, csv.WriteOptions(include_header=False))

    return append


def _parquet(stack: ExitStack, file: BinaryIO, columns: Sequence[str]) -> Append:
    """Begin a table of points: times as they are, whole numbers as bytes, and the rest in single precision."""
    kinds = {"time [s]": pa.float64(), "ring": pa.uint8(), "id": pa.uint8()}
    stamp = pa.field(STAMP.removeprefix("#"), pa.int64())
    schema = pa.schema([stamp, *(pa.field(name, kinds.get(name, pa.float32())) for name in columns)])
    writer = stack.enter_context(pq.ParquetWriter(file, schema))

    def append(stamp_ns: NDArray[np.int64], values: Array) -> None:
        arrays = [pa.array(column).cast(kind.type) for column, kind in zip(values.T, list(schema)[1:], strict=True)]
        writer.write_table(pa.table([pa.array(stamp_ns), *arrays], schema=schema))

    return append


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
