"""Read the controller's data, CSV or parquet, as a TOML file describes them; refuse rows that cannot be right."""

from __future__ import annotations

import math
import re
from bisect import bisect_left
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, tzinfo
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from simgrab.errors import RecordError
from simgrab.instrument.controller import LENGTHS, RADIUS_M, Controller
from simgrab.instrument.estimate.tables import decimal_comma, read_texts
from simgrab.instrument.read import Hoist, consistent
from simgrab.instrument.rope import bridged
from simgrab.io.parse import read_toml, shown
from simgrab.io.strict import Checked, convert
from simgrab.model.geometry import Array

DATA, DESCRIPTION = "data.csv", ".toml"
MOST_ROWS = 2_000_000  # 55 hours at 10 Hz
UNITS = {
    "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9,
    "deg": math.pi / 180, "rad": 1.0, **LENGTHS,
    "m/s": 1.0, "km/h": 1 / 3.6, "kn": 1852 / 3600, "mph": 0.44704, "t": 1000.0, "kg": 1.0,
    "deg/s": math.pi / 180, "rad/s": 1.0, "rpm": math.pi / 30, "m/min": 1 / 60,
}  # fmt: skip
_UNITS_OF = {"slew": ("deg", "rad"), "luff": ("deg", "rad"), "wind": ("m/s", "km/h", "kn", "mph"), "load": ("t", "kg")}
LEAST_ROPE_M, LONGEST_M = 0.5, 200.0  # a grab's centre hangs lower than that below the exit, whatever its rope
_USUAL_M = (2.0, 100.0)  # ropes and radii, for a suggestion
# Lowest and highest value and the greatest speed of any such crane, with much to spare, and the unit.
_LIMITS = {
    "slew": (-1e5, 1e5, 0.5, "rad"), "radius": (0.0, LONGEST_M, 2.0, "m"), "luff": (-0.2, 1.6, 0.2, "rad"),
    "rope": (LEAST_ROPE_M, LONGEST_M, 3.0, "m"), "wind": (-0.1, 80.0, 30.0, "m/s"),
    "load": (-1e4, 3e5, 1e5, "kg"),
}  # fmt: skip
_MOST_FAST = 0.1  # share of steps above the greatest speed: beyond it these are no single errors
DAY_S = 86_400.0
_MOVING = 0.98  # quantile of the speeds of readings
_MOST_RATE = 3.0  # ratio of the stated rate to that of the readings
Meta = msgspec.Meta
Bad = NDArray[np.bool_]
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)  # of which times of day are


class ClockColumn(Checked, frozen=True, kw_only=True):
    """Column of times.

    Attributes
    ----------
    column : str
    unit : str
        ``"s"``, ``"ms"``, ``"us"``, ``"ns"``, or ``"iso"`` for texts such as 2026-03-02T08:15:00.25,
        02.03.2026 08:15:00,25 or 08:15:00,25.
    start : float or str or None
        Time of the first frame, as the column has it; None is 0. Of texts only a live run goes without it.
    clock_sd_s : float
        Standard deviation of the difference between the two clocks.
    """

    error = RecordError

    column: str
    unit: Literal["s", "ms", "us", "ns", "iso"] = "s"
    start: float | str | None = None
    clock_sd_s: Annotated[float, Meta(ge=0, le=3600)] = 5.0

    def check(self) -> None:  # noqa: D102
        if self.start is not None and isinstance(self.start, str) != (self.unit == "iso"):
            raise ValueError('start: must be the time of the first frame as the column has it, a text for unit = "iso"')
        if isinstance(self.start, str):
            _moment(self.start)


class Quantity(Checked, frozen=True, kw_only=True):
    """Column of a quantity."""

    error = RecordError

    column: str
    rate_hz: Annotated[float, Meta(gt=0, le=1000)]  # readings a second
    resolution: Annotated[float, Meta(gt=0, le=1000)]  # size of a count, in the column's unit
    lag_s: Annotated[float, Meta(ge=-60, le=60)] = 0.0  # how late readings are stamped
    # standard deviation of the lag; by default that of a reading of any age up to one period; estimators of a whole
    # record take it as the greatest possible one
    jitter_s: Annotated[float, Meta(ge=0, le=60)] | None = None
    file: str = ""  # file beside the description, if the column is in another one

    @property
    def jitter(self) -> float:
        """Standard deviation of the lag, s."""
        return 1 / (math.sqrt(12) * self.rate_hz) if self.jitter_s is None else self.jitter_s

    def check(self) -> None:
        """Refuse files from elsewhere."""
        if Path(self.file).is_absolute() or ".." in Path(self.file).parts:
            raise ValueError(f"file: must be beside or below the description, got {shown(self.file)}")


