"""Blur of the lens, by the spread of edges that stand still (the slanted-edge method of ISO 12233).

Light across a straight edge is the edge convolved with the lens' and the pixel's spread. For a circle of confusion of
diameter d, the spread across an edge is a half ellipse of that width; the pixel's is a box of one pixel. The scene's
own edges may be softer, but not sharper: of many, the sharper ones count.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.match.footage.edges import straight_edges
from simgrab.match.footage.footage import Footage, to_linear
from simgrab.match.footage.quantity import Quantity, unknown
from simgrab.model.rng import stream

REACH_PX, ALONG_PX, STEP_PX = 5, 3, 0.25
DIAMETERS = np.arange(0, 8.01, 0.25)
SHIFTS = np.arange(-1, 1.01, 0.1)
FRAMES = 8
LEAST_EDGES, MOST_EDGES = 60, 600  # in all, and in a frame
LEAST_FIT = 0.97  # share of an edge's variance that the model explains
LEAST_CONTRAST = 0.03  # in linear light
SHARPER = 0.25  # quantile of the edges' diameters that counts
_SD = 0.2  # px, of the method itself
LEAST_PX = 1.0  # a smaller circle lies within a pixel and makes no difference
INDISTINCT_PX = 1.4  # nor does one up to this spread edges measurably
MOST_STEP = 6.0  # levels: coarser coding blurs by itself


@dataclass(frozen=True, eq=False)
class Blur:
    """Diameter of the circle of confusion, px, and those of single edges, shape (n,)."""

    diameter: Quantity
    edges: NDArray[np.float64]


def blur(footage: Footage, hidden: NDArray[np.bool_]) -> Blur:
    """Measure blur; ``hidden``, shape (height, width), are pixels of the display."""
    side = 2 * REACH_PX + 3
    usable = cv2.erode((~hidden).astype(np.uint8), np.ones((side, side), np.uint8), borderValue=0) > 0
    parts = [_edges(to_linear(f).astype(np.float32), f.astype(np.float32), usable) for f in _some(footage)]
    found, places = (np.concatenate(each) for each in zip(*parts, strict=True))
    if len(found) < LEAST_EDGES or len(set(places)) < 3:
        return Blur(unknown(f"only {len(found)} clear straight edges are in it", "px"), found)
    value = float(np.quantile(found, SHARPER))
    rng = stream(0, 0, "match.blur")
    groups = {place: found[places == place] for place in set(places.tolist())}
    names = list(groups)
    draws = [
        np.quantile(np.concatenate([groups[names[i]] for i in rng.integers(len(names), size=len(names))]), SHARPER)
        for _ in range(200)
    ]
    sd = float(np.hypot(np.std(draws), _SD))
    if footage.quantiser is not None and footage.quantiser > MOST_STEP:
        return Blur(unknown(f"coding in steps of {footage.quantiser:.1f} levels blurs it", "px"), found)
    if sd > 1.5:
        return Blur(unknown("its edges differ too much in sharpness", "px"), found)
    low, high = value - 1.96 * sd, max(value + 1.96 * sd, INDISTINCT_PX)
    return Blur(Quantity(max(value, LEAST_PX), 0.0 if low < INDISTINCT_PX else low, high, unit="px"), found)


def _some(footage: Footage) -> NDArray[np.uint8]:
    """Take a few frames: what moves, grab and ropes, has the sharpest edges."""
    return footage.luma[:: max(footage.frames // FRAMES, 1)][:FRAMES]


def _edges(
    linear: NDArray[np.float32], level: NDArray[np.float32], usable: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Diameters of edges, shape (n,), and the part of the picture that each lies in."""
    at, gx, gy, size = straight_edges(
        linear, usable, smooth_px=1.0, about_px=2.5, least=LEAST_CONTRAST / 12, most=MOST_EDGES
    )
    span = np.arange(-REACH_PX - 2, REACH_PX + 3)
    dy, dx = np.meshgrid(span, span, indexing="ij")
    diameters, places = list[float](), list[int]()
    for y, x in at.tolist():
        if min(y, x) < -span[0] or y + span[-1] >= linear.shape[0] or x + span[-1] >= linear.shape[1]:
            continue
        c, s = gx[y, x] / size[y, x], gy[y, x] / size[y, x]
        across, along = c * dx + s * dy, c * dy - s * dx
        near = (np.abs(across) <= REACH_PX) & (np.abs(along) <= ALONG_PX)
        window = np.s_[y + span[0] : y + span[-1] + 1, x + span[0] : x + span[-1] + 1]
        if level[window][near].max() > 245 or level[window][near].min() < 2:
            continue
        if (found := _diameter(across[near], linear[window][near].astype(float))) is not None:
            diameters.append(found)
            places.append(8 * (8 * y // linear.shape[0]) + 8 * x // linear.shape[1])
    return np.array(diameters, float), np.array(places, int)


def _table() -> NDArray[np.float64]:
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


_TABLE: list[NDArray[np.float64]] = []


def _diameter(across: NDArray[np.float64], light: NDArray[np.float64]) -> float | None:
    """Fit one edge; None where it is none."""
    if not _TABLE:
        _TABLE.append(_table())
    table = _TABLE[0]
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
