"""Vignetting, by how the light falls off outwards where surfaces are even.

What a scene shows gets brighter outwards about as often as darker; vignetting makes all of it darker (Zheng et al.,
Single-image vignetting correction using radial gradient symmetry, CVPR 2008). The law is cosⁿ of the field angle. What
is even is judged after the vignetting found so far is taken away: judged before, more of what gets darker outwards than
of what gets brighter would look uneven, and vignetting would be found too small.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy import stats

from simgrab.match.footage.footage import Footage, block_means, to_linear
from simgrab.match.footage.quantity import Quantity, positive, unknown
from simgrab.model.geometry import PAPER_FOCAL_LENGTH_MM, PAPER_PIXELS_PER_MM

CELL_PX = 8
SECTORS = 12
APART = 4  # cells: of the pairs that are compared
LEAST_PAIRS = 40  # of cells, in a sector
FOCAL_PER_WIDTH = PAPER_FOCAL_LENGTH_MM * PAPER_PIXELS_PER_MM / 1920  # typical; the law's shape hardly depends on it
EVEN = 0.3  # of a cell's logarithm, by which its neighbour may differ
MOST_SD = 0.4
_SD = 0.09  # stops, of the method itself
_ROUNDS, _CLOSE = 8, 0.01  # stops
_RANGE = -1.0, 5.0  # stops

Floats = NDArray[np.float64]


def vignetting(footage: Footage, still: NDArray[np.bool_] | None, hidden: NDArray[np.bool_]) -> Quantity:
    """Measure the loss at the farthest corner, stops.

    Parameters
    ----------
    still : ndarray of bool, shape (height, width), or None
        Pixels that stand still.
    hidden : ndarray of bool, shape (height, width)
        Pixels of display and grab.
    """
    width, height = footage.size
    rows, columns = height // CELL_PX, width // CELL_PX
    if min(rows, columns) < 2 * APART:
        return unknown("the picture is too small", "stops")
    level = footage.mean
    usable = (level > 6) & (level < 245) & ~hidden
    if still is not None and still.mean() > 0.3:
        usable &= still
    light = block_means(to_linear(level).astype(np.float32).astype(float), CELL_PX)
    good = block_means(usable.astype(float), CELL_PX) > 0.99
    x = (np.arange(columns) + 0.5) * CELL_PX - width / 2
    y = ((np.arange(rows) + 0.5) * CELL_PX - height / 2)[:, None]
    falloff = np.log1p((x**2 + y**2) / (FOCAL_PER_WIDTH * width) ** 2)
    falloff /= math.log1p((width**2 + height**2) / 4 / (FOCAL_PER_WIDTH * width) ** 2)
    log = np.log2(np.maximum(light, 1e-6))
    sector = np.floor((np.arctan2(y, x) / (2 * math.pi) + 0.5) * SECTORS).astype(int) % SECTORS
    value, (change, step, at) = 0.0, _pairs(log, falloff, good, sector)
    for _ in range(_ROUNDS):
        if not len(step):
            break
        before, value = value, float(np.clip(-_slope(change, step), *_RANGE))
        if abs(value - before) < _CLOSE:
            break
        change, step, at = _pairs(log, falloff, good, sector, value)
    parts = (at == i for i in range(SECTORS))
    found = np.array([-_slope(change[part], step[part]) for part in parts if part.sum() >= LEAST_PAIRS])
    if len(found) < SECTORS // 2:
        return unknown("too little of the picture shows even surfaces that stand still", "stops")
    spread = 1.4826 * float(np.median(np.abs(found - np.median(found))))
    sd = math.hypot(1.25 * spread / math.sqrt(len(found)), _SD)
    if sd > MOST_SD:
        return unknown("what it shows differs too much from one direction to another", "stops")
    reach = float(stats.t.ppf(0.975, len(found) - 1)) * sd
    return positive(max(value, 0.0), reach, "stops")


def _pairs(
    log: Floats, falloff: Floats, good: NDArray[np.bool_], sector: NDArray[np.int64], stops: float = 0.0
) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Find pairs of cells along rows and columns with even surface between them.

    ``stops`` is the vignetting by which evenness is judged.

    Returns
    -------
    change, step : ndarray, shape (n,)
        By how much the logarithm of light to base 2, and the falloff per stop, change from one cell to the other.
    sector : ndarray of int, shape (n,)
    """
    flat, parts = log + stops * falloff, list[tuple[NDArray[Any], ...]]()
    for values in ((flat, log, falloff, good, sector), (flat.T, log.T, falloff.T, good.T, sector.T)):
        level, light, fall, fit, where = values
        even = fit[1:] & fit[:-1] & (np.abs(np.diff(level, axis=0)) < EVEN)
        even = np.asarray(sliding_window_view(even, APART, axis=0).all(axis=-1))
        change, step = light[APART:] - light[:-APART], fall[APART:] - fall[:-APART]
        even &= np.abs(step) > 1e-4 * APART
        parts.append((change[even], step[even], where[APART // 2 : -(APART - APART // 2)][even]))
    change, step, where = (np.concatenate(part) for part in zip(*parts, strict=True))
    return change, step, where


def _slope(change: Floats, step: Floats) -> float:
    """Slope through the origin of least absolute deviation: the weighted median of the ratios."""
    return float(np.quantile(change / step, 0.5, weights=np.abs(step), method="inverted_cdf"))
