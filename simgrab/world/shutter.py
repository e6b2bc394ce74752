"""When each row of a picture sees the scene: exposure time and rolling shutter."""

from __future__ import annotations

import math

import numpy as np

from simgrab.geometry import Array

LONGEST_STEP_PX = 1.5  # that anything moves between the instants that are drawn
MOST_INSTANTS = 24


def instants(shutter_s: float, readout_s: float, speed_px_s: float) -> Array:
    """Instants to draw, s from the middle row's mid-exposure, close enough for what moves at a speed.

    Parameters
    ----------
    shutter_s : float
        Exposure time of a row.
    readout_s : float
        From the first row's exposure to the last's.
    speed_px_s : float
        Of the fastest thing in the picture.

    Returns
    -------
    ndarray, shape (n,)
        Increasing, symmetric about 0; a single 0 where nothing moves by a tenth of a pixel.
    """
    span = shutter_s + readout_s
    way = span * speed_px_s
    if way < 0.1:
        return np.zeros(1)
    count = min(math.ceil(way / LONGEST_STEP_PX) + 1, MOST_INSTANTS)
    return np.linspace(-span / 2, span / 2, max(count, 2))


def row_weights(height_px: int, shutter_s: float, readout_s: float, at: Array) -> Array:
    """Share of each instant in each row, shape (height_px, n): the scene goes linearly from instant to instant.

    Rows sum to 1. A row's exposure is centred on readout · ((row + ½)/height − ½).
    """
    if len(at) == 1:
        return np.ones((height_px, 1))
    step = at[1] - at[0]
    centre = (readout_s * ((np.arange(height_px) + 0.5) / height_px - 0.5))[:, None]
    if shutter_s < 1e-9:
        return np.asarray(np.maximum(1 - np.abs(centre - at) / step, 0.0))

    def integral(until: Array) -> Array:
        u = np.clip((until - at) / step, -1.0, 1.0)
        return np.asarray(step * (0.5 + u - u * np.abs(u) / 2))

    weights = integral(centre + shutter_s / 2) - integral(centre - shutter_s / 2)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def row_time(row_px: float, height_px: int, readout_s: float) -> float:
    """Mid-exposure of a row (px from the top), s from the middle row's."""
    return readout_s * (row_px / height_px - 0.5)
