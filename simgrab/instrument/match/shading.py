"""Vignetting, by how the light falls off outwards where surfaces are even.

What a scene shows gets brighter outwards about as often as darker; vignetting makes all of it darker (Zheng et al.,
Single-image vignetting correction using radial gradient symmetry, CVPR 2008). The law is cosⁿ of the field angle.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import stats

from simgrab.geometry import PAPER_FOCAL_LENGTH_MM, PAPER_PIXELS_PER_MM
from simgrab.instrument.match.footage import Footage, to_linear
from simgrab.instrument.match.quantity import Quantity, unknown

CELL_PX = 8
SECTORS = 12
LEAST_PAIRS = 40  # of cells, in a sector
FOCAL_PER_WIDTH = PAPER_FOCAL_LENGTH_MM * PAPER_PIXELS_PER_MM / 1920  # typical; the law's shape hardly depends on it
EVEN = 0.25  # of a cell's logarithm, by which its neighbour may differ
MOST_SD = 0.6
_SD = 0.12  # stops, of the method itself


def vignetting(footage: Footage, still: NDArray[np.bool_] | None, hidden: NDArray[np.bool_]) -> Quantity:
    """Measure the loss at the farthest corner, stops.

    Parameters
    ----------
    footage : Footage
    still : ndarray of bool, shape (height, width), or None
        Pixels that stand still.
    hidden : ndarray of bool, shape (height, width)
        Pixels of display and grab.
    """
    width, height = footage.size
    rows, columns = height // CELL_PX, width // CELL_PX
    if rows < 8 or columns < 8:
        return unknown("the picture is too small", "stops")
    h, w = rows * CELL_PX, columns * CELL_PX

    def cells(values: NDArray[np.floating]) -> NDArray[np.float64]:
        return np.asarray(cv2.resize(np.asarray(values[:h, :w], float), (columns, rows), interpolation=cv2.INTER_AREA))

    level = footage.mean
    usable = (level > 6) & (level < 245) & ~hidden
    if still is not None and still.mean() > 0.3:
        usable &= still
    light = cells(to_linear(level).astype(np.float32))
    good = cells(usable.astype(np.float32)) > 0.99
    x = (np.arange(columns) + 0.5) * CELL_PX - width / 2
    y = ((np.arange(rows) + 0.5) * CELL_PX - height / 2)[:, None]
    falloff = np.log1p((x**2 + y**2) / (FOCAL_PER_WIDTH * width) ** 2)
    falloff /= math.log1p((width**2 + height**2) / 4 / (FOCAL_PER_WIDTH * width) ** 2)
    log = np.log2(np.maximum(light, 1e-6))
    sector = np.floor((np.arctan2(y, x) / (2 * math.pi) + 0.5) * SECTORS).astype(int) % SECTORS
    changes, steps, where = list[NDArray[np.float64]](), list[NDArray[np.float64]](), list[NDArray[np.int64]]()
    for axis in (0, 1):
        both = good & np.roll(good, -1, axis)
        change, step = np.roll(log, -1, axis) - log, np.roll(falloff, -1, axis) - falloff
        both &= (np.abs(change) < EVEN) & (np.abs(step) > 1e-4)
        both[(-1, slice(None)) if axis == 0 else (slice(None), -1)] = False
        changes.append(change[both])
        steps.append(step[both])
        where.append(sector[both])
    change, step, at = (np.concatenate(parts) for parts in (changes, steps, where))
    found = [-_slope(change[at == i], step[at == i]) for i in range(SECTORS) if (at == i).sum() >= LEAST_PAIRS]
    if len(found) < SECTORS // 2:
        return unknown("too little of the picture shows even surfaces that stand still", "stops")
    value = float(np.median(found))
    spread = 1.4826 * float(np.median(np.abs(np.array(found) - value)))
    sd = math.hypot(1.25 * spread / math.sqrt(len(found)), _SD)
    if sd > MOST_SD:
        return unknown("what it shows differs too much from one direction to another", "stops")
    reach = float(stats.t.ppf(0.975, len(found) - 1)) * sd
    value = max(value, 0.0)
    return Quantity(value, max(value - reach, 0.0), value + reach, unit="stops")


def _slope(change: NDArray[np.float64], step: NDArray[np.float64]) -> float:
    """Slope through the origin of least absolute deviation: the weighted median of the ratios."""
    ratio, weight = change / step, np.abs(step)
    order = np.argsort(ratio)
    total = np.cumsum(weight[order])
    return float(ratio[order][np.searchsorted(total, total[-1] / 2)])
