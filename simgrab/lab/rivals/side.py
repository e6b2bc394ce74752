"""Cameras beside the one at the jib head: where they stand, what they took, and the pendulum that filters it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simgrab.errors import PictureError, RecordError
from simgrab.instrument.contract import Frame
from simgrab.instrument.estimate.inertial.readings import STAMP, check_times, numbers, read_description, read_table
from simgrab.io import pictures
from simgrab.lab.rivals.contract import Series, Swing
from simgrab.lab.rivals.kalman import Pendulum, averaged, grid, swing
from simgrab.model.geometry import Array

MOST_GAP_S = 1.0  # between readings


@dataclass(frozen=True, eq=False)
class SideView:
    """A pinhole camera that stands still in the jib frame, and its pictures."""

    name: str
    rotation: Array  # (3, 3), jib frame from camera: x right, y down, z forward
    centre: Array  # (3,), jib frame: origin O, x outboard, z up, m
    focal_px: float
    principal: tuple[float, float]  # pixel of the optical axis; (0, 0) is the outer corner of the top-left pixel
    frames: Iterable[Frame]  # in order, each with its time

    def rays(self, pixels: Array) -> Array:
        """Directions of pixels (n, 2) in the jib frame, shape (n, 3), with depth 1 in the camera's."""
        flat = (np.asarray(pixels, float) - self.principal) / self.focal_px
        return np.asarray(np.column_stack([flat, np.ones(len(flat))]) @ self.rotation.T)


@dataclass(frozen=True, eq=False)
class _Pictures:
    """Pictures of a folder, each read when it is asked for."""

    folder: Path
    names: tuple[str, ...]
    time: tuple[float, ...]

    def __iter__(self) -> Iterator[Frame]:
        for name, time in zip(self.names, self.time, strict=True):
            try:
                yield Frame(pictures.read(self.folder / name), time, name=name)
            except PictureError as problem:
                yield Frame(None, time, str(problem), name)


def read_view(folder: str | Path, origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> SideView:
    """Read a camera's folder, such as a dataset's ``sensors/clip_000/side0``.

    Parameters
    ----------
    folder : str or path
        With ``data.csv``, ``sensor.yaml`` and pictures in ``data/``.
    origin_m : tuple of 3 floats
        Origin of the body frame of ``T_BS`` in the jib frame, m: of a camera on the slewing platform minus the radius
        of the jib head, 0, and minus its height.

    Raises
    ------
    RecordError
        In one line: the file, and what is wrong with it. A picture that cannot be read is a lost frame.
    """
    folder = Path(folder)
    about, where = folder / "sensor.yaml", folder / "data.csv"
    data, pose = read_description(about, "camera")
    if not np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-3) or np.linalg.det(pose[:3, :3]) < 0:
        raise RecordError(f"{about}: T_BS must hold a rotation matrix")
    try:
        fu, fv, cu, cv = (float(number) for number in data["intrinsics"])
        if not np.isfinite((fu, fv, cu, cv)).all() or fu <= 0 or abs(fu - fv) > 1e-6 * fu:
            raise ValueError("no square pixels")
        if any(float(number) for number in data.get("distortion_coefficients", ())):
            raise ValueError("a lens with distortion")
    except (KeyError, TypeError, ValueError, OverflowError):
        raise RecordError(f"{about}: intrinsics must be fu = fv > 0, cu and cv, without distortion") from None
    table = read_table(where)
    if table.column_names != [STAMP, "filename"]:
        raise RecordError(f"{where}: columns must be {STAMP!r} and 'filename', got {table.column_names}")
    names, time = [str(name) for name in table["filename"].to_pylist()], numbers(where, table, STAMP) / 1e9
    for row in np.flatnonzero([Path(name).name != name for name in names])[:1]:
        raise RecordError(f"{where}: row {row + 1}: the name of a picture in data/ is needed, got {names[row]!r:.60}")
    check_times(time, f"{where}: time, row")
    centre = pose[:3, 3] + origin_m
    taken = _Pictures(folder / "data", tuple(names), tuple(time.tolist()))
    return SideView(folder.name, pose[:3, :3], centre, fu, (cu, cv), taken)


@dataclass(frozen=True, eq=False)
class LeanReadings:
    """Linear readings of the leans' tangents (tan α cos φ, tan α sin φ) along x and y of the jib frame."""

    source: str  # what a reason calls it
    time: Array  # (n,), s
    rows: Array  # (n, k, 2)
    values: Array  # (n, k), each is rows @ tangents; NaN where nothing was seen
    sd: float


def filtered(readings: list[LeanReadings], lengths: Series, time: Array) -> Swing:
    """Swing at instants (n,), s, by a Kalman filter of a pendulum whose tangents of lean and length, m, are read."""
    seen = [np.isfinite(one.values).all(axis=1) for one in readings]
    for one, some in zip(readings, seen, strict=True):
        if some.sum() < 2:
            return Swing.none(len(time), f"{one.source} in fewer than two pictures")
    every = np.unique(np.concatenate([one.time for one in readings]))
    steps = grid(Series(every, np.zeros((len(every), 1))))
    rows, values, sd = [], [], []
    for one, some in zip(readings, seen, strict=True):
        k = one.values.shape[1]
        flat = averaged(one.time[some], np.column_stack([one.rows[some].reshape(-1, 2 * k), one.values[some]]), steps)
        rows.append(np.nan_to_num(flat[:, : 2 * k]).reshape(-1, k, 2))
        values.append(flat[:, 2 * k :])
        sd += [one.sd] * k
    pendulum = Pendulum(lengths.at(steps)[:, 0], np.zeros(len(steps)))
    reading = np.concatenate(rows, axis=1)
    reading = np.concatenate([reading, np.zeros_like(reading)], axis=2)
    states = pendulum.filtered(np.concatenate(values, axis=1), reading, np.array(sd))
    found = swing(time, steps, *states, every, MOST_GAP_S)
    for one, some in zip(readings, seen, strict=True):
        found = found.without(_gone(one.time[some], time), f"{one.source} for more than {MOST_GAP_S:g} s")
    return replace(found, alpha=np.arctan(found.alpha))


def _gone(read: Array, at: Array) -> NDArray[np.bool_]:
    """Whether instants (n,) are farther than `MOST_GAP_S` from every reading (m,)."""
    after = np.clip(np.searchsorted(read, at), 1, len(read) - 1)
    near = np.minimum(np.abs(at - read[after - 1]), np.abs(at - read[after]))
    return np.asarray(near > MOST_GAP_S)