class Slew(Quantity, frozen=True, kw_only=True):
    """Slewing angle: its zero does not matter; ``clockwise``, seen from above, where it grows that way.

    ``setpoint`` names the column of the speed that is demanded of the drive, before any ramp.
    """

    unit: Literal["deg", "rad"] = "deg"
    setpoint: str = ""
    setpoint_unit: Literal["deg/s", "rad/s", "rpm"] = "deg/s"
    clockwise: bool = False


class Length(Quantity, frozen=True, kw_only=True):
    """A length less ``constant_m``, which is taken as 0 with a note if it is not stated."""

    unit: Literal["m", "dm", "cm", "mm", "ft"] = "m"
    constant_m: Annotated[float, Meta(ge=-LONGEST_M, le=LONGEST_M)] | None = None


class Radius(Length, frozen=True, kw_only=True):
    """Distance from the slewing axis to the rope exit O: an outreach begins at a rail or quay.

    ``setpoint`` as of `Slew`.
    """

    setpoint: str = ""
    setpoint_unit: Literal["m/s", "m/min"] = "m/s"


class Luff(Quantity, frozen=True, kw_only=True):
    """Angle of the jib above the horizontal: the radius is ``pivot_m`` + ``jib_m`` · cos(angle).

    ``setpoint`` as of `Slew`.
    """

    unit: Literal["deg", "rad"] = "deg"
    setpoint: str = ""
    setpoint_unit: Literal["deg/s", "rad/s"] = "deg/s"
    jib_m: Annotated[float, Meta(gt=0, le=LONGEST_M)]
    pivot_m: Annotated[float, Meta(ge=-LONGEST_M, le=LONGEST_M)] = 0.0


class Wind(Quantity, frozen=True, kw_only=True):
    """Speed of the wind, by the crane's anemometer."""

    unit: Literal["m/s", "km/h", "kn", "mph"] = "m/s"


class Load(Quantity, frozen=True, kw_only=True):
    """Hoisted mass, by the crane's load cell: ``grab_t`` is that of the empty grab, which a ``net`` load leaves out."""

    unit: Literal["t", "kg"] = "t"
    grab_t: Annotated[float, Meta(gt=0, le=200)]
    net: bool = False


class ControllerFacts(Checked, frozen=True, kw_only=True):
    """Description of a controller's data: at least one quantity, and radius or luff, not both."""

    error = RecordError

    time: ClockColumn
    slew: Slew | None = None
    radius: Radius | None = None
    luff: Luff | None = None
    rope: Length | None = None  # of the hoisting rope, |OA|
    wind: Wind | None = None
    load: Load | None = None
    longest_gap_s: Annotated[float, Meta(gt=0, le=60)] = 2.0  # readings further apart are not joined

    def check(self) -> None:  # noqa: D102
        if not self.quantities:
            raise ValueError("at least one of the tables slew, radius, luff, rope, wind and load is needed")
        for name, one in self.quantities.items():
            if isinstance(one, Slew | Radius | Luff) and one.setpoint == one.column:
                raise ValueError(f"{name}.setpoint: must be another column than {one.column!r}, of a speed")
        if self.radius and self.luff:
            raise ValueError("luff: leave it out, or radius, which follows from it")

    @property
    def quantities(self) -> dict[str, Quantity]:
        """Those that are described, by name."""
        named = {name: getattr(self, name) for name in _LIMITS}
        return {name: quantity for name, quantity in named.items() if quantity is not None}

    @staticmethod
    def file_of(quantity: Quantity, path: Path) -> Path:
        """Return the file of a quantity's column, given the path of the data."""
        return path.parent / quantity.file if quantity.file else path


def describe(path: str | Path) -> tuple[Path, ControllerFacts]:
    """Return the path of the controller's data, and their description; raises as `read_controller`."""
    path = Path(path)
    path = path / DATA if path.is_dir() else path
    toml = path.with_suffix(DESCRIPTION)
    return path, convert(
        read_toml(toml, RecordError, "description of the controller's data"), ControllerFacts, RecordError, toml
    )


