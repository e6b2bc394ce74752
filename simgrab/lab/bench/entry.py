"""What a method enters: one CSV file for each clip, and a description of the method.

``entry.json`` has ``method``, ``track`` and ``season``. ``CLIP.csv`` has the columns of `COLUMNS` and a row for each
frame of the clip, in order. Nothing else lies in the folder.
"""

from __future__ import annotations

import csv
import io
import math
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, get_args

import msgspec
import numpy as np
from numpy.typing import NDArray

from simgrab.errors import BenchError, RecordError, RunError, shortened
from simgrab.instrument.alarm import probability
from simgrab.instrument.contract import Instrument, Measurement, Status
from simgrab.instrument.run.run import measure
from simgrab.instrument.run.subject import checked
from simgrab.instrument.source import open_source
from simgrab.io.destination import check_new_folder, writing
from simgrab.io.files import drafted_folder, write
from simgrab.io.parse import read_json, read_text
from simgrab.io.strict import Checked, convert
from simgrab.lab.bench.files import CLIPS, Name, Published, as_json, published, sensor_folders
from simgrab.lab.bench.season import SENSORS, sensors_of
from simgrab.model import calibration
from simgrab.model.geometry import Array

Meta = msgspec.Meta
COLUMNS = ("clip", "frame", "status", "alpha_deg", "low_deg", "high_deg", "time_s")
ABOUT = "entry.json"
MOST_BYTES = 64_000_000
MOST_PROBLEMS = 20  # that are listed of one entry


class MethodDescription(Checked, frozen=True):
    """Description of a method."""

    error = BenchError

    method: Annotated[str, Meta(min_length=1, max_length=100)]
    # inputs that it used: "picture" (the picture without the display), "picture+rope" (the rope length on the display
    # too), and so on with sensors (`simgrab.lab.bench.season.sensors_of`)
    track: str
    season: str  # name of the season
    description: Annotated[str, Meta(max_length=1000)] = ""
    # most frequent reason of the frames without an angle, of each clip that has such frames
    reasons: dict[Name, Annotated[str, Meta(max_length=1000)]] = msgspec.field(default_factory=dict)

    def check(self) -> None:  # noqa: D102
        sensors_of(self.track, tuple(SENSORS))


@dataclass(frozen=True, eq=False)
class Answers:
    """A method's answers for the n frames of a clip."""

    status: tuple[str, ...]
    alpha: Array  # (n,), rad; NaN where there is none
    low: Array  # (n,), ends of its 95 % interval
    high: Array  # (n,)
    seconds: Array  # (n,), computing time of each frame, s

    @property
    def ok(self) -> NDArray[np.bool_]:
        """Frames with an angle, shape (n,)."""
        return np.isfinite(self.alpha)

    @property
    def measurements(self) -> tuple[Measurement, ...]:
        """Status, angle and probability of danger (`simgrab.instrument.alarm.probability`) of each frame."""
        chance = probability(self.alpha, self.low, self.high)
        return tuple(
            Measurement(status="ok", alpha=alpha, danger=danger)
            if status == "ok"
            else Measurement(status=status, reason="-")  # type: ignore[arg-type]  # checked when it was read
            for status, alpha, danger in zip(self.status, self.alpha.tolist(), chance.tolist(), strict=True)
        )


@dataclass(frozen=True, eq=False)
class Entry:
    """A method's answers for all clips, by name."""

    about: MethodDescription
    clips: dict[str, Answers]


