"""simgrab's render passes beside MuJoCo's own renderer, and pictures drawn in part beside those drawn whole."""

import msgspec
import mujoco
import numpy as np
import pytest
from conftest import small_scene

import simgrab
from simgrab.world.camera import changes
from simgrab.world.camera.renderer import REUSE
from simgrab.world.frames import FrameGenerator
from simgrab.world.scenery.model import FAR_M, HIDDEN, NEAR_M

DARK = {"sun": 0.0, "sky": 0.5}
SCENES = {
    "quay": small_scene(frames=6),
    "overcast": small_scene(frames=6, light=DARK),
    "low sun": small_scene(frames=6, light={"sun_elevation_deg": 12.0, "sun_azimuth_deg": 100.0}),
    "hold": simgrab.load("hold-coal", {"frames": 6}, size=(480, 270)),
    "water": simgrab.load("water-side", {"frames": 6}, size=(480, 270)),
    "lens": small_scene(frames=6, camera__distortion={"k1": -0.1}),
    "rain": simgrab.load("rain", {"frames": 6}, size=(480, 270)),
}


@pytest.fixture(scope="module", params=[name for name in SCENES if name != "lens"])
def generator(request):
    with FrameGenerator(SCENES[request.param]) as generator:
        yield generator


def by_mujoco(renderer, moment, *, segment):
    """Pixels and the depth buffer of `mjr_render`, rows counted from the bottom."""
    data, model = renderer.pose(moment), renderer.world.model
    option, scene = mujoco.MjvOption(), mujoco.MjvScene(model, maxgeom=model.ngeom + 16)
    option.geomgroup[:] = 1
    option.geomgroup[HIDDEN] = 0
    everything = mujoco.mjtCatBit.mjCAT_ALL
    mujoco.mjv_updateScene(model, data, option, None, mujoco.MjvCamera(), everything, scene)
    scene.flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = scene.flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = segment
    rect = renderer.aim(renderer.full, scene)
    renderer._buffer.make_current()
    mujoco.mjr_render(rect, scene, renderer._buffer.context)
    rgb, depth = np.empty((rect.height, rect.width, 3), np.uint8), np.empty((rect.height, rect.width), np.float32)
    mujoco.mjr_readPixels(rgb, depth, rect, renderer._buffer.context)
    groups = [int(model.geom_group[geom.objid]) for geom in scene.geoms[: scene.ngeom]]
    return rgb[::-1], depth[::-1].astype(float), np.array([255, *groups], np.uint8)


@pytest.mark.parametrize("frame", [0, 3])
def test_ids_and_depth_are_those_of_mujoco_to_the_bit(generator, frame):
    renderer, moment = generator.scene(frame).renderer, generator.project(frame).moment
    view = renderer.view(moment)
    colour, buffer, groups = by_mujoco(renderer, moment, segment=1)
    np.testing.assert_array_equal(view.ids, groups[colour[..., 0].astype(int) + 256 * colour[..., 1].astype(int)])
    depth = np.asarray(NEAR_M * FAR_M / (NEAR_M + buffer * (FAR_M - NEAR_M)), np.float32)
    np.testing.assert_array_equal(view.depth, depth)


@pytest.mark.parametrize("frame", [0, 3])
def test_colours_are_those_of_mujoco_but_for_rounding(generator, frame):
    renderer, moment = generator.scene(frame).renderer, generator.project(frame).moment
    ours = renderer.rgb(moment).astype(int)
    theirs = by_mujoco(renderer, moment, segment=0)[0]
    apart = np.abs(ours - theirs)
    assert apart.mean() < 0.5  # MuJoCo rounds the light of sun and sky by itself
    assert (apart.max(axis=2) > 8).mean() < 2e-3  # edges of shadows


def frames(scene, indices=None):
    with FrameGenerator(scene) as generator:
        return {i: generator.frame(i, full=True) for i in (range(scene.frames) if indices is None else indices)}


@pytest.mark.parametrize("name", SCENES)
def test_pictures_drawn_over_what_stands_still_are_those_drawn_whole(name, monkeypatch):
    reused = frames(SCENES[name])
    monkeypatch.setenv(REUSE, "0")
    for number, whole in frames(SCENES[name]).items():
        frame = reused[number]
        assert msgspec.to_builtins(frame.truth) == msgspec.to_builtins(whole.truth)
        np.testing.assert_array_equal(frame.full.ids, whole.full.ids)
        np.testing.assert_array_equal(frame.full.depth, whole.full.depth)
        np.testing.assert_array_equal(frame.mask, whole.mask)
        apart = (frame.rgb != whole.rgb).any(axis=2)
        assert apart.mean() < 1e-4  # single pixels at edges of shadows


def test_a_picture_does_not_depend_on_what_was_drawn_before():
    forwards = frames(SCENES["quay"])
    for number, frame in frames(SCENES["quay"], [5, 1, 3]).items():
        np.testing.assert_array_equal(frame.rgb, forwards[number].rgb)
        np.testing.assert_array_equal(frame.depth, forwards[number].depth)


def test_a_crane_that_moves_and_stops_is_drawn_alike_in_any_order():
    scene = simgrab.load("work-cycles", {"frames": 24}, size=(320, 180))
    there = frames(scene, [0, 1, 20, 21])
    for number, frame in frames(scene, [21, 0, 20]).items():
        np.testing.assert_array_equal(frame.rgb, there[number].rgb)


def test_windows_cover_the_tiles_and_stay_in_the_picture():
    rng = np.random.default_rng(0)
    for share in (0.0, 0.01, 0.2, 0.7, 1.0):
        grid = rng.random((9, 15)) < share
        covered = np.zeros((270, 480), bool)
        for x0, y0, x1, y1 in changes.windows(grid, 480, 270, changes.PASS_PX):
            assert 0 <= x0 < x1 <= 480
            assert 0 <= y0 < y1 <= 270
            covered[y0:y1, x0:x1] = True
        wanted = np.kron(grid, np.ones((changes.TILE_PX, changes.TILE_PX), bool))[:270, :480]
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
