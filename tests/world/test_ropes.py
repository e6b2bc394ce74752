from __future__ import annotations

import numpy as np

from simgrab.model.scenario import Jib
from simgrab.world.scenery.grabs.four_rope import four_rope
from simgrab.world.scenery.meshes.ropes import ROPE_CLASSES_M, Ropes, rope_part

ROPES = Ropes.of(Jib(), 4)
EXITS = np.array(ROPES.exits)


def test_exits_are_centred_on_the_origin() -> None:
    np.testing.assert_allclose(EXITS.mean(axis=0), 0.0, atol=1e-14)
    np.testing.assert_allclose(np.ptp(EXITS, axis=0), [0.45, 1.1, 0.0], atol=1e-12)


def test_ropes_do_not_cross() -> None:
    top, bottom = EXITS[:, :2], four_rope().terminations[:, :2]
    for s in np.linspace(0.0, 1.0, 21):
        at = (1 - s) * top + s * bottom
        gap = np.linalg.norm(at[:, None] - at[None, :], axis=-1) + 9.0 * np.eye(4)
        assert gap.min() > 0.3
    # Same corner above and below.
    np.testing.assert_array_equal(np.sign(top), np.sign(bottom))


def test_rope_is_closed_light_and_to_measure() -> None:
    for length in ROPE_CLASSES_M:
        part = rope_part(float(length), "rope", ROPES.radius_m)
        assert part.mesh.is_watertight
        assert part.mesh.volume > 0
        assert len(part.mesh.faces) < 3000
        np.testing.assert_allclose(part.mesh.bounds[:, 2], [0.0, length])
        assert np.linalg.norm(part.mesh.vertices[:, :2], axis=1).max() <= ROPES.radius_m + 1e-12
        assert part.uv is not None
        assert len(part.uv) == len(part.mesh.vertices)
