"""Scores as a table, a CSV file and a page."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from simgrab.errors import BenchError, first_line
from simgrab.io.destination import writing
from simgrab.io.files import write
from simgrab.io.parse import read_text
from simgrab.lab.bench.entry import MethodDescription, number
from simgrab.lab.bench.score import SCORER, THRESHOLDS_DEG, EntryScore, IntervalEstimate
from simgrab.lab.bench.season import Season

HEAD = (
    "method", "track", "rank", "average recall (%)", "answered (%)", "RMSE (°)", "95 % (°)", "at 10° (°)",
    "coverage (%)", "width (°)", "alarms missed", "false", "delay (frames)", "ms a frame",
)  # fmt: skip
BRIEF = {
    "method": "method", "track": "track", "rank": "rank", "average recall (%)": "recall %", "RMSE (°)": "RMSE °",
    "coverage (%)": "cover %", "alarms missed": "missed", "false": "false",
}  # fmt: skip
"""Columns for a terminal, and their heads there."""
_FIGURES = {
    "average_recall": (100, 1), "answered": (100, 1), "rmse_deg": (1, 3), "p95_deg": (1, 3), "at_10_deg": (1, 3),
    "coverage": (100, 1), "width_deg": (1, 3), "alarms_due": (1, 0), "alarms_missed": (1, 0), "alarms_false": (1, 0),
    "alarm_delay_frames": (1, 1), "ms_per_frame": (1, 1),
}  # fmt: skip
NOTE = (
    "Average recall: the mean over errors of "
    + ", ".join(f"{t:g}" for t in THRESHOLDS_DEG)
    + "° of the share of frames that lie within; a frame without an angle lies within none. In brackets: 95 % "
    "intervals over clips. Entries of a track share a rank unless their average recall differs significantly. The "
    "tilt is never aligned out."
)


def brief(scores: Sequence[EntryScore]) -> list[tuple[str, ...]]:
    """Rows of the columns of `BRIEF`, without intervals, for a terminal of 80 columns."""
    places = [HEAD.index(name) for name in BRIEF]
    return [tuple(row[i] if i < 2 else row[i].partition(" (")[0] for i in places) for row in map(_row, scores)]


def _row(one: EntryScore) -> tuple[str, ...]:
    """Text under `HEAD`."""
    text = {name: _text(one.figures[name], *how) for name, how in _FIGURES.items()}
    missed = f"{text.pop('alarms_missed')} of {text.pop('alarms_due')}"
    cells = list(text.values())
    cells.insert(list(text).index("alarms_false"), missed)
    own = (f"({one.about.method})", "", "") if one.sanity else (one.about.method, one.about.track, str(one.rank))
    return (*own, *cells)


def _text(figure: IntervalEstimate, times: float, digits: int) -> str:
    if figure.value is None:
        return "–"
    value = f"{times * figure.value:.{digits}f}"
    if figure.low is None or figure.high is None:
        return value
    return f"{value} ({times * figure.low:.{digits}f} to {times * figure.high:.{digits}f})"


_FIXED = ("season", "commitment", "scorer", "rank", "method", "track", "sanity", "clips", "frames")
_COLUMNS = (*_FIXED, *(f"{name}{end}" for name in _FIGURES for end in ("", "_low", "_high")))


Board = tuple[str, Sequence[EntryScore]]  # its title, and the scores


def _board(season: str, scorer: str, scores: Sequence[EntryScore]) -> Board:
    one = scores[0]
    return f"Season {season}: {one.clips} clips, {one.frames} frames, scorer {scorer}", scores


def table(scores: Sequence[EntryScore], season: Season) -> str:
    """Scores as a CSV file: each figure with the ends of its interval, to nine decimals."""
    text = io.StringIO()
    out = csv.writer(text, lineterminator="\n")
    out.writerow(_COLUMNS)
    for one in scores:
        figures = (one.figures[name] for name in _FIGURES)
        ends = [v for figure in figures for v in (figure.value, figure.low, figure.high)]
        out.writerow(
            [season.name, season.commitment, SCORER, one.rank, one.about.method, one.about.track, int(one.sanity)]
            + [one.clips, one.frames]
            + ["" if v is None else f"{v:.9f}" for v in ends]
        )
    return text.getvalue()


def read(path: Path) -> Board:
    """Read the scores of a season from a CSV file that `table` made; raises `BenchError` in one line, with the file."""
    lines = csv.DictReader(io.StringIO(read_text(path, BenchError)), strict=True)
    try:
        if tuple(lines.fieldnames or ()) != _COLUMNS:
            raise ValueError("the header is not that of bench score --out")
        found = list(lines)
        for count, row in enumerate(found, 1):
            if None in row or None in row.values():  # a row that is too long, or too short
                raise ValueError(f"row {count} must have {len(_COLUMNS)} cells")
        if len({(row["season"], row["commitment"], row["scorer"]) for row in found}) != 1:
            raise ValueError("its rows must be of one season, one commitment and one scorer")
        scores = [_parsed(row) for row in found]
    except (ValueError, csv.Error) as problem:
        raise BenchError(f"{path}: not scores of simgrab bench ({first_line(problem)})") from None
    return _board(found[0]["season"], found[0]["scorer"], scores)


def _parsed(row: dict[str, str]) -> EntryScore:
    figures = {}
    for name in _FIGURES:
        cells = (name, f"{name}_low", f"{name}_high")
        figures[name] = IntervalEstimate(*(number(row[cell], cell) if row[cell] else None for cell in cells))
    about = MethodDescription(row["method"], row["track"], row["season"])
    clips, frames, rank = (int(row[name]) for name in ("clips", "frames", "rank"))
    return EntryScore(about, frames, clips, figures, bool(int(row["sanity"])), np.empty(0), rank)


def save(scores: Sequence[EntryScore], season: Season, *, csv_file: Path | None, page: Path | None) -> None:
    """Write scores as a CSV file, as a page, or both."""
    if csv_file is not None:
        with writing(csv_file, BenchError):
            write(csv_file, table(scores, season).encode())
    if page is not None:
        save_page([_board(season.name, SCORER, scores)], page)


def save_page(boards: Sequence[Board], page: Path) -> None:
    """Write the leaderboard of some seasons as one HTML page."""
    from simgrab.reports import html

    shown = [(title, list(map(_row, scores))) for title, scores in boards]
    with writing(page, BenchError):
        write(page, html.page("bench.html", head=HEAD, boards=shown, note=NOTE).encode())
