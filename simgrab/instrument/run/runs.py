"""Results of a run, as a value and as a folder."""

from __future__ import annotations

import itertools
import json
import math
import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.csv

from simgrab.errors import RunError, first_line
from simgrab.instrument.alarm import Event
from simgrab.instrument.contract import Measurement, flaw
from simgrab.instrument.estimate.follow import Known
from simgrab.io import parquet
from simgrab.io.files import drafted_folder
from simgrab.io.parse import cannot, read_json
from simgrab.model import calibration as camera_file
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array
from simgrab.text import cell, encodable, printable

TABLE, SHEET, ALARMS, ABOUT, CAMERA = "angles.parquet", "angles.csv", "alarms.json", "run.json", "camera.toml"
_ANGLES = ("alpha", "alpha_low", "alpha_high")
_PEAK = ("peak", "peak_low", "peak_high")
_PARTS = {
    "box": ("box_x0_px", "box_y0_px", "box_x1_px", "box_y1_px"),
    "centre": ("u_px", "v_px"),
    "centre_sd": ("u_sd_px", "v_sd_px"),
}
TEXT = ("status", "reason", "rope_text", "rope_status")
_AT_ONCE = 1024  # rows of plain values, which take more memory than the table


class _Estimated(msgspec.Struct, frozen=True):
    estimator: str


class _Counts(msgspec.Struct, frozen=True):
    ok: int
    missed: int
    unread: int
    lost: int
    refused: int


class Facts(msgspec.Struct, frozen=True):
    """The part of ``run.json`` that `load` reads."""

    instrument: str
    source: str
    timed: bool
    counts: _Counts
    estimate: _Estimated | None
    tilt: Known | None


@dataclass(frozen=True, eq=False)
class Run:
    """Result of an instrument for a source.

    Attributes
    ----------
    instrument, source : str
    calibration : Calibration
        The camera as the instrument knew it.
    time : ndarray, shape (n,), or None
        Seconds; None for independent frames.
    names : tuple of n str
        Names of the pictures' files; empty in a video.
    measurements : tuple of n Measurement
    events : tuple of Event
        Alarms.
    about : dict
        Plain facts: the estimate and the tilt, and the speed.
    """

    instrument: str
    source: str
    calibration: Calibration
    time: Array | None
    names: tuple[str, ...]
    measurements: tuple[Measurement, ...]
    events: tuple[Event, ...]
    about: dict[str, Any]

    @property
    def failure(self) -> str | None:
        """Why the run measured nothing, in one line; None if at least one frame has an angle."""
        counts = Counter(m.status for m in self.measurements)
        if "ok" in counts:
            return None
        listed = ", ".join(f"{n} {status}" for status, n in counts.items())
        what = "no picture could be read" if set(counts) <= {"lost"} else "no frame gave an angle"
        estimate = self.about.get("estimate") or {}
        if estimate.get("status") == "refused" and any(m.centre for m in self.measurements):
            usual = Counter(m.reason for m in self.measurements if m.reason).most_common(1)
            why = f"{estimate['estimator']} refused: {estimate['reason']}"
            why += "".join(f"; {n} frames: {reason}" for reason, n in usual if estimate["reason"] not in reason)
        else:
            why = f"the first: {next((m.reason for m in self.measurements if m.reason), 'no frames')}"
        return printable(f"{self.source}: {what} ({listed}; {why})")

    @property
    def alpha(self) -> Array:
        """Swing of each frame, rad, shape (n,); NaN where there is none."""
        return np.array([m.alpha for m in self.measurements], float)

    @property
    def ends(self) -> Array:
        """Ends of the 95 % intervals, rad, shape (n, 2); NaN where there is none."""
        return np.array([(m.alpha_low, m.alpha_high) for m in self.measurements], float).reshape(-1, 2)

    @property
    def rope_length(self) -> Array:
        r"""Lengths \|OA\| from which the swings were computed, m, shape (n,); NaN where there is none."""
        return np.array([m.rope_length_m for m in self.measurements], float)

    @property
    def pixels(self) -> Array:
        """Grab centres, shape (n, 2); NaN where none was found."""
        return np.array([m.centre or (np.nan, np.nan) for m in self.measurements], float).reshape(-1, 2)


