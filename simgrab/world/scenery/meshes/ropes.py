"""The ropes: their exits at the jib head, and the mesh of a piece of rope."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simgrab.model.scenario import Jib
from simgrab.world.scenery import textures
from simgrab.world.scenery.meshes.part import Material, Part
from simgrab.world.scenery.meshes.shapes import solid, walls

LAY_M = 0.21  # length in which a strand runs once round: 6.5 diameters of the usual rope
STAGGER_M = 0.12  # two sheaves side by side cannot serve one plane: so far apart in y are the ropes of a pair
ROPE_CLASSES_M = (5, 10, 15, 20, 25, 30, 35, 40, 45)

_SIDES = 12


@dataclass(frozen=True)
class Ropes:
    """The ropes of a crane.

    Attributes
    ----------
    exits : tuple of n tuples of 3 floats
        Points at which they leave their sheaves, jib frame, m, in the order of the grab's terminations (seen from above
        counter-clockwise from +x, +y). Their centroid is O.
    radius_m : float
    """

    exits: tuple[tuple[float, float, float], ...]
    radius_m: float

    @classmethod
    def of(cls, jib: Jib, count: int) -> Ropes:
        """Return the 1, 2 or 4 ropes of a jib."""
        x, y = jib.rope_spread_x_m / 2, jib.rope_spread_y_m / 2
        inner = round(y - STAGGER_M, 9)
        exits = {
            1: ((0.0, 0.0, 0.0),),
            2: ((0.0, inner, 0.0), (0.0, -inner, 0.0)),  # clear of the camera's bracket
            4: ((x, y, 0.0), (-x, inner, 0.0), (-x, -y, 0.0), (x, -inner, 0.0)),
        }
        return cls(exits[count], jib.rope_diameter_mm / 2000)


def rope_part(length: float, name: str, radius: float) -> Part:
    """Return a straight rope from the origin up +z; lengths are in metres.

    The surface is slit along one side and folded in to the axis there, so that the texture can begin and end at the
    slit while every edge still joins two faces.
    """
    turn = np.linspace(0.0, 1.0, _SIDES + 1)
    rim = radius * np.stack([np.cos(2 * np.pi * turn), np.sin(2 * np.pi * turn)], axis=1)
    section = np.concatenate([rim, [(0.0, 0.0)]])  # the last one is the axis
    u = np.append(turn, 0.5)
    n = len(section)
    levels = np.array([0.0, length])
    vertices = np.concatenate([np.column_stack([section, np.full(n, z)]) for z in levels])
    uv = np.concatenate([np.column_stack([u, np.full(n, z / LAY_M)]) for z in levels])
    i = np.arange(_SIDES)
    axis = np.full(_SIDES, n - 1)
    ends = np.concatenate([np.stack([i + 1, i, axis], 1), np.stack([i + n, i + 1 + n, axis + n], 1)])
    material = Material("rope", texture=textures.load("rope"), specular=0.25, shininess=0.2)
    return Part(name, solid(vertices, np.concatenate([walls(np.arange(2 * n).reshape(2, n)), ends])), material, uv)
