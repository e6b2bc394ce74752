"""Laws of grabs put together at random, and of the random place that they are trained above."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
import trimesh

from simgrab import frames, scenes
from simgrab.errors import ScenarioError
from simgrab.scenario import Assembled, Clutter, RandomPlace
from simgrab.scenario.grab import Grab
from simgrab.world.scenery import places, textures
from simgrab.world.scenery.grabs import design_of
from simgrab.world.scenery.grabs.assembled import _Assembly
from simgrab.world.scenery.grabs.design import Design
from simgrab.world.scenery.parked import parked_grabs

COUNT = 40
ROPES = (1, 2, 4)
GRABS = [Assembled(shape=i / COUNT, volume_m3=3.0 + 17.0 * i / COUNT, ropes=ROPES[i % 3]) for i in range(COUNT)]
each = pytest.mark.parametrize("grab", GRABS[::2], ids=lambda grab: f"{grab.shape:g}")


def steel(design: Design, jaw: float = 0.0) -> trimesh.Trimesh:
    poses = design.frames(jaw)
    return trimesh.util.concatenate([body.steel.copy().apply_transform(poses[body.name]) for body in design.bodies])


@each
def test_all_steel_is_closed_and_faces_outwards(grab: Assembled) -> None:
    for body in design_of(grab).bodies:
        for part in body.parts:
            assert part.mesh.is_watertight, (body.name, part.name)
            assert part.mesh.is_winding_consistent, (body.name, part.name)
            assert part.mesh.volume > 0, (body.name, part.name)
            assert np.isfinite(part.mesh.vertices).all()


@each
def test_the_centre_is_on_the_ropes_axis_at_half_the_height(grab: Assembled) -> None:
    design = design_of(grab)
    low, high = steel(design).bounds
    assert low[2] + high[2] == pytest.approx(0.0, abs=1e-9)
    assert len(design.terminations) == grab.ropes
    np.testing.assert_allclose(design.terminations[:, :2].mean(axis=0), 0.0, atol=1e-12)
    assert design.terminations[:, 2].min() > 0


@each
def test_jaws_open_outwards_and_struts_point_at_them(grab: Assembled) -> None:
    own, design = _Assembly(grab), design_of(grab)
    (hx, hz), bodies = own.hinge, {body.name: body for body in design.bodies}
    assert len([name for name in bodies if name.startswith("jaw_")]) == own.count
    closed, opened = (design.frames(jaw) for jaw in (0.0, design.max_jaw))
    for k in range(own.count):
        azimuth = 2 * np.pi * k / own.count
        outwards = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        tip = np.array([*(0.0 - hx) * outwards[:2], -hz])
        before, after = (trimesh.transform_points([tip], poses[f"jaw_{k}"])[0] for poses in (closed, opened))
        assert (after - before) @ outwards > 0.2
        if f"strut_{k}" not in bodies:
            continue
        # Its far end, in the jaw's frame, is where it meets the jaw, and keeps to the line there.
        mesh = bodies[f"strut_{k}"].steel
        ends = mesh.vertices[np.argmax(np.linalg.norm(mesh.vertices, axis=1))]
        at = trimesh.transform_points([ends], closed[f"strut_{k}"])[0]
        in_jaw = trimesh.transform_points([at], np.linalg.inv(closed[f"jaw_{k}"]))
        pin = opened[f"strut_{k}"][:3, 3]
        wanted = trimesh.transform_points(in_jaw, opened[f"jaw_{k}"])[0] - pin
        pointed = trimesh.transform_points([ends], opened[f"strut_{k}"])[0] - pin
        across = np.cross(outwards, (0.0, 0.0, 1.0))
        directions = [np.arctan2(way[2], way @ outwards) for way in (wanted, pointed)]
        assert abs(pointed @ across - wanted @ across) < 1e-9
        assert np.angle(np.exp(1j * (directions[0] - directions[1]))) == pytest.approx(0.0, abs=0.12)


@each
def test_mass_follows_the_steel_and_cargo_lies_inside(grab: Assembled) -> None:
    design = design_of(grab)
    empty, full = design.mass_of(0.0, 0.0), design.mass_of(0.0, 1.0)
    assert empty.mass == pytest.approx(sum(body.mass_kg for body in design.bodies))
    for mass in (empty, full):
        a, b, c = mass.inertia
        assert min(a, b, c) > 0
        assert a + b > c
        assert b + c > a
        assert a + c > b
    heaps = design.heaps("ore", np.random.default_rng(0))
    assert design.holds_cargo == bool(heaps)
    assert full.mass - empty.mass == pytest.approx(design.cargo_kg if heaps else 0.0)
    low, high = steel(design).bounds
    for heap in heaps:
        assert heap.mesh.is_watertight
        assert heap.mesh.volume > 0
        assert (heap.mesh.bounds[0] > low - 1e-6).all()
        assert (heap.mesh.bounds[1, :2] < high[:2] + 1e-6).all()


def test_every_shape_is_another_grab_and_the_same_one_each_time() -> None:
    sizes = {tuple(np.round(np.ptp(steel(design_of(grab)).bounds, axis=0), 6)) for grab in GRABS}
    assert len(sizes) == COUNT
    a, b = (_Assembly(GRABS[7]).design() for _ in range(2))
    assert np.array_equal(steel(a).vertices, steel(b).vertices)
    assert a.max_jaw == b.max_jaw
    larger = steel(_Assembly(msgspec.structs.replace(GRABS[7], volume_m3=20.0)).design())
    assert larger.volume > steel(a).volume


def test_shapes_differ_far_more_than_those_of_any_kind() -> None:
    counts = {_Assembly(grab).count for grab in GRABS}
    assert {0, 2} < counts
    assert len(counts) >= 5
    extents = np.array([np.ptp(steel(design_of(grab)).bounds, axis=0) for grab in GRABS])
    slender = extents[:, 2] / extents[:, :2].max(axis=1)
    assert slender.max() > 3 * slender.min()


@pytest.mark.parametrize(
    ("keys", "wrong"),
    [
        ({"shape": 1.5}, "shape"), ({"shape": -0.1}, "shape"), ({"shape": float("nan")}, "shape"),
        ({"ropes": 3}, "ropes"), ({"volume_m3": 1.0}, "volume_m3"), ({"tines": 4}, "tines"),
    ],
)  # fmt: skip
def test_a_wrong_key_is_named(keys: dict[str, object], wrong: str) -> None:
    with pytest.raises(ScenarioError, match=wrong):
        scenes.load("quay-day", {"grab": {"model": "assembled", **keys}})


@pytest.mark.parametrize("shape", [0.0, 1.0])
def test_both_ends_of_the_range_are_shapes(shape: float) -> None:
    grab: Grab = Assembled(shape=shape)
    assert steel(design_of(grab)).volume > 0


# The place.


def test_a_random_place_is_level_ground_with_low_solids_near_the_grab() -> None:
    counts = set()
    for seed in range(6):
        ground, *solids = places.build(RandomPlace(), head_height=30.0, rng=np.random.default_rng(seed))
        assert ground.mesh.bounds[1, 2] == pytest.approx(-30.0)
        counts.add(len(solids))
        for part in solids:
            assert part.mesh.is_watertight
            assert part.mesh.volume > 0
            low, high = part.mesh.bounds
            assert low[2] == pytest.approx(-30.0, abs=0.13)
            if np.hypot(*(low[:2] + high[:2]) / 2) < 5.0:
                assert high[2] < -30.0 + 1.7
    assert len(counts) > 3


def test_a_random_place_has_the_same_shapes_unpainted() -> None:
    painted = places.build(RandomPlace(), head_height=28.0, rng=np.random.default_rng(3))
    with textures.unpainted():
        bare = places.build(RandomPlace(), head_height=28.0, rng=np.random.default_rng(3))
    assert [part.name for part in painted] == [part.name for part in bare]
    assert all(np.array_equal(a.mesh.vertices, b.mesh.vertices) for a, b in zip(painted, bare, strict=True))
    assert painted[0].material.texture is not None
    assert painted[0].material.texture.std() > 0


def test_assembled_grabs_stand_on_a_random_place() -> None:
    ground = places.build(RandomPlace(), head_height=28.0, rng=np.random.default_rng(1))
    clutter = Clutter(other_grabs=2, kinds=("assembled",))
    parts = parked_grabs(clutter, ground, head_height=28.0, rng=np.random.default_rng(2))
    assert {part.name.split("/")[0] for part in parts} == {"parked_0", "parked_1"}
    assert min(part.mesh.bounds[0, 2] for part in parts) > -28.0 - 1e-6


def test_the_scene_shows_each_frame_another_grab_and_labels_it() -> None:
    scene = scenes.load("training-shapes", {"frames": 4, "seed": 1}, size=(640, 360))
    seen = list(frames(scene, buffers=False))
    assert len({frame.rgb.tobytes() for frame in seen}) == 4
    for frame in seen:
        assert frame.mask.any() == (frame.truth.box_x0_px is not None)
