"""The four ropes: where they leave the jib head, and what a piece of one looks like."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray

from simgrab.world.scenery import textures
from simgrab.world.scenery.meshes.part import Material, Part
from simgrab.world.scenery.meshes.shapes import solid

ROPE_RADIUS = 0.016
LAY_M = 0.21  # length in which a strand runs once round: 6.5 diameters
ROPE_CLASSES_M = (5, 10, 15, 20, 25, 30, 35, 40, 45)

_SIDES = 12

#: Where the ropes leave their sheaves, jib frame, metres, shape (4, 3), in the order of the grab's ROPE_TERMINATIONS
#: (seen from above counter-clockwise from +x, +y). Two sheaves side by side cannot serve one plane, so the ropes of a
#: pair lie 0.12 m apart in y. The centroid is O.
ROPE_EXITS = np.array([(0.225, 0.55, 0.0), (-0.225, 0.43, 0.0), (-0.225, -0.55, 0.0), (0.225, -0.43, 0.0)])


def rope_part(length: float, name: str) -> Part:
    """Return a straight rope from the origin up +z.

    Parameters
    ----------
    length : float
        Metres.
    name : str
        Of the part.

    Returns
    -------
    Part
        Its texture's strands make one turn in `LAY_M`.
    """
    material = Material("rope", texture=textures.load("rope"), specular=0.25, shininess=0.2)
    mesh, uv = _tube(length)
    return Part(name, mesh, material, uv)


def _tube(length: float) -> tuple[trimesh.Trimesh, NDArray[np.float64]]:
    """Return a closed tube and its UVs.

    The surface is slit along one side and folded in to the axis there, so that the texture can begin and end at the
    slit while every edge still joins two faces.
    """
    turn = np.linspace(0.0, 1.0, _SIDES + 1)
    rim = ROPE_RADIUS * np.stack([np.cos(2 * np.pi * turn), np.sin(2 * np.pi * turn)], axis=1)
    section = np.concatenate([rim, [(0.0, 0.0)]])  # the last one is the axis
    u = np.append(turn, 0.5)
    n = len(section)
    levels = np.array([0.0, length])
    vertices = np.concatenate([np.column_stack([section, np.full(n, z)]) for z in levels])
    uv = np.concatenate([np.column_stack([u, np.full(n, z / LAY_M)]) for z in levels])
    i = np.arange(n)
    j = np.roll(i, -1)
    walls = np.concatenate([np.stack([i, j, j + n], 1), np.stack([i, j + n, i + n], 1)])
    i = np.arange(_SIDES)
    ends = np.concatenate(
        [
            np.stack([i + 1, i, np.full(_SIDES, n - 1)], 1),
            np.stack([i + n, i + 1 + n, np.full(_SIDES, 2 * n - 1)], 1),
        ]
    )
    return solid(vertices, np.concatenate([walls, ends])), uv
