from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from typing import get_args

import numpy as np
import pytest
from conftest import slow_but

from simgrab.dataset.pool import vet
from simgrab.model import scenes
from simgrab.model.scenario import Cargo
from simgrab.world.extensions import Recipe
from simgrab.world.scenery import model, plan
from simgrab.world.scenery.grabs.design import CARGO_LEVELS
from simgrab.world.scenery.grabs.four_rope import four_rope, linkage
from simgrab.world.scenery.grabs.four_rope.shells import back_curve
from simgrab.world.scenery.meshes.paint import finish
from simgrab.world.scenery.meshes.part import Part
from simgrab.world.scenery.places import fittings
from simgrab.world.scenery.places.ship import HATCH, coaming
from simgrab.world.scenery.plan import draw_up

GRAB = four_rope()
BODIES = [body.name for body in GRAB.bodies]
JAWS = np.linspace(0.0, GRAB.max_jaw, 23)


@pytest.fixture(scope="module")
def parts() -> dict[str, list[Part]]:
    return make(0)


@cache
def make(seed: int, paint: tuple[float, float, float] = (0.7, 0.3, 0.1), wear: float = 0.2) -> dict[str, list[Part]]:
    mixed = finish(paint, wear, 0.3, "ore", np.random.default_rng(seed))
    return {body.name: mixed.on(body.parts) for body in GRAB.bodies}


def points(parts: dict[str, list[Part]], jaw: float) -> dict[str, np.ndarray]:
    """Vertices of every body in the grab frame."""
    frames = GRAB.frames(jaw)
    return {body: moved(frames[body], np.concatenate([p.mesh.vertices for p in parts[body]])) for body in BODIES}


def moved(pose: np.ndarray, p: np.ndarray) -> np.ndarray:
    return p @ pose[:3, :3].T + pose[:3, 3]


