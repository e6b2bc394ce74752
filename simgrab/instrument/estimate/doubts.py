"""Whether the swing follows what a controller reports, and which mistake of its description would explain that not."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace

import numpy as np

from simgrab.instrument.controller import Controller
from simgrab.instrument.estimate import Estimator
from simgrab.instrument.estimate.jib import RADIUS_M
from simgrab.instrument.estimate.pendulum_smoother import NOT_CONVERGED, PendulumSmoother
from simgrab.instrument.estimate.tables import PixelRecord
from simgrab.model.calibration import Calibration
from simgrab.model.records.estimates import Estimate

# Beside the reported motion a fit to right data needs, in winds up to 14 m/s, a tenth of this white acceleration,
# m²/s³, and two thirds of this slow forcing, rad; the camera's share of apparent gravity is within 0.05 of 0 to 1.
MOST_FORCING, MOST_LEAN, SHARES = 3e-4, 3e-3, (-0.2, 1.2)
LONGER_M = (-0.6, 1.4)  # of the pendulum, beyond |OA|: two standard deviations of its prior
CLEARLY = 20.0  # difference of the logarithms of likelihoods
STRETCH_S = 60.0  # of the record, on which mistakes are tried
STEP_S = 0.3  # between its frames
AROUND_S = 10.0  # of readings around it, beside what the clock is uncertain by
MOST_SLEW_RAD_S = 0.5
LEAST_STEP = 1e-9  # rad or m, of readings that differ
FEET, DEGREES = 0.3048, 180 / np.pi


def doubt(estimator: Estimator, record: PixelRecord, calibration: Calibration, found: Estimate) -> str:
    """Say that the swing does not follow the controller's motion, and without which mistake it would.

    Of an estimate that was refused it says so only where there is one such mistake, and else what to check.

    A mistake is named where the swing follows without it on the stretch with most of the motion, and is far more likely
    than without each of the others that are tried.

    Parameters
    ----------
    estimator : Estimator
        What found it, with the controller that it used.
    record : PixelRecord
        With rope length and time.
    calibration : Calibration
    found : Estimate
        From all of the record.

    Returns
    -------
    str
        One line; empty if the swing follows, or no controller's motion was used.
    """
    if not isinstance(estimator, PendulumSmoother) or estimator.controller is None or estimator.needs_imu:
        return ""
    reported = [one for one in (estimator.controller.slew, estimator.controller.radius) if one is not None]
    if not any(np.nanmax(one) > np.nanmin(one) for one in reported):
        return ""
    if follows(found) or not (found.ok or found.reason == NOT_CONVERGED):
        return ""
    some, nearby = _stretch(record, estimator.controller)
    stated = replace(estimator, controller=nearby)
    costs = {}
    for text, one, scale in _mistakes(nearby):
        mended = _estimated(replace(stated, controller=one), some, calibration, scale)
        if follows(mended):
            costs[text] = float(mended.diagnostics["cost"])
    first, *others = [*sorted(costs, key=lambda text: costs[text])] or [""]
    sure = first and all(costs[other] > costs[first] + CLEARLY for other in others)
    checks = "are slew (unit, clockwise), radius or luff, offset_m, the rope's length and time.start right?"
    if not (sure or found.ok):  # what is not converged may yet be right
        return checks
    said = "the swing does not follow the controller's motion, and angles may be wrong by degrees"
    return f"{said}: {first if sure else checks}"


def follows(found: Estimate) -> bool:
    """Whether the swing follows the reported motion, so that hardly any other forces are needed."""
    of = found.diagnostics
    return (
        found.ok
        and of["forcing"] < MOST_FORCING
        and of["lean_sd"] < MOST_LEAN
        and SHARES[0] < of["follows"] < SHARES[1]
        and LONGER_M[0] < of["longer_m"] < LONGER_M[1]
    )


def _mistakes(controller: Controller) -> Iterator[tuple[str, Controller, float]]:
    """Yield what would explain it, the data without that mistake, and the factor of the rope's length; first none."""
    yield "", controller, 1.0
    if controller.slew is not None and np.nanmax(controller.slew) > np.nanmin(controller.slew):
        yield "it follows with slew.clockwise the other way round", replace(controller, slew=-controller.slew), 1.0
        rate = np.diff(np.interp(np.arange(*controller.time[[0, -1]]), controller.time, controller.slew))  # rad/s
        if np.nanmax(np.abs(rate), initial=0.0) * DEGREES < MOST_SLEW_RAD_S:
            yield "it follows with slewing angles in rad", _scaled(controller, "slew", DEGREES), 1.0
    if controller.radius is not None and np.nanmax(controller.radius) > np.nanmin(controller.radius):
        yield "it follows with radii in ft", _scaled(controller, "radius", FEET), 1.0
    if controller.rope is not None:
        yield "it follows with rope lengths in ft", controller, FEET


def _scaled(controller: Controller, name: str, by: float) -> Controller:
    """Scale readings; their least steps show the resolution, whose statement is as doubtful as that of the unit."""
    series = by * getattr(controller, name)
    steps = np.abs(np.diff(series))
    return replace(controller, **{name: series, f"{name}_sd": np.quantile(steps[steps > LEAST_STEP], 0.1) / 12**0.5})


def _estimated(estimator: PendulumSmoother, record: PixelRecord, calibration: Calibration, scale: float) -> Estimate:
    assert record.rope_length is not None
    return estimator.estimate(
        record.pixels, calibration, rope_length=scale * record.rope_length, time=record.time, pixel_sd=record.pixel_sd
    )


def _stretch(record: PixelRecord, controller: Controller) -> tuple[PixelRecord, Controller]:
    """Thin the stretch of a record in which most motion is reported, and keep the readings around it."""
    assert record.time is not None
    assert record.rope_length is not None
    moves = [(controller.slew, RADIUS_M), (controller.radius, 1.0)]
    steps = sum(np.abs(np.diff(series)) * lever for series, lever in moves if series is not None)
    way = np.concatenate([[0.0], np.cumsum(np.nan_to_num(steps))])
    starts = np.arange(record.time[0], max(record.time[-1] - STRETCH_S, record.time[0]) + 1, STRETCH_S / 6)
    begin = starts[np.argmax(np.diff([np.interp(starts + at, controller.time, way) for at in (0, STRETCH_S)], axis=0))]
    inside = np.flatnonzero((record.time >= begin) & (record.time <= begin + STRETCH_S))
    inside = inside[:: max(int(STEP_S / np.median(np.diff(record.time))), 1)]
    some = PixelRecord(*(getattr(record, field.name)[inside] for field in fields(record)))
    reach = AROUND_S + 4 * controller.clock_sd_s
    near = (controller.time > begin - reach) & (controller.time < begin + STRETCH_S + reach)
    series = {name: getattr(controller, name) for name in ("time", "slew", "radius", "rope")}
    return some, replace(controller, **{name: of[near] for name, of in series.items() if of is not None})
