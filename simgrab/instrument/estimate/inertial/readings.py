"""Read an inertial sensor's files in the layout of the EuRoC data set into checked arrays."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv

from simgrab.errors import RecordError, first_line
from simgrab.io.parse import opened, read_yaml
from simgrab.model.geometry import STANDARD_GRAVITY, Array

STAMP = "#timestamp [ns]"
RATE = tuple(f"w_RS_S_{axis} [rad s^-1]" for axis in "xyz")
FORCE = tuple(f"a_RS_S_{axis} [m s^-2]" for axis in "xyz")
MOST_CSV_BYTES = 2**30
MOST_YAML_BYTES = 2**16
LEAST_ROWS = 2
MOST_RATE, MOST_FORCE = 100.0, 1000.0
"""Beyond these, rad/s and m/s², no sensor on a crane reads."""
# Of the densities that a file does not state: those of a cheap sensor.
_DENSITIES = {
    "gyroscope_noise_density": 1e-4,
    "gyroscope_random_walk": 1e-5,
    "accelerometer_noise_density": 4e-3,
    "accelerometer_random_walk": 1e-3,
}


@dataclass(frozen=True, eq=False)
class ImuReadings:
    """Readings of an inertial measurement unit in the camera's housing.

    Attributes
    ----------
    time : ndarray, shape (n,)
        s, increasing, by the clock of the frames; a difference of some milliseconds does no harm.
    rate : ndarray, shape (n, 3)
        Angular rate over the ground, sensor frame, rad/s.
    force : ndarray, shape (n, 3)
        Specific force, acceleration less gravity, sensor frame, m/s².
    camera_from_sensor : ndarray, shape (3, 3)
        Nominal rotation from the sensor frame to the camera frame (x right, y down, z forward).
    gyroscope_noise_density, accelerometer_noise_density : float
        rad/s/√Hz and m/s²/√Hz, as the maker states them.
    gyroscope_random_walk, accelerometer_random_walk : float
        rad/s²/√Hz and m/s³/√Hz.

    Raises
    ------
    RecordError
        For wrong shapes, values that are not finite or too large for a sensor on a crane, and times that do not
        increase. The message names column and row (the first is 1).
    """

    time: Array
    rate: Array
    force: Array
    camera_from_sensor: Array
    gyroscope_noise_density: float = _DENSITIES["gyroscope_noise_density"]
    gyroscope_random_walk: float = _DENSITIES["gyroscope_random_walk"]
    accelerometer_noise_density: float = _DENSITIES["accelerometer_noise_density"]
    accelerometer_random_walk: float = _DENSITIES["accelerometer_random_walk"]

    def __post_init__(self) -> None:
        n = len(self.time)
        if self.time.shape != (n,) or self.rate.shape != (n, 3) or self.force.shape != (n, 3):
            shapes = f"{self.time.shape}, {self.rate.shape} and {self.force.shape}"
            raise RecordError(f"time, rate and force must have shapes (n,), (n, 3) and (n, 3), got {shapes}")
        if n < LEAST_ROWS:
            raise RecordError(f"{n} rows; at least {LEAST_ROWS} are needed")
        check_times(self.time)
        for name, values, most in (("rate", self.rate, MOST_RATE), ("force", self.force, MOST_FORCE)):
            for row, axis in np.argwhere(~(np.abs(values) <= most))[:1]:
                raise RecordError(f"{name}, row {row + 1}: must be within {most:g}, got {values[row, axis]:g}")
        turn = self.camera_from_sensor
        if turn.shape != (3, 3) or not np.allclose(turn @ turn.T, np.eye(3), atol=1e-3) or np.linalg.det(turn) < 0:
            raise RecordError("camera_from_sensor must be a rotation matrix (3, 3)")
        for name in _DENSITIES:
            if not 0 <= getattr(self, name) < math.inf:
                raise RecordError(f"{name} must be 0 or more, got {getattr(self, name):g}")

    def between(self, first: float, last: float) -> ImuReadings:
        """Keep readings from one time to another, s, and one more on either side."""
        begin = max(int(np.searchsorted(self.time, first)) - 1, 0)
        end = max(int(np.searchsorted(self.time, last)) + 1, begin + LEAST_ROWS)
        kept = copy.copy(self)  # what was checked is not checked again
        for name in ("time", "rate", "force"):
            object.__setattr__(kept, name, getattr(self, name)[begin:end])
        return kept

    @property
    def excess(self) -> float:
        """Excess of the mean specific force over g, m/s². A jib head moves level, so this is bias."""
        return float(np.linalg.norm(self.force, axis=-1).mean()) - STANDARD_GRAVITY

    def without_excess(self, excess: float) -> ImuReadings:
        """Subtract an `excess`, m/s², from the accelerometer's readings along the optical axis."""
        return replace(self, force=self.force + excess * self.camera_from_sensor[2])


