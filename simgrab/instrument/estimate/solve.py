"""Estimate one record with what the crane's controller reports beside the pictures."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeVar

import msgspec
import numpy as np

from simgrab.errors import RecordError
from simgrab.instrument.controller import ClockOffset, Controller, clock_offset
from simgrab.instrument.estimate.contract import Estimator
from simgrab.instrument.estimate.doubts import doubt
from simgrab.instrument.estimate.follow import LEAST_OFFSET_SD_M, WEAK_PRIOR_IF_FIXED, WEAK_PRIOR_OFFSET
from simgrab.instrument.estimate.record import PixelRecord
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array
from simgrab.model.records.estimates import Estimate

LEAST_CHANGE_M = 0.2  # of the rope's length: with less, an estimate on another clock is the same
R = TypeVar("R", bound=PixelRecord)


def on_clock(controller: Controller, record: PixelRecord) -> tuple[Controller, ClockOffset]:
    """Put a controller on the clock of a record, whose rope lengths are of a display; and by how much it was off.

    Raises `RecordError` for independent frames, and as `clock_offset` does.
    """
    if record.time is None:
        raise RecordError("the controller's data need frames that follow each other in time")
    read = np.full(len(record.time), np.nan) if record.rope_length is None else record.rope_length
    clock = clock_offset(controller, record.time, read)
    return controller.shifted(clock), clock


def informed(estimator: Estimator, controller: Controller | None, pixel_sd: Array, time: Array | None) -> Estimator:
    """Give an estimator what it uses: the controller's report of jib and wind, and the detector's deviation."""
    stated, given = pixel_sd[pixel_sd > 0], dict[str, Any]()
    estimator = estimator.in_wind(controller, time)
    if controller is not None and (controller.reports_motion or (controller.load is not None and estimator.needs_imu)):
        given["controller"] = controller
    if len(stated):
        given["wander_px"] = float(np.median(stated))
    taken = {name: value for name, value in given.items() if hasattr(estimator, name)}
    return replace(estimator, **taken) if taken else estimator


def solve(
    record: R,
    calibration: Calibration,
    estimator: Estimator,
    controller: Controller | None = None,
    until_s: float | None = None,
) -> tuple[R, Estimate, str]:
    """Estimate a record, with the rope lengths of the clock that the swing shows.

    Parameters
    ----------
    estimator : Estimator
        As `informed` returns it.
    controller : Controller, optional
        On the clock of the record.
    until_s : float, optional
        Seconds at the beginning from which the tilt is estimated.

    Returns
    -------
    PixelRecord
        With the rope lengths of its clock.
    Estimate
    str
        What the swing contradicts; mostly empty.
    """
    used = record.with_lengths(controller)
    found = used.estimate(estimator, calibration, until_s)
    moved = _by_swing(controller, estimator, found)
    if moved is not None and np.abs(_change(record, used, moved)).max() > LEAST_CHANGE_M:
        used = record.with_lengths(moved)
        found = used.estimate(estimator, calibration, until_s)
        moved = _by_swing(controller, estimator, found)
    if moved is not None:
        assert used.rope_length is not None
        used = replace(used, rope_length=used.rope_length + _change(record, used, moved))
    why = doubt(estimator, used, calibration, found)
    found = with_weak_prior(found, used, estimator, calibration, until_s)
    if found.ok:
        return used, found, why
    return used, replace(found, reason="; ".join(filter(None, [found.reason, why]))), ""


def _by_swing(controller: Controller | None, estimator: Estimator, estimate: Estimate) -> Controller | None:
    """Put a controller that reports the rope on the clock that the swing shows; None if it shows none."""
    late = None if estimator.needs_imu else estimate.diagnostics.get("clock_s")
    if late is None or controller is None or controller.rope is None:
        return None
    return controller.shifted(ClockOffset(float(late), controller.clock_sd_s, "the swing"))


def _change(record: PixelRecord, used: PixelRecord, controller: Controller) -> Array:
    """By how much the controller's rope lengths differ from those used (n,), m; 0 where one of them is missing."""
    lengths = record.with_lengths(controller).rope_length
    assert lengths is not None
    assert used.rope_length is not None
    return np.nan_to_num(lengths - used.rope_length)


def with_weak_prior(
    found: Estimate, record: PixelRecord, estimator: Estimator, calibration: Calibration, until_s: float | None = None
) -> Estimate:
    """Add the offset as a record shows it, for `far_offset`, where the calibration's prior would hide it."""
    if not found.ok or found.offset is None or calibration.offset_sd_m >= LEAST_OFFSET_SD_M:
        return found
    weak = record.estimate(estimator, msgspec.structs.replace(calibration, offset_sd_m=LEAST_OFFSET_SD_M), until_s)
    if weak.offset is None:
        return found
    shown = {WEAK_PRIOR_OFFSET: weak.offset, WEAK_PRIOR_IF_FIXED: weak.diagnostics.get("offset_if_fixed_m")}
    return replace(found, diagnostics={**found.diagnostics, **shown})


def stated_ends(estimate: Estimate) -> Array:
    """Intervals (n, 2) of α that a run states: by a model of the motion, else by blocks, else by frames, else NaN."""
    kinds = {i.kind: i.alpha for i in estimate.intervals if i.alpha is not None}
    stated = next((kinds[kind] for kind in ("posterior", "blocks", "iid") if kind in kinds), None)
    if stated is not None:
        return np.asarray(stated)
    assert estimate.alpha is not None
    return np.full((len(estimate.alpha), 2), np.nan)
