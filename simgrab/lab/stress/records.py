"""What every fidelity gives: records as the estimators get them, and the truth to judge by."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array

PROBE_ALPHA = math.radians(10.0)
"""The swing that sets off the alarm."""
PROBES = 72

Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class Records:
    """What the estimators get of M replications, and the truth to judge them by. Radians, metres, pixels.

    Attributes
    ----------
    pixels : ndarray, shape (M, n, 2)
        NaN where the grab was not found.
    rope : ndarray, shape (M, n)
        As reported; NaN where it was not read.
    time : ndarray, shape (n,), or None
        As reported; None for independent frames.
    calibration : Calibration
        As reported.
    alpha : ndarray, shape (M, n)
        True; NaN where there is no grab.
    beta : float
    sigma : ndarray, shape (M,)
    azimuth : float
        Of the tilt.
    probe_pixels, probe_rope : ndarray, shape (M, K, 2) and (M, K)
        The same camera looking at swings of `PROBE_ALPHA` evenly all around, each always found.
    pixel_sd : ndarray, shape (M, n), or None
        Standard deviation per coordinate as the detector states it; None without a detector.
    """

    pixels: Array
    rope: Array
    time: Array | None
    calibration: Calibration
    alpha: Array
    beta: float
    sigma: Array
    azimuth: float
    probe_pixels: Array
    probe_rope: Array
    pixel_sd: Array | None = None