def rows(run: Run) -> Iterator[dict[str, Any]]:
    """One plain row a frame; angles in degrees."""
    times = [None] * len(run.names) if run.time is None else run.time.tolist()
    for i, (time, name, m) in enumerate(zip(times, run.names, run.measurements, strict=True)):
        yield {"frame": i, "time_s": time, "file": encodable(name)} | plain_row(m)


def plain_row(m: Measurement) -> dict[str, Any]:
    """One plain row without its place; angles in degrees."""
    plain: dict[str, Any] = {"status": m.status, "reason": encodable(m.reason)}
    plain |= {f"{name}_deg": _degrees(getattr(m, name)) for name in _ANGLES}
    plain |= {"direction_deg": _degrees(m.direction), "danger": m.danger, "score": m.score}
    for name, columns in _PARTS.items():
        plain |= dict(zip(columns, getattr(m, name) or (None,) * len(columns), strict=True))
    rope_text = None if m.rope_text is None else encodable(m.rope_text)
    plain |= {"rope_text": rope_text, "rope_status": m.rope_status, "rope_length_m": m.rope_length_m}
    plain |= {"warning": m.warning} | {f"{name}_deg": _degrees(getattr(m, name)) for name in _PEAK}
    return plain | {"peak_in_s": m.peak_in_s}


def _degrees(value: float | None) -> float | None:
    return None if value is None else math.degrees(value)


def _radians(value: float | None) -> float | None:
    return None if value is None else math.radians(value)


def measurements(plain: Iterable[dict[str, Any]]) -> tuple[Measurement, ...]:
    """Read plain rows; raises `ValueError` or `LookupError`."""
    found = []
    for i, row in enumerate(plain, 1):
        given = {name: row[name] for name in (*TEXT, "danger", "score", "rope_length_m", "warning", "peak_in_s")}
        given |= {name: _radians(row[f"{name}_deg"]) for name in (*_ANGLES, "direction", *_PEAK)}
        for name, columns in _PARTS.items():
            part = tuple(row[column] for column in columns)
            given[name] = None if None in part else part
        try:
            found.append(msgspec.convert(given, Measurement))
        except msgspec.ValidationError as problem:
            raise ValueError(f"row {i}: {problem}") from None
        if wrong := flaw(found[-1]):
            raise ValueError(f"row {i}: {wrong}")
    return tuple(found)


def counts(measurements: Sequence[Measurement]) -> dict[str, int]:
    """How many frames have each status."""
    return {status: sum(m.status == status for m in measurements) for status in _Counts.__struct_fields__}


def table(run: Run) -> pa.Table:
    """Arrow table of `rows`."""
    names = ["frame", "time_s", "file", *plain_row(Measurement(status="lost", reason="-"))]
    kinds = {"frame": pa.int64(), "file": pa.string()} | dict.fromkeys(TEXT, pa.string())
    schema = pa.schema([pa.field(name, kinds.get(name, pa.float64())) for name in names])
    plain, parts = rows(run), [schema.empty_table()]
    while part := list(itertools.islice(plain, _AT_ONCE)):
        parts.append(pa.Table.from_pylist(part, schema=schema))
    return pa.concat_tables(parts).combine_chunks()


def alarms(events: Sequence[Event]) -> list[dict[str, Any]]:
    """Plain events in degrees; ``confirmed`` is for the operator to fill in."""
    return [
        {
            "event": i, "first_frame": e.first, "last_frame": e.last, "peak_frame": e.peak, "onset_s": e.onset_s,
            "end_s": e.end_s, "duration_s": e.duration_s, "peak_s": e.peak_s, "ongoing": e.ongoing,
            "alpha_deg": _degrees(e.alpha), "alpha_low_deg": _degrees(e.alpha_low),
            "alpha_high_deg": _degrees(e.alpha_high),
            "danger": e.danger, "confirmed": None,
        }
        for i, e in enumerate(events, 1)
    ]  # fmt: skip


