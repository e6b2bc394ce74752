"""A rigid transform between two frames of reference."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from simgrab.model.geometry.rotations import Array, to_camera


@dataclass(frozen=True, eq=False)
class Pose:
    """Pose of an inner frame in an outer one: ``outer_from_inner``, x ↦ R x + t. NumPy converts it to its matrix.

    Examples
    --------
    >>> import numpy as np
    >>> from simgrab.model.geometry import Pose, rotation_z
    >>> pose = Pose(rotation_z(np.pi / 2), np.array([1.0, 0.0, 0.0]))
    >>> (pose.inverse() @ pose).apply([3.0, 2.0, 1.0]).round(9).tolist()
    [3.0, 2.0, 1.0]
    """

    rotation: Array  # (..., 3, 3), R
    translation: Array  # (..., 3), t, the inner frame's origin, m

    @classmethod
    def from_matrix(cls, matrix: ArrayLike) -> Pose:
        """Read a matrix, shape (..., 3, 4) or (..., 4, 4)."""
        values = np.asarray(matrix, float)
        return cls(values[..., :3, :3], values[..., :3, 3])

    def as_matrix(self) -> Array:
        """Return the matrix, shape (..., 4, 4)."""
        matrix = np.zeros((*self.rotation.shape[:-2], 4, 4))
        matrix[..., :3, :3], matrix[..., :3, 3], matrix[..., 3, 3] = self.rotation, self.translation, 1.0
        return matrix

    def __array__(self, *args: Any, **kwargs: Any) -> Array:
        return np.asarray(self.as_matrix(), *args, **kwargs)

    def __matmul__(self, other: Pose) -> Pose:
        return Pose(self.rotation @ other.rotation, self.apply(other.translation))

    def inverse(self) -> Pose:
        """Return ``inner_from_outer``, x ↦ Rᵀ x − Rᵀ t."""
        return Pose(np.swapaxes(self.rotation, -1, -2), self.local(np.zeros(3)))

    def apply(self, points: ArrayLike) -> Array:
        """Express points (..., 3) of the inner frame in the outer one, R x + t; many poses pair with as many points."""
        if self.rotation.ndim == 2:
            return np.asarray(np.asarray(points, float) @ self.rotation.T + self.translation)
        return np.einsum("...ij,...j->...i", self.rotation, np.asarray(points, float)) + self.translation

    def local(self, points: ArrayLike) -> Array:
        """Express points (..., 3) of the outer frame in the inner one, Rᵀ (x − t)."""
        return to_camera(points, self.rotation, self.translation)
