"""What a run had to assume of its camera, and what its intervals owe to that."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np

from simgrab.instrument.angles import NORMAL, RecordArrays
from simgrab.instrument.contract import Instrument, Measurement
from simgrab.instrument.estimate import Estimator
from simgrab.instrument.estimate.follow import Known, far_offset, tested_offsets
from simgrab.instrument.estimate.intervals import LEAN_BY_MOUNT
from simgrab.instrument.estimate.solve import stated_ends
from simgrab.instrument.pipeline import MeasuredRecord, Pipeline, moving
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array

CONTRADICTS = "contradicts the camera file"  # of a note
ROPE_M = 20.0  # of an example
LEAST_BOXES = 40
LEAST_STRAIGHT = 0.5  # cosine of twice the yaw, below which the sides of a box hardly show those of the grab
UNKNOWN = (  # by 1.89° at most in the 44 s of docs/tutorials/levelled-camera.md
    "unless the camera is fixed, it leans as the crane moves: errors of up to 2° that no 95 % interval here includes; "
    'state mount ("fixed", "levelled" or "rigid") in the camera file'
)
LEANS = "the camera leans as the crane moves, which makes 95 % intervals up to {:.1f}° wider on either side"
# Of the longest rope, where the shortest is far shorter: by the smaller side of upright boxes, and where that of the
# grab itself shows the same. Without an error, cycles of 30 s or more reached 0.14 by the former, and 0.03 by both.
MOST_ERROR, MOST_ERROR_OF_BOTH = 0.08, 0.05
_PARTS = {"centre": "errors of the grab's centre", "wind_m_s": "the stated wind"}
_EXACT = {"focal_length_px": "focal length", "k1": "lens distortion", "display_constant_m": "rope lengths' constant"}
_TEXTS = {
    "focal_length_px": "focal length {0.focal_length_px:g} px (1 % more makes angles up to 1 % smaller)",
    "cx_px": "principal point ({0.cx_px:g}, {0.cy_px:g}) px",
    "k1": "lens distortion k1 = {0.k1:g}, k2 = {0.k2:g}, k3 = {0.k3:g}",
    "roll_deg": "roll {0.roll_deg:g} deg",
    "display_constant_m": "display constant {0.display_constant_m:g} m",
}


def assumptions(
    camera: Calibration,
    record: MeasuredRecord | None,
    tilt: Known | None,
    instrument: Instrument,
    measured: Sequence[Measurement],
    *,
    timed: bool = False,
) -> dict[str, Any]:
    """List assumed inputs, and compute the part of the intervals that the camera's offset causes.

    Returns
    -------
    dict
        ``inputs``: keys of the camera file that were assumed; ``width_deg``: mean width of the 95 % intervals of α;
        ``offset_deg``: by how much it would be less if the offset were known exactly, for a tilt of the whole record;
        else both are None. ``parts_deg``: the same of each part that is cheap to compute, the largest first, and
        ``tilt``, the width that the estimated tilt alone makes. ``text``: these in one line. ``beyond``: estimates that
        contradict what was stated, a line. ``leans``: that a camera leans or may lean as the crane moves, a line; empty
        where that is measured, and without time.
    """
    used = None if record is None else record.estimator
    live_radius = False
    if record is None and isinstance(instrument, Pipeline):  # a live run
        live_radius = instrument.reports_radius
        used, controller = instrument.chosen(camera, live=True), instrument.controller
        used = used if controller is None else used.in_wind(controller, controller.time)
    intervals = any(m.alpha_low is not None for m in measured)
    leans = timed and intervals and used is not None and not moving(used) and camera.mount != "fixed"
    pitched = record.pitched if record else tilt is not None and tilt.radius_m is not None and live_radius
    leans = leans and not pitched
    width, owed = _widths(camera, record, instrument) or (None, {})
    x, y, z = camera.offset_m
    offset = f"camera offset ({x:g}, {y:g}, {z:g}) ± {camera.offset_sd_m:g} m"
    parts = []
    if width is not None:
        names = _PARTS | {
            "mount": f"the camera's lean on its mount ({camera.mount})",
            "offset_m": f"errors of the {offset}",
        }
        less = ", ".join(f"{deg:.2f}° without {names[part]}" for part, deg in owed.items() if part != "tilt")
        tilt_alone = f"; the estimated tilt alone makes {owed['tilt']:.2f}°" if "tilt" in owed else ""
        parts.append(f"their mean width of {width:.2f}° would be less by {less}{tilt_alone}")
    texts = _TEXTS | ({"k1": "no lens distortion"} if camera.intrinsics.distortion.is_null else {})
    known = record is not None and record.estimate is not None and "roll" in record.estimate.diagnostics
    guesses = set(camera.assumed) - ({"roll_deg"} if known else set())
    outside = [text.format(camera) for key, text in texts.items() if key in guesses]
    if tilt is not None and tilt.offset_m is None:
        angle = math.degrees(math.atan2(math.hypot(x, y) + camera.offset_sd_m, ROPE_M))
        outside.insert(
            0,
            f"{offset}, which without rope lengths, of a display or --plc, is taken for tilt ({angle:.1f}° on "
            f"{ROPE_M:g} m of rope)",
        )
    if timed and used is not None and not used.intervals.wind_m_s:
        outside.append("lean of the grab in steady wind")
    if not intervals:
        parts = ["none: the record does not determine them"] if any(m.alpha is not None for m in measured) else []
    else:
        parts += [f"errors of these are not in them: {', '.join(outside)}"] if outside else []
        exact = [name for key, name in _EXACT.items() if key not in guesses and used is not None]
        parts += [f"stated, and so taken as exact: {', '.join(exact)}"] if exact else []
    by_motion = moving(used) and not (used is not None and used.needs_imu)
    fixed = None if record is None or record.estimate is None else tested_offsets(record.estimate)[1]
    offset_m = None if tilt is None else tilt.weak_prior_offset_m or tilt.offset_m
    far = far_offset(offset_m, camera, by_motion=by_motion, fixed=fixed)
    yaw = np.array([np.nan if s.yaw is None else s.yaw for s in record.arrays.observations] if record else [], float)
    return {"inputs": list(camera.assumed), "width_deg": width, "offset_deg": owed.get("offset_m"),
            "parts_deg": owed, "text": "; ".join(parts),
            "leans": _leans(camera.mount, record, instrument) if leans else "",
            "beyond": "; ".join(filter(None, [far, _of_size(camera, measured, yaw)]))}  # fmt: skip


def _leans(mount: str, record: MeasuredRecord | None, instrument: Instrument) -> str:
    """Say how a camera that is not fixed leans, and what would measure it."""
    stated = LEANS.format(math.degrees(NORMAL * LEAN_BY_MOUNT[mount])) if mount else UNKNOWN
    given = isinstance(instrument, Pipeline) and instrument.tilt is not None
    by = "--imu" if record is None else "--plc or --imu, without --calibration," if given else "--plc or --imu"
    return f"{stated}; {by} measures the lean"


def _of_size(camera: Calibration, measured: Sequence[Measurement], yaw: Array) -> str:
    """Name a constant error of the rope's length: the grab's distance times the smaller side of its box is constant.

    That side hardly changes as jaws open, but it does as a rectangle turns: where the yaw (n,), rad, is known, that of
    the rectangle itself must show the error too, of which less is then enough. Without an error it was at most 1.3 m,
    for four grabs in simulated cycles of 10 to 20 m of rope.
    """
    boxes = np.array([m.box or (np.nan,) * 4 for m in measured], float).reshape(-1, 4)
    length = np.array([m.rope_length_m or np.nan for m in measured], float) + camera.offset_m[2]
    inside = (boxes > 1) & (boxes < np.array([camera.width_px, camera.height_px] * 2) - 1)
    upright = np.where(inside.all(axis=1, keepdims=True), boxes[:, 2:] - boxes[:, :2], np.nan)
    sides, most = [upright], MOST_ERROR
    if np.isfinite(yaw).any():
        sides, most = [upright, _turned(upright, yaw)], MOST_ERROR_OF_BOTH
    errors = [_error(length, one.min(axis=1), most) for one in sides]
    error = min(errors, key=abs)
    if not error or len(set(np.sign(errors))) > 1:
        return ""
    return (
        f"the grab's size in the picture changes as on ropes {abs(error):.1f} m {'longer' if error > 0 else 'shorter'} "
        "than measured; are display_constant_m and the controller's rope.constant_m right, in sign too?"
    )


def _error(length: Array, size: Array, most: float) -> float:
    """Constant of lengths (n,), m, that makes them times sizes (n,) the same at both ends; 0 if it is small.

    ``most`` is the share of the longest rope up to which it is. The ends are the shortest and the longest quarter of
    the ropes. NaN where a size is not known.
    """
    known = np.isfinite(length) & (size > 0)
    if known.sum() < LEAST_BOXES:
        return 0.0
    length, size = length[known], size[known]
    ends = [length <= np.quantile(length, 0.25), length >= np.quantile(length, 0.75)]
    (near, far), (large, small) = ([float(np.median(of[end])) for end in ends] for of in (length, size))
    if large <= small or far <= near:
        return 0.0
    error = (far * small - near * large) / (large - small)
    clear = far - near >= (near + error) / 2 and abs(error) >= most * (far + error) ** 2 / (far - near)
    return error if clear else 0.0


def _turned(upright: Array, yaw: Array) -> Array:
    """Sides (n, 2) of rectangles turned by yaw (n,), of which upright boxes have these; NaN near 45 degrees."""
    c, s = np.abs(np.cos(yaw))[:, None], np.abs(np.sin(yaw))[:, None]
    straight = c**2 - s**2
    straight[np.abs(straight) < LEAST_STRAIGHT] = np.nan
    return np.asarray((upright * c - upright[:, ::-1] * s) / straight)


def _widths(
    camera: Calibration, record: MeasuredRecord | None, instrument: Instrument
) -> tuple[float, dict[str, float]] | None:
    """Mean width of intervals, and by how much it would be less without an error of each part, degrees.

    All but the offset only for estimators of single frames, which take milliseconds.
    """
    if record is None or record.estimate is None or not isinstance(instrument, Pipeline) or instrument.calibrate_s:
        return None
    estimator, estimate = record.estimator, record.estimate
    if estimator is None or estimate.alpha is None or estimate.offset is None:
        return None
    x, y, z = estimate.offset.tolist()  # so that the estimate itself stays the same
    exact = {"offset_m": (x, y, z), "offset_sd_m": 0.0}
    fixed, arrays, still = {"mount": "fixed"}, record.arrays, estimator
    changes: dict[str, tuple[dict[str, Any], RecordArrays, Estimator]] = {"offset_m": (exact, arrays, estimator)}
    if not estimator.needs_time:
        sure = replace(arrays, pixel_sd=np.zeros_like(arrays.pixel_sd))
        changes["centre"] = ({}, sure, estimator)
        if camera.mount in LEAN_BY_MOUNT and arrays.time is not None:
            changes["mount"] = (fixed, arrays, estimator)
        if estimator.intervals.wind_m_s:
            still = replace(estimator, intervals=replace(estimator.intervals, wind_m_s=0.0))
            changes["wind_m_s"] = ({}, arrays, still)
        changes["tilt"] = (exact | fixed, sure, still)
    width, found = _width(stated_ends(estimate)), {}
    for part, (of_camera, of_arrays, by) in changes.items():
        again = of_arrays.estimate(by, msgspec.structs.replace(camera, **of_camera))
        if not again.ok:
            return None
        other = _width(stated_ends(again))
        found[part] = other if part == "tilt" else max(width - other, 0.0)
    if math.isnan(width + sum(found.values())):
        return None
    return width, dict(sorted(found.items(), key=lambda one: -one[1]))


def _width(ends: Array) -> float:
    known = ends[np.isfinite(ends).all(axis=-1)]
    return float(np.rad2deg(np.mean(known[:, 1] - known[:, 0]))) if len(known) else math.nan
