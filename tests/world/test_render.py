"""The renderer draws in exactly the pixel geometry of `simgrab.geometry`."""

import os
import types

import mujoco
import numpy as np
import pytest
from conftest import small_scene

from simgrab import geometry
from simgrab.world import gl
from simgrab.world.camera.renderer import Renderer
from simgrab.world.frames import Studio
from simgrab.world.label import see
from simgrab.world.scenery.meshes import grab
from simgrab.world.scenery.model import GRAB
from simgrab.world.trajectory.iid import draw


class Spheres:
    """Stands in for a world: small spheres of the grab's group at given places, jib frame."""

    def __init__(self, centres, radius=0.1):
        spec = mujoco.MjSpec()
        spec.visual.headlight.active = 0
        spec.stat.extent = 1.0
        spec.visual.map.znear, spec.visual.map.zfar = 0.1, 200.0
        spec.visual.quality.offsamples = 0
        for centre in centres:
            spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], pos=centre, group=GRAB)
        self.model = spec.compile()

    def pose(self, data, _state):
        mujoco.mj_forward(self.model, data)


@pytest.mark.parametrize("lens", ["pinhole", "distorted"])
def test_a_small_sphere_appears_where_project_says(scene, crooked_scene, lens):
    """Every pose parameter, both axes of the principal point, and the half-pixel convention."""
    scenario = crooked_scene if lens == "distorted" else scene
    camera = scenario.camera
    rotation = geometry.camera_rotation(*np.radians((camera.beta_deg, camera.tilt_azimuth_deg, camera.roll_deg)))
    ideal = np.stack(np.meshgrid([60, 240, 430], [40, 130, 240]), -1).reshape(-1, 2) + 0.3
    depth = np.array([6.0, 8.0, 7.0] * 3)
    xy = (ideal - (camera.intrinsics.cx_px, camera.intrinsics.cy_px)) / camera.intrinsics.f_px
    centres = np.column_stack([xy, np.ones(9)]) * depth[:, None] @ rotation.T + camera.offset_m
    with Renderer(Spheres(centres), scenario) as renderer:
        renderer.pose(draw(scenario, 0))
        view = renderer.look()
        expected = camera.intrinsics.project(geometry.to_camera(centres, rotation, camera.offset_m))
        errors = []
        for (u, v), z in zip(expected, depth, strict=True):
            near = np.s_[int(v) - 11 : int(v) + 12, int(u) - 11 : int(u) + 12]
            y, x = np.nonzero(view.ids[near] == GRAB)
            errors.append((x.mean() + int(u) - 10.5 - u, y.mean() + int(v) - 10.5 - v))
            assert view.depth[near][view.ids[near] == GRAB].min() == pytest.approx(z - 0.1, abs=0.02)
        # Sampling moves the centroid of a disc of 6 px by a tenth or so, this way and that.
        np.testing.assert_allclose(errors, 0.0, atol=0.25)
        np.testing.assert_allclose(np.mean(errors, axis=0), 0.0, atol=0.08)


@pytest.fixture(scope="module", params=["scene", "crooked_scene"])
def studio(request):
    with Studio(request.getfixturevalue(request.param)) as studio:
        yield studio


def test_a_window_shows_what_the_whole_picture_shows(studio):
    aimed = studio.aim(1)
    whole = studio.renderer.look()
    x0, y0, x1, y1 = aimed.window
    inner = max(x0, 0), max(y0, 0), min(x1, 480), min(y1, 270)
    window, cut = studio.renderer.look(inner), whole.crop(inner)
    assert np.mean(window.ids != cut.ids) < 0.01
    same = window.ids == cut.ids
    assert np.median(np.abs(window.depth - cut.depth)[same]) < 1e-3


def test_windows_larger_than_the_buffer_are_drawn_in_tiles(studio):
    aimed = studio.aim(1)
    x0, y0, x1, y1 = aimed.window
    wide = studio.renderer.look((x0 - 300, y0 - 300, x1 + 300, y1 + 300), grab_only=True)
    tight = studio.renderer.look(aimed.window, grab_only=True)
    assert np.mean(wide.crop(aimed.window).ids != tight.ids) < 0.01
    assert (wide.ids == GRAB).sum() == pytest.approx((tight.ids == GRAB).sum(), rel=0.01)


