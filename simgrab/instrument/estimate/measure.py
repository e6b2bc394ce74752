"""Estimate one record, from file to figure: the work of `simgrab estimate`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from simgrab.errors import RecordError, first_line
from simgrab.instrument import alarm
from simgrab.instrument.controller import ClockOffset, in_words
from simgrab.instrument.controller_file import read_controller
from simgrab.instrument.estimate import DEFAULT, ESTIMATORS, Estimator, PendulumSmoother, RopeAware
from simgrab.instrument.estimate.follow import far_offset, tested_offsets
from simgrab.instrument.estimate.inertial.readings import read_imu
from simgrab.instrument.estimate.intervals import WORKING
from simgrab.instrument.estimate.record import PixelRecord
from simgrab.instrument.estimate.solve import informed, on_clock, solve, stated_ends
from simgrab.instrument.estimate.tables import read_record
from simgrab.model import calibration as camera_file
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array
from simgrab.model.records.estimates import Estimate, Intervals

# Diagnostics that are in radians.
_ANGLES = ("beta_history", "lean_sd", "pitch_per_m", "pitch_sd_per_m", "roll", "roll_error", "roll_sd")
# An offset that looks like less tilt than this is not worth a warning.
_LEAST_TILT = np.deg2rad(0.1)


@dataclass(frozen=True)
class EstimatedRecord:
    """A record, its camera, its estimate, and warnings, a line each."""

    record: PixelRecord
    calibration: Calibration
    estimate: Estimate
    warnings: tuple[str, ...] = ()


def estimate(
    pixels: ArrayLike,
    calibration: Calibration | str | Path,
    estimator: str = DEFAULT,
    *,
    rope_length: ArrayLike | None = None,
    time: ArrayLike | None = None,
) -> Estimate:
    """Estimate tilt and swing from the grab's centres in the pictures of one record.

    Parameters
    ----------
    pixels : array_like, shape (n, 2)
        As the pictures have them, px; NaN where the grab was not found.
    calibration : Calibration or path
        The camera, or its TOML file.
    estimator : str
        A name in `simgrab.instrument.estimate.ESTIMATORS`.
    rope_length : array_like, shape (n,), optional
        |OA|, m; required by some estimators.
    time : array_like, shape (n,), optional
        s; required by some estimators.

    Returns
    -------
    Estimate
        In radians; ``status`` is ``"refused"``, with a ``reason``, if the record does not determine the tilt.

    Raises
    ------
    RecordError
        If there is no such estimator, or the arrays have other shapes.

    Examples
    --------
    >>> import numpy as np
    >>> import simgrab
    >>> from simgrab.model.calibration import Calibration
    >>> camera = Calibration(width_px=1920, height_px=1080, focal_length_px=1645.0, cx_px=960.0, cy_px=540.0)
    >>> pixels = np.random.default_rng(0).normal((960, 640), 50, (200, 2))
    >>> found = simgrab.estimate(pixels, camera, "mean-ray")
    >>> found.status, round(float(np.degrees(found.beta)), 1)
    ('ok', 3.5)
    """
    kind = _kind(estimator)
    known = calibration if isinstance(calibration, Calibration) else camera_file.load(calibration)
    rope, when = (None if values is None else np.asarray(values, float) for values in (rope_length, time))
    try:
        return kind(intervals=WORKING).estimate(np.asarray(pixels, float), known, rope_length=rope, time=when)
    except ValueError as problem:
        raise RecordError(f"{estimator}: {first_line(problem)}") from None


def _kind(estimator: str) -> type[Estimator]:
    if estimator not in ESTIMATORS:
        raise RecordError(f"unknown estimator {estimator!r}; there are: {', '.join(ESTIMATORS)}")
    return ESTIMATORS[estimator]


def measure(
    path: str | Path,
    camera: str | Path,
    estimator: str | None = None,
    *,
    imu: str | Path | None = None,
    plc: str | Path | None = None,
) -> EstimatedRecord:
    """Estimate tilt and swing from a file.

    Parameters
    ----------
    path : path
        CSV or parquet with columns ``u_px, v_px[, u_sd_px, v_sd_px, rope_length_m, time_s]``, a dataset's
        ``labels.parquet`` or a run's ``angles.parquet``; an empty pixel is a missing frame.
    camera : path
        Camera TOML.
    estimator : str, optional
        A name in `simgrab.instrument.estimate.ESTIMATORS`.
    imu : path, optional
        Folder of the inertial sensor in the camera's housing, as
        `simgrab.instrument.estimate.inertial.readings.read_imu` takes it: then the estimator is `PendulumSmoother`.
    plc : path, optional
        Data of the crane's controller, as `simgrab.instrument.controller_file.read_controller` takes them. The
        estimator is by default `PendulumSmoother` if they report slewing or luffing, and else `RopeAware`.

    Raises
    ------
    RecordError, CalibrationError
        With one line that names the file and the row or column.
    """
    calibration, controller = camera_file.load(camera), None if plc is None else read_controller(plc)
    readings = None if imu is None else read_imu(imu)
    states_rope = controller is not None and controller.rope is not None
    if estimator is None:
        moves = readings is not None or (controller is not None and controller.reports_motion)
        estimator = PendulumSmoother.name if moves else RopeAware.name if states_rope else DEFAULT
    kind = _kind(estimator)(intervals=WORKING)
    kind = kind if readings is None else PendulumSmoother(imu=readings, intervals=WORKING)
    record = read_record(
        path, calibration, rope=kind.needs_rope and not states_rope, time=kind.needs_time or controller is not None,
        displayed=states_rope,
    )  # fmt: skip
    clock: ClockOffset | None = None
    if controller is not None:
        controller, clock = on_clock(controller, record)
    kind = informed(kind, controller, record.pixel_sd, record.time)
    present = int(record.with_lengths(controller).usable(rope=kind.needs_rope).sum())
    if present < kind.parameters:
        what = "a pixel and a rope length" if kind.needs_rope else "a pixel"
        raise RecordError(
            f"{path}: {present} of {len(record.pixels)} rows have {what}; {kind.name} needs at least "
            f"{kind.parameters}, one for each parameter"
        )
    record, found, why = solve(record, calibration, kind, controller)
    warnings = () if kind.needs_rope else _of_offset(estimator, record, calibration)
    by_motion = getattr(kind, "controller", None) is not None and not kind.needs_imu
    offset, fixed = tested_offsets(found)
    far = far_offset(offset, calibration, by_motion=by_motion, fixed=fixed)
    notes: tuple[str, ...] = ()
    if controller is not None and clock is not None:
        shown = clock.by_swing(*map(found.diagnostics.get, ("clock_s", "clock_sd_s"))) if by_motion else None
        said = in_words(clock.offset_s, clock.interval_s, clock.source, None if shown is None else shown.interval_s)
        wind = f"controller's wind: {kind.intervals.wind_m_s:.1f} m/s" if controller.wind is not None else ""
        notes = (*controller.notes, clock.note, f"controller's clock: {said}", wind)
    return EstimatedRecord(record, calibration, found, tuple(filter(None, (*notes, *warnings, far, why))))


def _of_offset(estimator: str, record: PixelRecord, calibration: Calibration) -> tuple[str, ...]:
    """Warn that an estimator without the rope's length takes the stated offset for tilt."""
    across = float(np.hypot(*calibration.offset_m[:2]))
    if record.rope_length is None:
        if across == 0:
            return ()
        effect = "looks like tilt"
    else:
        shortest = float(np.nanmin(record.rope_length))
        angle = np.arctan2(across, shortest)
        if angle <= _LEAST_TILT:
            return ()
        effect = f"looks like up to {np.rad2deg(angle):.1f} deg of tilt on ropes from {shortest:.1f} m"
    return (
        f"the camera file's offset of {across:.2f} m {effect}, which {estimator} cannot tell apart and its intervals "
        "leave out; rope-aware can, from rope_length_m",
    )


