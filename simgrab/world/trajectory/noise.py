"""Coloured noise of any length: white noise through a rational filter, in blocks drawn from named streams."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import signal

from simgrab.model.geometry import Array
from simgrab.model.rng import stream

BLOCK = 1024
_FORGETTING = 12.0  # time constants of the slowest pole after which the start is forgotten


@dataclass(frozen=True)
class ShapingFilter:
    """A filter H(s) = numerator/denominator, coefficients in falling powers of s (rad/s); its gain does not matter."""

    numerator: tuple[float, ...]
    denominator: tuple[float, ...]

    def discrete(self, step: float) -> tuple[Array, Array]:
        """Coefficients of the sampled filter whose output has variance 1 for white noise of variance 1."""
        b, a, _ = signal.cont2discrete((self.numerator, self.denominator), step, method="bilinear")
        b = np.ravel(b)
        impulse = np.zeros(math.ceil(self.memory() / step) + 1)
        impulse[0] = 1.0
        return b / np.linalg.norm(signal.lfilter(b, a, impulse)), a

    def memory(self) -> float:
        """Time after which the start has no influence, s."""
        return float(_FORGETTING / np.abs(np.real(np.roots(self.denominator))).min())


def low_pass(bandwidth_hz: float) -> ShapingFilter:
    """White up to a bandwidth: a second-order Butterworth filter."""
    w = 2 * np.pi * bandwidth_hz
    return ShapingFilter((1.0,), (1 / w**2, np.sqrt(2) / w, 1.0))


def narrow_band(frequency_hz: float, damping: float) -> ShapingFilter:
    """Trembling about a frequency: displacement of a damped oscillator that white noise drives, less its slow part."""
    w = 2 * np.pi * frequency_hz
    return ShapingFilter((1.0, 0.0), (1.0, 2 * damping * w, w**2))


def von_karman(scale_m: float, mean_m_s: float) -> ShapingFilter:
    """Turbulence along the wind, S(f) = 4σ²(L/U) / (1 + 70.8 (fL/U)²)^(5/6), von Karman (1948).

    The rational form is fitted to within 5 % of S for f L/U from 0.001 to 3 (`tests/world/test_motion.py`).
    """
    t = scale_m / mean_m_s
    zeros, poles = _VON_KARMAN
    return ShapingFilter(tuple(np.poly(np.divide(zeros, t))), tuple(np.poly(np.divide(poles, t))))


# Zeros and poles, in units of U/L (rad), of the filter fitted to von Karman's spectrum.
_VON_KARMAN = ((-2.4055, -13.748), (-0.81260, -3.1652, -19.116))


def noise(shape: ShapingFilter, step: float, *, seed: int, clip: int, name: str) -> Iterator[Array]:
    """Yield blocks of `BLOCK` samples, stationary from the first on, of variance 1.

    Parameters
    ----------
    shape : ShapingFilter
    step : float
        Time between samples, s.
    name : str
        The variable; block k is drawn from the stream ``name/k``.
    """
    b, a = shape.discrete(step)
    state = np.zeros(max(len(a), len(b)) - 1)
    ahead = int(np.ceil(shape.memory() / step / BLOCK))
    for block in range(10**12):
        white = stream(seed, clip, f"{name}/{block}").standard_normal(BLOCK)
        out, state = signal.lfilter(b, a, white, zi=state)
        if block >= ahead:
            yield out
