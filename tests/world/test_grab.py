"""Laws of the default grab and of its paint; `test_families` has those that hold for all clamshells."""

from collections.abc import Mapping, Sequence

import numpy as np
import pytest
from conftest import slow_but
from scipy.spatial import cKDTree

from simgrab.dataset.pool import vet
from simgrab.model import scenes
from simgrab.world.extensions import Recipe
from simgrab.world.scenery import model, plan
from simgrab.world.scenery.grabs.four_rope import four_rope
from simgrab.world.scenery.meshes import shapes
from simgrab.world.scenery.meshes.paint import finish
from simgrab.world.scenery.meshes.part import Material, Part
from simgrab.world.scenery.places import fittings
from simgrab.world.scenery.places.ship import HATCH, coaming
from simgrab.world.scenery.plan import draw_up

GRAB = four_rope()


def painted(seed: int, paint=(0.7, 0.3, 0.1), wear: float = 0.2) -> Mapping[str, Sequence[Part]]:
    mixed = finish(paint, wear, 0.3, "ore", np.random.default_rng(seed))
    return {body.name: mixed.on(body.parts) for body in GRAB.bodies}


def test_the_closed_grab_has_the_stated_size_and_mass() -> None:
    every = np.concatenate(list(GRAB.points(0.0).values()))
    np.testing.assert_allclose(every.max(axis=0), [1.45, 1.2, 1.7], atol=0.001)
    np.testing.assert_allclose(every.min(axis=0), [-1.45, -1.2, -1.7], atol=0.001)
    assert [GRAB.mass_of(0.0, load).mass for load in (0.0, 1.0)] == pytest.approx([10_500.0, 24_000.0])


def test_halves_are_a_half_turn_apart() -> None:
    for jaw in (0.0, 0.5, GRAB.max_jaw):
        cloud = GRAB.points(jaw)
        for stem in ("shell", "arms"):
            np.testing.assert_allclose(cloud[f"{stem}_inner"] * (-1, -1, 1), cloud[f"{stem}_outer"], atol=1e-12)


def test_terminations_are_in_the_head_and_falls_run_down_to_the_beam() -> None:
    head = GRAB.points(0.0)["head"]
    assert np.all((GRAB.terminations > head.min(axis=0)) & (GRAB.terminations < head.max(axis=0)))
    for jaw in np.linspace(0.0, GRAB.max_jaw, 9):
        assert np.all(GRAB.falls[:, 1, 2] + GRAB.frames(jaw)["beam"][2, 3] < GRAB.falls[:, 0, 2])


def test_jaw_out_of_range_is_refused() -> None:
    with pytest.raises(ValueError, match="must lie in"):
        GRAB.frames(1.2)


def test_another_paint_changes_no_shape_and_repeats_with_its_stream() -> None:
    one, other, again = painted(0), painted(9, paint=(0.1, 0.4, 0.6), wear=0.7), painted(0)
    for body in one:
        for a, b in zip(one[body], other[body], strict=True):
            np.testing.assert_array_equal(a.mesh.triangles, b.mesh.triangles)
    first, second, third = (parts["head"][0].material.picture for parts in (one, other, again))
    assert not np.array_equal(first, second)
    np.testing.assert_array_equal(first, third)


def test_wear_is_the_share_of_paint_that_is_lost() -> None:
    blue = (0.05, 0.25, 0.8)
    for wear, kept in ((0.0, 1.0), (0.3, 0.7), (1.0, 0.0)):
        texture = np.asarray(finish(blue, wear, 0.0, "coal", np.random.default_rng(1)).body.picture, int)
        assert (texture[..., 2] > texture[..., 0] + 40).mean() == pytest.approx(kept, abs=0.04)


@pytest.mark.parametrize("changes", slow_but([{"place": {"model": "plain"}}, {}], {"place": {"model": "plain"}}))
def test_a_world_leaves_the_shared_steel_as_it_was(changes: dict[str, object]) -> None:
    def every_byte() -> list[bytes]:
        meshes = [part.mesh for body in GRAB.bodies for part in body.parts]
        meshes += [coaming(is_open=False), fittings.cover(HATCH[0] + 0.6, HATCH[1] / 2 + 0.28), fittings.bitts()]
        meshes += fittings.winch()
        return [np.asarray(v).tobytes() for mesh in meshes for v in (mesh.vertices, mesh.faces, mesh.face_normals)]

    before = every_byte()
    model.build(draw_up(scenes.load("quay-day", changes | {"clutter.other_grabs": 3})))
    assert every_byte() == before


def test_nothing_is_painted_to_see_whether_a_world_can_be(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Material, "picture", property(lambda _: pytest.fail("painted")))
    assert vet(Recipe(scenes.load("quay-day", {"frames": 3}))).seen == 3


def test_points_between_corners_leave_no_gap():
    rng = np.random.default_rng(0)
    corners, shares = rng.normal(size=(20, 3, 3)), rng.dirichlet(np.ones(3), 2000)
    corners[::2, 2] = corners[::2, 1] + 0.1 * rng.random((10, 3)) / np.sqrt(3)  # one side of these is not divided
    points = plan._between(corners.reshape(-1, 3), np.arange(60).reshape(-1, 3), 0.15)
    for each in corners:
        own = points[np.abs((points - each[0]) @ np.cross(each[1] - each[0], each[2] - each[0])) < 1e-9]  # in its plane
        assert len(own) > 9
        assert cKDTree(own).query(shares @ each)[0].max() < 0.15 / np.sqrt(3)  # as where three sides are equal


@pytest.mark.parametrize("body", GRAB.bodies, ids=lambda body: body.name)
def test_volumes_of_parts_are_those_of_trimesh(body):
    assert [shapes.volume(part.mesh) for part in body.parts] == pytest.approx([p.mesh.volume for p in body.parts])
