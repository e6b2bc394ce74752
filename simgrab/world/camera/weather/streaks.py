"""Draw particles as the exposure smears them: each blocks as much light as its cross section and time allow.

A particle is spread over its path as samples, which are gathered in the level of a pyramid whose pixels are about as
wide as the particle looks. What a level holds is the share of its pixels' light that is blocked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.model.geometry import Array, Intrinsics
from simgrab.world.camera.row_blocks import each_block, enlarged, threaded_map
from simgrab.world.camera.weather.layer import Layer, Maker, matte
from simgrab.world.camera.weather.precipitation import Particles
from simgrab.world.camera.weather.render_pass import Picture, RenderPass

APERTURE_M = 0.003  # 4.8 mm at F/1.6
LEVELS = 6
COARSEST = 2 ** (LEVELS - 1)
BORDER_PX = 64  # rendered around the picture, for what spills into it; a multiple of COARSEST
SPACING = 0.8  # of samples along a streak, in pixels of their level
PART = 512  # streaks that are sampled at a time
FEW = 0.1  # so many of the thinnest may be rendered a little wider than they are
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


def draw(streaks: Streaks, rendered: RenderPass) -> Maker:
    """Draw streaks before what a picture shows, and none behind it."""
    height, width = rendered.depth.shape
    rows, columns = (-(-(n + 2 * BORDER_PX) // COARSEST) * COARSEST for n in (height, width))
    if not streaks.depth_m.size:
        return lambda _: None
    level = np.clip(np.round(np.log2(streaks.width_px / KERNEL_PX)), 0, LEVELS - 1).astype(int)
    finest = int(np.quantile(level, FEW, method="lower"))
    level = np.maximum(level, finest)
    even = np.ptp(streaks.brightness) == 0

    sums: list[Picture] = []
    for one in range(LEVELS - 1, finest - 1, -1):
        chosen = np.flatnonzero(level == one)
        if chosen.size:
            parts = np.array_split(chosen, -(-chosen.size // PART))
            samples = threaded_map(partial(_samples, streaks, 2**one, rendered.depth), parts)
            finer = _gather(samples, (rows >> one, columns >> one), even)
            sums = _before(sums, finer) if sums else finer
    times = rows // len(sums[0])

    def block(some: slice) -> Layer:
        inside = slice(some.start + BORDER_PX, some.stop + BORDER_PX)
        blocked, *light = (enlarged(s, times, inside, BORDER_PX + width)[:, BORDER_PX:] for s in sums)
        keep = 1 - blocked
        return Layer(keep, light[0]) if light else matte(keep, float(streaks.brightness[0]))

    return block


def _before(near: list[Picture], far: list[Picture]) -> list[Picture]:
    """Lay what a coarser level holds, which is nearer, over a finer one."""
    results, (height, width) = [np.empty_like(f) for f in far], far[0].shape
    times = height // len(near[0])

    def lay(rows: slice) -> None:
        here = [enlarged(n, times, rows, width) for n in near]
        keep = 1 - here[0]
        for result, n, f in zip(results, here, far, strict=True):
            np.add(n, cv2.multiply(f[rows], keep), out=result[rows])

    each_block(height, lay)
    return results


_Samples = tuple[NDArray[np.intp], Picture, Picture]  # flat cells of a level; share blocked; that times brightness


def _samples(streaks: Streaks, pixel: int, depth: Picture, chosen: NDArray[np.intp]) -> _Samples:
    """Spread streaks over their paths and drop what the scene hides."""
    height, width = depth.shape
    start, end = streaks.start_px[chosen], streaks.end_px[chosen]
    number = np.ceil(np.hypot(*(end - start).T) / (SPACING * pixel)).astype(np.intp) + 1
    order = np.arange(number.sum()) - np.repeat(np.cumsum(number) - number, number)
    along = (order.astype(np.float32) + np.float32(0.5)) / np.repeat(number.astype(np.float32), number)
    x, y = (
        np.repeat(a.astype(np.float32), number) + np.repeat((b - a).astype(np.float32), number) * along
        for a, b in zip(start.T, end.T, strict=True)
    )
    column, row = (np.clip(v, 0, n - 1).astype(np.int32) for v, n in ((x, width), (y, height)))
    hit = np.take(depth, row * width + column)
    seen = hit > np.repeat(streaks.depth_m[chosen].astype(np.float32), number)
    for v, n in ((x, width), (y, height)):
        seen &= (v > -BORDER_PX) & (v < n + BORDER_PX)
    seen = np.flatnonzero(seen)
    area = (streaks.area_px[chosen] / number / pixel**2).astype(np.float32)
    columns = -(-(width + 2 * BORDER_PX) // COARSEST) * COARSEST // pixel
    across, down = (((v[seen] + np.float32(BORDER_PX)) / np.float32(pixel)).astype(np.intp) for v in (x, y))
    light = area * streaks.brightness[chosen].astype(np.float32)
    return down * columns + across, np.repeat(area, number)[seen], np.repeat(light, number)[seen]


def _gather(samples: Sequence[_Samples], shape: tuple[int, int], even: bool) -> list[Picture]:
    """Return the share of each pixel's light that samples block, at most 1, and unless even that times brightness."""
    sums = []
    for which in (1,) if even else (1, 2):
        total = np.zeros(shape, np.float32)
        for part in samples:
            np.add.at(total.reshape(-1), part[0], part[which])
        sums.append(cv2.GaussianBlur(total, (3, 3), 0))
    if not even:
        sums[1] /= np.maximum(sums[0], 1)
    cv2.min(sums[0], 1.0, dst=sums[0])
    return sums
