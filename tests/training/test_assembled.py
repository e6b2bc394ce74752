"""Laws of grabs put together at random; `test_families` has those that hold for all kinds."""

from functools import cache

import msgspec
import numpy as np
import pytest
import trimesh

from simgrab import frames
from simgrab.errors import ScenarioError
from simgrab.model import scenes
from simgrab.model.scenario import Assembled, RandomPlace
from simgrab.model.scenario.grab import Grab
from simgrab.model.scenario.vary import variants
from simgrab.training.assembled import assembled
from simgrab.world.scenery import places
from simgrab.world.scenery.grabs import design_of
from simgrab.world.scenery.grabs.design import CARGO_LEVELS, Body, Design
from simgrab.world.scenery.grabs.drawn import any_of

COUNT = 41
GRABS = [Assembled(shape=i / (COUNT - 1)) for i in range(COUNT)]  # both ends of the range among them
each = pytest.mark.parametrize("grab", GRABS[::2], ids=lambda grab: f"{grab.shape:g}")


def steel(design: Design) -> trimesh.Trimesh:
    poses = design.frames(0.0)
    return trimesh.util.concatenate([body.steel.copy().apply_transform(poses[body.name]) for body in design.bodies])


def jaws(design: Design) -> list[Body]:
    return [body for body in design.bodies if body.name.startswith("jaw_")]


@each
def test_jaws_open_outwards(grab: Assembled) -> None:
    design = design_of(grab)
    closed, opened = (design.frames(jaw) for jaw in (0.0, design.max_jaw))
    assert (design.max_jaw > 0) == bool(jaws(design))
    for body in jaws(design):
        outwards = np.cross(body.axis, (0.0, 0.0, 1.0))
        tip = body.steel.vertices[body.steel.vertices[:, 2].argmin()]
        before, after = (trimesh.transform_points([tip], poses[body.name])[0] for poses in (closed, opened))
        assert (after - before) @ outwards > 0.2


@each
def test_struts_point_to_where_they_meet_the_jaws(grab: Assembled) -> None:
    design = design_of(grab)
    bodies = {body.name: body for body in design.bodies}
    closed = design.frames(0.0)
    for jaw in jaws(design):
        strut = bodies.get(jaw.name.replace("jaw", "strut"))
        if strut is None:
            continue
        # It is symmetric about its own axis, which runs through its pin.
        points = np.asarray(strut.steel.vertices)
        outwards = np.cross(strut.axis, (0.0, 0.0, 1.0))
        flat = np.stack([points @ outwards, points[:, 2]], axis=1)
        way = flat.mean(axis=0) / np.linalg.norm(flat.mean(axis=0))
        along = (flat @ way).max() * way
        end = along[0] * outwards + (0.0, 0.0, along[1])
        meets = trimesh.transform_points([end], np.linalg.inv(closed[jaw.name]) @ closed[strut.name])
        for opening in np.linspace(0.0, design.max_jaw, 4):
            poses = design.frames(float(opening))
            wanted = trimesh.transform_points(meets, poses[jaw.name])[0] - poses[strut.name][:3, 3]
            got = poses[strut.name][:3, :3] @ end
            cosine = wanted @ got / np.linalg.norm(wanted) / np.linalg.norm(got)
            assert np.degrees(np.arccos(min(cosine, 1.0))) < 1e-3


@each
def test_cargo_lies_between_closed_jaws(grab: Assembled) -> None:
    design = design_of(grab)
    heaps = design.heaps("ore", np.random.default_rng(0))
    empty, full = design.mass_of(0.0, 0.0), design.mass_of(0.0, 1.0)
    assert empty.mass == pytest.approx(sum(body.mass_kg for body in design.bodies))
    assert full.mass - empty.mass == pytest.approx(design.cargo_kg if heaps else 0.0)
    assert design.holds_cargo == bool(heaps)
    if not heaps:
        return
    assert len(heaps) == len(CARGO_LEVELS)
    poses = design.frames(0.0)
    shells = trimesh.util.concatenate([b.steel.copy().apply_transform(poses[b.name]) for b in jaws(design)])
    volumes = [heap.mesh.volume for heap in heaps]
    assert volumes == sorted(volumes)
    for heap in heaps:
        assert heap.mesh.is_watertight
        assert heap.mesh.volume > 0
        assert (heap.mesh.bounds[0] > shells.bounds[0]).all()
        assert (heap.mesh.bounds[1, :2] < shells.bounds[1, :2]).all()


