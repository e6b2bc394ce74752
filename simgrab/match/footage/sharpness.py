"""Sharpening by the camera, by how far light overshoots on both sides of edges.

An unsharp mask adds to a picture a share, its amount, of what a Gaussian blur takes away, and so each straight edge
gets a dark and a bright seam. Edges of rendered pictures overshoot by 3 to 4 % of their rise without it, for those that
rise most are chosen. How sharp an edge was before is not seen: a softer edge and a larger amount look like a sharper
one and a smaller amount. What is measured is the overshoot; the mask is the one that makes rendered edges alike.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from simgrab.match.footage.edges import away_from, part_of, resampled_sd, straight_edges
from simgrab.match.footage.footage import Footage
from simgrab.match.footage.quantity import Quantity, positive, unknown

Floats = NDArray[np.float64]

REACH_PX, ALONG_PX, STEP_PX = 8, 4, 0.5
FLAT = 6  # samples at either end of a profile that must be flat, and between which an edge rises
FLATNESS = 0.12  # of the rise, standard deviation of these
LEAST_RISE = 20.0  # levels
LEAST_EDGES, MOST_EDGES = 80, 400  # in all, and in a frame
AMOUNTS = np.arange(0, 5.01, 0.05)
RADII_PX = np.array([0.4, 0.5, 0.6, 0.8, 1.0, 1.2, 1.4, 1.6, 1.8, 2.0, 2.5, 3.0, 3.5])
EDGE_PX = 0.6  # standard deviation of rendered edges
LEAST_PERCENT = 4.5  # of an edge's rise: an overshoot that is none
DRAWS = 100
_SD_PERCENT, _SD_SHARE = 0.5, 0.05  # of the method itself: of the rise, and of the overshoot


@dataclass(frozen=True)
class Sharpness:
    """How far edges overshoot, and the unsharp mask that makes rendered edges alike."""

    overshoot: Quantity  # above the level 5 to 8 px from the edge, of its rise, %
    # amount, radius_px: of the mask; an amount of 0 where there is none
    amount: float = 0.0
    radius_px: float = 1.0

    @property
    def noise_gain(self) -> float:
        """By what the sharpening multiplies the variance of white noise."""
        amount, radius = self.amount, self.radius_px
        x = np.arange(-math.ceil(4 * radius), math.ceil(4 * radius) + 1)
        blurred = np.exp(-(x**2) / (2 * radius**2))
        blurred /= blurred.sum()
        centre, squares = float(blurred.max() ** 2), float((blurred**2).sum() ** 2)
        return (1 + amount) ** 2 - 2 * amount * (1 + amount) * centre + amount**2 * squares


def sharpness(footage: Footage, hidden: NDArray[np.bool_]) -> Sharpness:
    """Measure sharpening; ``hidden``, shape (height, width), are pixels of the display, which is not sharpened."""
    usable = away_from(hidden, REACH_PX + ALONG_PX)
    profiles, parts = (np.concatenate(each) for each in zip(*(_edges(f, usable) for f in footage.few), strict=True))
    if len(profiles) < LEAST_EDGES or len(set(parts)) < 3:
        return Sharpness(unknown(f"only {len(profiles)} edges between even surfaces are in it", "%"))
    middle = _middle(profiles)
    value = _overshoot(middle)
    sd = resampled_sd(profiles, parts, lambda some: _overshoot(_middle(some)), "match.sharpness", DRAWS)
    reach = 1.96 * math.hypot(sd, _SD_PERCENT, _SD_SHARE * value)
    overshoot = positive(value, reach, "%")
    return Sharpness(overshoot) if value < LEAST_PERCENT else Sharpness(overshoot, *_fit(middle))


def _edges(luma: NDArray[np.uint8], usable: NDArray[np.bool_]) -> tuple[Floats, NDArray[np.int64]]:
    """Profiles across straight edges, 0 to 1, shape (n, samples), and the part of the picture that each lies in."""
    level = luma.astype(np.float32)
    places, directions = straight_edges(
        level, usable, smooth_px=1.5, about_px=3.5, least=LEAST_RISE / 10, most=MOST_EDGES
    )
    wide = np.arange(-REACH_PX - 1, REACH_PX + 1 + STEP_PX / 2, STEP_PX)
    across, along = np.meshgrid(wide, np.arange(-ALONG_PX, ALONG_PX + 1), indexing="ij")
    profiles, parts = list[Floats](), list[int]()
    for (y, x), (c, s) in zip(places.tolist(), directions, strict=True):
        u, v = x + c * across - s * along, y + s * across + c * along
        seen = cv2.remap(level, u.astype(np.float32), v.astype(np.float32), cv2.INTER_CUBIC).mean(axis=1)
        seen = np.interp(_samples() + _crossing(wide, seen), wide, seen)
        ends = seen[:FLAT], seen[-FLAT:]
        rise = float(ends[1].mean() - ends[0].mean())
        clipped = seen.max() > 250 or seen.min() < 3
        if clipped or rise < LEAST_RISE or max(end.std() for end in ends) > FLATNESS * rise:
            continue
        profiles.append((seen - ends[0].mean()) / rise)
        parts.append(part_of(y, x, level.shape))
    return np.array(profiles, float).reshape(-1, len(_samples())), np.array(parts, int)


def _crossing(x: Floats, seen: Floats) -> float:
    """Where a profile is halfway up, px: a pixel from its middle at most."""
    half = (seen[:FLAT].mean() + seen[-FLAT:].mean()) / 2
    near = np.flatnonzero((np.abs(x[:-1] + STEP_PX / 2) < 1) & (seen[:-1] < half) & (seen[1:] >= half))
    if not len(near):
        return 0.0
    i = int(near[0])
    return float(np.clip(x[i] + STEP_PX * (half - seen[i]) / (seen[i + 1] - seen[i]), -1, 1))


def _samples() -> Floats:
    return np.arange(-REACH_PX, REACH_PX + STEP_PX / 2, STEP_PX)


def _middle(profiles: Floats) -> Floats:
    """Median profile, made alike on both sides."""
    median = np.median(profiles, axis=0)
    return np.asarray((median + 1 - median[::-1]) / 2)


def _overshoot(profile: Floats) -> float:
    return max(100 * (float(profile.max()) - 1), 0.0)


def _fit(profile: Floats) -> tuple[float, float]:
    """Fit amount and radius, px, of the mask by which a rendered edge gets a profile."""
    x = _samples()
    edge = ndtr(x / EDGE_PX)
    seam = edge - ndtr(x / np.hypot(EDGE_PX, RADII_PX)[:, None])
    sharp = edge + AMOUNTS[:, None, None] * seam
    low, high = sharp[..., :FLAT].mean(-1, keepdims=True), sharp[..., -FLAT:].mean(-1, keepdims=True)
    off = (((sharp - low) / (high - low) - profile) ** 2).sum(-1)
    amount, radius = np.unravel_index(int(off.argmin()), off.shape)
    return float(AMOUNTS[amount]), float(RADII_PX[radius])
