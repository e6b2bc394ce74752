"""What a run found, as a value and as a folder."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from simgrab import calibration as camera_file
from simgrab.calibration import Calibration
from simgrab.errors import RunError
from simgrab.files import drafted, drafted_folder
from simgrab.geometry import Array
from simgrab.instrument.alarm import Event
from simgrab.instrument.contract import Measurement

TABLE, SHEET, ALARMS, ABOUT, CAMERA = "angles.parquet", "angles.csv", "alarms.json", "run.json", "camera.toml"
_ANGLES = ("alpha", "alpha_low", "alpha_high")
_PARTS = {
    "box": ("box_x0_px", "box_y0_px", "box_x1_px", "box_y1_px"),
    "centre": ("u_px", "v_px"),
    "centre_sd": ("u_sd_px", "v_sd_px"),
}
_TEXT = ("status", "reason", "rope_text", "rope_status")


@dataclass(frozen=True, eq=False)
class Run:
    """What an instrument made of a source.

    Attributes
    ----------
    instrument, source : str
    calibration : Calibration
        The camera as the instrument knew it.
    time : ndarray, shape (n,), or None
        Seconds; None for independent frames.
    names : tuple of n str
        Of the pictures' files; empty in a video.
    measurements : tuple of n Measurement
    events : tuple of Event
        Alarms.
    about : dict
        Plain facts: the estimate and the tilt, what the paper's method makes of the same frames, and the speed.
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
    def alpha(self) -> Array:
        """Swing of each frame, rad, shape (n,); NaN where there is none."""
        return np.array([np.nan if m.alpha is None else m.alpha for m in self.measurements], float)

    @property
    def pixels(self) -> Array:
        """Grab centres, shape (n, 2); NaN where none was found."""
        return np.array([m.centre or (np.nan, np.nan) for m in self.measurements], float).reshape(-1, 2)


def rows(run: Run) -> list[dict[str, Any]]:
    """One plain row a frame; angles in degrees."""
    times = [None] * len(run.names) if run.time is None else run.time.tolist()
    return [
        {"frame": i, "time_s": time, "file": name} | _row(m)
        for i, (time, name, m) in enumerate(zip(times, run.names, run.measurements, strict=True))
    ]


def _row(m: Measurement) -> dict[str, Any]:
    plain: dict[str, Any] = {"status": m.status, "reason": m.reason}
    for name in _ANGLES:
        value = getattr(m, name)
        plain[f"{name}_deg"] = None if value is None else math.degrees(value)
    plain |= {"danger": m.danger, "score": m.score}
    for name, columns in _PARTS.items():
        plain |= dict(zip(columns, getattr(m, name) or (None,) * len(columns), strict=True))
    return plain | {"rope_text": m.rope_text, "rope_status": m.rope_status, "rope_length_m": m.rope_length_m}


def _measurement(row: dict[str, Any]) -> Measurement:
    plain = {name: row[name] for name in (*_TEXT, "danger", "score", "rope_length_m")}
    for name in _ANGLES:
        value = row[f"{name}_deg"]
        plain[name] = None if value is None else math.radians(value)
    for name, columns in _PARTS.items():
        part = tuple(row[column] for column in columns)
        plain[name] = None if None in part else part
    return msgspec.convert(plain, Measurement)


def table(run: Run) -> pa.Table:
    """Arrow table of `rows`."""
    names = ["frame", "time_s", "file", *_row(Measurement(status="lost", reason="-"))]
    kinds = {"frame": pa.int64(), "file": pa.string()} | dict.fromkeys(_TEXT, pa.string())
    schema = pa.schema([pa.field(name, kinds.get(name, pa.float64())) for name in names])
    return pa.Table.from_pylist(rows(run), schema=schema)


def alarms(events: Sequence[Event]) -> list[dict[str, Any]]:
    """Plain events in degrees; ``confirmed`` is for the operator to fill in."""
    return [
        {
            "event": i, "first_frame": e.first, "last_frame": e.last, "peak_frame": e.peak, "onset_s": e.onset_s,
            "end_s": e.end_s, "duration_s": e.duration_s, "peak_s": e.peak_s, "ongoing": e.ongoing,
            "alpha_deg": math.degrees(e.alpha),
            "alpha_low_deg": None if e.alpha_low is None else math.degrees(e.alpha_low),
            "alpha_high_deg": None if e.alpha_high is None else math.degrees(e.alpha_high),
            "danger": e.danger, "confirmed": None,
        }
        for i, e in enumerate(events, 1)
    ]  # fmt: skip


def _event(plain: dict[str, Any]) -> Event:
    low, high = plain["alpha_low_deg"], plain["alpha_high_deg"]
    return Event(
        first=plain["first_frame"], last=plain["last_frame"], peak=plain["peak_frame"], onset_s=plain["onset_s"],
        end_s=plain["end_s"], peak_s=plain["peak_s"], alpha=math.radians(plain["alpha_deg"]),
        alpha_low=None if low is None else math.radians(low), alpha_high=None if high is None else math.radians(high),
        danger=plain["danger"], ongoing=plain["ongoing"],
    )  # fmt: skip


def save(run: Run, folder: Path) -> None:
    """Write a run's tables into a folder that is there."""
    found = table(run)
    pq.write_table(found, folder / TABLE, compression="zstd")
    pyarrow.csv.write_csv(found, folder / SHEET)
    (folder / ALARMS).write_text(json.dumps(alarms(run.events), indent=1) + "\n", encoding="utf-8")
    about = {"instrument": run.instrument, "source": run.source, "timed": run.time is not None} | run.about
    (folder / ABOUT).write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
    run.calibration.save(folder / CAMERA)


def load(path: str | Path) -> Run:
    """Read a run's folder.

    Raises
    ------
    RunError
        If it is none.
    """
    path = Path(path)
    try:
        plain = pq.read_table(path / TABLE).to_pylist()
        about = json.loads((path / ABOUT).read_text(encoding="utf-8"))
        events = tuple(_event(e) for e in json.loads((path / ALARMS).read_text(encoding="utf-8")))
        measurements = tuple(_measurement(row) for row in plain)
        instrument, source, timed = about.pop("instrument"), about.pop("source"), about.pop("timed")
        time = np.array([row["time_s"] for row in plain], float) if timed else None
    except (OSError, ValueError, KeyError, TypeError, msgspec.ValidationError, pa.ArrowException) as problem:
        raise RunError(f"{path}: not a run of simgrab ({type(problem).__name__}: {problem})") from None
    names = tuple(row["file"] for row in plain)
    return Run(instrument, source, camera_file.load(path / CAMERA), time, names, measurements, events, about)


@contextmanager
def making(out: Path) -> Iterator[Path]:
    """Give a hidden folder that takes the name ``out`` once everything in it is written.

    Raises
    ------
    RunError
        If something lies in the way, or nothing can be written there.
    """
    if out.exists():
        raise RunError(f"{out} exists; choose another --out, or remove it")
    try:
        with drafted_folder(out) as draft:
            yield draft
    except OSError as problem:
        raise RunError(f"cannot write {out}: {problem.strerror or problem}") from None


def write(path: Path, text: str) -> None:
    """Write a text file under its name once it is whole.

    Raises
    ------
    RunError
    """
    try:
        with drafted(path) as draft:
            draft.write_text(text, encoding="utf-8")
    except OSError as problem:
        raise RunError(f"cannot write {path}: {problem.strerror or problem}") from None


Progress = Callable[[int, int | None], None]
