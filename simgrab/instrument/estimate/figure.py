"""The figure of `simgrab estimate`: positions of the grab, and the swing over time."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from simgrab.errors import RecordError
from simgrab.instrument.estimate.measure import EstimatedRecord
from simgrab.io.destination import check_file
from simgrab.io.files import drafted
from simgrab.model.geometry import camera_rotation
from simgrab.reports.plots import Axes, Figure

ENDINGS = (".png", ".svg", ".pdf")
BLUE, ORANGE, GREY = "#1f5a8a", "#c8551b", "#8a8f94"


def draw(measured: EstimatedRecord) -> Figure:
    """Three panels: the picture with axis and estimated vertical, the histogram of α, its course."""
    figure = Figure(figsize=(13, 4.6), layout="constrained")
    plane, histogram, trace = figure.subplots(1, 3, width_ratios=[1.35, 1, 1.35])
    _plane(plane, measured)
    _histogram(histogram, measured)
    _trace(trace, measured)
    figure.suptitle(_headline(measured), fontsize=11)
    return figure


def check(path: Path) -> None:
    """Refuse a figure that cannot be written, before anything is estimated; raises `RecordError`."""
    if path.suffix.lower() not in ENDINGS:
        raise RecordError(f"{path}: the figure's name must end in one of {', '.join(ENDINGS)}")
    check_file(path, RecordError, "--figure")


def save(measured: EstimatedRecord, path: str | Path) -> None:
    """Write the figure in the format of the file's ending (.svg, .png, .pdf)."""
    path = Path(path)
    with drafted(path) as draft:
        draw(measured).savefig(draft, format=path.suffix[1:].lower(), dpi=130)


def _headline(measured: EstimatedRecord) -> str:
    e = measured.estimate
    if e.beta is None or e.sigma is None:
        return f"{e.estimator}: refused — {e.reason}"
    return f"{e.estimator}, {e.frames} frames:  β = {np.rad2deg(e.beta):.3f}°,  σ = {np.rad2deg(e.sigma):.3f}°"


def _plane(axes: Axes, measured: EstimatedRecord) -> None:
    camera = measured.calibration.intrinsics
    ideal = camera.undistort(measured.record.pixels)
    axes.plot(*ideal.T, ".", ms=2.5, alpha=0.45, color=BLUE, mew=0, label="grab centre, undistorted", rasterized=True)
    axes.plot(camera.cx_px, camera.cy_px, "+", ms=12, mew=1.6, color="black", label="principal point C'")
    e = measured.estimate
    if e.beta is not None and e.tilt_azimuth is not None:
        rotation = camera_rotation(e.beta, e.tilt_azimuth, np.deg2rad(measured.calibration.roll_deg))
        vertical = camera.ideal(rotation.T @ np.array([0.0, 0.0, -1.0]))
        axes.axline((camera.cx_px, camera.cy_px), tuple(vertical), color=ORANGE, lw=0.9, label="0-degree line")
        axes.plot(*vertical, "o", ms=8, mfc="none", mew=1.8, color=ORANGE, label="estimated vertical G'")
    axes.set(xlim=(0, camera.width_px), ylim=(camera.height_px, 0), xlabel="u (px)", ylabel="v (px)")
    axes.set_aspect("equal")
    axes.set_title("in the picture", fontsize=10)
    axes.legend(fontsize=7.5, loc="upper right", framealpha=0.9)


def _histogram(axes: Axes, measured: EstimatedRecord) -> None:
    axes.set(xlabel="α (deg)", ylabel="frames")
    axes.set_title("swing angle", fontsize=10)
    if measured.estimate.alpha is not None:
        alpha = np.rad2deg(measured.estimate.alpha)
        axes.hist(alpha[np.isfinite(alpha)], bins=40, color=BLUE, alpha=0.85)
    axes.axvline(10, color=ORANGE, lw=1, ls="--")
    axes.annotate(
        "danger", (10, 0.97), xycoords=("data", "axes fraction"), fontsize=8, color=ORANGE, rotation=90, va="top"
    )


def _trace(axes: Axes, measured: EstimatedRecord) -> None:
    time = measured.record.time
    axes.set(xlabel="frame" if time is None else "time (s)", ylabel="α (deg)")
    axes.set_title("over time" if time is not None else "frame by frame", fontsize=10)
    e = measured.estimate
    if e.alpha is None:
        return
    at = np.arange(len(e.alpha)) if time is None else time
    order = np.argsort(at, kind="stable")
    ends = next((i.alpha for i in e.intervals if i.alpha is not None), None)
    if ends is not None:
        low, high = np.rad2deg(ends[order]).T
        axes.fill_between(at[order], low, high, color=GREY, alpha=0.5, lw=0, label="95 % interval", rasterized=True)
    axes.plot(at[order], np.rad2deg(e.alpha[order]), lw=0.7, color=BLUE, label="α", rasterized=True)
    axes.axhline(10, color=ORANGE, lw=1, ls="--")
    axes.set_ylim(bottom=0)
    axes.legend(fontsize=7.5, loc="upper right")
