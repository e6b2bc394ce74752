"""Sum up replications, whatever their number, and judge them by a study's limits."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from simgrab.instrument.estimate.intervals import student
from simgrab.lab.stress.axes import Value
from simgrab.lab.stress.study import Accept, Study, place
from simgrab.model.geometry import Array

Point = tuple[Value, ...]

BIAS_ERRORS, BIAS_LEVEL = 3.0, 0.9973  # of many replications, and their level
COVERAGE = (0.93, 0.97)
# Below so many replications the coverage's own error is larger than what is asked of it, and is allowed for.
COUNT_FOR_COVERAGE = 1000


@dataclass(frozen=True)
class MonteCarloFigure:
    """One number with its Monte Carlo standard errors: mean and root mean square over ``count`` replications."""

    count: int
    mean: float
    mean_se: float
    rms: float
    rms_se: float

    @property
    def z(self) -> float:
        """Size of the mean in standard errors."""
        return abs(self.mean) / self.mean_se if self.mean_se > 0 else (0.0 if self.mean == 0 else math.inf)

    def statistic(self, name: str) -> tuple[float, float]:
        """Give a statistic and its standard error."""
        return {"mean": (self.mean, self.mean_se), "rms": (self.rms, self.rms_se), "z": (self.z, 0.0)}[name]


NOTHING = MonteCarloFigure(0, math.nan, math.nan, math.nan, math.nan)


def figure(values: Array) -> MonteCarloFigure:
    """Sum up values, those left out that are not finite."""
    return _figure(np.array(_powers(values)))


def _powers(values: Array) -> tuple[float, float, float, float]:
    v = values[np.isfinite(values)]
    return float(len(v)), float(v.sum()), float(np.sum(v**2)), float(np.sum(v**4))


def _figure(sums: Array) -> MonteCarloFigure:
    count, s1, s2, s4 = sums.tolist()
    if not count:
        return NOTHING
    mean, square = s1 / count, s2 / count
    free = max(count - 1, 1)
    mean_se = math.sqrt(max(square - mean * mean, 0.0) / free)
    rms = math.sqrt(square)
    rms_se = math.sqrt(max(s4 / count - square * square, 0.0) / free) / (2 * rms) if rms > 0 else 0.0
    return MonteCarloFigure(int(count), mean, mean_se, rms, rms_se)


@dataclass
class StudySummary:
    """Figures of a study by point, estimator and column (``refused`` among them), of rows that are added in parts.

    Only counts and sums of powers 1, 2 and 4 are kept.
    """

    study: Study
    sums: dict[tuple[Point, str], Array] = field(default_factory=dict)  # (columns + 1, 4); the last is `refused`

    def add(self, table: pa.Table) -> None:
        """Take the rows of a part, which are all of one point."""
        if not table.num_rows:
            return
        point = tuple(table[s.axis][0].as_py() for s in self.study.axes)
        for name in self.study.estimators:
            rows = table.filter(pc.equal(table["estimator"], name))
            if not rows.num_rows:
                continue
            refused = (rows["status"].to_numpy(zero_copy_only=False) != "ok").astype(float)
            values = [np.asarray(rows[c].to_numpy(zero_copy_only=False), float) for c in self.study.columns]
            self.sums[point, name] = self.sums.get((point, name), 0) + np.array([*map(_powers, (*values, refused))])

    def at(self, point: Point, estimator: str, column: str) -> MonteCarloFigure:
        """Give a figure; an empty one where the estimator was not tried."""
        sums = self.sums.get((point, estimator))
        return NOTHING if sums is None else _figure(sums[(*self.study.columns, "refused").index(column)])

    def table(self) -> pa.Table:
        """One row a figure."""
        rows: list[dict[str, Any]] = []
        for point, name in self.sums:
            place = {s.axis: v for s, v in zip(self.study.axes, point, strict=True)}
            for column in (*self.study.columns, "refused"):
                rows.append({**place, "estimator": name, "quantity": column, **asdict(self.at(point, name, column))})
        return pa.Table.from_pylist(rows)


@dataclass(frozen=True)
class LimitVerdict:
    """One limit: where, what was found and what was accepted."""

    study: str
    text: str
    found: str
    passed: bool


def judge(summary: StudySummary) -> list[LimitVerdict]:
    """Hold a study's figures against its limits."""
    study = summary.study
    result = [_accepted(summary, accept) for accept in study.accept]
    if study.holds:
        for name in study.consistent:
            result += _consistent(summary, name)
    return result


def _accepted(summary: StudySummary, accept: Accept) -> LimitVerdict:
    figure = summary.at(accept.at, accept.estimator, accept.quantity)
    value, error = figure.statistic(accept.statistic)
    reach = _standard_errors(figure.count) * error
    low = -math.inf if accept.low is None else accept.low
    high = math.inf if accept.high is None else accept.high
    limits = f"at least {low:g}" if accept.high is None else f"at most {high:g}" if accept.low is None else ""
    limits = limits or f"from {low:g} to {high:g}"
    where = f"{accept.estimator}, {place(summary.study, accept.at)}"
    text = f"{where}: {accept.statistic} of {accept.quantity} {limits}"
    if accept.says:
        text += f" ({accept.says})"
    passed = figure.count > 0 and value + reach >= low and value - reach <= high
    found = f"{value:.4f} ± {error:.4f}" if figure.count else "no value in any replication"
    return LimitVerdict(summary.study.name, text, found, bool(passed))


def _standard_errors(count: int) -> float:
    """How many a limit allows for: of few replications Student's quantile, as they show their own spread badly."""
    return max(BIAS_ERRORS, float(student(BIAS_LEVEL, count - 1)))


def _consistent(summary: StudySummary, name: str) -> Iterator[LimitVerdict]:
    study = summary.study
    for column in ("beta_error_deg", "sigma_error_deg"):
        f = summary.at(study.holds, name, column)
        text = f"{name}: no bias of {column[: column.index('_')]} where the assumption holds"
        yield LimitVerdict(
            study.name, text, f"{f.mean:+.4f} ± {f.mean_se:.4f} deg", bool(f.z <= _standard_errors(f.count))
        )
    for column in ("cover_beta", "cover_sigma"):
        f = summary.at(study.holds, name, column)
        slack = BIAS_ERRORS * math.sqrt(0.95 * 0.05 / max(f.count, 1)) if f.count < COUNT_FOR_COVERAGE else 0.0
        text = f"{name}: 95 % interval of {column.removeprefix('cover_')} covers 93 to 97 % where the assumption holds"
        passed = COVERAGE[0] - slack <= f.mean <= COVERAGE[1] + slack
        found = f"{100 * f.mean:.1f} ± {100 * f.mean_se:.1f} %" if f.count else "no interval in any replication"
        yield LimitVerdict(study.name, text, found, bool(passed))


@dataclass(frozen=True)
class StudyResult:
    """A finished study: its figures, and how they stand against its limits."""

    summary: StudySummary
    verdicts: tuple[LimitVerdict, ...]
