"""simgrab's render passes beside MuJoCo's own renderer, and pictures drawn in part beside those drawn whole."""

from contextlib import contextmanager
from dataclasses import replace

import cv2
import msgspec
import mujoco
import numpy as np
import pytest
from conftest import slow_but, small_scene

import simgrab
from simgrab.model.geometry import Distortion, Intrinsics
from simgrab.world import gl
from simgrab.world.camera import changes
from simgrab.world.camera.lens import Lens
from simgrab.world.frames import FrameGenerator
from simgrab.world.scenery import model
from simgrab.world.scenery.model import FAR_M, HIDDEN, NEAR_M

SCENES = {
    "quay": small_scene(frames=3),
    "overcast": small_scene(frames=3, light={"sun": 0.0, "sky": 0.5}),
    "low sun": small_scene(frames=3, light={"sun_elevation_deg": 12.0, "sun_azimuth_deg": 100.0}),
    "lens": small_scene(frames=3, camera__distortion={"k1": -0.1}),
    **{name: simgrab.load(name, {"frames": 3}, size=(480, 270)) for name in ("hold-coal", "water-side", "rain")},
}


@pytest.fixture(scope="module", params=slow_but([name for name in SCENES if name != "lens"], "quay"))
def generator(request):
    with FrameGenerator(SCENES[request.param]) as generator:
        yield generator


@contextmanager
def textured(scene):
    """A scene's world, with textures, in a context of MuJoCo's own size for it."""
    world = model.build(scene.world.plan, textured=True)
    with gl.offscreen(world.model, *scene.renderer.full[2:]) as buffer:
        yield world, buffer
    scene.renderer._buffer.make_current()


def by_mujoco(scene, moment):
    """Depth buffer and pixels of `mjr_render`, first of ids, then of colours; and the groups of the ids."""
    made = []
    with textured(scene) as (world, buffer):
        data = mujoco.MjData(world.model)
        world.pose(data, moment)
        scene.renderer.pose(moment)
        option, drawn = mujoco.MjvOption(), mujoco.MjvScene(world.model, maxgeom=world.model.ngeom + 16)
        option.geomgroup[:] = 1
        option.geomgroup[HIDDEN] = 0
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(world.model, data, option, None, mujoco.MjvCamera(), everything, drawn)
        rect = scene.renderer.aim(scene.renderer.full, drawn)
        for segment in (1, 0):
            drawn.flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = drawn.flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = segment
            mujoco.mjr_render(rect, drawn, buffer.context)
            rgb = np.empty((rect.height, rect.width, 3), np.uint8)
            depth = np.empty((rect.height, rect.width), np.float32)
            mujoco.mjr_readPixels(rgb, depth, rect, buffer.context)
            made.append((depth[::-1].astype(float), rgb[::-1].astype(int)))
    groups = [int(world.model.geom_group[geom.objid]) for geom in drawn.geoms[: drawn.ngeom]]
    return *made, np.array([255, *groups], np.uint8)


@pytest.mark.parametrize("frame", [0, 2])
def test_ids_and_depth_are_those_of_mujoco_to_the_bit_and_colours_but_for_rounding(generator, frame):
    scene, moment = generator.scene(frame), generator.project(frame).moment
    view = scene.renderer.view(moment)
    (buffer, ids), (_, colours), groups = by_mujoco(scene, moment)
    np.testing.assert_array_equal(view.ids, groups[ids[..., 0] + 256 * ids[..., 1]])
    depth = np.asarray(NEAR_M * FAR_M / (NEAR_M + buffer * (FAR_M - NEAR_M)), np.float32)
    np.testing.assert_array_equal(view.depth, depth)
    apart = np.abs(scene.renderer.rgb(moment) - colours)
    assert apart.mean() < 0.5  # MuJoCo rounds the light of sun and sky by itself
    assert (apart.max(axis=2) > 8).mean() < 2e-3  # edges of shadows


def pictures(scene, indices):
    with FrameGenerator(scene) as generator:
        return {i: generator.frame(i).rgb for i in indices}


@pytest.mark.parametrize("name", slow_but(SCENES, "quay", "lens"))
def test_pictures_drawn_over_what_stands_still_are_those_drawn_whole(name, monkeypatch):
    with FrameGenerator(SCENES[name]) as generator:
        renderer = generator.scene(0).renderer
        assert renderer._at_rest(generator.project(0).moment)
        for number in range(3):
            monkeypatch.setattr(renderer, "_reuses", True)
            frame = generator.frame(number, full=True)
            monkeypatch.setattr(renderer, "_reuses", False)
            whole = generator.frame(number, full=True)
            assert msgspec.to_builtins(frame.truth) == msgspec.to_builtins(whole.truth)
            for buffer in ("ids", "depth", "mask"):
                np.testing.assert_array_equal(getattr(frame, buffer), getattr(whole, buffer))
            assert (frame.rgb != whole.rgb).any(axis=2).mean() < 1e-4  # single pixels at edges of shadows


