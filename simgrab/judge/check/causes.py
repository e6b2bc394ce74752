"""Sentences that state why a scene of a check failed."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from simgrab.instrument.run.runs import reasons
from simgrab.judge.check.trial import Trial


def causes(trial: Trial, failed: Sequence[str], *, compared: bool = False) -> Iterator[str]:
    """State in sentences what the errors of a scene consist of; nothing where the instrument failed.

    Parameters
    ----------
    trial : Trial
    failed : sequence of str
        Metrics that failed: sentences on the centre and on the angle are left out unless a metric of theirs did.
    compared : bool
        Whether one of them has a baseline.
    """
    if trial.run is None or trial.known is None or trial.evaluation is None:
        return
    run, true = trial.run, trial.known.alpha
    if lost := reasons(run):
        listed = "; ".join(f"{status} ({reason}) in {count}" for status, reason, count in lost[:3])
        yield f"{sum(count for *_, count in lost)} of {len(true)} frames have no angle: {listed}."
    offset = [trial.metrics.get(f"detection.centre.{axis}_mean_px") for axis in "uv"]
    if offset[0] is not None and offset[1] is not None and any(what.startswith("detection.centre") for what in failed):
        right, down = "right of" if offset[0] > 0 else "left of", "below" if offset[1] > 0 else "above"
        yield (
            f"On average the measured centre lies {abs(offset[0]):.1f} px {right} and {abs(offset[1]):.1f} px {down} "
            "the true one."
        )
    if not any(what.startswith(("angle.", "interval.", "alarm.")) for what in failed):
        return
    both = np.isfinite(run.alpha) & np.isfinite(true)
    bias, rmse = (trial.metrics[f"angle.overall.{name}_deg"] for name in ("bias", "rmse"))
    if bias is None or rmse is None:
        return
    spread, true_spread = (float(np.rad2deg(angle[both].std())) for angle in (run.alpha, true))
    if spread < true_spread / 10:
        yield (
            f"The measured angle hardly follows the swing: its standard deviation is {spread:.2f}°, that of the true "
            f"swing {true_spread:.2f}°."
        )
    elif bias**2 > rmse**2 / 2:
        rest = math.sqrt(max(rmse**2 - bias**2, 0.0))
        yield (
            f"Most of the error is an offset: on average, the measured angle is {abs(bias):.2f}° too "
            f"{'large' if bias > 0 else 'small'}. Without it the RMSE would be {rest:.2f}° instead of {rmse:.2f}°."
        )
    budget = trial.evaluation.budget
    if budget is None:
        return
    fed = budget.chain[-1].rmse_deg  # estimated from the run's own centres and lengths
    if fed is not None and budget.run.rmse_deg is not None and budget.run.rmse_deg > 2 * fed:
        read = any(m.rope_length_m is not None for m in run.measurements)
        inputs = "From the centres and rope lengths that this pipeline measured"
        yield (
            f"{inputs if read else 'From its centres and the true lengths'}, simgrab's estimator {budget.estimator} "
            f"computes angles with an RMSE of {fed:.2f}°: the error arises where this pipeline computes its angles."
        )
    else:
        yield f"Largest contribution in the error budget: {budget.limit}."
        if compared:
            yield "That is of the whole error; what grew since the baseline may be another."
