"""Figures of a run: swing over time, the picture's plane, the swings' histogram, the rope's length."""

from __future__ import annotations

import numpy as np

from simgrab.instrument.run.runs import Run
from simgrab.model.geometry import Array, camera_rotation
from simgrab.reports.plots import Axes, Figure

BLUE, RED, GREY, GREEN = "#1f5a8a", "#c8321b", "#8a8f94", "#3d7f4f"
MOST_PARTS = 4800
_LOST = {"lost": "black", "missed": RED, "unread": "#b58900", "refused": GREY}


def _axis(run: Run) -> tuple[Array, str]:
    return (np.arange(len(run.names), dtype=float), "frame") if run.time is None else (run.time, "time (s)")


def mark_lost(axes: Axes, at: Array, run: Run) -> None:
    """Mark frames without an angle by ticks at α = 0, in a colour for each status; ``at`` (n,) are their times."""
    for status, colour in _LOST.items():
        _foot(axes, at[[m.status == status for m in run.measurements]], colour, status)


def trace(run: Run) -> Figure:
    """Draw α over time with its intervals, alarms as bands, and at the foot the reasons for frames without α."""
    figure = Figure(figsize=(12, 4.2), layout="constrained")
    axes = figure.subplots()
    at, label = _axis(run)
    alpha = np.rad2deg(run.alpha)
    for event in run.events:
        axes.axvspan(event.onset_s, max(event.end_s, event.onset_s + 0.1), color=RED, alpha=0.18, lw=0)
    style = {"lw": 0.8} if run.time is not None else {"lw": 0, "marker": ".", "ms": 3}
    band, line = _ends(at, *np.rad2deg(run.ends).T), _ends(at, alpha, alpha)
    axes.fill_between(*band, color=GREY, alpha=0.45, lw=0, label="95 % interval", rasterized=True)
    axes.plot(np.repeat(line[0], 2), np.ravel(line[1:], "F"), color=BLUE, label="α", rasterized=True, **style)
    axes.axhline(10, color=RED, lw=1, ls="--", label="danger, 10°")
    mark_lost(axes, at, run)
    top = np.nanmax(alpha, initial=0.0)
    axes.set(xlabel=label, ylabel="α (deg)", ylim=(-0.4, max(top * 1.08, 11.0)), xlim=_span(at))
    axes.legend(fontsize=8, loc="upper right", ncols=4)
    return figure


def plane(run: Run) -> Figure:
    """Draw grab centres in the picture's plane, with the principal point and the vertical."""
    figure = Figure(figsize=(7.2, 4.4), layout="constrained")
    axes = figure.subplots()
    camera = run.calibration.intrinsics
    axes.plot(*camera.undistort(run.pixels).T, ".", ms=3.5, alpha=0.5, color=BLUE, mew=0,
              label="grab centre, undistorted", rasterized=True)  # fmt: skip
    axes.plot(camera.cx_px, camera.cy_px, "+", ms=12, mew=1.6, color="black", label="principal point C'")
    tilt = run.about["tilt"]
    if tilt is not None:
        beta, azimuth, roll = np.deg2rad((tilt["beta_deg"], tilt["tilt_azimuth_deg"], run.calibration.roll_deg))
        down = camera_rotation(beta, azimuth, roll).T @ np.array([0.0, 0.0, -1.0])
        axes.plot(*camera.ideal(down), "o", ms=8, mfc="none", mew=1.8, color=RED, label="estimated vertical G'")
    axes.set(xlim=(0, camera.width_px), ylim=(camera.height_px, 0), xlabel="u (px)", ylabel="v (px)")
    axes.set_aspect("equal")
    axes.legend(fontsize=8, loc="upper right")
    return figure


def histogram(run: Run) -> Figure:
    """Draw the histogram of measured swings."""
    figure = Figure(figsize=(7.2, 3.6), layout="constrained")
    axes = figure.subplots()
    alpha = np.rad2deg(run.alpha[np.isfinite(run.alpha)])
    if len(alpha):
        axes.hist(alpha, bins=np.linspace(0, max(alpha.max(), 11), 45).tolist(), color=BLUE, alpha=0.85)
    axes.axvline(10, color=RED, lw=1, ls="--")
    axes.set(xlabel="α (deg)", ylabel="frames")
    return figure


def rope(run: Run) -> Figure:
    """Draw the rope's length, and the frames in which it was not read."""
    figure = Figure(figsize=(12, 2.8), layout="constrained")
    axes = figure.subplots()
    at, label = _axis(run)
    axes.plot(at, run.rope_length, ".", ms=4, color=GREEN, mew=0, label="|OA|", rasterized=True)
    for status, colour in (("refused", GREY), ("jump", RED)):
        _foot(axes, at[[m.rope_status == status for m in run.measurements]], colour, f"display: {status}")
    axes.set(xlabel=label, ylabel="rope (m)", ylim=(0, None), xlim=_span(at))
    axes.legend(fontsize=8, loc="lower right")
    return figure


def _ends(at: Array, low: Array, high: Array) -> tuple[Array, Array, Array]:
    """Lowest and highest values (m,) in parts of a record (n,), of which there are no more than a figure shows."""
    starts = np.arange(0, len(at), -(-len(at) // MOST_PARTS))
    return at[starts], np.fmin.reduceat(low, starts), np.fmax.reduceat(high, starts)


def _foot(axes: Axes, at: Array, colour: str, label: str) -> None:
    if len(at):
        axes.plot(at, np.zeros(len(at)), "|", color=colour, ms=9, label=label, rasterized=True)


def _span(at: Array) -> tuple[float, float]:
    return (float(at[0]), float(at[-1])) if len(at) > 1 else (float(at[0]) - 0.5, float(at[0]) + 0.5)