def test_a_crane_that_stands_and_moves_is_drawn_alike_in_any_order():
    scene = simgrab.load("slew-alarm", {"frames": 80}, size=(320, 180))
    with FrameGenerator(scene) as generator:
        rests = {i: generator.scene(0).renderer._at_rest(generator.project(i).moment) for i in (0, 5, 60, 79)}
    assert set(rests.values()) == {True, False}
    there = pictures(scene, rests)
    for number, rgb in pictures(scene, reversed(rests)).items():
        np.testing.assert_array_equal(rgb, there[number])


@pytest.fixture(scope="module")
def quays():
    """One world with a renderer that draws in part, and one that draws whole."""
    with FrameGenerator(SCENES["quay"]) as generator, pytest.MonkeyPatch.context() as patch:
        generator.scene(0)
        patch.setenv(gl.REUSE, "0")
        with FrameGenerator(SCENES["quay"]) as whole:
            renderer = whole.scene(0).renderer
            patch.undo()
            yield generator, renderer


@pytest.mark.parametrize("changes", [
    {"present": False}, {"grab__load": 0.0, "grab__jaw": 0.5}, {"grab__load": 1.0},
    {"grab__alpha": 0.3, "grab__rope_length": 25.0}, {"grab__rope_length": 4.0},
    {"grab__rope_length": 1.0, "grab__alpha": 0.1}, {"jib": simgrab.JibState(0.0, 30.0, 0.0), "time": 0.0},
], ids=str)  # fmt: skip
def test_any_moment_at_rest_is_drawn_as_whole_and_whatever_came_before(changes, quays):
    generator, whole = quays
    first, renderer = generator.project(0).moment, generator.scene(0).renderer
    grab = {key.removeprefix("grab__"): value for key, value in changes.items() if key.startswith("grab__")}
    own = {key: value for key, value in changes.items() if not key.startswith("grab__")}
    moment = replace(first, grab=replace(first.grab, **grab), **own)
    assert renderer._at_rest(moment)
    rgb, view = renderer.rgb(moment), renderer.view(moment)
    whole.rgb(moment)  # another context in the same process
    renderer.rgb(first)
    renderer.view(moment, (-50, -40, 700, 400))
    np.testing.assert_array_equal(renderer.rgb(moment), rgb)
    np.testing.assert_array_equal(renderer.view(moment).ids, view.ids)
    assert ((whole.rgb(moment) != rgb).any(axis=2)).mean() < 1e-3
    np.testing.assert_array_equal(whole.view(moment).ids, view.ids)
    np.testing.assert_array_equal(whole.view(moment).depth, view.depth)
    assert whole.fingerprint != renderer.fingerprint


def test_windows_cover_the_tiles_and_stay_in_the_picture():
    rng = np.random.default_rng(0)
    for share in (0.0, 0.01, 0.2, 0.7, 1.0):
        grid = rng.random((34, 60)) < share
        covered = np.zeros((1080, 1920), bool)
        for x0, y0, x1, y1 in changes.windows(grid, 1920, 1080, changes.PASS_PX):
            assert 0 <= x0 < x1 <= 1920
            assert 0 <= y0 < y1 <= 1080
            covered[y0:y1, x0:x1] = True
        wanted = np.kron(grid, np.ones((changes.TILE_PX, changes.TILE_PX), bool))[:1080, :1920]
        assert covered[wanted].all()


def test_rectangles_hold_what_is_before_the_near_plane():
    rng = np.random.default_rng(1)
    boxes = changes.corners(*np.sort(rng.normal(0, 3, (2, 200, 3)), axis=0))
    found = changes.rectangles(boxes, 400.0, np.array([240.0, 135.0]), 0.1)
    for box, (x0, y0, x1, y1) in zip(boxes, found, strict=True):
        inside = box[0] + rng.random((500, 3)) * (box[7] - box[0])
        seen = inside[inside[:, 2] >= 0.1]
        at = 400.0 * seen[:, :2] / seen[:, 2:] + (240.0, 135.0)
        assert ((at >= (x0, y0)) & (at <= (x1, y1))).all()


@pytest.mark.parametrize("interpolation", [cv2.INTER_CUBIC, cv2.INTER_NEAREST])
def test_bending_what_changed_is_bending_the_whole_picture(interpolation):
    rng = np.random.default_rng(0)
    k = Intrinsics(400, 300, 330.0, 200.0, 150.0, Distortion(k1=-0.12, p1=0.01))
    bent = Lens(k).map((0, 0, 400, 300))
    width, height = (bent.source[i + 2] - bent.source[i] for i in (0, 1))
    before = rng.integers(0, 256, (height, width, 3), np.uint8)
    for _ in range(30):
        x, y = (np.sort(rng.integers(0, n + 1, 2)).tolist() for n in (width, height))
        after = before.copy()
        after[y[0] : y[1], x[0] : x[1]] += 100
        over = bent.resample_over(
            bent.resample(before, interpolation), after, [(x[0], y[0], x[1], y[1])], interpolation
        )
        assert (over == bent.resample(after, interpolation)).all()
