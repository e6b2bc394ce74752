"""Record the sensors beside the camera into files, in the layout of the EuRoC data set."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from pyarrow import csv

from simgrab.dataset import sensor_files
from simgrab.dataset.sensor_files import STAMP, description_of, folder_of, picture_of, tables_of
from simgrab.dataset.tables import Writing
from simgrab.errors import ScenarioError
from simgrab.model.geometry import Array
from simgrab.model.scenario import Lidar, Scenario, SideCamera
from simgrab.world.extensions import Recipe
from simgrab.world.scenery.grabs import design_of

CAMERA_BYTES, LIDAR_BYTES = 650_000_000, 400_000_000
"""What a camera of 1280x960 px and a LiDAR, each with a world of its own, add to a process; 610 and 354 MB measured."""
Append = Callable[[NDArray[np.int64], Array], None]
"""Appends rows to a table: their time stamps, ns, and values (n, columns)."""


def check(recipe: Recipe) -> None:
    """Refuse sensors in a world whose motion is not the scenario's own physics."""
    if recipe.scenario.sensors and recipe.extensions.trajectory is not None:
        raise ScenarioError(
            "sensors", "a trajectory of yours gives poses without accelerations: leave out sensors, or the trajectory"
        )


def memory_bytes(scenario: Scenario) -> int:
    """Estimate the memory of `write`, in addition to the memory of a process that renders the frames."""
    bytes_of = {SideCamera: CAMERA_BYTES, Lidar: LIDAR_BYTES}
    return sum(bytes_of.get(type(sensor), 0) for sensor in scenario.sensors.values())


def write(recipe: Recipe, writing: Writing, recorded: Callable[[], None] = lambda: None) -> list[str]:
    """Write the files of all clips, one clip after another, and return their names.

    ``recorded`` is called whenever some seconds of a sensor are recorded.
    """
    scenario = recipe.scenario
    for clip in range(scenario.clip_count if scenario.sensors else 0):
        _write_clip(recipe, clip, writing, recorded)
    return list(sensor_files.names(scenario))


def _write_clip(recipe: Recipe, clip: int, writing: Writing, recorded: Callable[[], None]) -> None:
    from simgrab.world.sensors.record import devices_of, record  # with SciPy's filters, as for the physics of frames

    variant = recipe.variant(recipe.scenario.span(clip).start)
    devices, scenario = devices_of(variant, clip, recipe.split, renders=True), variant.scenario
    grab_kg = design_of(scenario.grab).mass_of(0.0, 0.0).mass
    with ExitStack() as stack:

        def opened(name: str) -> BinaryIO:
            return stack.enter_context(stack.enter_context(writing(name)).open("wb"))

        tables: dict[str, list[Append]] = {}
        for name, device in devices.items():
            stack.callback(device.close)
            sensor = scenario.sensors[name]
            about = opened(description_of(clip, name, sensor))
            about.write(sensor_files.describe(sensor, device.body_from_sensor, grab_kg).encode())
            kind = _parquet if isinstance(sensor, Lidar) else _csv
            data, truth = tables_of(clip, name, sensor)
            first = _listing if isinstance(sensor, SideCamera) else kind
            tables[name] = [
                first(stack, opened(data), device.columns),
                kind(stack, opened(truth), device.truth_columns),
            ]
        for name, rows in record(scenario, clip, devices):
            for append, values in zip(tables[name], (rows.values, rows.truth), strict=True):
                append(rows.stamp_ns, values)
            for number, picture in zip(rows.values[:, 0].tolist(), rows.pictures, strict=False):
                with writing(f"{folder_of(clip, name)}/data/{picture_of(int(number))}") as path:
                    path.write_bytes(picture)
            recorded()


def _listing(_stack: ExitStack, file: BinaryIO, _columns: Sequence[str]) -> Append:
    """Begin a table of pictures, by their file's name."""
    file.write(f"{STAMP},filename\n".encode())

    def append(stamp_ns: NDArray[np.int64], values: Array) -> None:
        rows = zip(stamp_ns.tolist(), values[:, 0].tolist(), strict=True)
        file.write("".join(f"{stamp},{picture_of(int(number))}\n" for stamp, number in rows).encode())

    return append


def _csv(_stack: ExitStack, file: BinaryIO, columns: Sequence[str]) -> Append:
    """Begin a table of text; numbers are written so that reading returns the same values."""
    file.write((",".join([STAMP, *columns]) + "\n").encode())

    def append(stamp_ns: NDArray[np.int64], values: Array) -> None:
        arrays = [pa.array(stamp_ns), *(pa.array(np.ascontiguousarray(column)) for column in values.T)]
        table = pa.table(arrays, names=[str(i) for i in range(len(arrays))])
        csv.write_csv(table, file, csv.WriteOptions(include_header=False))

    return append


def _parquet(stack: ExitStack, file: BinaryIO, columns: Sequence[str]) -> Append:
    """Begin a table of points: times unchanged, whole numbers as bytes, other values in single precision."""
    kinds = {"time [s]": pa.float64(), "ring": pa.uint8(), "id": pa.uint8()}
    stamp = pa.field(STAMP.removeprefix("#"), pa.int64())
    schema = pa.schema([stamp, *(pa.field(name, kinds.get(name, pa.float32())) for name in columns)])
    writer = stack.enter_context(pq.ParquetWriter(file, schema))

    def append(stamp_ns: NDArray[np.int64], values: Array) -> None:
        arrays = [pa.array(column).cast(kind.type) for column, kind in zip(values.T, list(schema)[1:], strict=True)]
        writer.write_table(pa.table([pa.array(stamp_ns), *arrays], schema=schema))

    return append
