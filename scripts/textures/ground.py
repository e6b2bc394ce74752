"""Ground textures: bulk cargo, concrete, sea and ship's plating, each a seamless tile."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from .noise import Image, fractal, ramp, stretch

SIZE = 1024


def lumps(rng: np.random.Generator, *, count: int, fill: float) -> tuple[Image, Image]:
    """Scatter faceted lumps on a tile.

    Parameters
    ----------
    rng : numpy.random.Generator
    count : int
        Lumps on the tile.
    fill : float
        Mean lump radius over the mean distance of neighbours; 0.3 is loose, 0.7 touches.

    Returns
    -------
    height, tone : ndarray, shape (SIZE, SIZE)
        Height in pixels (0 between lumps), and a value in [0, 1] that differs from facet to facet.
    """
    centre = rng.uniform(0, SIZE, (count, 2))
    radius = SIZE / np.sqrt(count) * fill * rng.lognormal(0.0, 0.35, count)
    row, column = np.indices((SIZE, SIZE), dtype=float)
    warp = 0.35 * SIZE / np.sqrt(count)
    spot = np.stack([row + warp * (fractal(SIZE, rng, slope=2.6) - 0.5), column], axis=-1) % SIZE
    distance, index = cKDTree(centre, boxsize=SIZE).query(spot.reshape(-1, 2), workers=1)
    index = index.reshape(SIZE, SIZE)
    offset = (spot - centre[index] + SIZE / 2) % SIZE - SIZE / 2
    # Every lump is cut by three planes of its own; the lowest one is the facet that shows.
    facets = []
    for _ in range(3):
        lean = rng.normal(0.0, 0.7, (count, 2))
        facets.append(radius[index] * rng.uniform(0.5, 1.0, count)[index] + (offset * lean[index]).sum(-1))
    dome = np.sqrt(np.maximum(radius[index] ** 2 - distance.reshape(SIZE, SIZE) ** 2, 0.0))
    height = np.maximum(np.minimum(dome, np.min(facets, axis=0)), 0.0)
    tone = rng.uniform(0, 1, (3, count))[np.argmin(facets, axis=0), index]
    return height, np.where(height > 0, tone, 0.5)


def bulk(rng: np.random.Generator, layers: list[tuple[int, float]], *, fines: float) -> Image:
    """Brightness in [0, 1] of a heaped lumpy material: facets, crevices and fines; ``layers`` of (count, fill)."""
    height = fines * fractal(SIZE, rng, slope=1.2, low=20)
    tone = 0.5 + 0.35 * (fractal(SIZE, rng, slope=0.6, low=40) - 0.5)
    for count, fill in layers:
        rock, rock_tone = lumps(rng, count=count, fill=fill)
        tone = np.where(rock > height, rock_tone, tone)
        height = np.maximum(height, rock)
    crevice = sum(
        np.tanh((height - gaussian_filter(height, s, mode="wrap")) / (0.7 * s)) for s in (2.0, 6.0, 16.0)
    )
    grit = fractal(SIZE, rng, slope=0.3, low=60) - 0.5
    return stretch(0.55 * tone + 0.35 * np.asarray(crevice) + 0.30 * grit)


def coal(rng: np.random.Generator) -> Image:
    """Run-of-mine coal: black lumps up to a hand's breadth, grey fines, a little brown."""
    light = bulk(rng, [(30000, 0.5), (5000, 0.33), (700, 0.26)], fines=1.5)
    picture = ramp(light, [(0, (13, 13, 14)), (0.45, (33, 33, 35)), (0.85, (58, 58, 60)), (1, (88, 88, 90))])
    dust = 0.5 * fractal(SIZE, rng, slope=2.4, low=3) + 0.5 * fractal(SIZE, rng, slope=1.5, low=12)
    return picture + (np.clip(dust - 0.45, 0, 1) * 26)[..., None] * np.array([1.05, 0.96, 0.84])


def ore(rng: np.random.Generator) -> Image:
    """Iron-ore fines with some lumps: dull red-brown."""
    light = bulk(rng, [(40000, 0.45), (4000, 0.25), (300, 0.2)], fines=2.5)
    picture = ramp(light, [(0, (44, 28, 24)), (0.5, (92, 60, 50)), (0.9, (122, 84, 70)), (1, (146, 110, 96))])
    damp = fractal(SIZE, rng, slope=2.2, low=4)
    return picture * (0.86 + 0.28 * damp)[..., None]


def grain(rng: np.random.Generator) -> Image:
    """Maize or wheat: fine, pale, dusty, with streaks of chaff."""
    light = bulk(rng, [(60000, 0.5)], fines=2.0)
    picture = ramp(light, [(0, (118, 94, 60)), (0.5, (170, 142, 96)), (1, (206, 182, 138))])
    chaff = 0.6 * fractal(SIZE, rng, slope=1.8, low=6) + 0.4 * fractal(SIZE, rng, slope=2.6, low=3)
    return picture * (0.90 + 0.20 * chaff)[..., None] + (np.clip(chaff - 0.7, 0, 1) * 40)[..., None]


TEXTURES: dict[str, Callable[[np.random.Generator], Image]] = {"coal": coal, "ore": ore, "grain": grain}


def write_all(folder: Path) -> None:
    """Write every ground texture as JPEG into a folder; the same bytes each time."""
    for seed, (name, make) in enumerate(TEXTURES.items(), start=100):
        picture = np.clip(make(np.random.default_rng(seed)), 0, 255).round().astype(np.uint8)
        path = folder / f"{name}.jpg"
        cv2.imwrite(str(path), picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])
