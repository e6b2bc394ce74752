"""The transfer function of sRGB (IEC 61966-2-1), between linear light and display values, both in [0, 1]."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def decoded(value: NDArray[np.float64]) -> NDArray[np.float64]:
    """Turn display values into linear light."""
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def encoded(light: NDArray[np.float64]) -> NDArray[np.float64]:
    """Turn linear light into display values."""
    return np.where(light <= 0.0031308, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055)
