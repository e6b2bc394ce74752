"""Heaps of bulk cargo as height fields that stand about as steep as the cargo lies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

Field = NDArray[np.float64]


@dataclass(frozen=True)
class Cargo:
    """A bulk material."""

    texture: str  # bundled texture
    tile_m: float  # side of one tile of it, metres
    repose: float  # angle of repose, radians
    rough: float  # standard deviation of the heap's surface at scales below a metre, metres


CARGOES = {
    "coal": Cargo("coal", 5.5, np.radians(37.0), 0.085),
    "ore": Cargo("ore", 5.0, np.radians(36.0), 0.07),
    "grain": Cargo("grain", 4.5, np.radians(27.0), 0.02),
    "bauxite": Cargo("bauxite", 5.0, np.radians(34.0), 0.06),
    "sulphur": Cargo("sulphur", 4.5, np.radians(32.0), 0.035),
}


def warped(x: Field, y: Field, rng: np.random.Generator) -> tuple[Field, Field]:
    """Grid points (len(x), len(y)) shifted by smooth noise, so that cones lose their perfect circles."""
    gx, gy = np.meshgrid(x, y, indexing="ij")
    step = float(x[1] - x[0])
    for grid in (gx, gy):
        for width, reach in ((1.8, 0.32), (0.7, 0.07)):
            noise = gaussian_filter(rng.standard_normal(grid.shape), width / step, mode="reflect")
            grid += reach * noise / noise.std()
    return gx, gy


def cones(gx: Field, gy: Field, tops: NDArray[np.float64], slope: float) -> Field:
    """Upper hull of cones: ``tops`` (N, 3) in metres, ``slope`` = tan of the angle of repose."""
    field = np.full(gx.shape, -np.inf)
    for x, y, z in tops:
        field = np.maximum(field, z - slope * np.hypot(gx - x, gy - y))
    return field


def dug(gx: Field, gy: Field, field: Field, pits: NDArray[np.float64], slope: float) -> Field:
    """Cut craters into a field: each pit (x, y, floor z, floor radius) leaves walls at the angle of repose."""
    for x, y, z, radius in pits:
        field = np.minimum(field, z + slope * np.maximum(np.hypot(gx - x, gy - y) - radius, 0.0))
    return field


def roughened(field: Field, step: float, rough: float, rng: np.random.Generator) -> Field:
    """Add what pouring and sliding leave: lumps of a few decimetres and broad waves; ``step`` is the grid, metres."""
    noise = np.zeros_like(field)
    for width, weight in ((0.2, 0.35), (0.45, 0.9), (1.3, 1.6)):
        layer = gaussian_filter(rng.standard_normal(field.shape), width / step, mode="reflect")
        noise += weight * layer / max(float(layer.std()), 1e-9)
    return gaussian_filter(field, 0.12 / step) + rough * noise


def pile(x: Field, y: Field, height: float, cargo: Cargo, *, spread: float, rng: np.random.Generator) -> Field:
    """Pour a heap as grabs leave it, centred on the grid: a ridge along x, ``spread`` long, with a bite taken out.

    ``height`` is that of the highest top. The field is negative outside the heap. All is in metres.
    """
    slope = float(np.tan(cargo.repose))
    count = 6
    along = np.linspace(-0.5, 0.5, count) * spread + rng.normal(0, 0.08 * spread, count)
    tall = height * (1 - 0.45 * np.abs(np.linspace(-1, 1, count)) ** 1.5) * rng.uniform(0.82, 1.0, count)
    tall *= height / max(tall.max(), 1e-9)
    tops = np.stack([along, rng.normal(0, 0.12 * height, count), tall], 1)
    gx, gy = warped(x, y, rng)
    field = cones(gx, gy, tops, slope)
    bite = np.array([[rng.uniform(-0.3, 0.3) * spread, rng.choice([-1, 1]) * 0.9 * height, 0.3 * height, 0.9]])
    field = np.where(field > 0, np.maximum(dug(gx, gy, field, bite, slope), 0.05), field)
    rim = np.exp(-np.maximum(field, 0) / 0.25)
    ragged = gaussian_filter(rng.standard_normal(field.shape), 4)
    field = field + 0.10 * rim * ragged / ragged.std()
    return roughened(field, float(x[1] - x[0]), cargo.rough, rng)
