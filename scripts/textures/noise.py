"""Seamless procedural noise, the raw material of every texture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float64]


def fractal(
    size: int, rng: np.random.Generator, *, slope: float = 2.0, low: float = 1.0, high: float = np.inf
) -> Image:
    """Tileable noise with a power-law spectrum, scaled to [0, 1].

    Parameters
    ----------
    size : int
        Pixels a side.
    slope : float
        Amplitude falls as frequency^(−slope/2): 0 is white, 2 is cloudy, 3 and more is smooth.
    low, high : float
        Band, in cycles a tile.

    Returns
    -------
    ndarray, shape (size, size)
    """
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(size, 1 / size), np.fft.rfftfreq(size, 1 / size), indexing="ij"))
    spectrum = np.fft.rfft2(rng.standard_normal((size, size)))
    spectrum *= np.where((frequency >= low) & (frequency <= high), np.maximum(frequency, 1.0) ** (-slope / 2), 0.0)
    picture = np.fft.irfft2(spectrum, s=(size, size))
    return stretch(picture)


def stretch(picture: Image) -> Image:
    """Scale a picture so that its 0.5 and 99.5 percentiles land on 0 and 1, and clip."""
    low, high = np.percentile(picture, [0.5, 99.5])
    return np.clip((picture - low) / (high - low), 0.0, 1.0)


def ramp(value: Image, stops: list[tuple[float, tuple[int, int, int]]]) -> Image:
    """Colour a scalar picture by linear interpolation between (value, (r, g, b)) stops; returns (H, W, 3) in 0–255."""
    at = [s[0] for s in stops]
    return np.stack([np.interp(value, at, [s[1][c] for s in stops]) for c in range(3)], axis=-1)