@pytest.mark.parametrize("frame", range(4))
def test_the_amodal_box_bounds_the_drawn_silhouette(studio, frame):
    aimed = studio.aim(frame)
    mask = studio.renderer.look(aimed.window, grab_only=True).ids == GRAB
    y, x = np.nonzero(mask)
    drawn = np.array([x.min(), y.min(), x.max() + 1, y.max() + 1]) + (*aimed.window[:2], *aimed.window[:2])
    assert np.abs(drawn - aimed.amodal_box).max() <= 1.0
    sight = see(studio.renderer, aimed)
    assert 0.5 < sight.visible_fraction <= 1.0
    assert sight.in_frame_fraction == pytest.approx(1.0)


def test_the_model_stands_as_the_closed_forms_say(studio):
    """MuJoCo's kinematics against body_frames and jib_from_grab, which labels and the second renderer use."""
    for frame in range(6):
        state = studio.aim(frame).moment.grab
        data = studio.renderer.data
        for body, grab_from_body in grab.body_frames(state.jaw).items():
            expected = state.jib_from_grab @ grab_from_body
            np.testing.assert_allclose(data.body(body).xpos, expected[:3, 3], atol=1e-9)
            np.testing.assert_allclose(data.body(body).xmat.reshape(3, 3), expected[:3, :3], atol=1e-9)


def test_ropes_run_from_the_head_to_the_exits(studio):
    from simgrab.world.scenery.meshes import ropes

    state = studio.aim(2).moment.grab
    pose, data = state.jib_from_grab, studio.renderer.data
    for k, (end, top) in enumerate(zip(grab.ROPE_TERMINATIONS, ropes.ROPE_EXITS, strict=True)):
        start = pose[:3, :3] @ end + pose[:3, 3]
        body = data.body(f"rope_{k}")
        np.testing.assert_allclose(body.xpos, start, atol=1e-9)
        np.testing.assert_allclose(
            body.xmat.reshape(3, 3)[:, 2], (top - start) / np.linalg.norm(top - start), atol=1e-9
        )


def test_masses(studio):
    assert studio.world.model.body("head").subtreemass[0] == pytest.approx(10_500, abs=1)


def test_rgb_repeats(studio):
    studio.aim(3)
    first = studio.renderer.rgb()
    studio.renderer.look()
    assert np.array_equal(first, studio.renderer.rgb())
    assert first.shape == (270, 480, 3)
    assert 40 < first.mean() < 200


def test_no_opengl_says_what_to_install(monkeypatch, scene):
    from simgrab.errors import RendererError

    def broken(*_):
        raise AttributeError("'NoneType' object has no attribute 'eglQueryString'")

    monkeypatch.setattr(f"mujoco.{os.environ['MUJOCO_GL']}.GLContext", broken)
    with pytest.raises(RendererError, match="apt-get install"):
        Renderer(types.SimpleNamespace(model=mujoco.MjSpec().compile()), scene)


def test_a_sun_that_does_not_shine_casts_no_shadows_and_none_are_missed():
    with Studio(small_scene(light={"sun": 0.0, "sky": 0.5})) as studio:
        studio.aim(0)
        lights = studio.world.model.light_castshadow
        assert not lights.any()
        without = studio.renderer.rgb()
        lights[studio.world.model.light("sun").id] = True
        np.testing.assert_array_equal(studio.renderer.rgb(), without)
    with Studio(small_scene(light={"sun": 0.5})) as studio:
        assert studio.world.model.light_castshadow.any()


def test_opengl_without_memory_for_a_model_raises_before_it_renders(caplog):
    with gl._out_of_memory_raises():
        mujoco.get_mju_user_warning()("OpenGL error 0x502 in or before mjr_makeContext")
    assert "0x502" in caplog.text
    with pytest.raises(MemoryError, match="0x505"), gl._out_of_memory_raises():
        mujoco.get_mju_user_warning()("OpenGL error 0x505 in or before mjr_makeContext")
    assert mujoco.get_mju_user_warning() is None