def reasons(measurements: Sequence[Measurement]) -> list[tuple[str, str, int]]:
    """Count statuses and reasons; numbers within a reason are left out, because they concern one frame."""

    def bare(reason: str) -> str:
        return re.sub(r"\d", "#", re.sub(r" ?\([^()]*\d[^()]*\)", "", reason))

    counted = Counter((m.status, bare(m.reason)) for m in measurements if m.status != "ok")
    return [(*key, count) for key, count in counted.most_common(20)]


def _event(plain: dict[str, Any]) -> dict[str, Any]:
    event = {name: plain[name] for name in ("onset_s", "end_s", "peak_s", "danger", "ongoing")}
    event |= {name: plain[f"{name}_frame"] for name in ("first", "last", "peak")}
    return event | {name: _radians(plain[f"{name}_deg"]) for name in _ANGLES}


def _sheet(found: pa.Table) -> pa.Table:
    """Make a table safe for a spreadsheet, which might take text as a formula."""
    for i, field in enumerate(found.schema):
        if pa.types.is_string(field.type):
            texts = [None if text is None else cell(text) for text in found.column(i).to_pylist()]
            found = found.set_column(i, field, pa.array(texts, pa.string()))
    return found


def save(run: Run, folder: Path) -> None:
    """Write a run's tables into an existing folder."""
    found = table(run)
    parquet.write(found, folder / TABLE, compression="zstd")
    with (folder / SHEET).open("wb") as file:
        pyarrow.csv.write_csv(_sheet(found), file)
    (folder / ALARMS).write_text(json.dumps(alarms(run.events), indent=1) + "\n", encoding="utf-8")
    about = {
        "instrument": encodable(run.instrument), "source": encodable(run.source), "timed": run.time is not None,
        "failure": run.failure,
    } | run.about  # fmt: skip
    (folder / ABOUT).write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
    run.calibration.save(folder / CAMERA)


def load(path: str | Path) -> Run:
    """Read a run's folder.

    Raises
    ------
    RunError
        If the folder is not a run.
    """
    path = Path(path)
    if not path.is_dir():
        raise RunError(f"{path}: {'not a run of simgrab: a run is a folder' if path.exists() else 'does not exist'}")
    if not os.path.lexists(path / TABLE):
        raise RunError(f"{path}: not a run of simgrab: it has no {TABLE}")
    plain = parquet.rows(parquet.read_table(path / TABLE, RunError), RunError, cannot(path / TABLE))
    about, alarmed = read_json(path / ABOUT, RunError), read_json(path / ALARMS, RunError)
    try:
        facts = msgspec.convert(about, Facts)
        events = tuple(msgspec.convert(_event(e), Event) for e in alarmed)
        measured = measurements(plain)
        time = np.array(msgspec.convert([row["time_s"] for row in plain], list[float])) if facts.timed else None
        names = msgspec.convert([row["file"] for row in plain], tuple[str, ...])
    except (ValueError, LookupError, TypeError, AttributeError) as problem:
        raise RunError(f"{path}: not a run of simgrab ({type(problem).__name__}: {first_line(problem)})") from None
    if time is not None and not np.isfinite(time).all():
        raise RunError(f"{path / TABLE}: time_s, row {np.flatnonzero(~np.isfinite(time))[0] + 1}: is missing")
    about = {key: value for key, value in about.items() if key not in ("instrument", "source", "timed", "failure")}
    camera = camera_file.load(path / CAMERA)
    return Run(facts.instrument, facts.source, camera, time, names, measured, events, about)


@contextmanager
def making(out: Path) -> Iterator[Path]:
    """Yield a hidden folder that is renamed to ``out`` once everything in it is written.

    Raises
    ------
    RunError
        If the path is taken, or cannot be written.
    """
    try:
        with drafted_folder(out) as draft:
            yield draft
    except OSError as problem:
        if os.path.lexists(out):
            raise RunError(f"{out} was written by another run in the meantime; choose another --out") from None
        raise RunError(f"cannot write {out}: {problem.strerror or problem}") from None


Progress = Callable[[int, int | None], None]
