"""Match a run on a video that was coded anew, cut or resampled with the truth of the original, by time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simgrab.errors import RunError
from simgrab.model.geometry import Array

SAME_S = 5e-4  # time stamps of an unchanged video are those of the table exactly, but for rounding
_APART_S = 1.0  # between beginnings that count as different
_CLEARER = 1.25  # ratio of mean distances by which one beginning must fit better than others
_LEAST, _MOST = 8, 300  # measured frames that are compared


def nearest(times: Array, stamps: Array) -> NDArray[np.int64]:
    """Index of the nearest of increasing time stamps, shape (n,); the earlier of two as near."""
    after = np.minimum(np.searchsorted(stamps, times), len(stamps) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(np.abs(times - stamps[before]) <= np.abs(stamps[after] - times) + SAME_S, before, after)


def begins(times: Array, stamps: Array, measured: Array, true: Array) -> float:
    """Find the time of the video at which a run begins.

    A part that was cut out of a video has times of its own. Where they differ from the video's, or end before it, the
    beginning is the frame of the video from which measured positions follow the true ones best, whatever their constant
    difference.

    Parameters
    ----------
    times : ndarray, shape (n,)
        Of the run's frames, s.
    stamps : ndarray, shape (m,)
        Of the video's frames, s, increasing.
    measured : ndarray, shape (n, d)
        Positions, or angles, in the run's frames; NaN where there are none.
    true : ndarray, shape (m, d)
        The same in the video's frames.

    Raises
    ------
    RunError
        If several beginnings fit about as well.
    """
    step = spacing(stamps)
    whole = abs(np.ptp(stamps) - np.ptp(times)) < max(spacing(times), step) * 1.01
    likely = whole or bool((np.abs(stamps[nearest(times, stamps)] - times) < SAME_S).all())
    known = np.flatnonzero(np.isfinite(measured).all(axis=-1))
    if len(known) < _LEAST:
        if likely:
            return float(stamps[0])
        raise RunError(f"its times differ from those of the video, and only {len(known)} frames have a position")
    some = known[:: -(-len(known) // _MOST)]
    last = stamps[-1] - np.ptp(times) + step
    starts = stamps[stamps <= max(last, stamps[0])]
    fits = np.array([_distance(times[some] + at, stamps, measured[some], true) for at in starts])
    best = int(np.argmin(fits))
    if likely and fits[0] <= _CLEARER * fits[best]:
        return float(stamps[0])
    others = np.where(np.abs(starts - starts[best]) < _APART_S, np.inf, fits)
    other = int(np.argmin(others))
    if not np.isfinite(fits[best]) or others[other] < _CLEARER * fits[best]:
        raise RunError(f"its measurements fit about as well from {starts[best]:.3f} s as from {starts[other]:.3f} s")
    return float(starts[best])


def spacing(times: Array) -> float:
    """Median step of times, s; 0 for a single one."""
    return float(np.median(np.diff(times))) if len(times) > 1 else 0.0


def _distance(times: Array, stamps: Array, measured: Array, true: Array) -> float:
    """Mean distance, without the median difference; infinite where the truth of most frames is unknown."""
    at = nearest(times, stamps)
    off = measured - true[at]
    off = off[np.isfinite(off).all(axis=-1) & (np.abs(stamps[at] - times) <= spacing(stamps) / 2 + SAME_S)]
    if len(off) < max(len(times) / 2, 1):
        return np.inf
    return float(np.median(np.linalg.norm(off - np.median(off, axis=0), axis=-1)))
