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
from simgrab.world.weather.layer import Layer
from simgrab.world.weather.particles import Particles
from simgrab.world.weather.sight import Picture, Sight

APERTURE_M = 0.003  # 4.8 mm at F/1.6
LEVELS = 6
COARSEST = 2 ** (LEVELS - 1)
BORDER_PX = 64  # drawn around the picture, for what spills into it; a multiple of COARSEST
SPACING = 0.5  # of samples along a streak, in pixels of their level
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
    level = np.clip(np.round(np.log2(streaks.width_px / KERNEL_PX)), 0, LEVELS - 1).astype(int)
    blocked = glow = np.zeros((rows // COARSEST // 2, columns // COARSEST // 2), np.float32)
    for one in range(LEVELS - 1, -1, -1):
        shape = (rows >> one, columns >> one)
        samples = _samples(streaks, np.flatnonzero(level == one), 2**one, sight.depth)
        share, light = _gather(samples, shape, 2**one)
        # What coarser levels hold is nearer.
        keep = 1 - _enlarged(blocked, shape)
        glow = _enlarged(glow, shape) + light * keep
        blocked = 1 - (1 - share) * keep
    inside = np.s_[BORDER_PX : BORDER_PX + height, BORDER_PX : BORDER_PX + width]
    return Layer(np.ascontiguousarray(1 - blocked[inside]), np.ascontiguousarray(glow[inside]))


_Samples = tuple[Array, Array, Array]  # (N, 2) pixels of the picture; cross section, px²; that times brightness


def _samples(streaks: Streaks, chosen: NDArray[np.intp], pixel: int, depth: Picture) -> _Samples:
    """Spread streaks over their paths and drop what the scene hides."""
    start, step = streaks.start_px[chosen], (streaks.end_px - streaks.start_px)[chosen]
    number = np.ceil(np.hypot(*step.T) / (SPACING * pixel)).astype(int) + 1
    which = np.repeat(np.arange(len(chosen)), number)
    order = np.arange(len(which)) - np.repeat(np.cumsum(number) - number, number)
    at = start[which] + step[which] * ((order + 0.5) / number[which])[:, None]
    height, width = depth.shape
    x, y = np.clip(at[:, 0].astype(int), 0, width - 1), np.clip(at[:, 1].astype(int), 0, height - 1)
    near = (at > -BORDER_PX).all(axis=1) & (at < (width + BORDER_PX, height + BORDER_PX)).all(axis=1)
    seen = near & (depth[y, x] > streaks.depth_m[chosen][which])
    area = (streaks.area_px[chosen] / number)[which][seen]
    return at[seen], area, area * streaks.brightness[chosen][which][seen]


def _gather(samples: _Samples, shape: tuple[int, int], pixel: int) -> tuple[Picture, Picture]:
    """Return the share of each pixel's light that samples block, at most 1, and that share times their brightness."""
    at, area, light = samples
    cell = ((at + BORDER_PX) / pixel).astype(int)
    flat = cell[:, 1] * shape[1] + cell[:, 0]
    sums = [np.bincount(flat, w / pixel**2, shape[0] * shape[1]).reshape(shape) for w in (area, light)]
    share, glow = (cv2.GaussianBlur(s.astype(np.float32), (3, 3), 0) for s in sums)
    excess = np.maximum(share, 1.0)
    return share / excess, glow / excess


def _enlarged(picture: Picture, shape: tuple[int, int]) -> Picture:
    return cv2.resize(picture, shape[::-1], interpolation=cv2.INTER_LINEAR)