def read_controller(
    path: str | Path, facts: ControllerFacts | None = None, read: Callable[[Path], pa.Table] | None = None
) -> Controller:
    """Read the controller's data.

    Series of different rates are interpolated linearly at the times of the one with most readings, and have a row of
    NaN in each of its gaps beyond ``longest_gap_s``.

    Parameters
    ----------
    path : path
        ``.parquet``, or else CSV with a header; a folder with ``data.csv``; or a description whose quantities name
        their files.
    facts : ControllerFacts, optional
        By default read from the TOML file of the same name beside the data.
    read : callable, optional
        Reads a file's table; by default all of it.

    Raises
    ------
    RecordError
        With one line that names the file, and the key, or the column and the row (the first is 1): for files that
        cannot be read, missing columns, and where more than half of the readings are refused.
    """
    if facts is None:
        path, facts = describe(path)
        if facts.time.unit == "iso" and facts.time.start is None:
            raise RecordError(f"{path.with_suffix(DESCRIPTION)}: time.start: is missing: the time of the first frame")
    path = Path(path)
    notes: list[str] = []
    files: dict[Path, _Rows] = {}
    series: dict[str, tuple[Array, Array, float, float]] = {}
    setpoints: dict[str, tuple[Array, Array]] = {}
    for name, quantity in facts.quantities.items():
        file = facts.file_of(quantity, path)
        if file.suffix.lower() == DESCRIPTION:
            raise RecordError(f"{path}: {name}.file: is missing: which file the column is in")
        if file not in files:
            table = read(file) if read else read_texts(file, [facts.time.column], facts.time.column)
            files[file] = _rows(file, table, facts.time, notes)
        axis = "radius" if name == "luff" else name
        series[axis] = _series(files[file], name, quantity, notes)
        if isinstance(quantity, Slew | Radius | Luff) and quantity.setpoint:
            setpoints[axis] = _setpoints(files[file], name, quantity, notes)
    if "slew" in series and "radius" not in series:
        notes.append(f"{path}: slew without radius or luff: a radius of {RADIUS_M:g} m is assumed")
    beside: dict[str, Array] = {
        name: np.column_stack(series.pop(name)[:2]) for name in ("wind", "load") if name in series
    }
    stamps = [one[:, 0] for one in beside.values()]
    if "wind" in beside and not np.ptp(beside["wind"][:, 1]):
        notes.append(f"{path}: wind: the same reading throughout, and not used")
        del beside["wind"]
    grid = max([time for time, *_ in series.values()] or stamps, key=len)
    motion = [
        (series[name][0], one) for name, one in (("slew", facts.slew), ("radius", facts.radius or facts.luff)) if one
    ]
    late_s = [max(one.lag_s, 0.0) + (0.0 if np.array_equal(time, grid) else 1 / one.rate_hz) for time, one in motion]
    holes = np.flatnonzero(np.diff(grid) > facts.longest_gap_s)
    grid = np.insert(grid, holes + 1, (grid[holes] + grid[holes + 1]) / 2)
    found: dict[str, Any] = {**beside, "motion_late_s": max(late_s, default=0.0)}
    for name, (time, values, sd, still_sd) in series.items():
        joined = bridged(grid, time, values, facts.longest_gap_s)
        joined[(grid < time[0]) | (grid > time[-1])] = np.nan
        joined[holes + 1 + np.arange(len(holes))] = np.nan
        found[name] = joined
        if name != "rope":
            found |= {f"{name}_sd": sd, f"{name}_still_sd": still_sd}
    if len(setpoints) == 1:
        notes.append(f"{path}: {next(iter(setpoints))}.setpoint is not used without that of the other drive")
    for axis, (time, values) in setpoints.items():
        at = np.searchsorted(time, grid, side="right")
        since, values = np.append(-np.inf, time)[at], np.append(np.nan, values)[at]  # until the next one
        values = np.where(grid - since <= facts.longest_gap_s, values, np.nan)
        if axis == "radius" and isinstance(facts.luff, Luff):
            values = _of_radius(values, found["radius"], facts.luff)
        found[f"{axis}_setpoint"] = values
    if facts.load is not None:
        found["grab_kg"] = 1000 * facts.load.grab_t
    if facts.rope is not None:
        found["rope_unit"] = facts.rope.unit
    if facts.time.start is None:
        found["clock_from"] = f"its description without time.start: the first frame is at 0 of {facts.time.column!r}"
    return Controller(grid, **found, clock_sd_s=facts.time.clock_sd_s, notes=tuple(notes))


