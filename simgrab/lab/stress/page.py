"""The report: limits, a heat map of assumption against estimator, and every study's curves in words."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from simgrab.io import files
from simgrab.lab.stress import convergence_figures, figures
from simgrab.lab.stress.score import MARGIN_DEG
from simgrab.lab.stress.study import Study
from simgrab.lab.stress.summary import Finding, Summary
from simgrab.reports.html import page, svg

HALF_REFUSED = 0.5

Share = Callable[[Callable[[Any], Any], Iterable[Any]], Iterator[Any]]


def write(findings: Sequence[Finding], path: Path, share: Share) -> None:
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


def worst_at_ten(summary: Summary, name: str) -> tuple[float, float]:
    """Largest mean error at a true 10° over the points, deg, and largest share of refused records."""
    errors = [summary.at(p, name, "alpha10_most_deg").mean for p in summary.study.points]
    refused = [summary.at(p, name, "refused").mean for p in summary.study.points]
    finite = [e for e in errors if np.isfinite(e)]
    return max(finite, default=np.nan), max((r for r in refused if np.isfinite(r)), default=np.nan)


def axes(study: Study) -> str:
    """Name a study's axes, each with the range of its values."""
    return ", ".join(f"{s.axis} {_span(s.values)}" for s in study.axes)


def _span(values: Sequence[Any]) -> str:
    if any(isinstance(v, str) for v in values):
        return f"({len(values)} kinds)"
    return f"{min(values):g} … {max(values):g}" if len(values) > 1 else f"{values[0]:g}"


def cell(summary: Summary, name: str) -> tuple[str, str]:
    """Return an estimator's largest error and the colour of its cell; nothing where there is none."""
    if name not in summary.study.estimators:
        return "", ""
    error, refused = worst_at_ten(summary, name)
    if refused > HALF_REFUSED:
        return "refused", "#d9c6e8"
    if not np.isfinite(error):
        return "", ""
    heat = float(np.clip((np.log10(max(error, 1e-3)) + 1.5) / 2.5, 0, 1))  # white at 0.03°, red at 10°
    return f"{error:.2f}", f"hsl(12 85% {96 - 38 * heat:.0f}%)"


def _section(finding: Finding) -> dict[str, Any]:
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
        figure = convergence_figures.draw(summary)
        drawn = [("", svg(figure, study.name, study.title), convergence_figures.sentences(summary))]
    else:
        drawn = [
            (
                title,
                svg(figures.draw(summary, points), f"{study.name}-{i}", title or study.title),
                [sentence(summary, points) for sentence in figures.SENTENCES],
            )
            for i, (title, points) in enumerate(figures.slices(summary))
        ]
    return {"name": study.name, "title": study.title, "lead": lead, "figures": drawn}
