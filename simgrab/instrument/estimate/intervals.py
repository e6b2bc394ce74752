"""Intervals from influences, the effect of each frame, or of each block of seconds, on the estimate.

An estimate that solves Σ ψ(frame; θ) = 0 errs by the mean of its frames' influences, so the scatter of the
influences is its variance (the sandwich; Huber 1967). Frames of one swing are far from independent: then only sums over
blocks are independent, and there are so few blocks that Student's quantiles are needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from simgrab.model.geometry import Array

LEVEL = 0.95  # nominal coverage
MIN_BLOCKS, MAX_BLOCKS = 3, 4  # with fewer there is no interval; long records get longer blocks instead of more
LEAN_BY_WIND = 3.6e-5
"""rad/(m/s)²: a grab of 10 m² (Cd·A) and, with its cargo for half of the time, 17 t."""
LEAN_BY_MOUNT = {"levelled": np.deg2rad(0.85), "rigid": np.deg2rad(1.5)}
"""Standard deviation per axis, rad, of how a camera on such a mount leans about its mean tilt as the crane works. With
it, intervals of 20 s to 10 minutes of work hold (clips 1 to 4 of ``scripts/estimator_study.py``)."""


@dataclass(frozen=True)
class IntervalSettings:
    """Settings of intervals.

    Attributes
    ----------
    block_s : float
        Least length of a block, s. The energy of a swing decorrelates in about 70 s with 1 % damping and 240 s with 0.3
        %; blocks must be several times as long.
    apart_s : float
        Frames count as independent if they are so far apart, s, in place of blocks. With 0.6 s, intervals of cycles at
        work hold in records of 20 s and of 10 minutes alike (``scripts/estimator_study.py``).
    wind_m_s : float
        Mean wind during the record. The grab leans in it, which frames alone cannot tell from a tilt of the camera; it
        widens the intervals of β and α. 0 takes the air as still.
    """

    block_s: float = 600.0
    apart_s: float = 0.0
    wind_m_s: float = 0.0

    @property
    def lean_variance(self) -> float:
        """Of the grab's mean lean by wind per axis, rad²: ½ρ Cd·A v² over its weight, in an unknown direction."""
        return (LEAN_BY_WIND * self.wind_m_s**2) ** 2 / 2


WORKING = IntervalSettings(apart_s=0.6)
"""Of a crane that works: swings are excited again in each cycle of 60 to 90 s."""


def iid_covariance(influence: Array, count: Array, independent: Array) -> Array:
    """Covariance (M, p, p) of estimates with influences (M, p, n), of count (M,) frames so many (M,) independent."""
    square = influence @ influence.swapaxes(-1, -2)
    return np.asarray(square / (count * np.maximum(independent - 1, 1))[:, None, None])


def independent(time: Array | None, count: Array, settings: IntervalSettings) -> Array:
    """How many of the frames (M,) count as independent."""
    if time is None or not settings.apart_s:
        return count
    return np.minimum(count, np.maximum(np.ptp(time) / settings.apart_s, 2))


def block_of(time: Array, settings: IntervalSettings) -> tuple[NDArray[np.int64], int]:
    """Block of each frame, shape (n,), as whole numbers from 0, and how many there are.

    Blocks are equal stretches of the record; a stretch without frames is no block.
    """
    if time.size < 2 or np.ptp(time) == 0:
        return np.zeros(time.size, np.int64), min(time.size, 1)
    start = time.min()
    length = (time.max() - start) * time.size / (time.size - 1)  # the last frame lasts as long as the others
    wanted = int(np.clip(np.floor(length / settings.block_s + 1e-9), 1, MAX_BLOCKS))
    label = np.minimum((time - start) * wanted / length, wanted - 1).astype(np.int64)
    used = np.bincount(label) > 0
    return (np.cumsum(used) - 1)[label], int(used.sum())


def too_few(blocks: int, settings: IntervalSettings) -> str:
    """Return why there is no interval by blocks."""
    return f"too few blocks: {blocks} of at least {settings.block_s:g} s, where {MIN_BLOCKS} are needed"


def block_covariance(influence: Array, count: Array, block: NDArray[np.int64], blocks: int) -> Array:
    """Covariance (M, p, p) of estimates with influences (M, p, n), if only blocks of frames are independent."""
    order = np.argsort(block, kind="stable")
    starts = np.searchsorted(block[order], np.arange(blocks))
    ordered = influence if np.all(order[1:] > order[:-1]) else influence[..., order]
    sums = np.add.reduceat(ordered, starts, axis=-1)
    return np.asarray(sums @ sums.swapaxes(-1, -2) * (blocks / (blocks - 1)) / (count**2)[:, None, None])


def student(level: float, degrees: Array | float) -> Array:
    """Two-sided quantile of Student's t distribution."""
    return np.asarray(scipy.special.stdtrit(np.maximum(degrees, 1), 0.5 + level / 2))


def radial(value: Array, var_along: Array, var_across: Array, quantile: Array) -> Array:
    """Interval, shape (..., 2), of a distance on the sphere whose far end is uncertain.

    The distance cannot be negative, and an error across it only lengthens it. Far from 0 this is the ordinary interval.
    Its lower end is 0 below (1.96² + 2.15)^½ = 2.45 standard deviations, the length that a two-dimensional Gaussian
    about 0 exceeds once in twenty. For a distance of 0 its upper end is the same length.
    """
    reach, wider = quantile * np.sqrt(var_along), 0.56 * quantile**2 * var_across
    ends = np.empty((*value.shape, 2))
    np.maximum(np.sqrt(np.maximum(value * value - wider, 0.0)) - reach, 0.0, out=ends[..., 0])
    far = value + reach
    np.sqrt(far * far + wider, out=ends[..., 1])
    return ends


def split(covariance: Array, towards: Array) -> tuple[Array, Array]:
    """Variance (...) along and across directions (..., 2), from covariances (..., 2, 2)."""
    unit = towards / np.maximum(np.linalg.norm(towards, axis=-1, keepdims=True), 1e-300)
    along = np.einsum("...i,...ij,...j->...", unit, covariance, unit)
    return along, np.trace(covariance, axis1=-2, axis2=-1) - along


def skewness(influence: Array) -> Array:
    """Skewness (M,) of a mean of n terms (M, n) that add up to 0."""
    square = influence * influence
    return np.asarray(np.vecdot(square, influence) / np.maximum(square.sum(axis=-1), 1e-300) ** 1.5)


def of_scale(sigma: Array, var_sigma2: Array, skewness: Array, quantile: Array) -> Array:
    """Interval, shape (..., 2), of σ from the variance and the skewness of σ̂².

    Without skewness it is Gaussian in log σ². Otherwise Hall's (1992) cubic transformation removes the effect of
    skewness on Student's statistic. A mean of squares is very skewed under a heavy tail.
    """
    k, by_log = np.where(np.abs(skewness) < 1e-3, 1.0, skewness), np.abs(skewness) < 1e-3
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):  # of a grab that all but rests
        error = np.sqrt(var_sigma2) / sigma**2
        ends = []
        for t in (quantile, -quantile):
            hall = np.sqrt(np.maximum(1 - error * 3 / k * (np.cbrt(1 + k * (t - k / 6)) - 1), 0.0))
            ends.append(np.where(by_log, np.exp(-t * error / 2), hall))
    return np.asarray(sigma[..., None] * np.stack(ends, axis=-1))
