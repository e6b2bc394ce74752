"""An evaluation as one HTML page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from simgrab.instrument.run.figures import BLUE, GREY, RED, mark_lost
from simgrab.instrument.run.runs import Run
from simgrab.judge.evaluate.table import tables
from simgrab.judge.evaluate.truths import Truths
from simgrab.reports import html
from simgrab.reports.plots import Figure


def page(run: Run, known: Truths, evaluation: Mapping[str, Any]) -> str:
    """Write the page of what `simgrab.judge.evaluate.evaluation.evaluate` found."""
    return html.page(
        "evaluation.html",
        run=run,
        trace=trace(run, known),
        budget=None if evaluation["budget"] is None else chain(evaluation["budget"]),
        tables=tables(evaluation),
    )


def trace(run: Run, known: Truths) -> Figure:
    """Draw true and measured swing, and the error below."""
    figure = Figure(figsize=(12, 5.2), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
    timed = run.time is not None
    at = run.time if run.time is not None else np.arange(len(run.names), dtype=float)
    style: dict[str, Any] = {"lw": 0.9} if timed else {"lw": 0, "marker": ".", "ms": 3 if len(at) > 200 else 7}
    alpha, true = np.rad2deg(run.alpha), np.rad2deg(known.alpha)
    above.plot(at, true, color=GREY, label="true", rasterized=True, **(style | ({"lw": 2.2} if timed else {})))
    above.plot(at, alpha, color=BLUE, label="measured", rasterized=True, **style)
    mark_lost(above, at, run)
    above.axhline(10, color=RED, lw=1, ls="--")
    above.set(ylabel="α (deg)", ylim=(-0.4, None))
    above.legend(fontsize=8, loc="upper right")
    ends = np.rad2deg(run.ends)
    below.fill_between(at, ends[:, 0] - alpha, ends[:, 1] - alpha, color=GREY, alpha=0.45, lw=0, rasterized=True)
    below.plot(at, alpha - true, color=BLUE, rasterized=True, **style)
    below.axhline(0, color="black", lw=0.6)
    below.set(xlabel="time (s)" if timed else "frame", ylabel="error (deg)")
    return figure


def chain(budget: Mapping[str, Any]) -> Figure:
    """Draw the budget's chain as bars, the paper's method beside it."""
    rows = [(row["stage"], row["rmse_deg"], BLUE) for row in (*budget["chain"], budget["run"])]
    rows += [(f"paper's method, {row['stage']}", row["rmse_deg"], GREY) for row in budget["paper"]]
    figure = Figure(figsize=(10, 0.42 * len(rows) + 0.9), layout="constrained")
    axes = figure.subplots()
    names, values, colours = zip(*rows, strict=True)
    bars = axes.barh(range(len(rows)), [value or 0.0 for value in values], color=colours)
    axes.bar_label(bars, ["refused" if v is None else f"{v:.3f}°" for v in values], padding=3, fontsize=8)
    axes.set_yticks(range(len(rows)), names, fontsize=8)
    axes.invert_yaxis()
    axes.set(xlabel=f"RMSE of α (deg) in {budget['run']['frames']} frames")
    axes.margins(x=0.12)
    return figure
