"""What a run had to assume of its camera, and what its intervals owe to that."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np

from simgrab.instrument.angles import by_estimate, calibrate
from simgrab.instrument.contract import Instrument
from simgrab.instrument.estimate.contract import FrameEstimator
from simgrab.instrument.estimate.follow import Known
from simgrab.instrument.pipeline import MeasuredRecord, Pipeline
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array

ROPE_M = 20.0  # of an example
_TEXTS = {
    "focal_length_px": "focal length {0.focal_length_px:g} px (1 % more makes every angle 1 % smaller)",
    "cx_px": "principal point ({0.cx_px:g}, {0.cy_px:g}) px",
    "k1": "no lens distortion",
    "display_constant_m": "display constant {0.display_constant_m:g} m",
}


def assumptions(
    camera: Calibration, record: MeasuredRecord | None, tilt: Known | None, instrument: Instrument
) -> dict[str, Any]:
    """List assumed inputs, and compute the part of the intervals that the camera's offset causes.

    Returns
    -------
    dict
        ``inputs``: keys of the camera file that were assumed; ``width_deg``: mean width of the 95 % intervals of α;
        ``offset_deg``: by how much it would be less if the offset were known exactly, for estimators that work frame by
        frame, on a tilt of the whole record; else both are None. ``text``: both in one line.
    """
    width, owed = _widths(camera, record, instrument) or (None, None)
    x, y, z = camera.offset_m
    offset = f"camera offset ({x:g}, {y:g}, {z:g}) ± {camera.offset_sd_m:g} m"
    parts = []
    if width is not None and owed is not None:
        parts.append(f"{owed:.2f}° of their mean width of {width:.2f}° come from: {offset}")
    outside = [text.format(camera) for key, text in _TEXTS.items() if key in camera.assumed]
    if tilt is not None and tilt.offset_m is None:
        angle = math.degrees(math.atan2(camera.offset_sd_m, ROPE_M))
        outside.insert(0, f"{offset} ({angle:.1f}° on {ROPE_M:g} m of rope)")
    if outside:
        parts.append(f"errors of these are not in them: {', '.join(outside)}")
    return {"inputs": list(camera.assumed), "width_deg": width, "offset_deg": owed, "text": "; ".join(parts)}


def _widths(camera: Calibration, record: MeasuredRecord | None, instrument: Instrument) -> tuple[float, float] | None:
    """Mean width of intervals, and by how much it would be less without an error of the offset, degrees."""
    if record is None or record.estimate is None or not isinstance(instrument, Pipeline) or instrument.calibrate_s:
        return None
    estimator, estimate = instrument.chosen(camera), record.estimate
    if not isinstance(estimator, FrameEstimator) or estimate.alpha is None or estimate.offset is None:
        return None
    x, y, z = estimate.offset.tolist()  # so that the estimate itself stays the same
    exact = msgspec.structs.replace(camera, offset_m=(x, y, z), offset_sd_m=0.0)
    again = calibrate(record.arrays, exact, estimator)
    if not again.ok:
        return None
    width, less = (_width(by_estimate(record.arrays, estimator, one)[1]) for one in (estimate, again))
    return None if math.isnan(width + less) else (width, max(width - less, 0.0))


def _width(ends: Array) -> float:
    known = ends[np.isfinite(ends).all(axis=-1)]
    return float(np.rad2deg(np.mean(known[:, 1] - known[:, 0]))) if len(known) else math.nan
