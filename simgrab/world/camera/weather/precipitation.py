"""Rain and snow: populations of drops and flakes by the rate at which they fall, and those near enough to be seen."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from simgrab.model.geometry import Array, Intrinsics

BINS = 24
FARTHEST_M = 60.0
# Angle, rad, under which the farthest particles are seen that are rendered one by one; the others are haze. Rain has
# few drops that are near enough, and they are small.
SNOW_RAD, RAIN_RAD = 1.7e-3, 0.7e-3

RAIN_MM = (0.3, 6.0)  # smaller drops are drizzle's, larger ones break up
# Melted diameters of flakes 1 to 12 mm across.
SNOW_MELTED_MM = (0.55, 2.9)
SNOW_DENSITY = 0.17  # g/cm³ · mm: density · diameter of flakes (Holroyd 1971, as in Fabry & Szyrmer 1999)
FLUTTER_M_S = 0.25  # standard deviation of each component; flakes tumble (Kajikawa 1989: 0.1 … 0.3)
DROP_BRIGHTNESS = 0.8  # of white: a drop gathers light from all around it, most of it from the sky (Garg & Nayar 2007)

NEAREST_M = 0.3  # from the camera: the housing's visor keeps them off
MARGIN = 0.1  # of the picture's size: streaks may come in from outside


@dataclass(frozen=True, eq=False)
class Precipitation:
    """Particles in the air, by bins of diameter; shapes (B,).

    Attributes
    ----------
    diameter_m : ndarray
        Root mean square of each bin, so that cross sections are right.
    density_m3 : ndarray
        Particles in a cubic metre.
    fall_m_s : ndarray
        Terminal speed.
    flutter_m_s : float
        Standard deviation of each component of a particle's own velocity.
    brightness : float
        Of a particle, as a share of a white surface's.
    least_rad : float
        Angle under which the farthest particles are seen that are rendered one by one; the others are haze.
    """

    diameter_m: Array
    density_m3: Array
    fall_m_s: Array
    flutter_m_s: float
    brightness: float
    least_rad: float

    @property
    def extinction(self) -> Array:
        """Share of light that a metre of each bin's particles blocks, 1/m, shape (B,).

        The geometric cross section: the light that a particle diffracts, as much again, stays within a pixel.
        """
        return np.asarray(self.density_m3 * np.pi / 4 * self.diameter_m**2)

    @property
    def reach_m(self) -> Array:
        """Depth to which each bin's particles are rendered, shape (B,)."""
        return np.asarray(np.minimum(self.diameter_m / self.least_rad, FARTHEST_M))


def rain(rate_mm_h: float) -> Precipitation:
    """Marshall & Palmer's (1948) drops: N0 = 8000 m⁻³ mm⁻¹, Λ = 4.1 R^−0.21 mm⁻¹; speeds of Atlas et al. (1973)."""
    slope = 4.1 * rate_mm_h**-0.21
    edges = np.geomspace(*RAIN_MM, BINS + 1)
    diameter, density = _bins(edges, 8000.0, slope)
    fall = 9.65 - 10.3 * np.exp(-0.6 * diameter)
    return Precipitation(diameter / 1000, density, fall, 0.0, DROP_BRIGHTNESS, RAIN_RAD)


def snow(rate_mm_h: float) -> Precipitation:
    """Gunn & Marshall's (1958) flakes: N0 = 3800 R^−0.87 m⁻³ mm⁻¹ and Λ = 2.55 R^−0.48 mm⁻¹ of melted diameter.

    A flake's own diameter follows from its mass and density; it falls at 0.8 D^0.16 m/s (Locatelli & Hobbs 1974,
    aggregates, D in mm).
    """
    slope = 2.55 * rate_mm_h**-0.48
    edges = np.geomspace(*SNOW_MELTED_MM, BINS + 1)
    melted, density = _bins(edges, 3800.0 * rate_mm_h**-0.87, slope)
    diameter = np.sqrt(melted**3 / SNOW_DENSITY)
    return Precipitation(diameter / 1000, density, 0.8 * diameter**0.16, FLUTTER_M_S, 1.0, SNOW_RAD)


def _bins(edges: Array, intercept: float, slope: float) -> tuple[Array, Array]:
    """Root mean square diameter, mm, and number, 1/m³, of N0·exp(−Λ D) between edges."""
    number = -np.diff(np.exp(-slope * edges)) * intercept / slope
    # ∫ D² exp(−Λ D) dD = −exp(−Λ D) (D²/Λ + 2 D/Λ² + 2/Λ³)
    square = edges**2 / slope + 2 * edges / slope**2 + 2 / slope**3
    area = -np.diff(np.exp(-slope * edges) * square) * intercept
    return np.sqrt(area / number), number


@dataclass(frozen=True, eq=False)
class Particles:
    """Particles in the camera frame, in the middle of the exposure, shapes (N, 3), (N, 3) and (N,)."""

    position_m: Array
    velocity_m_s: Array
    diameter_m: Array


def scatter(
    precipitation: Precipitation, intrinsics: Intrinsics, jib_from_camera: Array, wind_m_s: Array,
    rng: np.random.Generator,
) -> Particles:  # fmt: skip
    """Draw the particles of one frame, uniform in the volume before the camera, in wind (3,) of the jib frame.

    There are as many in each bin as a Poisson distribution gives in the volume to the bin's reach.
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
