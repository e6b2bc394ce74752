"""Draw particles as the exposure smears them: each blocks as much light as its cross section and time allow.

A particle is spread over its path as samples, which are gathered in the level of a pyramid whose pixels are about as
wide as the particle looks. What a level holds is the share of its pixels' light that is blocked.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.geometry import Array, Intrinsics
from simgrab.world.weather.layer import Layer, clear, matte
from simgrab.world.weather.particles import Particles
from simgrab.world.weather.sight import Picture, Sight

APERTURE_M = 0.003  # 4.8 mm at F/1.6
LEVELS = 6
COARSEST = 2 ** (LEVELS - 1)
BORDER_PX = 64  # drawn around the picture, for what spills into it; a multiple of COARSEST
SPACING = 0.8  # of samples along a streak, in pixels of their level
FEW = 0.1  # so many of the thinnest may be drawn a little wider than they are
KERNEL_PX = 2.1  # width at half height of what one sample leaves, in pixels of its level


@dataclass(frozen=True, eq=False)
class Streaks:
    """Paths of particles through the picture.

    Attributes
    ----------
    start_px, end_px : ndarray, shape (N, 2)
        As the picture has them.
    depth_m : ndarray, shape (N,)
        Amid the path, along the optical axis.
    area_px : ndarray, shape (N,)
        Cross section.
    width_px : ndarray, shape (N,)
        Of particle and blur: the lens is focused on the scene, far behind the particles that are near.
    brightness : ndarray, shape (N,)
    """

    start_px: Array
    end_px: Array
    depth_m: Array
    area_px: Array
    width_px: Array
    brightness: Array


def expose(particles: Particles, brightness: Array, intrinsics: Intrinsics, shutter_s: float) -> Streaks:
    """Project the paths that particles take while the shutter is open."""
    half = particles.velocity_m_s * (shutter_s / 2)
    depth, diameter = particles.position_m[:, 2], particles.diameter_m
    ends = [intrinsics.project(particles.position_m + s * half) for s in (-1, 1)]
    scale = intrinsics.f_px / depth
    area = np.pi / 4 * (scale * diameter) ** 2
    width = scale * np.hypot(diameter, APERTURE_M)
    seen = np.isfinite(ends[0] + ends[1]).all(axis=1)  # a path that passes the camera has no end in the picture
    return Streaks(*(v[seen] for v in (*ends, depth, area, width, brightness)))


def draw(streaks: Streaks, sight: Sight) -> Layer:
    """Draw streaks before what a picture shows, and none behind it."""
    height, width = sight.depth.shape
    rows, columns = (-(-(n + 2 * BORDER_PX) // COARSEST) * COARSEST for n in (height, width))
    if not streaks.depth_m.size:
        return clear((height, width))
    level = np.clip(np.round(np.log2(streaks.width_px / KERNEL_PX)), 0, LEVELS - 1).astype(int)
    finest = int(np.quantile(level, FEW, method="lower"))
    level = np.maximum(level, finest)
    even = np.ptp(streaks.brightness) == 0
    sums = [np.zeros((1, 1), np.float32)] * (1 if even else 2)  # what is blocked, and how bright that is
    for one in range(LEVELS - 1, finest - 1, -1):
        shape = (rows >> one, columns >> one)
        coarser = [cv2.resize(s, shape[::-1], interpolation=cv2.INTER_LINEAR) for s in sums]
        chosen = np.flatnonzero(level == one)
        if chosen.size:
            keep = 1 - coarser[0]  # what coarser levels hold is nearer
            finer = _gather(_samples(streaks, chosen, 2**one, sight.depth), shape, 2**one, even)
            coarser = [near + cv2.multiply(far, keep) for near, far in zip(coarser, finer, strict=True)]
        sums = coarser
    sums = [cv2.resize(s, (columns, rows), interpolation=cv2.INTER_LINEAR) for s in sums] if finest else sums
    inside = np.s_[BORDER_PX : BORDER_PX + height, BORDER_PX : BORDER_PX + width]
    keep = 1 - sums[0][inside]
    if even:
        return matte(keep, float(streaks.brightness[0]))
    return Layer(keep, np.ascontiguousarray(sums[1][inside]))


_Samples = tuple[NDArray[np.intp], Array, Array]  # flat cells of their level; cross section, px²; that times brightness


def _samples(streaks: Streaks, chosen: NDArray[np.intp], pixel: int, depth: Picture) -> _Samples:
    """Spread streaks over their paths and drop what the scene hides."""
    height, width = depth.shape
    start, end = streaks.start_px[chosen], streaks.end_px[chosen]
    number = np.ceil(np.hypot(*(end - start).T) / (SPACING * pixel)).astype(np.intp) + 1
    order = np.arange(number.sum()) - np.repeat(np.cumsum(number) - number, number)
    share = (order.astype(np.float32) + np.float32(0.5)) / np.repeat(number.astype(np.float32), number)
    x, y = (
        np.repeat(a.astype(np.float32), number) + np.repeat((b - a).astype(np.float32), number) * share
        for a, b in zip(start.T, end.T, strict=True)
    )
    column, row = (np.clip(v, 0, n - 1).astype(np.int32) for v, n in ((x, width), (y, height)))
    hit = np.take(depth, row * width + column)
    seen = hit > np.repeat(streaks.depth_m[chosen].astype(np.float32), number)
    for v, n in ((x, width), (y, height)):
        seen &= (v > -BORDER_PX) & (v < n + BORDER_PX)
    seen = np.flatnonzero(seen)
    area = streaks.area_px[chosen] / number
    columns = -(-(width + 2 * BORDER_PX) // COARSEST) * COARSEST // pixel
    across, down = (((v[seen] + np.float32(BORDER_PX)) / np.float32(pixel)).astype(np.intp) for v in (x, y))
    light = area * streaks.brightness[chosen]
    return down * columns + across, np.repeat(area, number)[seen], np.repeat(light, number)[seen]


def _gather(samples: _Samples, shape: tuple[int, int], pixel: int, even: bool) -> list[Picture]:
    """Return the share of each pixel's light that samples block, at most 1, and unless even that times brightness."""
    cell, *weights = samples
    sums = []
    for weight in weights[: 1 if even else 2]:
        total = np.bincount(cell, weight, shape[0] * shape[1]).astype(np.float32).reshape(shape)
        sums.append(cv2.GaussianBlur(total / np.float32(pixel**2), (3, 3), 0))
    if not even:
        sums[1] /= np.maximum(sums[0], 1)
    sums[0] = np.minimum(sums[0], 1)
    return sums
