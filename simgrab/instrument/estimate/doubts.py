"""Whether the swing follows what a controller reports, and which mistake of its description would explain that not."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from simgrab.instrument.controller import RADIUS_M, Controller
from simgrab.instrument.estimate import Estimator
from simgrab.instrument.estimate.pendulum_smoother import NOT_CONVERGED, PendulumSmoother
from simgrab.instrument.estimate.record import PixelRecord
from simgrab.model.calibration import Calibration
from simgrab.model.records.estimates import Estimate

STATED = "as stated"
CHECKS = "are slew (unit, clockwise), radius or luff, offset_m, the rope's length and time.start right?"
SELDOM_S = 0.15  # between readings: hard brakes last hardly a second
COARSE_M = 0.02  # standard deviation of O's place by a reading: beyond it, right data too may not follow
# Beside the reported motion a fit to right data needs, in winds up to 14 m/s, a tenth of this white acceleration,
# m²/s³, and two thirds of this slow forcing, rad; the camera's share of apparent gravity is within 0.05 of 0 to 1.
MOST_FORCING, MOST_LEAN, SHARES = 3e-4, 3e-3, (-0.2, 1.2)
# Of the pendulum beyond |OA|, two standard deviations of its prior, and three, which right data do not reach.
LONGER_M, FARTHER_M = (-0.6, 1.4), (-1.1, 1.9)
CLEARLY = 20.0  # difference of the logarithms of likelihoods
STRETCH_S = 60.0  # of the record, on which mistakes are tried
STEP_S = 0.3  # between its frames
AROUND_S = 10.0  # of readings around it, beside what the clock is uncertain by
MOST_SLEW_RAD_S = 0.5
LEAST_STEP = 1e-9  # rad or m, of readings that differ
DEGREES = 180 / np.pi


def doubt(estimator: Estimator, record: PixelRecord, calibration: Calibration, found: Estimate) -> str:
    """Say that the swing does not follow the controller's motion, and without which mistake it would.

    On the stretch with most of the motion, the swing must follow without the mistake, and the record be far more likely
    than with the data as stated and without another mistake. None is named where only the pendulum's length shows that
    it does not follow. Errors of pixels that last and whose deviation is not stated look alike: then it says nothing.

    Parameters
    ----------
    estimator : Estimator
        What found it, with the controller that it used.
    record : PixelRecord
        With rope length and time.
    found : Estimate
        From all of the record. Of one that did not converge it says what to check.

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
    if not estimator.wander_px:
        return "" if found.ok else _checks(estimator.controller)
    some, nearby = _stretch(record, estimator.controller)
    costs = {}
    for text, one in _mistakes(nearby):
        tried = some.estimate(replace(estimator, controller=one), calibration)
        likely = tried.ok if text == STATED else follows(tried)
        costs[text] = float(tried.diagnostics["cost"]) if likely else np.inf
    first, *others = sorted(costs, key=lambda text: costs[text])
    said = "the swing does not follow the controller's motion"
    if first != STATED and costs[first] < costs[others[0]] - CLEARLY:
        return f"{said}: {first}"
    if not found.ok:
        return _checks(estimator.controller)
    within = FARTHER_M[0] < found.diagnostics["longer_m"] < FARTHER_M[1]
    return "" if within else f"{said}: {_checks(estimator.controller)}"


def _checks(controller: Controller) -> str:
    """Say what to check of a controller's description, and that its readings are few or coarse where they are."""
    radius_m = RADIUS_M if controller.radius is None else float(np.nanmean(controller.radius))
    off_m = max(controller.slew_sd * radius_m, controller.radius_sd)
    every_s = float(np.median(np.diff(controller.time)))
    doubts = []
    if every_s > SELDOM_S:
        doubts.append(f"readings every {every_s:.2g} s may be too few where drives brake hard")
    if off_m > COARSE_M:
        doubts.append(
            f"resolution and jitter_s (0.29 of a period unless stated) put them {100 * off_m:.0f} cm off each"
        )
    return f"{'; '.join(doubts)}; else {CHECKS}" if doubts else CHECKS


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


def _mistakes(controller: Controller) -> Iterator[tuple[str, Controller]]:
    """Yield what would explain it, and the data without that mistake."""
    yield STATED, controller
    slew = controller.slew
    if slew is not None and np.nanmax(slew) > np.nanmin(slew):
        yield "it follows with slew.clockwise the other way round", replace(controller, slew=-slew)
        rate = np.diff(np.interp(np.arange(*controller.time[[0, -1]]), controller.time, slew))  # rad/s
        if np.nanmax(np.abs(rate), initial=0.0) * DEGREES < MOST_SLEW_RAD_S:
            # The least steps show the resolution, whose statement is as doubtful as that of the unit.
            steps = np.abs(np.diff(slew * DEGREES))
            sd = float(np.quantile(steps[steps > LEAST_STEP], 0.1)) / 12**0.5
            yield (
                "it follows with slewing angles in rad",
                replace(controller, slew=slew * DEGREES, slew_sd=sd, slew_still_sd=None),
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
    within = (record.time >= begin) & (record.time <= begin + STRETCH_S)
    inside = np.flatnonzero(within & record.usable(rope=True))
    some = record.part(inside[:: max(int(STEP_S / np.median(np.diff(record.time))), 1)])
    reach = AROUND_S + 4 * controller.clock_sd_s
    near = (controller.time > begin - reach) & (controller.time < begin + STRETCH_S + reach)
    series = {name: getattr(controller, name) for name in ("time", "slew", "radius", "rope")}
    return some, replace(controller, **{name: of[near] for name, of in series.items() if of is not None})
