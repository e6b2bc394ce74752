"""Early warnings and forecasts against the true swing, beside two simple forecasts of the next turning point."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from simgrab.instrument.alarm import DANGER, WARNED_AT, events, warning
from simgrab.instrument.contract import Measurement
from simgrab.instrument.forecast import HORIZON_S
from simgrab.judge.evaluate.swings import SURELY, errors, meet, swings_in, true_events
from simgrab.model.geometry import STANDARD_GRAVITY, Array

UNSURE = 0.05, 0.95  # forecasts between these count for reliability; most frames are far from danger
_AROUND = 3  # frames on each side that a measured turning point exceeds


def score(times: Array, measurements: Sequence[Measurement], true: Array, at: float = WARNED_AT) -> dict[str, Any]:
    """Compare forecasts at times (n,), s, with the true swings (n,), rad, NaN where they are not known.

    A warning starts at the probability ``at``. Returns the fields of `simgrab.judge.evaluate.values.Warnings`.
    """
    raised = [msgspec.structs.replace(w, end_s=w.end_s + HORIZON_S) for w in events(times, measurements, at, warning)]
    sure = [e for e in true_events(times, true) if e.alpha > SURELY]
    met = [next((w for w in raised if meet(e, w)), None) for e in sure]
    leads = [min(e.onset_s - w.onset_s, HORIZON_S) for e, w in zip(sure, met, strict=True) if w is not None]
    false = sum(not swings_in(times, true, w) for w in raised)
    hours = float(times[-1] - times[0]) / 3600 if len(times) else 0.0
    columns = np.array(
        [(m.alpha, m.rope_length_m, m.warning, m.peak, m.peak_low, m.peak_high) for m in measurements], float
    )
    alpha, rope, chance, peak, low, high = columns.reshape(-1, 6).T
    due = next_peak(times, true)
    known = np.isfinite(peak) & np.isfinite(due)
    guesses = {"peak": peak, "persist": last_peak(alpha), "two_frames": from_two_frames(times, alpha, rope)}
    stated, happened = unsure(chance, within(times, true))
    return {
        "hours": hours, "events": len(sure), "missed": len(sure) - len(leads), "late": sum(lead <= 0 for lead in leads),
        "reported": len(raised), "false": false, "false_per_h": false / hours if hours else None,
        "leads": leads, "lead_s": float(np.median(leads)) if leads else None,
        "unsure": len(stated), "reliability": reliability(stated, happened),
        **{f"{name}_rmse_deg": errors(guess[known], due[known])["rmse_deg"] for name, guess in guesses.items()},
        "peak_coverage": float(np.mean((low <= due) & (due <= high), where=known)) if known.any() else None,
        "peak_width_deg": float(np.rad2deg(np.mean(high[known] - low[known]))) if known.any() else None,
    }  # fmt: skip


def within(times: Array, true: Array) -> Array:
    """Greatest swing within `HORIZON_S` of each frame, shape (n,); NaN where it is not known for so long."""
    ends = np.searchsorted(times, times + HORIZON_S, side="right")
    most = [np.max(true[i:end]) for i, end in enumerate(ends)]
    return np.where(times + HORIZON_S <= times[-1:], most, np.nan)


def next_peak(times: Array, true: Array) -> Array:
    """Swing at the first turning point after each frame, shape (n,); NaN where there is none within `HORIZON_S`."""
    tops = np.flatnonzero((true[1:-1] > true[:-2]) & (true[1:-1] >= true[2:])) + 1
    if not len(tops):
        return np.full(len(times), np.nan)
    after = np.searchsorted(tops, np.arange(len(times)), side="right")
    at = tops[np.minimum(after, len(tops) - 1)]
    return np.where((after < len(tops)) & (times[at] <= times + HORIZON_S), true[at], np.nan)


def last_peak(alpha: Array) -> Array:
    """Forecast that the last amplitude persists: the last turning point of measured swings (n,), seen in full."""
    found = np.full(len(alpha), np.nan)
    for i in range(2 * _AROUND, len(alpha)):
        around = alpha[i - 2 * _AROUND : i + 1]
        found[i] = around[_AROUND] if np.argmax(around) == _AROUND else found[i - 1]
    return found


def from_two_frames(times: Array, alpha: Array, rope: Array) -> Array:
    """Forecast of an undamped pendulum without forcing, (n,), from the angle and its change since the frame before."""
    rate = np.diff(alpha, prepend=np.nan) / np.diff(times, prepend=np.nan)
    return np.hypot(alpha, rate * np.sqrt(rope / STANDARD_GRAVITY))


def unsure(chance: Array, most: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Keep forecasts between 5 % and 95 %, shape (k,), and whether the greatest swing exceeded 10°."""
    some = (chance >= UNSURE[0]) & (chance <= UNSURE[1]) & np.isfinite(most)
    return chance[some], most[some] > DANGER


def reliability(chance: Array, happened: NDArray[np.bool_]) -> float | None:
    """Mean distance, over frames, of the share that happened from the stated probability, in tenths of probability."""
    if not len(chance):
        return None
    tenth = np.minimum((10 * chance).astype(int), 9)
    gap = np.bincount(tenth, happened - chance, minlength=10)
    return float(np.abs(gap).sum() / len(chance))
