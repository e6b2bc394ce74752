"""Blur of the lens, by the spread of edges that stand still (the slanted-edge method of ISO 12233).

Light across a straight edge is the edge convolved with the lens' and the pixel's spread. For a circle of confusion of
diameter d, the spread across an edge is a half ellipse of that width; the pixel's is a box of one pixel. The scene's
own edges may be softer, but not sharper: of many, the sharper ones count.
"""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import NDArray

from simgrab.match.footage.edges import away_from, part_of, resampled_sd, straight_edges
from simgrab.match.footage.footage import Footage, to_linear
from simgrab.match.footage.quantity import Quantity, unknown

Floats = NDArray[np.float64]

REACH_PX, ALONG_PX, STEP_PX = 5, 3, 0.25
DIAMETERS = np.arange(0, 8.01, 0.25)
SHIFTS = np.arange(-1, 1.01, 0.1)
DRAWS = 200
LEAST_EDGES, MOST_EDGES = 60, 600  # in all, and in a frame
LEAST_FIT = 0.97  # share of an edge's variance that the model explains
LEAST_CONTRAST = 0.03  # in linear light
SHARPER = 0.25  # quantile of the edges' diameters that counts
_SD = 0.2  # px, of the method itself
LEAST_PX = 1.0  # a smaller circle lies within a pixel and makes no difference
INDISTINCT_PX = 1.4  # nor does one up to this spread edges measurably
MOST_STEP = 6.0  # levels: coarser coding blurs by itself


def blur(footage: Footage, hidden: NDArray[np.bool_]) -> Quantity:
    """Measure the diameter of the circle of confusion, px.

    Parameters
    ----------
    footage : Footage
        Of which a few frames count: what moves, grab and ropes, has the sharpest edges.
    hidden : ndarray of bool, shape (height, width)
        Pixels of the display.
    """
    usable = away_from(hidden, REACH_PX + 1)
    found, parts = (np.concatenate(each) for each in zip(*(_edges(f, usable) for f in footage.few), strict=True))
    if len(found) < LEAST_EDGES or len(set(parts)) < 3:
        return unknown(f"only {len(found)} clear straight edges are in it", "px")

    def sharper(diameters: Floats) -> float:
        return float(np.quantile(diameters, SHARPER))

    value, sd = sharper(found), math.hypot(resampled_sd(found, parts, sharper, "match.blur", DRAWS), _SD)
    if footage.quantiser is not None and footage.quantiser > MOST_STEP:
        return unknown(f"coding in steps of {footage.quantiser:.1f} levels blurs it", "px")
    if sd > 1.5:
        return unknown("its edges differ too much in sharpness", "px")
    low, high = value - 1.96 * sd, max(value + 1.96 * sd, INDISTINCT_PX)
    return Quantity(max(value, LEAST_PX), 0.0 if low < INDISTINCT_PX else low, high, unit="px")


def _edges(level: NDArray[np.uint8], usable: NDArray[np.bool_]) -> tuple[Floats, NDArray[np.int64]]:
    """Diameters of edges, shape (n,), and the part of the picture that each lies in."""
    linear = to_linear(level).astype(np.float32)
    places, directions = straight_edges(
        linear, usable, smooth_px=1.0, about_px=2.5, least=LEAST_CONTRAST / 12, most=MOST_EDGES
    )
    span = np.arange(-REACH_PX - 2, REACH_PX + 3)
    dy, dx = np.meshgrid(span, span, indexing="ij")
    diameters, parts = list[float](), list[int]()
    for (y, x), (c, s) in zip(places.tolist(), directions, strict=True):
        if min(y, x) < -span[0] or y + span[-1] >= linear.shape[0] or x + span[-1] >= linear.shape[1]:
            continue
        across, along = c * dx + s * dy, c * dy - s * dx
        near = (np.abs(across) <= REACH_PX) & (np.abs(along) <= ALONG_PX)
        window = np.s_[y + span[0] : y + span[-1] + 1, x + span[0] : x + span[-1] + 1]
        if level[window][near].max() > 245 or level[window][near].min() < 2:
            continue
        if (found := _diameter(across[near], linear[window][near].astype(float))) is not None:
            diameters.append(found)
            parts.append(part_of(y, x, linear.shape))
    return np.array(diameters, float), np.array(parts, int)


@functools.cache
def _table() -> Floats:
    """Edges of each diameter and shift at the bins' middles, shape (diameters, shifts, bins)."""
    fine = np.arange(-REACH_PX - 8, REACH_PX + 8, 0.02)
    bins = np.arange(-REACH_PX, REACH_PX + STEP_PX / 2, STEP_PX)
    box = np.where(np.abs(fine) <= 0.5, 1.0, 0.0)
    rows = []
    for d in DIAMETERS:
        if d > 1:
            disc = np.sqrt(np.clip((d / 2) ** 2 - fine**2, 0, None))
            spread = np.convolve(disc / disc.sum(), box / box.sum(), "same")
        else:
            spread = box / box.sum()
        edge = np.cumsum(spread)
        rows.append([np.interp(bins - shift, fine, edge) for shift in SHIFTS])
    return np.array(rows)


def _diameter(across: Floats, light: Floats) -> float | None:
    """Fit one edge; None where it is none."""
    table = _table()
    which = np.rint((across + REACH_PX) / STEP_PX).astype(int)
    count = np.bincount(which, minlength=table.shape[2])[: table.shape[2]].astype(float)
    total = np.bincount(which, light, table.shape[2])[: table.shape[2]]
    n, sy, syy = count.sum(), total.sum(), float((light**2).sum())
    se, see, sey = table @ count, table**2 @ count, table @ total
    det = see - se**2 / n
    rise = (sey - se * sy / n) / np.maximum(det, 1e-12)
    about_mean = syy - sy**2 / n
    left = about_mean - rise**2 * det
    best = np.unravel_index(int(left.argmin()), left.shape)
    contrast = float(rise[best])
    if contrast < LEAST_CONTRAST or left[best] > (1 - LEAST_FIT) * about_mean:
        return None
    by_diameter = left.min(axis=1)
    i = int(by_diameter.argmin())
    if i in (0, len(DIAMETERS) - 1):
        return float(DIAMETERS[i])
    a, b, c = by_diameter[i - 1 : i + 2]
    bend = a - 2 * b + c
    return float(DIAMETERS[i] + (0.5 * (a - c) / bend if bend > 0 else 0.0) * 0.25)