@dataclass(frozen=True, eq=False)
class _Rows:
    """A file's table, the rows whose times increase, and these times, s since the first frame."""

    path: Path
    table: pa.Table
    kept: NDArray[np.int64]
    time: Array


@dataclass(frozen=True)
class _Refusing:
    """Counts refused readings of a column, and refuses the file if they are more than half."""

    where: str
    rows: NDArray[np.int64]
    notes: list[str]

    def __call__(self, values: Array, bad: Bad, reason: str, cure: str = "") -> Array:
        """Return the values (n,) with NaN in place of bad ones (n,)."""
        if not bad.any():
            return values
        count, total = int(bad.sum()), int((bad | np.isfinite(values)).sum())
        first = int(self.rows[bad.argmax()]) + 1
        line = f"{self.where}: {count} of {total} readings refused, the first in row {first}: {reason}"
        if 2 * count > total:
            raise RecordError(f"{line}{cure}")
        self.notes.append(line)
        return np.where(bad, np.nan, values)


def _rows(path: Path, table: pa.Table, clock: ClockColumn, notes: list[str]) -> _Rows:
    """Read the times of a file's table, of which the longest increasing sequence is kept."""
    if not 2 <= table.num_rows <= MOST_ROWS:
        raise RecordError(f"{path}: {table.num_rows} rows; at least 2 are needed, and at most {MOST_ROWS} are read")
    every = np.arange(table.num_rows)
    refuse = _Refusing(f"{path}: time, column {clock.column!r}", every, notes)
    if clock.unit == "iso":
        start = 0.0 if clock.start is None else _moment(str(clock.start))
        time, bad = _parsed(path, table, clock.column, _moment)
        cure = f"; texts such as {_FORMS} are needed"
        first = str(table[clock.column][int(np.isfinite(time).argmax())])
        if isinstance(clock.start, str) and np.isfinite(time).any() and _form(first) != _form(clock.start):
            raise RecordError(
                f"{path}: time.start is {clock.start}, and column {clock.column!r} begins with {first}: both need a "
                "date or none, and a time zone or none"
            )
    else:
        start = float(clock.start or 0.0) * UNITS[clock.unit]
        time, bad = _parsed(path, table, clock.column, float)
        time = time * UNITS[clock.unit]
        cure = _of_commas(table, clock.column, bad)
    time, passes = _past_midnight(time, start)
    notes += [f"{path}: time, column {clock.column!r}: passes midnight; later rows are of the next day"] * passes
    time = refuse(time, bad | ~np.isfinite(time), "not a time", cure)
    known = np.flatnonzero(np.isfinite(time))
    kept = known[_increasing(time[known])]
    back = np.isfinite(time)
    back[kept] = False
    refuse(time, back, "it does not increase")
    return _Rows(path, table, kept, time[kept])