def read_imu(folder: str | Path) -> ImuReadings:
    """Read ``data.csv`` and ``sensor.yaml`` of a folder such as a dataset's ``sensors/clip_000/imu0``.

    The body frame of ``T_BS`` must be the camera frame. Noise densities that the file does not state are taken to be
    those of a cheap sensor.

    Raises `RecordError` with one line that names the file and the row (the first is 1), column or key.
    """
    about, where = Path(folder) / "sensor.yaml", Path(folder) / "data.csv"
    data, pose = read_description(about, "imu")
    try:
        densities = {name: float(data.get(name, default)) for name, default in _DENSITIES.items()}
    except (TypeError, ValueError, OverflowError):
        raise RecordError(f"{about}: the noise densities must be numbers") from None
    stamp, *values = read_columns(where, STAMP, *RATE, *FORCE)
    rate, force = np.stack(values[:3], axis=-1), np.stack(values[3:], axis=-1)
    try:
        return ImuReadings(stamp / 1e9, rate, force, pose[:3, :3], **densities)
    except RecordError as problem:
        raise RecordError(f"{where}: {problem}") from None


def check_times(time: Array, what: str = "time, row") -> None:
    """Check that times (n,), s, are finite and increase; raises `RecordError` naming the first row that does not."""
    for row in np.flatnonzero(~np.isfinite(time))[:1]:
        raise RecordError(f"{what} {row + 1}: must be a finite number, got {time[row]:g}")
    for row in np.flatnonzero(np.diff(time) <= 0)[:1] + 1:
        raise RecordError(f"{what} {row + 1}: must increase, got {time[row]:.6f} s after {time[row - 1]:.6f} s")


def read_columns(path: Path, *names: str) -> list[Array]:
    """Read columns of numbers; raises `RecordError` for a missing column, or a row without a number."""
    table = read_table(path)
    for name in names:
        if table.column_names.count(name) != 1:
            found = "twice" if name in table.column_names else "missing"
            raise RecordError(f"{path}: column {name!r} is {found}; there are: {', '.join(table.column_names)}")
    return [numbers(path, table, name) for name in names]


def read_table(path: Path) -> pa.Table:
    """Read the CSV file of a sensor; raises `RecordError` in one line."""
    with opened(path, RecordError, "readings", most_bytes=MOST_CSV_BYTES) as file:
        text = file.read()
    try:
        return pa.csv.read_csv(pa.BufferReader(text))
    except (UnicodeDecodeError, pa.ArrowInvalid) as problem:
        raise RecordError(f"{path}: it is not valid CSV ({first_line(problem)})") from None


def numbers(path: Path, table: pa.Table, name: str) -> Array:
    """Return a column as numbers; raises `RecordError` with the row of a value that is not finite."""
    column = table[name]
    if not (pa.types.is_floating(column.type) or pa.types.is_integer(column.type)):
        raise RecordError(f"{path}: column {name!r} holds something that is not a number")
    values = column.to_numpy().astype(float)
    for row in np.flatnonzero(~np.isfinite(values))[:1]:
        raise RecordError(f"{path}: {name!r}, row {row + 1}: a finite number is needed")
    return np.asarray(values)


def read_description(path: Path, kind: str) -> tuple[dict[str, Any], Array]:
    """Read a ``sensor.yaml`` of a kind of sensor, such as ``"imu"``; returns it, and its pose T_BS (4, 4).

    Raises `RecordError` with one line that names the file and the problem.
    """
    data = read_yaml(path, RecordError, "sensor description", most_bytes=MOST_YAML_BYTES)
    if not isinstance(data, dict) or not isinstance(data.get("T_BS"), dict):
        raise RecordError(f"{path}: T_BS is missing: the sensor's pose in the frame of its body")
    if data.get("sensor_type", kind) != kind:
        article = "an" if kind[0] in "aeiou" else "a"
        raise RecordError(f"{path}: sensor_type: {article} {kind} is needed, got {data['sensor_type']!r:.40}")
    try:
        entries = data["T_BS"]["data"]
        if not all(isinstance(number, int | float) for number in entries):  # lists within may name each other
            raise TypeError("not a list of numbers")
        pose = np.array(entries, float).reshape(4, 4)
    except (KeyError, TypeError, ValueError, OverflowError):
        raise RecordError(f"{path}: T_BS must hold 16 numbers") from None
    if not np.isfinite(pose).all():
        raise RecordError(f"{path}: T_BS must hold finite numbers")
    return data, pose
