"""The report: limits, a heat map of assumption against estimator, and every study's curves in words."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from simgrab.instrument.estimate import ZeroTilt
from simgrab.io import files
from simgrab.lab.stress import figures
from simgrab.lab.stress.score import MARGIN_DEG
from simgrab.lab.stress.study import Study, place
from simgrab.lab.stress.summary import MonteCarloFigure, Point, StudyResult, StudySummary
from simgrab.reports.html import page, svg

HALF_REFUSED = 0.5
# Curve, its column and statistic, factor and unit, and the key of which the largest is the worst.
_CURVES: tuple[tuple[str, str, str, float, str, Callable[[MonteCarloFigure], float]], ...] = (
    ("bias of β̂", "beta_error_deg", "mean", 1, "°", lambda f: abs(f.mean)),
    ("RMSE of β̂", "beta_error_deg", "rms", 1, "°", lambda f: f.rms),
    ("95 % interval of β covers it", "cover_beta", "mean", 100, " %", lambda f: -f.mean),
    ("95 % interval of σ covers it", "cover_sigma", "mean", 100, " %", lambda f: -f.mean),
    ("records refused", "refused", "mean", 100, " %", lambda f: f.mean),
    ("α̂ at a true 10° in the worst direction", "alpha10_most_deg", "mean", 1, "°", lambda f: f.mean),
    ("swings of 11° missed", "miss", "mean", 100, " %", lambda f: f.mean),
    ("swings of 9° that set off the alarm", "false_alarm", "mean", 100, " %", lambda f: f.mean),
)

Share = Callable[[Callable[[Any], Any], Iterable[Any]], Iterator[Any]]


def write(findings: Sequence[StudyResult], path: Path, share: Share) -> None:
    """Write the page, which needs no other file; ``share`` spreads the drawing over processes."""
    sections = {section["name"]: section for section in share(_section, findings)}
    curves = [f.summary for f in findings if f.summary.study.kind == "estimators"]
    names = list(dict.fromkeys(name for summary in curves for name in summary.study.estimators))
    verdicts = [(v, (v.study, v.text, v.found, "met" if v.passed else "NOT MET")) for f in findings for v in f.verdicts]
    text = page(
        "stress.html",
        met=[row for verdict, row in verdicts if verdict.passed],
        missed=[row for verdict, row in verdicts if not verdict.passed],
        margin_deg=MARGIN_DEG,
        estimators=names,
        heat=[(s.study.name, axes(s.study), [cell(s, name) for name in names]) for s in curves],
        sections=[sections[f.summary.study.name] for f in findings],
    )
    files.write(path, text)


def axes(study: Study) -> str:
    """Name a study's axes, each with the range of its values."""
    return ", ".join(f"{s.axis} {_span(s.values)}" for s in study.axes)


def _span(values: Sequence[Any]) -> str:
    if any(isinstance(v, str) for v in values):
        return f"({len(values)} kinds)"
    return f"{min(values):g} … {max(values):g}" if len(values) > 1 else f"{values[0]:g}"


def cell(summary: StudySummary, name: str) -> tuple[str, str]:
    """Return an estimator's largest mean error at a true 10°, deg, and its cell's colour; nothing without any."""
    errors, refused = (
        [mean for p in summary.study.points if np.isfinite(mean := summary.at(p, name, column).mean)]
        for column in ("alpha10_most_deg", "refused")
    )
    if max(refused, default=0.0) > HALF_REFUSED:
        return "refused", "#d9c6e8"
    if not errors:
        return "", ""
    heat = float(np.clip((np.log10(max(*errors, 1e-3)) + 1.5) / 2.5, 0, 1))  # white at 0.03°, red at 10°
    return f"{max(errors):.2f}", f"hsl(12 85% {96 - 38 * heat:.0f}%)"


def _section(finding: StudyResult) -> dict[str, Any]:
    """Write one study's part of the page: its words, and each figure with title and sentences."""
    summary = finding.summary
    study = summary.study
    lead = f"{study.replications} replications, seed {study.seed}, depth {study.depth}"
    if not any(s.axis == "n" for s in study.axes):
        lead += f", n = {study.n}"
    if study.given:
        lead += "; " + ", ".join(f"{k} = {v}" for k, v in study.given.items())
    if study.fewer:
        lead += "; " + ", ".join(f"{k}: {v} replications" for k, v in study.fewer.items())
    if study.kind == "convergence":
        drawn = [("", svg(figures.convergence(summary), study.name, study.title), list[str]())]
    else:
        drawn = [
            (
                title,
                svg(figures.draw(summary, points), f"{study.name}-{i}", title or study.title),
                sentences(summary, points),
            )
            for i, (title, points) in enumerate(figures.slices(summary))
        ]
    return {"name": study.name, "title": study.title, "lead": lead, "figures": drawn}


def rivals(summary: StudySummary) -> list[str]:
    """Estimators worth a word: all, but for the one that corrects nothing."""
    return [name for name in summary.study.estimators if name != ZeroTilt.name] or list(summary.study.estimators)


def extreme(
    summary: StudySummary, points: Sequence[Point], column: str, key: Callable[[MonteCarloFigure], float]
) -> tuple[MonteCarloFigure, str, Point] | None:
    """Find the estimator and the point with the largest ``key`` of a column."""
    found = [
        (figure, name, point)
        for name in rivals(summary)
        for point in points
        if (figure := summary.at(point, name, column)).count
    ]
    return max(found, key=lambda f: key(f[0]), default=None)


def sentences(summary: StudySummary, points: Sequence[Point]) -> list[str]:
    """Say of each curve where it is worst, and which estimator's worst is mildest."""
    result = []
    for name, column, statistic, factor, unit, key in _CURVES:
        found = extreme(summary, points, column, key)
        if found is None:
            continue
        figure, worst, point = found
        value, error = (factor * number for number in figure.statistic(statistic))
        text = f"{name}: at worst {value:.4g} ± {error:.2g}{unit} ({worst}, {place(summary.study, point)})"
        mildest = {}  # of those that do not refuse a tenth
        for rival in rivals(summary):
            figures = [f for p in points if (f := summary.at(p, rival, column)).count]
            if figures and all(summary.at(p, rival, "refused").mean <= 0.1 for p in points):
                mildest[rival] = max(figures, key=key)
        best = min(mildest, key=lambda rival: key(mildest[rival]), default=worst)
        if best != worst and column != "refused":
            text += f"; of {best} {factor * mildest[best].statistic(statistic)[0]:.4g}{unit}"
        result.append(f"{text}.")
    return result or ["No record was solved."]