def run(
    folder: Path, out: Path, instrument: Instrument, track: str, *, method: str = "",
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, str]:  # fmt: skip
    """Let an instrument measure a season's clips, and write an entry.

    It is given videos, camera files, and the folders of the sensors that the track allows. In tracks without the rope
    length, camera files state no display. Where a clip's sensors are not the season's, or the instrument raises
    `RecordError`, every frame of the clip is refused.

    Parameters
    ----------
    folder : Path
        Of a prepared season, of which ``clips`` is read.
    out : Path
        New folder.
    track : str
        Of the season (`simgrab.lab.bench.season.sensors_of`).
    method : str
        Name in the table; the instrument's unless given.
    progress : callable, optional
        Called with (clips done, clips in all).

    Returns
    -------
    dict
        The most frequent reason, by clips of which no frame has an angle.

    Raises
    ------
    BenchError, SourceError, CalibrationError, InstrumentError, RunError
        Before the first clip if the instrument cannot measure with the inputs of the track.
    """
    check_new_folder(out, BenchError)
    season = published(folder)
    instrument = checked(instrument)
    try:
        sensors = [name for kind in sensors_of(track, season.sensors) for name in SENSORS[kind]]
    except ValueError as problem:
        raise BenchError(str(problem)) from None
    display = "rope" in track.split("+")
    about = MethodDescription(method or instrument.name, track, season.name)
    try:
        instrument.check_inputs(sensors, display=display)
    except RunError as problem:
        raise BenchError(f"track {track}: {problem}") from None
    files, reasons, empty = dict[str, str](), dict[str, str](), dict[str, str]()
    for count, (name, frames) in enumerate(season.clips.items(), 1):
        video = folder / CLIPS / f"{name}.mp4"
        camera = calibration.load(video.with_suffix(".camera.toml"))
        if not display:
            camera = msgspec.structs.replace(camera, digit_layout=None)
        begun = time.perf_counter()
        try:
            subject: Instrument = instrument
            if sensors:
                subject = instrument.with_sensors(sensor_folders(folder, season, name, sensors))
            measurements = measure(open_source(video), camera, subject, source=name).measurements
        except RecordError as problem:
            measurements = (Measurement(status="refused", reason=str(problem)),) * frames
        each = (time.perf_counter() - begun) / len(measurements)
        files[f"{name}.csv"] = written(name, measurements, each)
        if without := Counter(m.reason for m in measurements if m.status != "ok"):
            reasons[name] = shortened(without.most_common(1)[0][0])
            if without.total() == len(measurements):
                empty[name] = reasons[name]
        if progress:
            progress(count, len(season.clips))
    about = msgspec.structs.replace(about, reasons=reasons)
    with writing(out, BenchError):
        out.parent.mkdir(parents=True, exist_ok=True)
    with writing(out, BenchError), drafted_folder(out) as draft:
        for file, text in files.items():
            write(draft / file, text.encode())
        write(draft / ABOUT, as_json(about))
    return empty


def written(clip: str, measurements: Sequence[Measurement], seconds: float) -> str:
    """Write a clip's CSV file; angles to a millionth of a degree, an interval with one end alone left out."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    for frame, m in enumerate(measurements):
        ends = (None, None) if None in (m.alpha_low, m.alpha_high) else (m.alpha_low, m.alpha_high)
        angles = ("" if a is None else f"{math.degrees(a):.6f}" for a in (m.alpha, *ends))
        table.writerow([clip, frame, m.status, *angles, f"{seconds:.6f}"])
    return text.getvalue()


def read(folder: Path, season: Published) -> Entry:
    """Read an entry; raises `BenchError` with the first of its `problems`, and how many there are."""
    entry, found = _read(folder, season)
    if found:
        more = f" (and {len(found) - 1} more; see simgrab bench check)" if len(found) > 1 else ""
        raise BenchError(f"{found[0]}{more}")
    assert entry is not None
    return entry


def problems(folder: Path, season: Published) -> list[str]:
    """List what is wrong with an entry's format: file, line and what is right."""
    return _read(folder, season)[1]


