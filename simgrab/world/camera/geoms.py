"""The geoms of a posed world, as render passes draw them."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgrab.model.geometry import Array
from simgrab.world.camera import changes
from simgrab.world.scenery.model import GRAB, HIDDEN, JIB, PLACE, ROPE

PIECE_FACES = 512  # whose vertices take as long as one more call of OpenGL


@dataclass(frozen=True, eq=False)
class Geom:
    """One geom, which is a mesh, or some of its faces.

    Attributes
    ----------
    number : int
        In the model.
    faces : tuple of 2 ints
        The first of its mesh's faces that it has, and the one after its last.
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
    faces: tuple[int, int]
    group: int
    position: tuple[float, float, float]
    turn: NDArray[np.float32]
    corners: Array

    @property
    def moves(self) -> bool:
        """Whether it belongs to the grab or the ropes."""
        return self.group in (ROPE, GRAB)

    @property
    def stands(self) -> bool:
        """Whether it belongs to the place or the jib head."""
        return self.group in (PLACE, JIB)


@dataclass(frozen=True, eq=False)
class Pieces:
    """The geoms of a model, in its order; those of place and jib are cut, so that a window needs a part of them.

    Attributes
    ----------
    numbers : ndarray, shape (n,)
        Of the geoms.
    faces : ndarray, shape (n, 2)
        See `Geom`.
    boxes : ndarray, shape (n, 8, 3)
        Corners of the box around each, in the geom's own frame.
    """

    numbers: NDArray[np.int64]
    faces: NDArray[np.int64]
    boxes: Array

    @classmethod
    def of(cls, model: mujoco.MjModel) -> Pieces:
        """Cut the geoms of a model."""
        numbers, faces, lows, highs = [], [], [], []
        for number, (mesh, group) in enumerate(zip(model.geom_dataid, model.geom_group, strict=True)):
            count = int(model.mesh_facenum[mesh])
            first = np.arange(0, count, PIECE_FACES if group in (PLACE, JIB) else count)
            own = np.asarray(model.mesh_face)[model.mesh_faceadr[mesh] :][:count]
            corners = np.asarray(model.mesh_vert)[model.mesh_vertadr[mesh] + own.ravel()]
            numbers.append(np.full(len(first), number))
            faces.append(np.stack([first, np.append(first[1:], count)], axis=1))
            lows.append(np.minimum.reduceat(corners, 3 * first))
            highs.append(np.maximum.reduceat(corners, 3 * first))
        low, high = (np.concatenate(ends).astype(float) for ends in (lows, highs))
        return cls(np.concatenate(numbers), np.concatenate(faces), changes.corners(low, high))


def shown(model: mujoco.MjModel, data: mujoco.MjData, pieces: Pieces, *, grab_only: bool) -> list[Geom]:
    """Geoms that a posed world shows, in the model's order.

    Parameters
    ----------
    model : mujoco.MjModel
    data : mujoco.MjData
    pieces : Pieces
        Of the model.
    grab_only : bool
        Leave out what is not the grab or its load.
    """
    groups = np.asarray(model.geom_group)[pieces.numbers]
    some = np.flatnonzero(groups == GRAB if grab_only else groups != HIDDEN)
    numbers = pieces.numbers[some]
    turns = np.asarray(data.geom_xmat)[numbers].reshape(-1, 3, 3)
    places = np.asarray(data.geom_xpos)[numbers]
    corners = np.einsum("nij,nkj->nki", turns, pieces.boxes[some]) + places[:, None]
    matrices = np.zeros((len(numbers), 4, 4), np.float32)
    matrices[:, :3, :3], matrices[:, 3, 3] = turns.transpose(0, 2, 1), 1
    rounded = places.astype(np.float32).tolist()
    return [
        Geom(number, (first, end), group, tuple(position), matrix, box)
        for number, (first, end), group, position, matrix, box in zip(
            numbers.tolist(), pieces.faces[some].tolist(), groups[some].tolist(), rounded, matrices.reshape(-1, 16),
            corners, strict=True,
        )
    ]
