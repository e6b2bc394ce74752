"""The report: limits, a heat map of assumption against estimator, and every study's curves in words."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from simgrab.judge.stress import convergence_figures, figures
from simgrab.judge.stress.score import MARGIN_DEG
from simgrab.judge.stress.summary import Summary
from simgrab.pages.html import page, svg, table, text
from simgrab.utilities.files import drafted

if TYPE_CHECKING:
    from simgrab.judge.stress.summary import Finding

_STYLE = """
td.hot { text-align: right; font-variant-numeric: tabular-nums; } ul { margin: .5rem 0 0; padding-left: 1.2rem; }
.bad { color: #a11; font-weight: 600; } details { margin: .6rem 0; }
"""
HALF_REFUSED = 0.5

Share = Callable[[Callable[[Any], Any], Iterable[Any]], Iterator[Any]]


def write(findings: Sequence[Finding], path: Path, share: Share) -> None:
    """Write the page, which needs no other file; ``share`` spreads the drawing over processes."""
    sections = dict(share(_section, findings))
    with drafted(path) as draft:
        draft.write_text(_page(findings, sections), encoding="utf-8")


def _page(findings: Sequence[Finding], sections: dict[str, str]) -> str:
    curves = [f for f in findings if f.summary.study.kind == "estimators"]
    lead = (
        "Which assumption breaks which estimator, and by how much. Errors are estimate minus truth; bars are two Monte "
        "Carlo standard errors."
    )
    parts = ["<h2>Limits</h2>", _limits(findings)]
    if curves:
        parts += [
            "<h2>Assumption × estimator</h2>",
            "<p>Error of α̂ at a true 10° in the worst direction (deg), mean over replications, at the worst value of "
            f"the axis. Beyond {MARGIN_DEG:g}° a swing of 11° can be missed, or one of 9° set off the alarm. "
            "“refused”: more than half of the records.</p>",
            _heat(curves),
        ]
    parts += [sections[f.summary.study.name] for f in findings]
    return page("The stress laboratory", lead, parts, _STYLE)


def _limits(findings: Sequence[Finding]) -> str:
    verdicts = [v for f in findings for v in f.verdicts]
    if not verdicts:
        return "<p>None were set.</p>"
    failed = [v for v in verdicts if not v.passed]
    said = f"<p>{len(verdicts) - len(failed)} of {len(verdicts)} limits are met.</p>"
    head = ["study", "limit", "found", ""]

    def body(some: Sequence[Any]) -> list[list[str]]:
        return [[v.study, v.text, v.found, "met" if v.passed else "NOT MET"] for v in some]

    if failed:
        said += table(head, body(failed)).replace("<td>NOT MET", "<td class='bad'>NOT MET")
    met = [v for v in verdicts if v.passed]
    return said + f"<details><summary>Limits that are met</summary>{table(head, body(met))}</details>"


def worst_at_ten(summary: Summary, name: str) -> tuple[float, float]:
    """Largest mean error at a true 10° over the points, deg, and largest share of refused records."""
    errors = [summary.at(p, name, "alpha10_most_deg").mean for p in summary.study.points]
    refused = [summary.at(p, name, "refused").mean for p in summary.study.points]
    finite = [e for e in errors if np.isfinite(e)]
    return max(finite, default=np.nan), max((r for r in refused if np.isfinite(r)), default=np.nan)


def _heat(findings: Sequence[Finding]) -> str:
    names = list(dict.fromkeys(name for f in findings for name in f.summary.study.estimators))
    head = "".join(f"<th class='n'>{text(name)}</th>" for name in names)
    rows = []
    for finding in findings:
        study = finding.summary.study
        cells = "".join(_cell(finding.summary, name) if name in study.estimators else "<td></td>" for name in names)
        what = ", ".join(f"{s.axis} {span(s.values)}" for s in study.axes)
        rows.append(f"<tr><td><a href='#{study.name}'>{text(study.name)}</a></td><td>{text(what)}</td>{cells}</tr>")
    return f"<table><thead><tr><th>study</th><th>axes</th>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"


def span(values: Sequence[Any]) -> str:
    """Say from where to where an axis goes."""
    if any(isinstance(v, str) for v in values):
        return f"({len(values)} kinds)"
    return f"{min(values):g} … {max(values):g}" if len(values) > 1 else f"{values[0]:g}"


def _cell(summary: Summary, name: str) -> str:
    error, refused = worst_at_ten(summary, name)
    if refused > HALF_REFUSED:
        return "<td class='hot' style='background:#d9c6e8'>refused</td>"
    if not np.isfinite(error):
        return "<td></td>"
    heat = float(np.clip((np.log10(max(error, 1e-3)) + 1.5) / 2.5, 0, 1))  # white at 0.03°, red at 10°
    return f"<td class='hot' style='background:hsl(12 85% {96 - 38 * heat:.0f}%)'>{error:.2f}</td>"


def _section(finding: Finding) -> tuple[str, str]:
    """Write one study's part of the page."""
    summary = finding.summary
    study = summary.study
    lead = f"{study.replications} replications, seed {study.seed}, depth {study.depth}"
    if not any(s.axis == "n" for s in study.axes):
        lead += f", n = {study.n}"
    if study.given:
        lead += "; " + ", ".join(f"{k} = {v}" for k, v in study.given.items())
    if study.fewer:
        lead += "; " + ", ".join(f"{k}: {v} replications" for k, v in study.fewer.items())
    parts = [f"<h2 id='{study.name}'>{text(study.title)}</h2><p class='lead'>{text(lead)}.</p>"]
    if study.kind == "convergence":
        parts.append(_figure(convergence_figures.draw(summary), study.name, convergence_figures.sentences(summary)))
    else:
        for i, (title, points) in enumerate(figures.slices(summary)):
            said = [sentence(summary, points) for sentence in figures.SENTENCES]
            parts.append(f"<h3>{text(title)}</h3>" if title else "")
            parts.append(_figure(figures.draw(summary, points), f"{study.name}-{i}", said))
    return study.name, "\n".join(parts)


def _figure(figure: Any, name: str, sentences: Sequence[str]) -> str:
    words = "".join(f"<li>{text(s)}</li>" for s in sentences)
    return f"<figure>{svg(figure, name)}<figcaption><ul>{words}</ul></figcaption></figure>"