def _read(folder: Path, season: Published) -> tuple[Entry | None, list[str]]:
    found, clips, about = list[str](), dict[str, Answers](), None
    try:
        about = convert(read_json(folder / ABOUT, BenchError), MethodDescription, BenchError, folder / ABOUT)
        if about.season != season.name:
            found.append(f"{folder / ABOUT}: season {about.season!r}; these clips are of season {season.name!r}")
        try:
            sensors_of(about.track, season.sensors)
        except ValueError as problem:
            found.append(f"{folder / ABOUT}: {problem}")
    except BenchError as problem:
        found.append(str(problem))
    wanted = {ABOUT, *(f"{clip}.csv" for clip in season.clips)}
    strange = sorted(path.name for path in folder.glob("[!.]*") if path.name not in wanted)
    found += [f"{folder / name}: not a file of this season" for name in strange[:MOST_PROBLEMS]]
    for clip, count in season.clips.items():
        try:
            clips[clip] = _answers(folder / f"{clip}.csv", clip, count)
        except BenchError as problem:
            found.append(str(problem))
        if len(found) > MOST_PROBLEMS:
            break
    return (None if found or about is None else Entry(about, clips)), found


def _answers(path: Path, clip: str, count: int) -> Answers:
    """Read one clip's answers; raises `BenchError` at the first line that does not keep to the format."""
    text = read_text(path, BenchError, most_bytes=MOST_BYTES)
    lines = csv.reader(io.StringIO(text), strict=True)
    rows = list[tuple[str, float, float, float, float]]()
    try:
        if tuple(next(lines, ())) != COLUMNS:
            raise ValueError(f"the header must be {','.join(COLUMNS)}")
        for frame, line in enumerate(lines):
            rows.append(_row(line, clip, frame, count))
    except (ValueError, csv.Error) as problem:
        raise BenchError(f"{path}, line {max(lines.line_num, 1)}: {problem}") from None
    if len(rows) != count:
        raise BenchError(f"{path}: {len(rows)} frames; the clip has {count}, and each needs a row")
    status, *numbers = zip(*rows, strict=True)
    alpha, low, high, seconds = (np.array(column, float) for column in numbers)
    return Answers(status, np.deg2rad(alpha), np.deg2rad(low), np.deg2rad(high), seconds)


def _row(line: list[str], clip: str, frame: int, count: int) -> tuple[str, float, float, float, float]:
    if len(line) != len(COLUMNS):
        raise ValueError(f"{len(line)} columns; {len(COLUMNS)} are required")
    if line[0] != clip:
        raise ValueError(f"clip {line[0]!r} in the file of {clip!r}")
    if frame >= count:
        raise ValueError(f"the clip has only {count} frames")
    if line[1] != str(frame):
        raise ValueError(f"frame {line[1]!r}; {frame} is due: every frame once, in order")
    status = line[2]
    if status not in get_args(Status):
        raise ValueError(f"status {status!r}; it must be one of {', '.join(get_args(Status))}")
    alpha, low, high = (number(text, name) for text, name in zip(line[3:6], COLUMNS[3:6], strict=True))
    seconds = number(line[6], COLUMNS[6])
    if (status == "ok") == math.isnan(alpha):
        raise ValueError("alpha_deg is required with status ok, and empty otherwise")
    if status != "ok" and not (math.isnan(low) and math.isnan(high)):
        raise ValueError("an interval is only allowed with status ok")
    if math.isnan(low) != math.isnan(high):
        raise ValueError("low_deg and high_deg must both be given or both be empty")
    if not math.isnan(alpha) and not 0 <= alpha <= 90:
        raise ValueError(f"alpha_deg must lie between 0 and 90, got {alpha:g}")
    if low > high:
        raise ValueError(f"low_deg, {low:g}, is above high_deg, {high:g}")
    if math.isnan(seconds) or seconds < 0:
        raise ValueError("time_s must be 0 or more")
    return status, alpha, low, high, seconds


def number(text: str, name: str) -> float:
    """Read a number; NaN where the cell is empty."""
    if not text:
        return math.nan
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"{name} must be a number or empty, got {text!r:.40}") from None
    if not math.isfinite(value):
        raise ValueError(f"{name} must be finite, got {text!r:.40}")
    return value
