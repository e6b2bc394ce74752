"""Find the readings of a record that are consistent with the hoist: the rope's length changes no faster than its speed.

Two readings r₁, r₂ at t₁ < t₂ agree where

    |r₂ − r₁| ≤ v (t₂ − t₁ + h) + s,

v being the hoist's greatest speed, h how long the display may hold a value, and s its step. If the rope moves no faster
than v, and the display lags by a constant time and holds values for at most h, every pair of correct readings agrees,
even with lost frames. A sequence in which each reading agrees with the next is a chain. A reading is accepted if every
longest chain contains it. So a wrong first reading excludes itself and not the later ones, and of two equally supported
readings neither is accepted. A stretch of equal errors d is detected if it is shorter than the hoist's time there and
back, 2 ((d − s) / v − h), or half of that at either end of a record; for d = 3 m this is 4 s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgrab.model.geometry import Array

ROUNDING = 1e-9  # of numbers as stored


@dataclass(frozen=True)
class Hoist:
    """Limits of the hoist and its display."""

    speed_m_s: float = 70 / 60  # greatest speed; cranes of this kind hoist 50 to 70 m/min
    # how long the display may hold a value: twice its refresh period, because one refresh may be missed; it also
    # allows for jitter of time stamps, and for a hoist that overshoots its speed while accelerating
    hold_s: float = 0.4
    step_m: float = 0.01  # step of the display, which rounds: one unit of its last decimal

    def reach(self, seconds: Array) -> Array:
        """Greatest difference, m, of readings so many seconds apart."""
        return self.speed_m_s * (seconds + self.hold_s) + self.step_m


def consistent(times: Array, lengths: Array, hoist: Hoist | None = None) -> NDArray[np.bool_]:
    """Return which readings of a record are accepted.

    Parameters
    ----------
    times : ndarray, shape (n,)
        Seconds, increasing.
    lengths : ndarray, shape (n,)
        Lengths of the hoist rope, m; NaN where there is no reading; it is not accepted.

    Returns
    -------
    ndarray of bool, shape (n,)

    Raises
    ------
    ValueError
        If the shapes differ or a time is missing or does not increase.

    Examples
    --------
    >>> consistent(np.arange(6) / 9, np.array([20.0, 20.1, 23.1, 20.2, 20.3, 20.4])).tolist()
    [True, True, False, True, True, True]
    """
    times, lengths = np.asarray(times, float), np.asarray(lengths, float)
    if times.ndim != 1 or times.shape != lengths.shape:
        raise ValueError(f"times and lengths must be of one shape (n,), got {times.shape} and {lengths.shape}")
    if not np.isfinite(times).all() or (np.diff(times) <= 0).any():
        raise ValueError("times must be finite and increase")
    hoist = hoist or Hoist()
    read = np.flatnonzero(np.isfinite(lengths))
    believed = np.zeros(len(times), bool)
    if not len(read):
        return believed
    t, r = times[read], lengths[read]
    upto = _longest(t, r, hoist)
    through = upto + _longest(-t[::-1], r[::-1], hoist)[::-1] - 1
    longest = through == through.max()
    # On every longest chain: the only reading at its place in them.
    places = np.bincount(upto[longest])
    believed[read] = longest & (places[np.where(longest, upto, 0)] == 1)
    return believed


def _longest(t: Array, r: Array, hoist: Hoist) -> NDArray[np.int64]:
    """Length of the longest chain that ends at each reading; O(n · readings within the time of any change)."""
    longest = np.ones(len(t), np.int64)
    # So long ago anything agrees, and the longest chain up to then will do.
    horizon = max((float(np.ptp(r)) - hoist.step_m) / hoist.speed_m_s - hoist.hold_s, 0.0)
    start = np.searchsorted(t, t - horizon - ROUNDING)
    best_until = done = 0
    for i in range(1, len(t)):
        if start[i] > done:
            best_until = max(best_until, int(longest[done : start[i]].max()))
            done = int(start[i])
        agree = np.abs(r[i] - r[done:i]) <= hoist.reach(t[i] - t[done:i]) + ROUNDING
        longest[i] = 1 + max(best_until, int(np.where(agree, longest[done:i], 0).max(initial=0)))
    return longest
