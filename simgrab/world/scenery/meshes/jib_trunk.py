"""The fly-jib's trunk behind the head sheaves: a lattice of four chords, jib frame."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import trimesh
from numpy.typing import NDArray

from simgrab.world.scenery.meshes.shapes import block, join, rod

NOSE_X, TAIL_X = -1.30, -10.2
_PANELS = 8


def trunk() -> trimesh.Trimesh:
    """Return the trunk: chords, posts, diagonals, and the box that carries the cheek plates."""
    x = np.linspace(NOSE_X, TAIL_X, _PANELS + 1)
    share = (x - NOSE_X) / (TAIL_X - NOSE_X)
    half = 0.72 + 0.16 * share
    top = np.full_like(x, 0.78)
    low = 0.24 - 1.0 * np.sin(np.pi * np.clip(share * 0.62, 0, 1))
    pieces = [block((NOSE_X - 0.12, -0.76, 0.16), (NOSE_X + 0.10, 0.76, 0.86), 0.015)]
    for side in (-1.0, 1.0):
        upper, lower = (np.stack([x, side * half, z], axis=1) for z in (top, low))
        pieces += _chain(upper, 0.075) + _chain(lower, 0.085)
        pieces += [rod(upper[i], lower[i], 0.04, 8) for i in range(1, _PANELS + 1)]
        pieces += [rod((upper, lower)[i % 2][i], (lower, upper)[i % 2][i + 1], 0.045, 8) for i in range(_PANELS)]
    left, right = -half, half
    for z, radius in ((top, 0.04), (low, 0.045)):
        pieces += [rod((x[i], left[i], z[i]), (x[i], right[i], z[i]), radius, 8) for i in range(1, _PANELS + 1)]
        pieces += [
            rod((x[i], (left, right)[i % 2][i], z[i]), (x[i + 1], (right, left)[i % 2][i + 1], z[i + 1]), 0.035, 8)
            for i in range(_PANELS)
        ]
    return join(pieces)


def _chain(points: NDArray[np.float64], radius: float) -> list[trimesh.Trimesh]:
    """Return a chord through points, each piece a little longer than its panel so that the joints close."""
    pieces = []
    for a, b in pairwise(points):
        reach = (b - a) / np.linalg.norm(b - a) * 0.02
        pieces.append(rod(a - reach, b + reach, radius, 10))
    return pieces
