"""The jib head's steel, and the ropes that leave it."""

from functools import cache

import numpy as np
import pytest
import trimesh

from simgrab.errors import ScenarioError
from simgrab.model.scenario import Jib
from simgrab.world.scenery.clearance import check_camera
from simgrab.world.scenery.grabs.four_rope import four_rope
from simgrab.world.scenery.meshes.jib import CLEAR_Z, SHEAVE_Z, jib_parts
from simgrab.world.scenery.meshes.part import Part
from simgrab.world.scenery.meshes.ropes import ROPE_CLASSES_M, Ropes, rope_part

NARROW = Jib(rope_spread_x_m=0.2, rope_spread_y_m=0.5, rope_diameter_mm=16)
WIDE = Jib(rope_spread_x_m=0.8, rope_spread_y_m=1.2, rope_diameter_mm=50)
CAMERAS = np.array([(0.0, 0.6, -0.3), (0.0, -0.6, -0.3)])
USUAL = Ropes.of(Jib(), 4)
HANGING = ("floodlights", "lenses")


@pytest.fixture(
    scope="module",
    params=[(Jib(), 4), (NARROW, 4), (WIDE, 4), (Jib(), 2), (NARROW, 2), (WIDE, 2), (Jib(), 1), (WIDE, 1)],
    ids=lambda given: f"{given[1]} ropes of {given[0].rope_diameter_mm:g} mm",
)
def ropes(request: pytest.FixtureRequest) -> Ropes:
    return Ropes.of(*request.param)


@pytest.fixture(scope="module")
def parts(ropes: Ropes) -> tuple[Part, ...]:
    return jib_parts(ropes)


@cache
def surface(part: Part) -> np.ndarray:
    return np.asarray(trimesh.sample.sample_surface(part.mesh, 8_000, seed=1)[0])


def test_every_mesh_is_closed_and_faces_outwards(parts: tuple[Part, ...]) -> None:
    for part in parts:
        assert part.mesh.is_watertight, part.name
        assert part.mesh.is_winding_consistent, part.name
        assert part.mesh.volume > 0, part.name


def test_only_the_floodlights_hang_below_the_sheaves(parts: tuple[Part, ...]) -> None:
    for part in parts:
        near = np.abs(part.mesh.vertices[:, 0]) < 1.2
        if part.name not in HANGING and near.any():
            assert part.mesh.vertices[near, 2].min() > CLEAR_Z, part.name


@pytest.mark.parametrize("camera", CAMERAS)
def test_nothing_stands_in_the_cameras_cone(camera: np.ndarray, parts: tuple[Part, ...]) -> None:
    for part in parts:
        ray = surface(part) - camera
        below = ray[:, 2] < 0
        angle = np.arctan2(np.hypot(ray[below, 0], ray[below, 1]), -ray[below, 2])
        assert np.all(angle > np.radians(40.0)), part.name
        assert np.linalg.norm(ray, axis=1).min() > 0.3, part.name


def test_hanging_ropes_are_clear_of_steel(parts: tuple[Part, ...], ropes: Ropes) -> None:
    for part in parts:
        if part.name == "sheaves" or part.name.startswith("bend"):
            continue  # what the ropes lie on
        p = surface(part)
        p = p[p[:, 2] < SHEAVE_Z]
        gaps = np.linalg.norm(p[:, None, :2] - np.array(ropes.exits)[None, :, :2], axis=2)
        assert gaps.min(initial=9.0) > 1.5 * ropes.radius_m, part.name


def test_floodlights_are_clear_of_ropes_that_swing_15_degrees(parts: tuple[Part, ...], ropes: Ropes) -> None:
    p = np.concatenate([surface(part) for part in parts if part.name in HANGING])
    p = p[p[:, 2] < 0]
    for exit_ in ropes.exits:
        ray = p - exit_
        assert np.degrees(np.arctan2(np.hypot(ray[:, 0], ray[:, 1]), -ray[:, 2])).min() > 20.0


def test_sheaves_are_tangent_to_the_ropes(parts: tuple[Part, ...], ropes: Ropes) -> None:
    sheaves = next(part for part in parts if part.name == "sheaves")
    for x, y, _ in ropes.exits:
        v = np.asarray(sheaves.mesh.vertices)
        groove = v[
            (np.abs(v[:, 1] - y) < 0.9 * ropes.radius_m) & (np.abs(v[:, 2] - SHEAVE_Z) < 0.01) & (v[:, 0] > x - 0.1)
        ]
        # The bottom of the groove carries the rope from inboard.
        assert groove[:, 0].min() == pytest.approx(x - ropes.radius_m, abs=0.005)


def test_a_camera_in_the_steel_is_refused_and_none_below_it(parts: tuple[Part, ...]) -> None:
    steel = trimesh.util.concatenate([part.mesh for part in parts])
    for centre in ((0.0, 0.6, 0.5), (0.0, 0.6, 0.3)):
        with pytest.raises(ScenarioError, match="jib head's steel"):
            check_camera(np.array(centre), steel)
    for centre in ((0.0, 0.0, 0.0), (0.0, 0.6, -0.3), (1.5, -1.5, -0.8)):
        check_camera(np.array(centre), steel)


def test_exits_are_centred_on_the_origin() -> None:
    np.testing.assert_allclose(np.mean(USUAL.exits, axis=0), 0.0, atol=1e-14)
    np.testing.assert_allclose(np.ptp(USUAL.exits, axis=0), [0.45, 1.1, 0.0], atol=1e-12)


def test_ropes_do_not_cross() -> None:
    top, bottom = np.array(USUAL.exits)[:, :2], four_rope().terminations[:, :2]
    for s in np.linspace(0.0, 1.0, 21):
        at = (1 - s) * top + s * bottom
        gap = np.linalg.norm(at[:, None] - at[None, :], axis=-1) + 9.0 * np.eye(4)
        assert gap.min() > 0.3
    # Same corner above and below.
    np.testing.assert_array_equal(np.sign(top), np.sign(bottom))


def test_rope_is_closed_light_and_to_measure() -> None:
    for length in ROPE_CLASSES_M:
        part = rope_part(float(length), "rope", USUAL.radius_m)
        assert part.mesh.is_watertight
        assert part.mesh.volume > 0
        assert len(part.mesh.faces) < 3000
        np.testing.assert_allclose(part.mesh.bounds[:, 2], [0.0, length])
        assert np.linalg.norm(part.mesh.vertices[:, :2], axis=1).max() <= USUAL.radius_m + 1e-12
        assert part.uv is not None
        assert len(part.uv) == len(part.mesh.vertices)
