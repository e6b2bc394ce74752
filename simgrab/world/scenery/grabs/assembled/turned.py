"""Solids of revolution of grabs that are put together at random."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh

from simgrab.world.scenery.grabs.assembled.dimensions import Dimensions
from simgrab.world.scenery.meshes import shapes


def turned(d: Dimensions, outline: Sequence[tuple[float, float]], sides: int) -> trimesh.Trimesh:
    """Turn a closed outline (r, z), m, about the axis, and stretch it along y by ``half_y`` over ``half``.

    Of four sides, each faces an axis.
    """
    mesh = trimesh.creation.revolve(np.array([*outline, outline[0]], float), sections=sides)
    shapes.outward(mesh)
    if sides == 4:
        mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 4, (0, 0, 1)))
        mesh.apply_scale((2**0.5, 2**0.5, 1.0))
    mesh.apply_scale((1.0, d.half_y / d.half, 1.0))
    return shapes.solid(mesh.vertices, mesh.faces)
