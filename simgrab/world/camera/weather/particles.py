"""The drops and flakes near enough to be seen one by one."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from simgrab.model.geometry import Array, Intrinsics
from simgrab.world.camera.weather.precipitation import Precipitation

NEAREST_M = 0.3  # the housing's visor keeps them off
MARGIN = 0.1  # of the picture's size: streaks may come in from outside


@dataclass(frozen=True, eq=False)
class Particles:
    """Particles in the camera frame, in the middle of the exposure.

    Attributes
    ----------
    position_m, velocity_m_s : ndarray, shape (N, 3)
    diameter_m : ndarray, shape (N,)
    """

    position_m: Array
    velocity_m_s: Array
    diameter_m: Array


def scatter(
    precipitation: Precipitation,
    intrinsics: Intrinsics,
    jib_from_camera: Array,
    wind_m_s: Array,
    rng: np.random.Generator,
) -> Particles:
    """Draw the particles of one frame, uniform in the volume before the camera.

    Parameters
    ----------
    precipitation : Precipitation
    intrinsics : Intrinsics
    jib_from_camera : ndarray, shape (3, 3)
    wind_m_s : ndarray, shape (3,)
        Velocity of the air, jib frame.
    rng : numpy.random.Generator

    Returns
    -------
    Particles
        As many in each bin as a Poisson distribution gives in the volume to the bin's reach.
    """
    low, high = frustum(intrinsics)
    reach = np.maximum(precipitation.reach_m, NEAREST_M)
    volume = np.prod(high - low) * (reach**3 - NEAREST_M**3) / 3
    count = rng.poisson(precipitation.density_m3 * volume)
    bins = np.repeat(np.arange(len(count)), count)
    u = rng.random((len(bins), 3))
    depth = np.cbrt(NEAREST_M**3 + u[:, 2] * (reach[bins] ** 3 - NEAREST_M**3))
    position = np.column_stack([(low + u[:, :2] * (high - low)) * depth[:, None], depth])
    velocity = np.tile(wind_m_s, (len(bins), 1))
    velocity[:, 2] -= precipitation.fall_m_s[bins]
    if precipitation.flutter_m_s:
        velocity += precipitation.flutter_m_s * rng.standard_normal((len(bins), 3))
    return Particles(position, velocity @ jib_from_camera, precipitation.diameter_m[bins])


@lru_cache(maxsize=2)
def frustum(intrinsics: Intrinsics) -> tuple[Array, Array]:
    """Least and greatest (x, y) at unit depth that the picture and its margin show, shapes (2,)."""
    w, h = intrinsics.width_px, intrinsics.height_px
    u, v = np.linspace(0, w, 33), np.linspace(0, h, 33)
    border = [*((x, y) for x in u for y in (0, h)), *((x, y) for x in (0, w) for y in v)]
    rays = intrinsics.rays(border)
    shown = rays[:, :2] / rays[:, 2:]
    low, high = shown.min(axis=0), shown.max(axis=0)
    margin = MARGIN * (high - low)
    return low - margin, high + margin
