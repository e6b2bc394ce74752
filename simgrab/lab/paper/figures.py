"""The figures of section 4.4, and two that it lacks."""

from __future__ import annotations

import numpy as np

from simgrab.instrument.estimate import PaperIteration
from simgrab.lab.paper.paper import PaperStudy
from simgrab.lab.stress.figures import COLOURS
from simgrab.model.geometry import Array
from simgrab.reports.plots import Axes, Figure, MultipleLocator

BLUE, ORANGE, GREEN, _, GREY, _, _ = COLOURS
ROUNDING = 1e-14  # an arccosine at a few degrees knows no more; smaller differences are drawn as this


def draw_all(study: PaperStudy) -> dict[str, Figure]:
    """Draw every figure, by name."""
    return {
        "errors": _errors(study),
        "convergence": _convergence(study),
        "starts": _starts(study),
        "rivals": _rivals(study),
    }


def _boxes(axes: Axes, data: list[Array], labels: list[str], color: str) -> None:
    boxes = axes.boxplot(
        [np.log10(np.maximum(d, ROUNDING)) for d in data],
        tick_labels=labels,
        widths=0.6,
        patch_artist=True,
        flierprops={"marker": ".", "ms": 2.5, "mfc": GREY, "mec": "none"},
        medianprops={"color": "black", "lw": 1},
    )
    for box in boxes["boxes"]:  # narrow ones still show by their edges
        box.set(facecolor=(color, 0.55), edgecolor=color, linewidth=1.8)
    for line in boxes["whiskers"] + boxes["caps"]:
        line.set(color=color, linewidth=0.9)
    axes.grid(axis="y", lw=0.4, alpha=0.6)


def _errors(study: PaperStudy) -> Figure:
    figure = Figure(figsize=(11, 4.3), layout="constrained")
    left, right = figure.subplots(1, 2)
    labels = [str(n) for n in study.known]
    _boxes(left, [np.abs(s.beta_error) for s in study.known.values()], labels, BLUE)
    left.set(xlabel="n", ylabel="log₁₀ |β̂ − β|  (rad)", title="tilt, axis known")
    _boxes(right, [np.abs(s.sigma2_error) for s in study.known.values()], labels, ORANGE)
    right.set(xlabel="n", ylabel="log₁₀ |σ̂²/σ² − 1|", title="swing variance, axis known")
    return figure


def _convergence(study: PaperStudy) -> Figure:
    figure = Figure(figsize=(11, 4.3), layout="constrained")
    left, right = figure.subplots(1, 2)
    stop = PaperIteration().epsilon
    for axes, steps, first, title, label, size, color in (
        (left, study.beta_steps, 0, "tilt", "log₁₀ |β⁽ᵗ⁾ − β̂|  (rad)", 1.0, BLUE),
        (right, study.sigma2_steps, 1, "swing variance", "log₁₀ |σ²⁽ᵗ⁾/σ̂² − 1|", study.settings.sigma**2, ORANGE),
    ):
        columns = range(first, steps.shape[1])
        data = [steps[:, t][np.isfinite(steps[:, t])] for t in columns]
        _boxes(axes, data, [str(t) for t in columns], color)
        axes.axhline(np.log10(stop / size), color=GREY, lw=0.9, ls="--")
        axes.annotate(
            "the stop rule's ε", (0.02, np.log10(stop / size)), (0, 3), xycoords=("axes fraction", "data"),
            textcoords="offset points", fontsize=8, color=GREY,
        )  # fmt: skip
        axes.set(xlabel="iteration t", ylabel=label, title=title + ", distance from the limit")
        axes.yaxis.set_major_locator(MultipleLocator(2))
    return figure


def _starts(study: PaperStudy) -> Figure:
    figure = Figure(figsize=(11, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    at = [s.start_deg for s in study.starts]
    twice = 2 * np.rad2deg(study.settings.beta)
    left.plot(at, [100 * s.refused / study.settings.replications for s in study.starts], "o-", color=ORANGE, ms=4)
    left.set(xlabel="start β⁽⁰⁾ (deg)", ylabel="refused (%)", title="arccos of more than 1")
    others = [s for s in study.starts if s.start_deg != 0]
    right.semilogy([s.start_deg for s in others], [s.apart for s in others], "o-", color=BLUE, ms=4)
    right.axhline(1e-9, color=GREY, lw=0.8, ls=":")
    right.set(xlim=left.get_xlim(), ylim=(1e-13, 1e-8))
    right.set(xlabel="start β⁽⁰⁾ (deg)", ylabel="largest |β̂ − β̂ from 0|  (rad)", title="of those not refused")
    for axes in (left, right):
        axes.axvline(twice, color=GREY, lw=1, ls="--")
        axes.annotate(
            "2β", (twice, 0.9), (-4, 0), xycoords=("data", "axes fraction"), textcoords="offset points",
            fontsize=9, color=GREY, ha="right",
        )  # fmt: skip
        axes.grid(lw=0.4, alpha=0.6)
    return figure


def _rivals(study: PaperStudy) -> Figure:
    figure = Figure(figsize=(11, 4.3), layout="constrained")
    left, right = figure.subplots(1, 2)
    series = (
        ("iteration, axis known", study.known, BLUE, "o-"),
        ("iteration, axis estimated", study.estimated, ORANGE, "s--"),
        ("mean ray", study.mean_ray, GREY, "^:"),
        ("geometric median", study.median, GREEN, "D-"),
    )
    for label, spreads, color, style in series:
        n = list(spreads)
        left.loglog(n, [np.rad2deg(s.beta.rms) for s in spreads.values()], style, color=color, ms=4.5, label=label)
        if label != "iteration, axis known":
            size = [np.rad2deg(np.sqrt(np.mean(s.azimuth_error**2))) for s in spreads.values()]
            right.loglog(n, size, style, color=color, ms=4.5, label=label)
    left.set(xlabel="n", ylabel="RMSE of β̂ (deg)", title="tilt")
    right.set(xlabel="n", ylabel="RMSE of the axis (deg)", title="0-degree line, where it is estimated")
    for axes in (left, right):
        axes.grid(lw=0.4, alpha=0.6, which="both")
        axes.legend(fontsize=8)
    return figure