def box(clouds: Iterable[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    every = np.concatenate(list(clouds))
    return every.min(axis=0), every.max(axis=0)


def test_every_mesh_is_closed_and_faces_outwards(parts: dict[str, list[Part]]) -> None:
    assert set(parts) == set(BODIES)
    for body, of_body in parts.items():
        for part in of_body:
            assert part.mesh.is_watertight, (body, part.name)
            assert part.mesh.is_winding_consistent, (body, part.name)
            assert all(piece.volume > 0 for piece in part.mesh.split()), (body, part.name)


def test_few_faces(parts: dict[str, list[Part]]) -> None:
    assert sum(len(p.mesh.faces) for of_body in parts.values() for p in of_body) < 25_000


def test_closed_grab_fills_its_box_around_the_origin(parts: dict[str, list[Part]]) -> None:
    low, high = box(points(parts, 0.0).values())
    np.testing.assert_allclose(high, [1.45, 1.2, 1.7], atol=0.005)
    np.testing.assert_allclose(low, [-1.45, -1.2, -1.7], atol=0.005)


def test_open_grab_is_wider(parts: dict[str, list[Part]]) -> None:
    low, high = box(points(parts, GRAB.max_jaw).values())
    assert 3.5 <= (high - low)[0] <= 4.5
    assert (high - low)[1] == pytest.approx(2.4, abs=0.01)


def test_arms_keep_their_length() -> None:
    x, z = linkage.SHELL_PIN
    for jaw in JAWS:
        frames = GRAB.frames(jaw)
        for side, sign in (("outer", 1.0), ("inner", -1.0)):
            shell_pin = moved(frames[f"shell_{side}"], np.array([sign * x, 0.0, z]))
            head_pin = frames[f"arms_{side}"][:3, 3]
            assert np.linalg.norm(shell_pin - head_pin) == pytest.approx(linkage.CRANK.arm_m, abs=1e-9)
            # The arm's own far end is on the shell's pin: its angle is right, not only its length.
            closed = GRAB.frames(0.0)
            far = moved(closed[f"shell_{side}"], np.array([sign * x, 0.0, z])) - closed[f"arms_{side}"][:3, 3]
            np.testing.assert_allclose(moved(frames[f"arms_{side}"], far), shell_pin, atol=1e-9)


def test_closed_is_zero_and_opening_lowers_the_beam() -> None:
    assert all(q == pytest.approx(0.0, abs=1e-12) for q in GRAB.positions(0.0).values())
    beam = [linkage.CRANK.at(jaw).beam_z for jaw in JAWS]
    assert np.all(np.diff(beam) < 0)
    assert beam[0] - beam[-1] < 1.3


def test_body_frames_follow_from_pins_and_joints() -> None:
    for jaw in JAWS:
        q, frames = GRAB.positions(jaw), GRAB.frames(jaw)
        np.testing.assert_array_equal(frames["head"], np.eye(4))
        assert frames["beam"][2, 3] == pytest.approx(linkage.CRANK.at(jaw).beam_z, abs=1e-12)
        for body, parent in linkage.PARENTS.items():
            local = np.linalg.inv(frames[parent]) @ frames[body]
            slide = q[body] if body == "beam" else 0.0
            turn = 0.0 if body == "beam" else q[body]
            np.testing.assert_allclose(local[:3, 3], np.add(linkage.pins[body], (0, 0, slide)), atol=1e-12)
            # Rodrigues about +y
            K = np.array([[0, 0, 1], [0, 0, 0], [-1, 0, 0]], float)
            expected = np.eye(3) + np.sin(turn) * K + (1 - np.cos(turn)) * K @ K
            np.testing.assert_allclose(local[:3, :3], expected, atol=1e-12)


def test_halves_are_a_half_turn_apart(parts: dict[str, list[Part]]) -> None:
    for jaw in (0.0, 0.5, GRAB.max_jaw):
        cloud = points(parts, jaw)
        for stem in ("shell", "arms"):
            turned = cloud[f"{stem}_inner"] * (-1, -1, 1)
            np.testing.assert_allclose(turned, cloud[f"{stem}_outer"], atol=1e-12)


def test_lips_open_outwards_from_the_closing_line() -> None:
    for jaw in JAWS:
        frames = GRAB.frames(jaw)
        outer, inner = (moved(frames[b], GRAB.lips[b]) for b in ("shell_outer", "shell_inner"))
        np.testing.assert_allclose(outer, inner * (-1, 1, 1), atol=1e-12)
        assert np.all(outer[:, 0] > 0)
    assert outer[0, 0] > 1.3


def test_lip_corners_lie_on_the_steel(parts: dict[str, list[Part]]) -> None:
    lips = next(p for p in parts["shell_outer"] if p.name == "lips")
    for corner in GRAB.lips["shell_outer"]:
        assert np.linalg.norm(lips.mesh.vertices - corner, axis=1).min() < 0.03


def test_beam_and_shells_stay_clear_of_the_head(parts: dict[str, list[Part]]) -> None:
    for jaw in JAWS:
        cloud = points(parts, jaw)
        floor = cloud["head"][:, 2].min()
        assert cloud["beam"][:, 2].max() < floor
        assert cloud["shell_outer"][:, 2].max() < floor
        assert cloud["shell_outer"][:, 0].min() > -0.15  # only the ears reach beside the other shell's


def test_masses() -> None:
    assert GRAB.mass_kg == pytest.approx(10_500.0)


def test_another_paint_changes_no_shape(parts: dict[str, list[Part]]) -> None:
    other = make(9, paint=(0.1, 0.4, 0.6), wear=0.7)
    for body in BODIES:
        for a, b in zip(parts[body], other[body], strict=True):
            np.testing.assert_array_equal(a.corners[0], b.corners[0])
    assert not np.array_equal(parts["head"][0].material.texture, other["head"][0].material.texture)


@pytest.mark.parametrize("changes", slow_but([{"place": {"model": "plain"}}, {}], {"place": {"model": "plain"}}))
def test_a_world_leaves_the_shared_steel_as_it_was(changes: dict[str, object]) -> None:
    def every_byte() -> list[bytes]:
        meshes = [part.mesh for body in GRAB.bodies for part in body.parts]
        meshes += [
            coaming(is_open=False),
            fittings.cover(HATCH[0] + 0.6, HATCH[1] / 2 + 0.28),
            fittings.bitts(),
            *fittings.winch(),
        ]
        return [np.asarray(v).tobytes() for mesh in meshes for v in (mesh.vertices, mesh.faces, mesh.face_normals)]

    before = every_byte()
    scenario = scenes.load("quay-day", changes | {"clutter.other_grabs": 3})
    model.build(scenario, draw_up(scenario))
    assert every_byte() == before


def test_nothing_of_the_grab_is_painted_to_see_whether_its_world_can_be(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plan, "finish", lambda *_: pytest.fail("painted"))
    seen = vet(Recipe(scenes.load("quay-day", {"frames": 3}))).seen
    assert seen == 3


def test_paint_repeats_with_its_stream(parts: dict[str, list[Part]]) -> None:
    again = make.__wrapped__(0)
    np.testing.assert_array_equal(parts["head"][0].material.texture, again["head"][0].material.texture)


def test_wear_is_the_share_of_paint_that_is_lost() -> None:
    blue = (0.05, 0.25, 0.8)
    for wear, painted in ((0.0, 1.0), (0.3, 0.7), (1.0, 0.0)):
        mixed = finish(blue, wear, 0.0, "coal", np.random.default_rng(1))
        texture = np.asarray(mixed.body.texture, int)
        share = (texture[..., 2] > texture[..., 0] + 40).mean()
        assert share == pytest.approx(painted, abs=0.04)


@pytest.mark.parametrize("cargo", get_args(Cargo))
def test_cargo_lies_inside_the_closed_shells(cargo: str, parts: dict[str, list[Part]]) -> None:
    heaps = GRAB.heaps(cargo, np.random.default_rng(3))
    low, high = box(points(parts, 0.0).values())
    curve = back_curve(201)
    volumes = []
    for heap in heaps:
        v = np.asarray(heap.mesh.vertices)
        assert heap.mesh.is_watertight
        assert np.all(v.min(axis=0) > low)
        assert np.all(v.max(axis=0) < high)
        assert np.abs(v[:, 1]).max() < 1.15 - 0.025
        wall = np.interp(v[:, 2], curve[:, 1], curve[:, 0])
        assert np.all(np.abs(v[:, 0]) < wall)
        volumes.append(heap.mesh.volume)
    assert len(heaps) == len(CARGO_LEVELS)
    assert np.all(np.diff(volumes) > 0)
    assert heaps[-1].mesh.vertices[:, 2].max() > 0.0  # heaped above the rim


def test_unknown_cargo_is_named() -> None:
    with pytest.raises(ValueError, match="'sand'"):
        GRAB.heaps("sand", np.random.default_rng(0))


def test_terminations_are_in_the_head_and_falls_run_down_to_the_beam(parts: dict[str, list[Part]]) -> None:
    low, high = box([points(parts, 0.0)["head"]])
    ends = GRAB.terminations
    assert np.all((ends > low) & (ends < high))
    assert np.all((ends[:, 2] > 1.6) & (ends[:, 2] <= 1.7))
    assert GRAB.falls.ndim == 3
    assert GRAB.falls.shape[1:] == (2, 3)
    for jaw in JAWS:
        ends = GRAB.falls[:, 1] + GRAB.frames(jaw)["beam"][:3, 3]
        assert np.all(ends[:, 2] < GRAB.falls[:, 0, 2])


def test_jaw_out_of_range_is_refused() -> None:
    with pytest.raises(ValueError, match="must lie in"):
        GRAB.frames(1.2)


def test_closing_ropes_pay_out_what_their_falls_take() -> None:
    """Six falls to a rope, steeper than 6° from the vertical: nearly six times as far as the beam sinks."""
    paid = [GRAB.closing_rope_m(jaw) for jaw in JAWS]
    sunk = np.array([-linkage.joint_positions(jaw)["beam"] for jaw in JAWS])
    assert paid[0] == 0
    assert (np.diff(paid) > 0).all()
    np.testing.assert_allclose(paid[1:], 6 * sunk[1:], rtol=0.006)
