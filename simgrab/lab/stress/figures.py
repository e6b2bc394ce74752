"""Figures of studies: six panels of curves for each value of the second axis, and the map of convergence."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from simgrab.lab.stress.axes import Value
from simgrab.lab.stress.convergence import population, starts_at_zero
from simgrab.lab.stress.laws import LAWS
from simgrab.lab.stress.study import axis_of, stated
from simgrab.lab.stress.summary import Point, StudySummary
from simgrab.model.geometry import Array
from simgrab.reports.plots import Axes, Figure, rc_context
from simgrab.text import printable

GREY = "#8a8f94"
COLOURS = ("#1f5a8a", "#c8551b", "#3b7d4f", "#7a4a9e", GREY, "#b0902a", "#2a9d9d")
_LOG_AXES = ("n", "sigma")
_STYLE: Any = {"font.size": 8.5, "svg.fonttype": "none", "axes.titlesize": 9.5}
_BOLD: Any = {"axes.titleweight": "bold", "axes.titley": 1.0}

Curve = tuple[str, str, str, float]  # column, statistic, line style, factor


def slices(summary: StudySummary) -> list[tuple[str, list[Point]]]:
    """Points of the first axis, for each value of the second, with what to call them."""
    points, axes = summary.study.points, summary.study.axes
    if len(axes) == 1:
        return [("", points)]
    return [(stated(axes[1].axis, value), [p for p in points if p[1] == value]) for value in axes[1].values]


def draw(summary: StudySummary, points: Sequence[Point]) -> Figure:
    """Draw bias, RMSE, coverage, refusals, α̂ at a true 10°, and missed and false alarms."""
    with rc_context(_STYLE | _BOLD):
        figure = Figure(figsize=(11.5, 6.0))
        figure.subplots_adjust(0.06, 0.11, 0.99, 0.95, 0.2, 0.36)
        (bias, rms, cover), (refused, ten, alarm) = figure.subplots(2, 3)
        panels: tuple[tuple[Axes, str, str, tuple[Curve, ...]], ...] = (
            (bias, "bias of β̂", "deg", (("beta_error_deg", "mean", "-", 1),)),
            (rms, "RMSE of β̂", "deg", (("beta_error_deg", "rms", "-", 1),)),
            (cover, "95 % covers β —, σ - -, β by blocks ···", "%",
             (("cover_beta", "mean", "-", 100), ("cover_sigma", "mean", "--", 100),
              ("blocks_cover_beta", "mean", ":", 100))),
            (refused, "records refused", "%", (("refused", "mean", "-", 100),)),
            (ten, "α̂ at a true 10°: worst direction —, mean - -", "deg",
             (("alpha10_most_deg", "mean", "-", 1), ("alpha10_error_deg", "mean", "--", 1))),
            (alarm, "11° missed —, 9° alarms - -", "%",
             (("miss", "mean", "-", 100), ("false_alarm", "mean", "--", 100))),
        )  # fmt: skip
        values = [p[0] for p in points]
        x = list(range(len(values))) if any(isinstance(v, str) for v in values) else [float(v) for v in values]
        for axes, title, unit, curves in panels:
            for (index, name), (column, statistic, style, factor) in itertools.product(
                enumerate(summary.study.estimators), curves
            ):
                found = factor * np.array([summary.at(p, name, column).statistic(statistic) for p in points])
                colour = COLOURS[index % len(COLOURS)]
                if np.isfinite(found).any():
                    axes.errorbar(
                        x, found[:, 0], yerr=2 * found[:, 1], fmt=style, marker="o", color=colour, ms=3,
                        lw=1.3, capsize=2, label=name if style == "-" else None,
                    )  # fmt: skip
            axes.set(title=title, ylabel=unit)
            _ticks(axes, summary.study.axes[0].axis, values, x)
        bias.set_yscale("symlog", linthresh=0.01)
        rms.set_yscale("log")
        cover.axhline(95, color=GREY, lw=0.8, ls=(0, (1, 3)))
        for axes in (cover, refused, alarm):
            axes.set_ylim(-4, 104)
        bias.legend(fontsize=7.5)
        return figure


def _ticks(axes: Axes, name: str, values: Sequence[Value], x: Sequence[float]) -> None:
    if any(isinstance(v, str) for v in values):
        axes.set_xticks(x, [printable(v) for v in values], rotation=20, ha="right", parse_math=False)
    elif name in _LOG_AXES and min(x) > 0:
        axes.set_xscale("log")
    unit = axis_of(name).unit
    axes.set_xlabel(f"{name} ({unit})" if unit else name)
    axes.grid(lw=0.4, alpha=0.6)


def convergence(summary: StudySummary) -> Figure:
    """Draw share converged from start 0 for each distribution, at the largest n, and three curves."""
    laws, ns, betas, sigmas = (s.values for s in summary.study.axes)
    beta, sigma = np.array(betas, float), np.array(sigmas, float)
    n, (name, *_) = ns[-1], summary.study.estimators

    def means(column: str, law: Value) -> Array:
        """Means of a column, shape (β, σ)."""
        return np.array([[summary.at((law, n, b, s), name, column).mean for s in sigmas] for b in betas])

    with rc_context(_STYLE):
        figure = Figure(figsize=(11.5, 6.6), layout="constrained")
        above, below = np.ravel(np.asarray(figure.subfigures(2, 1)))
        maps = np.atleast_1d(above.subplots(1, len(laws), sharey=True))
        rates, where, steps = below.subplots(1, 3)
        middle = len(sigmas) // 2
        for axes, law, colour in zip(maps, laws, itertools.cycle(COLOURS), strict=False):
            kurtosis = LAWS[str(law)].kurtosis
            share = 100 * means("converges", law)
            axes.imshow(share, origin="lower", aspect="auto", cmap="RdYlGn", vmin=0, vmax=100, alpha=0.75)
            for (i, j), v in np.ndenumerate(share):
                foretold = starts_at_zero(np.deg2rad(beta[i]), np.deg2rad(sigma[j]), kurtosis)
                axes.text(j, i, f"{v:.0f}" + ("" if foretold else "*"), ha="center", va="center", fontsize=7)
            axes.set_xticks(range(len(sigma)), [f"{s:g}" for s in sigma])
            axes.set_yticks(range(len(beta)), [f"{b:g}" for b in beta])
            axes.set(title=str(law), xlabel="σ (deg)")
            linear, rate = means("rate_linear", law), means("rate", law)
            rates.plot(linear.ravel(), rate.ravel(), ".", color=colour, ms=5, label=str(law))
            found = [summary.at((law, n, b, sigmas[-1]), name, "fixed_error_deg").statistic("mean") for b in betas]
            value, error = np.array(found).T
            where.errorbar(beta, value, yerr=error, fmt="o", ms=3, color=colour, capsize=2)
            fine = np.linspace(beta.min(), beta.max(), 200)
            fixed = [population(np.deg2rad(b), np.deg2rad(sigma[-1]), kurtosis)[0] for b in fine]
            where.plot(fine, np.rad2deg(fixed) - fine, color=colour, lw=1)
            steps.plot(beta, means("iterations", law)[:, middle], "o-", ms=3, lw=1.2, color=colour)
        maps[0].set_ylabel("β (deg)")
        above.suptitle(f"converged from start 0 (%), n = {n:g}; *: predicted to leave its domain for n → ∞")
        ends = rates.get_xlim()
        rates.plot(ends, ends, color=GREY, lw=0.8)
        rates.set(title="contraction: measured against linearised", xlabel="cotβ*·mean(x·α/sinα)", ylabel="T′(β*)")
        rates.legend(fontsize=7)
        where.set(title=f"β* − β at σ = {sigma[-1]:g}°; lines: theory, n → ∞", xlabel="β (deg)", ylabel="deg")
        steps.set(title=f"steps from start 0 at σ = {sigma[middle]:g}°", xlabel="β (deg)", ylabel="mean iterations")
        for axes in (where, steps):
            axes.grid(lw=0.4, alpha=0.6)
        return figure
