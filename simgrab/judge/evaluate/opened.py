"""What `simgrab evaluate` compares: a run, or a table of angles by another program, and the truth of its frames."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from simgrab.dataset import datasets
from simgrab.errors import RecordError, first_line
from simgrab.instrument import alarm
from simgrab.instrument.contract import Measurement
from simgrab.instrument.estimate.tables import check_columns, check_present, numbers, read_texts
from simgrab.instrument.run import runs
from simgrab.instrument.run.runs import Run
from simgrab.instrument.source import dataset_files
from simgrab.judge.evaluate import truths
from simgrab.judge.evaluate.truths import Truths
from simgrab.model import calibration

HEADER = "alpha_deg, and frame, time_s or file"
_BLANK = runs.plain_row(Measurement(status="missed", reason="no angle"))


def opened(run: Run | str | Path, known: Truths | str | Path, start_s: float | None = None) -> tuple[Run, Truths]:
    """Open a run and the truth of its frames, as `simgrab.judge.evaluate.evaluation.evaluate` takes them."""
    if not isinstance(run, Run):
        path, by_frame = Path(run), False
        if path.is_file() and not isinstance(known, Truths):
            run, by_frame = _of_table(path, Path(known))
        else:
            run = runs.load(path)
        start_s = 0.0 if by_frame and start_s is None else start_s
    return run, known if isinstance(known, Truths) else truths.of(run, known, start_s)


def _of_table(path: Path, known: Path) -> tuple[Run, bool]:
    """Make a run of a table, and say whether its times are those of a video's frames, by number."""
    files: list[str] = []
    if known.is_dir():
        source, camera = dataset_files(known), calibration.load(known / datasets.CAMERA)
        files = [str(file.relative_to(source.root)) for file in source.files]
        stamps, keys = np.array(source.times, float), ("file", "frame")
    else:
        stamps, keys = truths.read_film(known.with_suffix(".parquet")).stamps, ("time_s", "frame")
        camera = calibration.load(known.with_suffix(".camera.toml"))
    found = read_texts(path, ["frame", "time_s", "file", *_BLANK], HEADER)
    check_columns(path, found, keys, ["alpha_deg"])
    key = next(name for name in keys if name in found.column_names)
    if key == "time_s":
        times, names = numbers(path, found, key), ("",) * found.num_rows
        check_present(path, key, times, increasing=True)
    else:
        at = _places(path, found, key, files, len(stamps))
        times, names = stamps[at], tuple(files[i] for i in at) if files else ("",) * len(at)
    timed = bool(np.isfinite(times).all() and (np.diff(times) > 0).all())
    measurements = _measurements(path, found)
    events = alarm.events(times, measurements) if timed else ()
    about = {"counts": runs.counts(measurements), "estimate": None, "tilt": None}
    made = Run(path.stem, str(path), camera, times if timed else None, names, measurements, events, about)
    return made, key == "frame" and not files


def _places(path: Path, found: pa.Table, key: str, files: list[str], count: int) -> NDArray[np.int64]:
    """Find the frames of rows, of which there are ``count``, by the names of their files or by their numbers, (n,)."""
    if key == "file":
        index = {name: i for i, file in enumerate(files) for name in (file, Path(file).name)}
        at = np.array([index.get(str(name), -1) for name in found[key].to_pylist()])
        wrong, right = at < 0, f"one of the dataset's, such as {files[0]}"
    else:
        at = numbers(path, found, key)
        check_present(path, key, at, increasing=True)
        wrong, right = (at < 0) | (at >= count) | (at % 1 != 0), f"a whole number from 0 to {count - 1}"
    for row in np.flatnonzero(wrong)[:1]:
        raise RecordError(f"{path}: {key}, row {row + 1}: is {found[key][row]}; must be {right}")
    return at.astype(np.int64)


def _measurements(path: Path, found: pa.Table) -> tuple[Measurement, ...]:
    alpha = numbers(path, found, "alpha_deg")
    for row in np.flatnonzero(~np.isnan(alpha) & ~((alpha >= 0) & (alpha <= 90)))[:1]:
        raise RecordError(
            f"{path}: alpha_deg, row {row + 1}: is {alpha[row]:g}; must be 0 to 90, or empty where there is no angle"
        )
    columns = {name: _cells(path, found, name) for name in _BLANK if name in found.column_names}
    rows = []
    for cells in zip(*columns.values(), strict=True):
        given = {name: cell for name, cell in zip(columns, cells, strict=True) if cell not in (None, "")}
        if given.setdefault("status", "ok" if "alpha_deg" in given else "missed") == "ok":
            given["reason"] = ""
        rows.append(_BLANK | given)
    try:
        return runs.measurements(rows)
    except ValueError as problem:
        raise RecordError(f"{path}: {first_line(problem)}") from None


def _cells(path: Path, found: pa.Table, name: str) -> list[Any]:
    if name in runs.TEXT:
        return [str(cell or "").strip() for cell in found[name].to_pylist()]
    return [None if np.isnan(value) else value for value in numbers(path, found, name).tolist()]
