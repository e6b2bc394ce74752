"""Heaps of cargo in the closed grab, grab frame."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray

from simgrab.world.scenery import textures
from simgrab.world.scenery.grabs.design import CARGO_LEVELS
from simgrab.world.scenery.grabs.four_rope.shells import HALF_WIDTH, back_curve
from simgrab.world.scenery.meshes.part import Material, Part
from simgrab.world.scenery.meshes.shapes import solid

_CLEARANCE = 0.012  # between the heap and the plates' inside
_HALF_Y = HALF_WIDTH - 0.045
_SHOULDER = (-1.05, -0.75, -0.46, -0.19)  # height of the heap at its edge, per level
_DOME = (0.16, 0.20, 0.24, 0.27)  # rise of the middle
_SLUMP = (0.0, 0.0, 0.03, 0.12)  # how far it falls away towards the side plates, whose top edge is hollowed
_LUMPS = {"coal": 0.045, "ore": 0.028, "grain": 0.010, "bauxite": 0.024, "sulphur": 0.014}  # roughness, metres
_GRID = (41, 37)


def cargo_parts(cargo: str, rng: np.random.Generator) -> list[Part]:
    """Return one heap for each of `CARGO_LEVELS`, inside the closed shells, in the grab frame.

    Parameters
    ----------
    cargo : str
        "coal", "ore", "grain", "bauxite" or "sulphur".
    rng : numpy.random.Generator
        Draws the lumps of the surface.

    Returns
    -------
    list of Part
        Named ``cargo_25``, ``cargo_50``, ``cargo_75`` and ``cargo_100``.
    """
    if cargo not in _LUMPS:
        raise ValueError(f"cargo is {cargo!r}; it must be one of {', '.join(sorted(_LUMPS))}")
    material = Material(f"grab_{cargo}", texture=textures.load(cargo), tile_m=1.4, specular=0.05, shininess=0.1)
    return [
        Part(f"cargo_{round(100 * level)}", _heap(shoulder, dome, slump, _roughness(rng, _LUMPS[cargo])), material)
        for level, shoulder, dome, slump in zip(CARGO_LEVELS, _SHOULDER, _DOME, _SLUMP, strict=True)
    ]


def _floor(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Height of the shells' inside, kept clear of the plate."""
    curve = back_curve(81)
    inner = np.maximum.accumulate(curve[:, 0]) - _CLEARANCE * 1.4
    return np.asarray(np.interp(np.abs(x), inner, curve[:, 1] + _CLEARANCE * 1.4))


def _roughness(rng: np.random.Generator, size: float) -> NDArray[np.float64]:
    """Lumps of two sizes over the heap's grid, metres."""
    nx, ny = _GRID
    fine = rng.standard_normal((nx, ny))
    coarse = rng.standard_normal((nx, ny))
    for axis in (0, 1):
        for _ in range(3):
            coarse = (np.roll(coarse, 1, axis) + coarse + np.roll(coarse, -1, axis)) / 3
    return np.asarray(size * (0.6 * fine + 1.2 * coarse / coarse.std()))


def _heap(shoulder: float, dome: float, slump: float, rough: NDArray[np.float64]) -> trimesh.Trimesh:
    nx, ny = _GRID
    v = np.linspace(-1.0, 1.0, ny)
    y = _HALF_Y * v
    curve = back_curve(81)
    edge_x = np.interp(shoulder - slump, curve[:, 1], curve[:, 0]) - 2.5 * _CLEARANCE
    u = np.linspace(-1.0, 1.0, nx)[:, None]
    x = np.broadcast_to(edge_x * u, (nx, ny))
    fade = (1 - u**4) * (1 - v**6)
    top = shoulder + dome * (1 - np.abs(u) ** 1.6) * (1 - v**2) - slump * np.abs(v) ** 3 + rough * fade
    bottom = np.minimum(_floor(x), top - 0.02)
    grid = np.arange(nx * ny).reshape(nx, ny)
    vertices = np.concatenate(
        [np.stack([x, np.broadcast_to(y, (nx, ny)), z], axis=-1).reshape(-1, 3) for z in (top, bottom)]
    )
    return solid(vertices, _closed_faces(grid))


def _closed_faces(grid: NDArray[np.int64]) -> NDArray[np.int64]:
    """Faces of a top grid, a bottom grid of the same shape behind it, and the skirt between them."""
    below = grid + grid.size
    a, b, c, d = (np.asarray(corner) for corner in (grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]))
    top = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    rim = np.concatenate([grid[:-1, 0], grid[-1, :-1], grid[:0:-1, -1], grid[0, :0:-1]])
    after = np.roll(rim, -1)
    low, low_after = below.ravel()[rim], below.ravel()[after]
    skirt = np.concatenate([np.stack([rim, low, low_after], -1), np.stack([rim, low_after, after], -1)])
    faces: NDArray[np.int64] = np.concatenate([top, top[:, ::-1] + grid.size, skirt])
    return faces
