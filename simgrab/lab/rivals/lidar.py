"""A rival that measures with a LiDAR on the slewing platform, after the patent CN115784015B."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from simgrab.errors import RecordError, first_line
from simgrab.instrument.estimate.frames import interpolated
from simgrab.instrument.estimate.inertial.readings import check_times, numbers
from simgrab.lab.rivals.contract import Series, Swing
from simgrab.lab.rivals.kalman import Pendulum, averaged, grid, swing
from simgrab.model.geometry import Array

COLUMNS = ("timestamp [ns]", "x [m]", "y [m]", "z [m]")
NEAR_M, FEWEST = 1.1, 14  # DBSCAN: ropes have fewer points so near each other, the grab has more
JIB_NEAR_M, JIB_FEWEST = 1.5, 4
WITHIN_M = 7.0  # of the hanging grab, horizontally
CLEAR_M = 2.0  # above the ground, and below the jib, where the grab is sought
GRAB_POINTS, JIB_POINTS = 25, 10  # fewest
MOST_GAP_S = 1.0  # between scans
LEAN_SD = np.radians(0.4)  # of the line between two clusters


@dataclass(frozen=True, eq=False)
class Scans:
    """Scans of a LiDAR, each at one instant.

    Attributes
    ----------
    time : ndarray, shape (n,)
        s, increasing.
    points : tuple of n ndarray, shape (k, 3)
        Echoes in the platform frame: origin on the slewing axis at quay level, x outboard, z up, m.
    """

    time: Array
    points: tuple[Array, ...]

    def __post_init__(self) -> None:
        if self.time.shape != (len(self.points),) or not len(self.points):
            raise RecordError(f"times (n,) and n scans are needed, got {self.time.shape} and {len(self.points)}")
        check_times(self.time, "time of scan")
        for row, points in enumerate(self.points):
            if points.ndim != 2 or points.shape[1] != 3:
                raise RecordError(f"scan {row + 1}: points must have shape (k, 3), got {points.shape}")

    @classmethod
    def of(cls, stamp_ns: NDArray[np.int64], points: Array, platform_from_sensor: Array) -> Scans:
        """Split echoes (k, 3) of the sensor's frame by their time stamps (k,), which do not decrease.

        Echoes that are not finite are left out.
        """
        points = points @ platform_from_sensor[:3, :3].T + platform_from_sensor[:3, 3]
        stamps, first = np.unique(stamp_ns, return_index=True)
        if len(stamp_ns) and (np.diff(stamp_ns) < 0).any():
            row = int(np.argmax(np.diff(stamp_ns) < 0)) + 2
            raise RecordError(f"timestamp, row {row}: must not decrease")
        parts = np.split(points, first[1:]) if len(stamps) else []
        return cls(stamps / 1e9, tuple(part[np.isfinite(part).all(axis=1)] for part in parts))


def read_scans(folder: str | Path, platform_from_sensor: Array) -> Scans:
    """Read ``data.parquet`` of a folder such as a dataset's ``sensors/clip_000/lidar0``.

    Raises `RecordError` with one line: the file, and what is wrong with it.
    """
    where = Path(folder) / "data.parquet"
    try:
        table = pq.read_table(where, columns=list(COLUMNS))
        points = np.stack([table[name].cast(pa.float64()).to_numpy() for name in COLUMNS[1:]], axis=-1)
    except (OSError, KeyError, pa.ArrowException) as problem:
        raise RecordError(f"{where}: it cannot be read as scans ({first_line(problem)})") from None
    stamps = numbers(where, table, COLUMNS[0]).astype(np.int64)
    try:
        return Scans.of(stamps, points, platform_from_sensor)
    except RecordError as problem:
        raise RecordError(f"{where}: {problem}") from None


def clusters(points: Array, near_m: float, fewest: int) -> list[NDArray[np.int64]]:
    """DBSCAN: rows of each cluster, the largest first.

    Points with at least so many within reach, themselves included, are a cluster's core; others within reach of a core
    join it; the rest is left out.
    """
    if len(points) < fewest:
        return []
    pairs = cKDTree(points).query_pairs(near_m, output_type="ndarray")
    count = np.bincount(pairs.ravel(), minlength=len(points)) + 1
    core = count >= fewest
    both = pairs[core[pairs].all(axis=1)]
    links = csr_array((np.ones(len(both)), (both[:, 0], both[:, 1])), shape=(len(points),) * 2)
    label = connected_components(links, directed=False)[1]
    label[~core] = -1
    for a, b in ((0, 1), (1, 0)):
        join = core[pairs[:, a]] & ~core[pairs[:, b]]
        label[pairs[join, b]] = label[pairs[join, a]]
    rows = [np.flatnonzero(label == one) for one in np.unique(label[label >= 0])]
    return sorted(rows, key=len, reverse=True)


def ends(points: Array, jib_m: float, hanging: Array | None = None) -> tuple[Array, Array] | str:
    """Find jib end P and grab Q of one scan, or why not.

    Parameters
    ----------
    points : ndarray, shape (k, 3)
    jib_m : float
        Height of the jib's end, m.
    hanging : ndarray, shape (2,), optional
        Where the grab hangs at rest.
    """
    above = points[points[:, 2] > jib_m - CLEAR_M]
    jib = clusters(above, JIB_NEAR_M, JIB_FEWEST)
    if not jib or len(jib[0]) < JIB_POINTS:
        return "no cluster of the jib's end"
    end = above[jib[0]].mean(axis=0)
    around = hanging if hanging is not None else np.array([above[jib[0], 0].max(), 0.0])
    low = points[(points[:, 2] > CLEAR_M) & (points[:, 2] < jib_m - 2 * CLEAR_M)]
    low = low[np.linalg.norm(low[:, :2] - around, axis=1) < WITHIN_M]
    for rows in clusters(low, NEAR_M, FEWEST):
        if len(rows) >= GRAB_POINTS:
            return end, low[rows].mean(axis=0)
    return "no cluster of the grab"


def lidar(scans: Scans, rest: Scans, time: Array, jib_m: float) -> Swing:
    """Angle of the line from the jib's end to the grab, from clusters of a LiDAR's echoes, filtered by a pendulum.

    After CN115784015B. Known: the LiDAR on the slewing platform, clusters of the jib's end P and of the grab Q, and an
    accuracy of 10 mm that is claimed. Filled in: DBSCAN within a cylinder below the jib, the clusters' means, scans of
    the hanging grab that give the line from P to Q at rest, and the Kalman filter [θ, θ̇] along x and y.

    Parameters
    ----------
    scans, rest : Scans
        Of the clip, and of the grab at rest on a rope of about the same length.
    time : ndarray, shape (n,)
        s.
    jib_m : float
        Height of the jib's end, m.
    """
    still = [one for points in rest.points if not isinstance(one := ends(points, jib_m), str)]
    if not still:
        return Swing.none(len(time), "at rest there is no cluster of the jib's end or of the grab")
    straight = np.mean([grab - jib for jib, grab in still], axis=0)
    hanging = np.mean([grab for _, grab in still], axis=0)[:2]
    each = [ends(points, jib_m, hanging) for points in scans.points]
    found = [(t, *one) for t, one in zip(scans.time, each, strict=True) if not isinstance(one, str)]
    if len(found) < 2:
        why = [one for one in each if isinstance(one, str)] or ["one scan is no record"]
        return Swing.none(len(time), why[0])
    at, jib, grab = (np.array(values) for values in zip(*found, strict=True))
    depth = jib_m - grab[:, 2]
    lean = Series(at, np.arctan2((grab - jib - straight)[:, :2], depth[:, None]))
    steps = grid(lean)
    length = interpolated(steps, at, depth[:, None]).mean() * np.ones(len(steps))
    pendulum = Pendulum(length, np.zeros(len(steps)))
    states = pendulum.filtered(averaged(at, lean.values, steps), np.eye(2, 4), np.full(2, LEAN_SD))
    return swing(time, steps, *states, at, MOST_GAP_S)
