"""Scores as a table, a CSV file and a page."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

from simgrab.errors import BenchError
from simgrab.judge.bench.score import SCORER, THRESHOLDS_DEG, Figure, Score
from simgrab.judge.bench.season import Season
from simgrab.utilities.destination import writing
from simgrab.utilities.files import write

HEAD = (
    "method", "track", "rank", "average recall (%)", "answered (%)", "RMSE (°)", "95 % (°)", "at 10° (°)",
    "coverage (%)", "width (°)", "alarms missed", "false", "delay (frames)", "ms a frame",
)  # fmt: skip
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


def rows(scores: Sequence[Score]) -> list[tuple[str, ...]]:
    """Rows of text under `HEAD`, the entries first and then those that test the scorer."""
    return [_row(one) for one in scores]


def _row(one: Score) -> tuple[str, ...]:
    text = {name: _text(one.figures[name], *how) for name, how in _FIGURES.items()}
    missed = f"{text.pop('alarms_missed')} of {text.pop('alarms_due')}"
    cells = list(text.values())
    cells.insert(list(text).index("alarms_false"), missed)
    own = (f"({one.about.method})", "", "") if one.sanity else (one.about.method, one.about.track, str(one.rank))
    return (*own, *cells)


def _text(figure: Figure, times: float, digits: int) -> str:
    if figure.value is None:
        return "–"
    value = f"{times * figure.value:.{digits}f}"
    if figure.low is None or figure.high is None:
        return value
    return f"{value} ({times * figure.low:.{digits}f} to {times * figure.high:.{digits}f})"


def table(scores: Sequence[Score], season: Season) -> str:
    """Scores as a CSV file: each figure with the ends of its interval, to nine decimals."""
    text = io.StringIO()
    out = csv.writer(text, lineterminator="\n")
    fixed = ["season", "commitment", "scorer", "rank", "method", "track", "sanity", "clips", "frames"]
    out.writerow(fixed + [f"{name}{end}" for name in _FIGURES for end in ("", "_low", "_high")])
    for one in scores:
        ends = [
            v for name in _FIGURES for v in (one.figures[name].value, one.figures[name].low, one.figures[name].high)
        ]
        out.writerow(
            [season.name, season.commitment, SCORER, one.rank, one.about.method, one.about.track, int(one.sanity)]
            + [one.clips, one.frames]
            + ["" if v is None else f"{v:.9f}" for v in ends]
        )
    return text.getvalue()


def save(scores: Sequence[Score], season: Season, *, csv_file: Path | None, page: Path | None) -> None:
    """Write scores as a CSV file, as a page, or both."""
    if csv_file is not None:
        with writing(csv_file, BenchError):
            write(csv_file, table(scores, season).encode())
    if page is not None:
        from simgrab.pages import html

        lead = f"Season {season.name}: {scores[0].clips} clips, {scores[0].frames} frames. Scorer {SCORER}."
        text = html.page("bench.html", lead=lead, head=HEAD, rows=rows(scores), note=NOTE)
        with writing(page, BenchError):
            write(page, text.encode())
