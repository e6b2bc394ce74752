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
    """What the estimators get of M replications, and the truth to judge them by. Radians, metres, pixels."""

    pixels: Array  # (M, n, 2), NaN where the grab was not found
    rope: Array  # (M, n), as reported; NaN where it was not read
    time: Array | None  # (n,), as reported; None for independent frames
    calibration: Calibration  # as reported
    alpha: Array  # (M, n), true; NaN where there is no grab
    beta: float
    sigma: Array  # (M,)
    azimuth: float  # of the tilt
    # (M, K, 2), the same camera looking at swings of `PROBE_ALPHA` evenly all around, each always found
    probe_pixels: Array
    probe_rope: Array  # (M, K)
    # (M, n), standard deviation per coordinate as the detector states it; None without a detector
    pixel_sd: Array | None = None
