"""Poses form a group that acts on points."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from simgrab.model.geometry import Pose


@pytest.mark.parametrize("shape", [(), (5,)])
def test_poses_are_scipys_rigid_transforms(shape):
    rng = np.random.default_rng(2)
    turns = [Rotation.random(shape[0] if shape else None, rng=rng) for _ in range(2)]
    a, b = (Pose(turn.as_matrix(), rng.normal(size=(*shape, 3))) for turn in turns)
    points = rng.normal(size=(*shape, 3))
    theirs, other = (RigidTransform.from_matrix(pose.as_matrix()) for pose in (a, b))
    np.testing.assert_allclose(a @ b, (theirs * other).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(a.inverse(), theirs.inv().as_matrix(), atol=1e-14)
    np.testing.assert_allclose(a.apply(points), theirs.apply(points), atol=1e-14)
    np.testing.assert_allclose(a.local(a.apply(points)), points, atol=1e-14)
    np.testing.assert_array_equal(Pose.from_matrix(a.as_matrix()[..., :3, :]), a)
