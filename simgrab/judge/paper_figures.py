"""The figures of section 4.4, and two that it lacks."""

from __future__ import annotations

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from simgrab.geometry import Array
from simgrab.judge.paper import PaperStudy

BLUE, ORANGE, GREEN, GREY = "#1f5a8a", "#c8551b", "#3b7d4f", "#8a8f94"
SMALLEST = 1e-16  # what a difference of 0 is drawn as


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
        [np.log10(np.maximum(d, SMALLEST)) for d in data],
        tick_labels=labels,
        widths=0.6,
        patch_artist=True,
        flierprops={"marker": ".", "ms": 2.5, "mfc": GREY, "mec": "none"},
        medianprops={"color": "black", "lw": 1.2},
    )
    for box in boxes["boxes"]:
        box.set(facecolor=color, alpha=0.55, linewidth=0.8)
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
    for axes, steps, first, label, color in (
        (left, study.beta_steps, 0, "log₁₀ |β⁽ᵗ⁾ − β̂|  (rad)", BLUE),
        (right, study.sigma2_steps, 1, "log₁₀ |σ²⁽ᵗ⁾/σ̂² − 1|", ORANGE),
    ):
        columns = range(first, steps.shape[1])
        data = [steps[:, t][np.isfinite(steps[:, t])] for t in columns]
        _boxes(axes, data, [str(t) for t in columns], color)
        axes.set(xlabel="iteration t", ylabel=label, ylim=(-16.5, None))
        axes.annotate(
            "differences of 0 are drawn at −16", (0.02, 0.02), xycoords="axes fraction", fontsize=7.5, color=GREY
        )
    return figure


def _starts(study: PaperStudy) -> Figure:
    figure = Figure(figsize=(11, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    at = [s.start_deg for s in study.starts]
    twice = 2 * np.rad2deg(study.settings.beta)
    left.plot(at, [100 * s.refused / study.settings.replications for s in study.starts], "o-", color=ORANGE, ms=4)
    left.set(xlabel="start β⁽⁰⁾ (deg)", ylabel="refused (%)", title="arccos of more than 1")
    right.semilogy(at, [max(s.apart, SMALLEST) for s in study.starts], "o-", color=BLUE, ms=4)
    right.axhline(1e-9, color=GREY, lw=0.8, ls=":")
    right.set(xlabel="start β⁽⁰⁾ (deg)", ylabel="largest |β̂ − β̂ from 0|  (rad)", title="of those not refused")
    for axes in (left, right):
        axes.axvline(twice, color=GREY, lw=1, ls="--")
        axes.annotate("2β", (twice, 0.9), xycoords=("data", "axes fraction"), fontsize=9, color=GREY, ha="right")
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
        left.loglog(n, [np.rad2deg(s.rmse_beta) for s in spreads.values()], style, color=color, ms=4.5, label=label)
        if label != "iteration, axis known":
            size = [np.rad2deg(np.sqrt(np.mean(s.azimuth_error**2))) for s in spreads.values()]
            right.loglog(n, size, style, color=color, ms=4.5, label=label)
    left.set(xlabel="n", ylabel="RMSE of β̂ (deg)", title="tilt")
    right.set(xlabel="n", ylabel="RMSE of the axis (deg)", title="0-degree line, where it is estimated")
    for axes in (left, right):
        axes.grid(lw=0.4, alpha=0.6, which="both")
        axes.legend(fontsize=8)
    return figure
