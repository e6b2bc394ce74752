"""Match a run on a video that was re-encoded, cut or resampled with the truth of the original, by time."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from simgrab.errors import RunError
from simgrab.model.geometry import Array

SAME_S = 5e-4  # time stamps of an unchanged video are those of the table exactly, but for rounding
_NEAR_S = 1.0  # by which a coder may delay pictures; beginnings farther apart are different ones
_CLEARLY, _BETTER = 1.25, 1.05  # ratios of distances by which one beginning fits clearly better, or better
_KEPT = 0.9  # share of the smallest distances: the others may be false detections
_LEAST, _MOST, _FINE = 8, 300, 8  # positions that are compared; steps between frames
_LEAST_STEP_S = 1 / 240


def nearest(times: Array, stamps: Array) -> NDArray[np.int64]:
    """Index of the nearest of increasing time stamps, shape (n,); the earlier of two as near."""
    after = np.minimum(np.searchsorted(stamps, times), len(stamps) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(np.abs(times - stamps[before]) <= np.abs(stamps[after] - times) + SAME_S, before, after)


def begins(times: Array, stamps: Array, measured: Array, true: Array, *, alone: bool = False) -> float:
    """Find the time of the video at which a run begins.

    A part that was cut out of a video has times of its own, and coders and resamplers delay pictures. The beginning is
    that from which measured positions follow the true ones best, whatever their constant difference. A run whose times
    are some of the video's, or as long, begins within a second of it unless another beginning fits clearly better.

    Parameters
    ----------
    times : ndarray, shape (n,)
        Of the run's frames, s.
    stamps : ndarray, shape (m,)
        Of the video's frames, s, increasing.
    measured : ndarray, shape (n, d)
        Positions, px, or other numbers that change with time, in the run's frames; NaN where there are none.
    true : ndarray, shape (m, d)
        The same in the video's frames.
    alone : bool
        Whether they are angles alone, which may err more than they change: then the run must lie in the video, and its
        times say nothing.

    Raises
    ------
    RunError
        If there are too few positions, or none of the beginnings fits clearly best.
    """
    step, first = spacing(stamps), float(stamps[0])
    whole = abs(np.ptp(stamps) - np.ptp(times)) < max(spacing(times), step) + _NEAR_S / 2
    likely = not alone and (whole or bool((np.abs(stamps[nearest(times, stamps)] - times) < SAME_S).all()))
    known = np.flatnonzero(np.isfinite(measured).all(axis=-1))
    if len(known) < _LEAST:
        if likely:
            return first
        raise RunError(f"{len(known)} of its frames have {'an angle' if alone else 'a position'}")
    some = known[:: -(-len(known) // _MOST)]

    def fits(starts: Array) -> Array:
        return np.array([_distance(times[some] + start, stamps, measured[some], true) for start in starts])

    delays = np.arange(-_NEAR_S, _NEAR_S, max(step, _LEAST_STEP_S))
    starts = np.unique([*(first + delays), *stamps[stamps <= stamps[-1] - np.ptp(times) + _NEAR_S]])
    if alone:
        starts = stamps[stamps <= stamps[-1] - np.ptp(times) + step]
    found = fits(starts)
    near = np.abs(starts - first) < _NEAR_S
    best = int(np.argmin(np.where(near, found, np.inf) if likely else found))
    others = np.where(np.abs(starts - starts[best]) < _NEAR_S, np.inf, found)
    if likely and others.min() * _CLEARLY < found[best]:
        best = int(np.argmin(others))
        others = np.where(np.abs(starts - starts[best]) < _NEAR_S, np.inf, found)
        likely = False
    if not likely and not min(others.min(), _spread(measured[some])) > found[best] * _CLEARLY:
        what = "angles" if alone else "positions"
        raise RunError(f"its {what} follow those from {starts[best]:.2f} s on hardly better than others")
    fine = starts[best] + np.arange(-_FINE, _FINE + 1) * step / _FINE
    finest = fits(fine)
    if likely and fits(stamps[:1])[0] <= _BETTER * finest.min():
        return first
    return float(fine[int(np.argmin(finest))])


def spacing(times: Array) -> float:
    """Median step of times, s; 0 for a single one."""
    return float(np.median(np.diff(times))) if len(times) > 1 else 0.0


def _distance(times: Array, stamps: Array, measured: Array, true: Array) -> float:
    """Mean distance, without the median difference; infinite where the truth of most frames is unknown."""
    there = [np.interp(times, stamps, column, left=np.nan, right=np.nan) for column in true.T]
    off = measured - np.stack(there, axis=-1)
    off = off[np.isfinite(off).all(axis=-1)]
    if 2 * len(off) < len(times):
        return np.inf
    return _spread(off)


def _spread(points: Array) -> float:
    """Mean distance of points (n, d) from their median, without the farthest."""
    size = np.sort(np.linalg.norm(points - np.median(points, axis=0), axis=-1))
    return float(size[: math.ceil(_KEPT * len(size))].mean())