def _series(rows: _Rows, name: str, quantity: Any, notes: list[str]) -> tuple[Array, Array, float, float]:
    """Return the readings of a quantity, SI: times (n,), values (n,), the standard deviation of one, and at rest."""
    where, scale = f"{rows.path}: {name}, column {quantity.column!r}", UNITS[quantity.unit]
    refuse = _Refusing(where, rows.kept, notes)
    cells, bad = _parsed(rows.path, rows.table, quantity.column, float)
    raw = refuse(cells[rows.kept], bad[rows.kept], "not a number", _of_commas(rows.table, quantity.column, bad))
    empty = int((np.isnan(cells) & ~bad)[rows.kept].sum())
    if 0 < 2 * empty < len(raw):  # more: a column of a lower rate
        notes.append(f"{where}: {empty} of {len(raw)} cells are empty")
    low, high, speed, unit = _LIMITS[name]
    values = raw * scale
    if isinstance(quantity, Length):
        values = values + (quantity.constant_m or 0.0)
        if quantity.constant_m is None:
            means = "|OA| is the length itself" if name == "rope" else "it begins at the slewing axis, not at a rail"
            notes.append(f"{where}: {name}.constant_m is not stated, and taken as 0: {means}")
    if isinstance(quantity, Load):
        values = values + 1000 * quantity.grab_t * quantity.net
    wrong = ~((values > low) & (values < high)) & np.isfinite(values)
    values = refuse(values, wrong, f"not between {low:g} and {high:g} {unit}", _hint(name, raw[wrong]))
    known = np.isfinite(values)
    time, values, at = rows.time[known], values[known], rows.kept[known]
    if len(values) < 2:
        raise RecordError(f"{where}: {len(values)} readings; at least 2 are needed")
    every = float(np.median(np.diff(time)))
    if not 1 / _MOST_RATE < every * quantity.rate_hz < _MOST_RATE:
        raise RecordError(
            f"{where}: a reading every {every:g} s, but {name}.rate_hz states {quantity.rate_hz:g} a second; "
            "is time.unit right?"
        )
    if name == "slew":
        values = np.unwrap(values) * (-1 if quantity.clockwise else 1)
    hoist = Hoist(speed, 2 / quantity.rate_hz + 4 * quantity.jitter, quantity.resolution * scale)
    fast = np.abs(np.diff(values)) > hoist.reach(np.diff(time))
    what = f"faster than {speed:g} {unit}/s"
    if np.mean(fast) > _MOST_FAST:
        raise RecordError(f"{where}: {100 * np.mean(fast):.0f} % of the steps are {what}; is {name}.unit right?")
    believed = consistent(time, values, hoist) if fast.any() else np.ones(len(time), bool)
    _Refusing(where, at, notes)(values, ~believed, what)
    time, values = time[believed], values[believed]
    moving = float(np.quantile(np.abs(np.diff(values) / np.diff(time)), _MOVING))  # most of a record is rest
    still_sd = quantity.resolution * scale / math.sqrt(12)
    sd = math.hypot(still_sd, moving * quantity.jitter)
    if name == "luff":
        lever = quantity.jib_m * float(np.sqrt(np.mean(np.sin(values) ** 2)))
        sd, still_sd = sd * lever, still_sd * lever
        values = quantity.pivot_m + quantity.jib_m * np.cos(values)
    return time - quantity.lag_s, values, sd, still_sd


def _setpoints(rows: _Rows, name: str, quantity: Slew | Radius | Luff, notes: list[str]) -> tuple[Array, Array]:
    """Return the speeds demanded of a drive, SI per second: times (n,) and values (n,)."""
    where, speed, unit = f"{rows.path}: {name}.setpoint, column {quantity.setpoint!r}", *_LIMITS[name][2:]
    cells, bad = _parsed(rows.path, rows.table, quantity.setpoint, float)
    sign = -1 if isinstance(quantity, Slew) and quantity.clockwise else 1
    values = sign * cells[rows.kept] * UNITS[quantity.setpoint_unit]
    wrong = bad[rows.kept] | (np.abs(values) > speed)
    if wrong.any():  # no reason to refuse the readings
        first = int(rows.kept[wrong.argmax()]) + 1
        notes.append(
            f"{where}: {wrong.sum()} of {len(wrong)} are not used, the first in row {first}: not a number, or faster "
            f"than {speed:g} {unit}/s; is {name}.setpoint_unit right?"
        )
    known = np.isfinite(values) & ~wrong
    return rows.time[known] - quantity.lag_s, values[known]


def _of_radius(setpoints: Array, radius: Array, luff: Luff) -> Array:
    """Turn setpoints of the luff angle (n,), rad/s, into those of the radius, m/s, as at their last change."""
    known = np.flatnonzero(np.isfinite(radius))
    if not len(known):
        return np.full(len(setpoints), np.nan)
    out = np.interp(np.arange(len(radius)), known, radius[known]) - luff.pivot_m
    changed = np.append(True, np.diff(setpoints) != 0)
    per_rad = -np.sqrt(np.maximum(luff.jib_m**2 - out**2, 0))
    return np.asarray(setpoints * per_rad[np.maximum.accumulate(np.where(changed, np.arange(len(radius)), 0))])