@cache
def size_and_jaws(grab: Grab) -> tuple[tuple[float, ...], int]:
    design = design_of(grab)
    return tuple(np.round(np.ptp(steel(design).bounds, axis=0), 6).tolist()), len(jaws(design))


def test_every_shape_is_another_grab_and_the_same_one_each_time() -> None:
    sizes, counts = map(set, zip(*map(size_and_jaws, GRABS), strict=True))
    assert len(sizes) == COUNT
    assert {0, 2} < counts
    assert len(counts) >= 5
    a, b = (assembled(GRABS[7]) for _ in range(2))
    assert np.array_equal(steel(a).vertices, steel(b).vertices)
    assert a.max_jaw == b.max_jaw
    larger = assembled(msgspec.structs.replace(GRABS[7], volume_m3=20.0))
    assert steel(larger).volume > steel(a).volume


def test_ropes_change_nothing_but_what_they_end_in() -> None:
    four, two = (assembled(Assembled(shape=0.3, ropes=ropes)) for ropes in (4, 2))
    for body, other in zip(jaws(four), jaws(two), strict=True):
        assert np.array_equal(body.steel.vertices, other.steel.vertices)
    assert (len(four.terminations), len(two.terminations)) == (4, 2)


@pytest.mark.parametrize("kind", ["clamshell", "orange-peel", "scissors"])
def test_shapes_differ_more_than_those_of_a_real_kind(kind: str) -> None:
    def spread(grabs: list[Grab]) -> float:
        extents = np.array([size_and_jaws(grab)[0] for grab in grabs])
        return float(np.std(np.log(extents / extents[:, 2:]), axis=0).sum())

    drawn = [any_of(kind, np.random.default_rng(i), (6.0, 6.0)) for i in range(16)]
    assert spread(list(GRABS[:20])) > 1.3 * spread(drawn)


@pytest.mark.parametrize("keys", [{"shape": 1.5}, {"shape": -0.1}, {"shape": float("nan")}, {"tines": 4}])
def test_a_wrong_key_is_named(keys: dict[str, object]) -> None:
    with pytest.raises(ScenarioError, match=next(iter(keys))):
        scenes.load("quay-day", {"grab": {"model": "assembled", **keys}})


# The place.


def test_a_random_place_is_level_ground_with_low_solids_near_the_grab() -> None:
    counts, near = set(), 0
    for seed in range(8):
        ground, *solids = places.build(RandomPlace(), head_height=30.0, rng=np.random.default_rng(seed))
        assert ground.mesh.bounds[1, 2] == pytest.approx(-30.0)
        counts.add(len(solids))
        for part in solids:
            assert part.mesh.is_watertight
            assert part.mesh.volume > 0
            low, high = part.mesh.bounds
            assert low[2] == pytest.approx(-30.0, abs=0.05)
            if np.hypot(*part.mesh.bounds.mean(axis=0)[:2]) < 5.0:
                assert high[2] < -30.0 + 1.7
                near += 1
    assert len(counts) > 3
    assert near > 5


def test_the_scene_draws_another_grab_for_each_frame_and_labels_it() -> None:
    scene = scenes.load("training-shapes", {"frames": 4, "seed": 1}, size=(480, 270))
    grabs = [one.scenario.grab for one, _ in variants(scene)]
    assert len(set(grabs)) == 4
    shown = []
    for frame in frames(scene, buffers=False):
        assert frame.mask.any() == (frame.truth.box_x0_px is not None)
        shown.append(frame.mask.any())
    assert any(isinstance(grab, Assembled) and seen for grab, seen in zip(grabs, shown, strict=True))