def as_json(measured: EstimatedRecord) -> dict[str, Any]:
    """Plain data in degrees, with null for missing values; includes every frame's α."""
    estimate = measured.estimate
    plain = estimate_json(estimate) | {"warnings": list(measured.warnings), "alpha_deg": _degrees(estimate.alpha)}
    plain["above_10_deg"] = above(estimate)
    plain["intervals"] = [_interval(i) | {"alpha_deg": _degrees(i.alpha)} for i in estimate.intervals]
    return plain


def above(estimate: Estimate) -> dict[str, float | None]:
    """Share of the frames with α beyond 10°, as `simgrab.instrument.alarm.share` returns it."""
    if estimate.alpha is None:
        return alarm.share(*np.empty((3, 0)))
    return alarm.share(estimate.alpha, *stated_ends(estimate).T)


def estimate_json(estimate: Estimate) -> dict[str, Any]:
    """Plain data in degrees of an estimate of the whole record."""
    return {
        "estimator": estimate.estimator,
        "status": estimate.status,
        "reason": estimate.reason,
        "frames": estimate.frames,
        "beta_deg": _degrees(estimate.beta),
        "tilt_azimuth_deg": _degrees(estimate.tilt_azimuth),
        "sigma_deg": _degrees(estimate.sigma),
        "offset_m": _plain(estimate.offset),
        "intervals": [_interval(interval) for interval in estimate.intervals],
        "diagnostics": _diagnostics(estimate.diagnostics),
    }


def _interval(interval: Intervals) -> dict[str, Any]:
    return {
        "kind": interval.kind,
        "level": interval.level,
        "beta_deg": _degrees(interval.beta),
        "sigma_deg": _degrees(interval.sigma),
        "blocks": interval.blocks,
        "note": interval.note,
    }


def _diagnostics(diagnostics: Mapping[str, Any]) -> dict[str, Any]:
    """Plain diagnostics; angles become degrees, as in their names."""
    result = {}
    for name, value in diagnostics.items():
        if name in _ANGLES:
            result[f"{name}_deg"] = _degrees(value)
        elif name == "sigma2_history":
            result[f"{name}_deg2"] = _plain(np.rad2deg(np.rad2deg(value)))
        else:
            result[name] = _plain(value)
    return result


def _degrees(value: float | Array | None) -> Any:
    return None if value is None else _plain(np.rad2deg(value))


def _plain(value: Any) -> Any:
    """Turn arrays into lists, and values that are not finite into None."""
    return msgspec.json.decode(msgspec.json.encode(value, enc_hook=lambda array: array.tolist()))
