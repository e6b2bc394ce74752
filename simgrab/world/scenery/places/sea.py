"""Harbour water: one sheet with ripples and foam in its picture and a light swell in its shape."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from simgrab.world.scenery.meshes.part import Material, Part
from simgrab.world.scenery.places.canvas import Picture, Plane, cloud, noise, shrunk, tiled, toned
from simgrab.world.scenery.places.shapes import sheet
from simgrab.world.scenery.textures import load

SIZE, PIXELS, TILE = 48.0, 2048, 16.0  # metres, pixels, metres of the ripple tile
FAR = 120.0


def sea(
    z: float, chop: float, bands: Sequence[tuple[float, float]], foam_y: Sequence[float], *, rng: np.random.Generator
) -> list[Part]:
    """Return the water as sheets about the origin.

    Parameters
    ----------
    z : float
        Still water level, metres, in the frame of the place.
    chop : float
        From 0, oily calm, to 1, as rough as a harbour gets.
    bands : sequence of (float, float)
        Ranges of y that hold water, metres; ships and quays lie between them.
    foam_y : sequence of float
        Walls along x at which foam and flotsam gather.
    """
    shifts = rng.integers(0, round(PIXELS * TILE / SIZE), (2, 2))
    ripples = noise(rng, cells=5, octaves=4), noise(rng, cells=4, octaves=4)
    foam = noise(rng, cells=5, octaves=4), noise(rng, cells=60, octaves=4)

    @cache
    def pictures() -> tuple[Picture, Picture]:
        plain = _ripples(chop, shifts, *ripples)
        return _foamed(plain, chop, foam_y, *foam), shrunk(plain, 0.5)

    near = Material("water", texture=lambda: pictures()[0], specular=0.12, shininess=0.55)
    far = Material("water far", texture=lambda: pictures()[1], specular=0.0)
    half = SIZE / 2
    cuts = np.array([-FAR, -3 * half, -half, half, 3 * half, FAR])
    n = 61
    swell = gaussian_filter(rng.standard_normal((n, n)), (1.4, 1.0), mode="wrap")
    swell *= (0.015 + 0.06 * chop) / swell.std()
    parts = []
    for band, (low, high) in enumerate(bands):
        rows = [low, *cuts[(cuts > low) & (cuts < high)], high]
        for i, (x0, x1) in enumerate(pairwise(cuts)):
            for j, (y0, y1) in enumerate(pairwise(rows)):
                inside = -half <= y0 and y1 <= half
                x, y, height = np.array([x0, x1]), np.array([y0, y1]), np.array(z)
                if i == 2 and inside:
                    x, y = np.linspace(x0, x1, n), np.linspace(y0, y1, max(2, round((y1 - y0) / SIZE * n)))
                    fade_x, fade_y = (np.clip((half - np.abs(v)) / 3, 0, 1) for v in (x, y))
                    height = z + swell[:, : len(y)] * np.minimum(fade_x[:, None], fade_y)
                mesh = sheet(x, y, height, bottom=z - 1.0)
                uv = mesh.vertices[:, :2] / SIZE + 0.5
                parts.append(Part(f"water {band}{i}{j}", mesh, near if inside else far, uv))
    return parts


def _ripples(chop: float, shifts: NDArray[np.int64], windy: list[Plane], tone: list[Plane]) -> Picture:
    """Two ripple tiles crossed, with patches of wind and calm; seamless."""
    side = round(PIXELS * TILE / SIZE)
    tile = load("water", side)
    sheets = []
    for turn, (row, column) in enumerate(shifts):
        one = np.roll(np.rot90(tile, turn), (int(row), int(column)), (0, 1))
        sheets.append(tiled(one, PIXELS, PIXELS))
    wind = cv2.resize(cloud((512, 512), windy), (PIXELS, PIXELS))
    share = np.clip(0.72 + 0.4 * (wind - 0.5), 0, 1)
    ripples = cv2.blendLinear(sheets[0], sheets[1], share, 1 - share)
    mean = np.full_like(ripples, tile.mean(axis=(0, 1)).astype(np.uint8))
    relief = np.clip((0.25 + 0.75 * chop) * (0.5 + wind), 0.1, 1.0).astype(np.float32)
    picture = cv2.blendLinear(ripples, mean, relief, 1 - relief)
    return toned(picture, tone, 220, 60, 215)


def _foamed(picture: Picture, chop: float, foam_y: Sequence[float], windy: list[Plane], laced: list[Plane]) -> Picture:
    """Lay threads of foam along the walls and, when it is rough, astray."""
    wind = cv2.resize(cloud((512, 512), windy), (PIXELS, PIXELS))
    lace = cv2.resize(cloud((1024, 1024), laced), (PIXELS, PIXELS))
    threads = np.exp(-(((lace - 0.5) / 0.035) ** 2))
    row = SIZE / 2 - (np.arange(PIXELS) + 0.5) / PIXELS * SIZE
    away = np.abs(np.subtract.outer(foam_y, row))
    near = (np.exp(-away / 0.5) + 0.22 * np.exp(-away / 2.2)).max(axis=0)
    stray = np.clip((wind - 0.62) * 3, 0, 0.35)
    foam = (
        threads * np.clip(near[:, None] * (0.35 + 0.9 * chop) * (0.4 + wind) + stray * (0.2 + chop), 0, 0.8)
    ).astype(np.float32)
    white = np.full_like(picture, (168, 172, 166))
    return np.asarray(cv2.blendLinear(white, picture, foam, 1 - foam), np.uint8)
