"""The rope's length in every frame of a record: consistent readings, and interpolation between them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from simgrab.instrument.observation import Observation
from simgrab.instrument.read import consistent
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array

LONGEST_S = 2.0  # between readings; at 70 m/min the error is at most 1.2 m


def rope(observations: Sequence[Observation], calibration: Calibration) -> tuple[Array, NDArray[np.bool_]]:
    r"""Find the rope's length in every frame; gaps between readings are `bridged` up to `LONGEST_S`.

    Independent frames (without times) have only their own readings.

    Returns
    -------
    length : ndarray, shape (n,)
        \|OA\|, m; NaN where it is not known.
    jump : ndarray of bool, shape (n,)
        Frames with a length that the hoist cannot have reached.
    """
    hoist = np.array(
        [np.nan if s.rope_status != "read" or s.hoist_m is None else s.hoist_m for s in observations], float
    )
    if any(s.time_s is None for s in observations):
        return _sound(hoist + calibration.display_constant_m), np.zeros(len(hoist), bool)
    times = np.array([s.time_s for s in observations], float)
    believed = consistent(times, hoist)
    jump = np.isfinite(hoist) & ~believed
    length = bridged(times, times, np.where(believed, hoist, np.nan), LONGEST_S)
    return _sound(length + calibration.display_constant_m), jump


def _sound(length: Array) -> Array:
    return np.where(length > 0, length, np.nan)


def bridged(at: Array, time: Array, values: Array, longest: float) -> Array:
    """Interpolate readings (n,) linearly at times (m,); NaN in gaps longer than so many seconds.

    Before the first and after the last reading they stay constant for half of this time.
    """
    known = np.isfinite(values)
    time, values = time[known], values[known]
    if not len(time):
        return np.full(len(at), np.nan)
    after, before = np.searchsorted(time, at), np.searchsorted(time, at, side="right") - 1
    gap = time[np.minimum(after, len(time) - 1)] - time[np.maximum(before, 0)]  # 0 at a reading
    outside = np.maximum(time[0] - at, at - time[-1])
    near = np.where(outside > 0, outside <= longest / 2, gap <= longest)
    return np.where(near, np.interp(at, time, values), np.nan)
