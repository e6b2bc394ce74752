"""The curves of a study: one figure of six panels for each value of its second axis."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from simgrab.lab.stress import sentences
from simgrab.lab.stress.parameters import Value
from simgrab.lab.stress.study import axis_of
from simgrab.lab.stress.summary import Point, Summary
from simgrab.reports.plots import Axes, Figure, rc_context
from simgrab.text import printable

COLOURS = ("#1f5a8a", "#c8551b", "#3b7d4f", "#7a4a9e", "#8a8f94", "#b0902a", "#2a9d9d")
_LOG_AXES = ("n", "sigma")
_STYLE: Any = {
    "font.size": 8.5,
    "svg.fonttype": "none",
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titley": 1.0,
}

Curve = tuple[str, str, str, float]  # column, statistic, line style, factor


def slices(summary: Summary) -> list[tuple[str, list[Point]]]:
    """Points of the first axis, for each value of the second, with what to call them."""
    points = summary.study.points
    if len(summary.study.axes) == 1:
        return [("", points)]
    result = []
    second = summary.study.axes[1]
    for value in second.values:
        some = [p for p in points if p[1] == value]
        unit = axis_of(second.axis).unit
        result.append((f"{second.axis} = {value if isinstance(value, str) else f'{value:g}'} {unit}".strip(), some))
    return result


def draw(summary: Summary, points: Sequence[Point]) -> Figure:
    """Draw bias, RMSE, coverage, refusals, α̂ at a true 10°, and missed and false alarms."""
    with rc_context(_STYLE):
        figure = Figure(figsize=(11.5, 6.0))
        figure.subplots_adjust(0.06, 0.11, 0.99, 0.95, 0.2, 0.36)
        (bias, rms, cover), (refused, ten, alarm) = figure.subplots(2, 3)
        x = _positions(points)
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
        for axes, title, unit, curves in panels:
            for (index, name), curve in itertools.product(enumerate(summary.study.estimators), curves):
                _line(axes, summary, points, x, name, COLOURS[index % len(COLOURS)], curve)
            axes.set(title=title, ylabel=unit)
            _ticks(axes, summary, points, x)
        bias.set_yscale("symlog", linthresh=0.01)
        rms.set_yscale("log")
        cover.axhline(95, color="#8a8f94", lw=0.8, ls=(0, (1, 3)))
        for axes in (cover, refused, alarm):
            axes.set_ylim(-4, 104)
        bias.legend(fontsize=7.5)
        return figure


def _positions(points: Sequence[Point]) -> list[float]:
    values = [p[0] for p in points]
    if any(isinstance(v, str) for v in values):
        return [float(i) for i in range(len(values))]
    return [float(v) for v in values]


def _ticks(axes: Axes, summary: Summary, points: Sequence[Point], x: list[float]) -> None:
    name = summary.study.axes[0].axis
    values: list[Value] = [p[0] for p in points]
    if any(isinstance(v, str) for v in values):
        axes.set_xticks(x, [printable(v) for v in values], rotation=20, ha="right", parse_math=False)
    elif name in _LOG_AXES and min(x) > 0:
        axes.set_xscale("log")
    unit = axis_of(name).unit
    axes.set_xlabel(f"{name} ({unit})" if unit else name)
    axes.grid(lw=0.4, alpha=0.6)


def _line(
    axes: Axes, summary: Summary, points: Sequence[Point], x: list[float], name: str, colour: str, curve: Curve
) -> None:
    column, statistic, style, factor = curve
    found = np.array([summary.at(p, name, column).statistic(statistic) for p in points]) * factor
    if not np.isfinite(found).any():
        return
    axes.errorbar(
        x, found[:, 0], yerr=2 * found[:, 1], fmt=style, marker="o", color=colour, ms=3, lw=1.3, capsize=2,
        label=name if style == "-" else None,
    )  # fmt: skip


SENTENCES: tuple[Callable[[Summary, Sequence[Point]], str], ...] = (
    sentences.bias,
    sentences.spread,
    sentences.coverage,
    sentences.failures,
    sentences.alarm_error,
    sentences.alarms,
)
"""One for each panel, in reading order."""