def _parsed(path: Path, table: pa.Table, name: str, parse: Any) -> tuple[Array, Bad]:
    """Return a column as numbers (n,), NaN where empty, and which cells are something else (n,)."""
    if table.column_names.count(name) != 1:
        found = "duplicate" if name in table.column_names else "missing"
        raise RecordError(f"{path}: column {name!r} is {found}; there are: {shown(', '.join(table.column_names))}")
    column = table[name]
    if pa.types.is_floating(column.type) or pa.types.is_integer(column.type):
        values = np.asarray(column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False), float)
        return values, ~np.isfinite(values) & ~column.is_null().to_numpy(zero_copy_only=False)
    if not pa.types.is_string(column.type):
        try:
            column = column.cast(pa.string())
        except pa.ArrowException:
            raise RecordError(f"{path}: column {name!r} has the unsupported type {column.type}") from None
    values, bad = np.full(table.num_rows, np.nan), np.zeros(table.num_rows, bool)
    for row, text in enumerate(column.to_pylist()):
        if text is None or not text.strip():
            continue
        with suppress(ValueError, RecordError, OverflowError):
            values[row] = parse(text)
        bad[row] = not math.isfinite(values[row])
    return values, bad


def _of_commas(table: pa.Table, name: str, bad: Bad) -> str:
    """Name the cure where the first of the bad cells (n,) of a column has a decimal comma."""
    return decimal_comma(str(table[name][int(bad.argmax())])) if bad.any() else ""


_FORMS = "2026-03-02T08:15:00, 02.03.2026 08:15:00 or 08:15:00"


def _moment(text: str) -> float:
    """Read a date with a time, or a time of day: s since `EPOCH`, or since midnight; without a zone it is UTC."""
    try:
        return (_stated(text) - EPOCH).total_seconds()
    except ValueError:
        raise RecordError(f"start: must be such as {_FORMS}, got {shown(text)}") from None


def _form(text: str) -> tuple[bool, bool]:
    """Whether a time states its date, and its zone."""
    return not _of_day(text), _stated(text, None).tzinfo is not None


def _of_day(text: str) -> bool:
    return text.strip()[2:3] == ":"


def _stated(text: str, zone: tzinfo | None = UTC) -> datetime:
    text = re.sub(r"^(\d\d)\.(\d\d)\.(\d{4}) +", r"\3-\2-\1T", text.strip())  # day, month, year
    found = datetime.fromisoformat(f"{EPOCH:%Y-%m-%d}T{text}" if _of_day(text) else text)
    return found if found.tzinfo and not (zone and _of_day(text)) else found.replace(tzinfo=zone)


def _past_midnight(time: Array, start: float) -> tuple[Array, bool]:
    """Return times (n,) since the start, s, and whether they are times of day that pass midnight."""
    known = np.isfinite(time)
    day = time[known]
    steps = np.diff(day, prepend=day[:1])
    days = np.maximum(np.cumsum((steps < -DAY_S / 2).astype(int) - (steps > DAY_S / 2)), 0)
    if not days.any() or not days[-1] or day.min() < 0 or day.max() > DAY_S:
        return time - start, False
    later = time.copy()
    later[known] += DAY_S * days
    first, last = day[0], day[-1] + DAY_S * days[-1]
    after = not first <= start <= last and first <= start + DAY_S <= last
    return later - start - DAY_S * after, True


def _increasing(time: Array) -> NDArray[np.int64]:
    """Return the indices of a longest increasing sequence (Fredman 1975)."""
    if (np.diff(time) > 0).all():
        return np.arange(len(time))
    ends: list[float] = []  # least end of a sequence of each length, and where it is
    at: list[int] = []
    before = np.full(len(time), -1)
    for i, t in enumerate(time.tolist()):
        k = bisect_left(ends, t)
        if ends[k : k + 1] == [t]:  # of equal times the first is kept
            continue
        before[i] = at[k - 1] if k else -1
        ends[k : k + 1], at[k : k + 1] = [t], [i]
    chain = [at[-1]]
    while before[chain[-1]] >= 0:
        chain.append(int(before[chain[-1]]))
    return np.array(chain[::-1])


def _hint(name: str, raw: Array) -> str:
    """Suggest the units in which readings (n,) would be plausible."""
    low, high = _LIMITS[name][:2] if name in _UNITS_OF else _USUAL_M
    units = _UNITS_OF.get(name, LENGTHS)
    middle = float(np.median(raw)) if len(raw) else math.nan
    fitting = [unit for unit in units if low < middle * UNITS[unit] < high]
    return f"; {middle:g} would be plausible in {' or '.join(fitting)}: see {name}.unit" if fitting else ""
