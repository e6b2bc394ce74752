"""One replication again: its picture, and the result of every estimator."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from simgrab.errors import StressError
from simgrab.instrument.estimate.frames import gravity, mount_from_camera
from simgrab.io.destination import check_file, writing
from simgrab.io.files import drafted, write
from simgrab.io.parse import shown
from simgrab.lab.stress import estimators
from simgrab.lab.stress.axes import Value
from simgrab.lab.stress.catalogue import depth_of
from simgrab.lab.stress.figures import COLOURS
from simgrab.lab.stress.laboratory import scored
from simgrab.lab.stress.records import Picture, Records
from simgrab.lab.stress.study import Study, place
from simgrab.model.geometry import camera_rotation
from simgrab.model.records.estimates import Estimates
from simgrab.reports.plots import Figure


@dataclass(frozen=True)
class Replay:
    """One replication at one point of a study, and records of it alone.

    By estimator, ``estimates`` has one record each, and ``rows`` the row of ``trials.parquet``. ``sheet``, shape
    (height, width, 3), BGR, shows the frames in which the grab is found worst, where there are pictures.
    """

    study: Study
    point: tuple[Value, ...]
    trial: int
    records: Records
    estimates: dict[str, Estimates]
    rows: dict[str, dict[str, Any]]
    sheet: Picture | None

    def as_json(self) -> dict[str, Any]:
        """Plain data; what is not there is null."""
        return {
            "study": self.study.name,
            "at": {s.axis: v for s, v in zip(self.study.axes, self.point, strict=True)},
            "trial": self.trial,
            "estimators": {name: {**row, "diagnostics": self._diagnostics(name)} for name, row in self.rows.items()},
        }

    def as_text(self) -> str:
        """Lines for a person."""
        lines = [f"{self.study.name}, {place(self.study, self.point)}, replication {self.trial}"]
        for name, row in self.rows.items():
            lines.append(f"{name}: {row['status']}" + (f", {row['reason']}" if row["reason"] else ""))
            numbers = {k: v for k, v in row.items() if isinstance(v, float)} | self._diagnostics(name)
            lines += [f"  {k:20s} {_short(v)}" for k, v in numbers.items()]
        return "\n".join(lines)

    def _diagnostics(self, name: str) -> dict[str, Any]:
        return {k: _plain(v[0]) for k, v in self.estimates[name].diagnostics.items()}


def parse_trial(study: Study, text: str) -> int:
    """Read the number of a replication."""
    if not re.fullmatch(r"[0-9]{1,18}", text) or int(text) >= study.replications:
        raise StressError(f"--replay: TRIAL must be 0 to {study.replications - 1} in {study.name}, got {shown(text)}")
    return int(text)


def parse_point(study: Study, at: Sequence[str]) -> tuple[Value, ...]:
    """Read a point from one text for each axis; none is the last point."""
    if not at:
        return study.points[-1]
    for point in study.points:
        if len(at) == len(point) and all(_same(a, v) for a, v in zip(at, point, strict=True)):
            return point
    points = "; ".join(" ".join(f"--at {value}" for value in point) for point in study.points)
    given = " ".join(f"--at {value}" for value in at)
    raise StressError(f"{given}: not a combination of axis values of {study.name}; one of: {points}")


def _same(text: str, value: Value) -> bool:
    try:
        return text == value or float(text) == value
    except ValueError:
        return False


def replay(study: Study, trial: int, point: tuple[Value, ...]) -> Replay:
    """Make one replication again; its numbers are those of the whole run."""
    depth = depth_of(study.depth)
    records, sheet = depth.show(depth.prepare(study, point), study.seed, trial)
    names = [name for name in study.estimators if trial < study.trials_of(name)]
    estimates = {name: estimators.run(name, records) for name in names}
    rows = {name: {k: _plain(v[0]) for k, v in scored(study, name, records).items()} for name in names}
    return Replay(study, point, trial, records, estimates, rows, sheet)


def pictures(again: Replay, out: str | Path) -> list[Path]:
    """Draw the replication and write it as PNG into a folder, and beside it its worst frames, where there are any."""
    path = Path(out) / f"replay-{again.study.name}-{again.trial}.png"
    paths = [path]
    check_file(path, StressError)
    with writing(path, StressError):
        with drafted(path) as draft:
            draw(again).savefig(draft, format="png", dpi=110)
        if again.sheet is not None:
            paths.append(path.with_stem(f"{path.stem}-frames"))
            write(paths[-1], cv2.imencode(".png", again.sheet)[1].tobytes())
    return paths


def draw(again: Replay) -> Figure:
    """Draw detected grab centre and where each estimator takes the vertical to be; and α̂ over the frames."""
    records = again.records
    k = records.calibration.intrinsics
    figure = Figure(figsize=(12, 5), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot(*records.pixels[0].T, ".", ms=2, color="#b9bfc4", label="grab")
    left.plot(k.cx_px, k.cy_px, "+", ms=12, color="#1c2126", label="C′, as stated")
    rotation = camera_rotation(records.beta, records.azimuth, np.deg2rad(records.calibration.roll_deg))
    left.plot(*k.project(rotation.T @ (0.0, 0.0, -1.0)), "x", ms=12, mew=2, color="#1c2126", label="G′, true")
    right.plot(np.rad2deg(records.alpha[0]), color="#1c2126", lw=0.8, label="true")
    for (name, found), colour in zip(again.estimates.items(), COLOURS, strict=False):
        if not found.ok[0]:
            continue
        down = gravity(found.beta[0], found.tilt_azimuth[0]) @ mount_from_camera(records.calibration)
        left.plot(*k.project(down), "o", ms=7, mfc="none", mew=1.6, color=colour, label=f"G′, {name}")
        right.plot(np.rad2deg(found.alpha[0]), color=colour, lw=0.7, alpha=0.7, label=name)
    left.set(title="detected grab centre", xlabel="u (px)", ylabel="v (px)", aspect="equal")
    left.invert_yaxis()
    right.set(title="swing", xlabel="frame", ylabel="α (deg)")
    for axes in (left, right):
        axes.grid(lw=0.4, alpha=0.6)
        axes.legend(fontsize=7.5)
    return figure


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray) and value.ndim:
        return [_plain(v) for v in value if np.isfinite(v)]
    plain = value.item() if isinstance(value, np.generic | np.ndarray) else value
    return None if isinstance(plain, float) and not np.isfinite(plain) else plain


def _short(value: Any) -> str:
    if isinstance(value, list):
        return " ".join(_short(v) for v in value)
    return f"{value:.6g}" if isinstance(value, float) else str(value)
