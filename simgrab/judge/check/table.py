"""A check as a table to read."""

from __future__ import annotations

from collections import Counter

from rich.table import Table

from simgrab.judge.check.report import Report
from simgrab.judge.check.verdicts import Verdict
from simgrab.reports.terminal import cell, stdout

LOG_WIDTH = 1000  # no limit: a log has no width
HEAD = "scene", "what", "value", "limit", "baseline (may be worse by)"
COLOURS = {"passed": "green", "failed": "red", "skipped": "yellow"}


def show(report: Report, *, quiet: bool = False) -> None:
    """Print a check: all verdicts, or with ``quiet`` those that failed, and why."""
    console = stdout()
    if not console.is_terminal:
        console = stdout(width=LOG_WIDTH)
    if not quiet:
        console.print(_table(report))
    for verdict in report.verdicts:
        if verdict.status == "failed" or (verdict.message and not quiet):
            name = " ".join(filter(None, (verdict.scene, verdict.what)))
            console.print(f"{cell(name)}: [{COLOURS[verdict.status]}]{cell(verdict.message)}[/]", soft_wrap=True)
    for name, scene in report.scenes.items():
        if scene.causes:
            console.print(cell(f"{name}: {scene.causes}"), soft_wrap=True)
    for sentence in report.common:
        console.print(cell(sentence), soft_wrap=True)
    if not quiet:
        for note in report.notes:
            console.print(cell(note), soft_wrap=True)
    if not (quiet and report.passed):
        statuses = Counter[str](verdict.status for verdict in report.verdicts)
        counts = [f"{statuses[status]} {status}" for status in COLOURS]
        state = "passed" if report.passed else "failed"
        what = cell(f"{report.suite}, seed {report.seed}: {report.instrument}")
        console.print(f"{what} [{COLOURS[state]}]{state}[/] ({', '.join(counts)})", soft_wrap=True)


def _table(report: Report) -> Table:
    """Verdicts as rows, without columns that are empty throughout; names stay whole where the terminal is narrow."""
    rows = [cells(verdict) for verdict in report.verdicts]
    used = [i for i in range(len(HEAD)) if any(row[i] for row in rows)]
    table = Table()
    for i in used:
        table.add_column(HEAD[i], justify="left" if i < 2 else "right", no_wrap=i == 1, overflow="fold")
    table.add_column("", no_wrap=True)
    for verdict, row in zip(report.verdicts, rows, strict=True):
        table.add_row(*(cell(row[i]) for i in used), f"[{COLOURS[verdict.status]}]{verdict.status}[/]")
    return table


def cells(verdict: Verdict) -> tuple[str, str, str, str, str]:
    """Write scene, metric, value, limit and baseline."""
    value = "" if verdict.value is None else f"{verdict.value:.4g}"
    value += f" ({verdict.frames})" if verdict.frames else ""
    past = ""
    if verdict.reference is not None and verdict.allowed is not None:
        past = f"{verdict.reference:.4g} ({round(verdict.allowed, 8):.2g})"
    return verdict.scene, verdict.what, value, verdict.limit, past
