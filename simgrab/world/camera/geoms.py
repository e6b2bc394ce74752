"""The geoms of a posed world, as render passes draw them."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgrab.model.geometry import Array
from simgrab.world.camera import changes
from simgrab.world.scenery.model import GRAB, HIDDEN, ROPE


@dataclass(frozen=True, eq=False)
class Geom:
    """One geom, which is a mesh.

    Attributes
    ----------
    number : int
        In the model.
    group : int
        Id that its pixels get.
    position : tuple of 3 floats
        Jib frame, m; rounded to 32 bits, as MuJoCo draws it.
    turn : ndarray of float32, shape (16,)
        Its orientation, as OpenGL takes it.
    corners : ndarray, shape (8, 3)
        Of the box around it, jib frame, m; as `changes.corners` orders them.
    """

    number: int
    group: int
    position: tuple[float, float, float]
    turn: NDArray[np.float32]
    corners: Array

    @property
    def moves(self) -> bool:
        """Whether it belongs to the grab or the ropes, and not to the place or the jib head."""
        return self.group in (ROPE, GRAB)


def boxes(model: mujoco.MjModel) -> Array:
    """Corners of the box around each geom's mesh, in the geom's own frame, shape (n, 8, 3)."""
    meshes = np.asarray(model.geom_dataid)
    spans = zip(model.mesh_vertadr[meshes], model.mesh_vertnum[meshes], strict=True)
    vertices = [np.asarray(model.mesh_vert[start : start + count], float) for start, count in spans]
    return changes.corners(np.array([v.min(axis=0) for v in vertices]), np.array([v.max(axis=0) for v in vertices]))


def shown(model: mujoco.MjModel, data: mujoco.MjData, boxes: Array, *, grab_only: bool) -> list[Geom]:
    """Geoms that a posed world shows, in the model's order; with ``grab_only`` the grab and its load alone.

    ``boxes`` are those of the function of that name.
    """
    groups = np.asarray(model.geom_group)
    numbers = np.flatnonzero(groups == GRAB if grab_only else groups != HIDDEN)
    turns = np.asarray(data.geom_xmat)[numbers].reshape(-1, 3, 3)
    places = np.asarray(data.geom_xpos)[numbers]
    corners = np.einsum("nij,nkj->nki", turns, boxes[numbers]) + places[:, None]
    matrices = np.zeros((len(numbers), 4, 4), np.float32)
    matrices[:, :3, :3], matrices[:, 3, 3] = turns.transpose(0, 2, 1), 1
    rounded = places.astype(np.float32).tolist()
    return [
        Geom(number, int(groups[number]), tuple(position), matrix, box)
        for number, position, matrix, box in zip(
            numbers.tolist(), rounded, matrices.reshape(-1, 16), corners, strict=True
        )
    ]
