"""The renderer draws in exactly the pixel geometry of `simgrab.model.geometry`."""

import os
import types
from contextlib import closing
from unittest.mock import Mock

import mujoco
import numpy as np
import pytest
import trimesh
from conftest import small_scene

from simgrab.model import geometry
from simgrab.model.scenario import Jib
from simgrab.world import gl
from simgrab.world.camera.buffers import observe
from simgrab.world.camera.renderer import Renderer
from simgrab.world.extensions import Recipe
from simgrab.world.frames import FrameGenerator
from simgrab.world.scenery.grabs.four_rope import four_rope
from simgrab.world.scenery.model import GRAB
from simgrab.world.trajectory.iid import draw


class Spheres:
    """Stands in for a world: small spheres of the grab's group at given places, jib frame."""

    textures = types.MappingProxyType({})

    def __init__(self, centres, radius=0.1):
        spec = mujoco.MjSpec()
        spec.visual.headlight.active = 0
        spec.stat.extent = 1.0
        spec.visual.map.znear, spec.visual.map.zfar = 0.1, 200.0
        spec.visual.quality.offsamples = 0
        ball = trimesh.creation.icosphere(subdivisions=4, radius=radius)
        spec.add_mesh(name="ball", uservert=ball.vertices.ravel(), userface=ball.faces.ravel())
        for centre in centres:
            spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="ball", pos=centre, group=GRAB)
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
    with closing(Renderer(Spheres(centres), scenario, Recipe(scenario).split)) as renderer:
        view = renderer.view(draw(scenario, 0))
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
def generator(request):
    with FrameGenerator(request.getfixturevalue(request.param)) as generator:
        yield generator


def test_a_window_shows_what_the_whole_picture_shows(generator):
    projection, renderer = generator.project(1), generator.scene(1).renderer
    whole = renderer.view(projection.moment)
    x0, y0, x1, y1 = projection.window
    inner = max(x0, 0), max(y0, 0), min(x1, 480), min(y1, 270)
    window, cut = renderer.view(projection.moment, inner), whole.crop(inner)
    assert np.mean(window.ids != cut.ids) < 0.01
    same = window.ids == cut.ids
    assert np.median(np.abs(window.depth - cut.depth)[same]) < 1e-3


def test_windows_larger_than_the_buffer_are_drawn_in_tiles(generator):
    projection, renderer = generator.project(1), generator.scene(1).renderer
    moment, (x0, y0, x1, y1) = projection.moment, projection.window
    wide = renderer.silhouette(moment, (x0 - 300, y0 - 300, x1 + 300, y1 + 300))
    tight = renderer.silhouette(moment, projection.window)
    assert np.mean(wide[300:-300, 300:-300] != tight) < 0.01
    assert wide.sum() == pytest.approx(tight.sum(), rel=0.01)


@pytest.mark.parametrize("k1", [0.0, -0.1])
def test_silhouette_and_view_of_the_grab_are_the_same_drawn_together(k1):
    with FrameGenerator(small_scene(frames=3, camera__distortion={"k1": k1})) as generator:
        for frame in range(3):
            projection, renderer = generator.project(frame), generator.scene(frame).renderer
            silhouette, view = renderer.grab_views(projection.moment, projection.window)
            alone = renderer.view(projection.moment, projection.window)
            assert (silhouette == renderer.silhouette(projection.moment, projection.window)).all()
            assert (view.ids == alone.ids).all()
            assert (view.depth == alone.depth).all()


@pytest.mark.parametrize("frame", range(4))
def test_the_amodal_box_bounds_the_drawn_silhouette(generator, frame):
    projection, renderer = generator.project(frame), generator.scene(frame).renderer
    mask = renderer.silhouette(projection.moment, projection.window)
    y, x = np.nonzero(mask)
    drawn = np.array([x.min(), y.min(), x.max() + 1, y.max() + 1]) + 2 * projection.window[:2]
    assert np.abs(drawn - projection.amodal_box).max() <= 1.0
    visibility = observe(renderer, projection)
    assert 0.5 < visibility.visible_fraction <= 1.0
    assert visibility.in_frame_fraction == pytest.approx(1.0)


def test_the_model_stands_as_the_closed_forms_say(generator):
    """MuJoCo's kinematics against body_frames and jib_from_grab, which labels and the second renderer use."""
    for frame in range(6):
        moment = generator.project(frame).moment
        state, data = moment.grab, generator.scene(frame).renderer.pose(moment)
        for body, grab_from_body in four_rope().frames(state.jaw).items():
            expected = state.jib_from_grab.as_matrix() @ grab_from_body
            np.testing.assert_allclose(data.body(body).xpos, expected[:3, 3], atol=1e-9)
            np.testing.assert_allclose(data.body(body).xmat.reshape(3, 3), expected[:3, :3], atol=1e-9)


def test_ropes_run_from_the_head_to_the_exits(generator):
    from simgrab.world.scenery.meshes import ropes

    moment = generator.project(2).moment
    pose, data = moment.grab.jib_from_grab, generator.scene(2).renderer.pose(moment)
    for k, (end, top) in enumerate(zip(four_rope().terminations, ropes.Ropes.of(Jib(), 4).exits, strict=True)):
        start = pose.apply(end)
        body = data.body(f"rope_{k}")
        np.testing.assert_allclose(body.xpos, start, atol=1e-9)
        np.testing.assert_allclose(
            body.xmat.reshape(3, 3)[:, 2], (top - start) / np.linalg.norm(top - start), atol=1e-9
        )


def test_masses(generator):
    assert generator.scene(0).world.model.body("head").subtreemass[0] == pytest.approx(10_500, abs=1)


def test_no_opengl_says_what_to_install(monkeypatch, scene):
    from simgrab.errors import RendererError

    broken = Mock(side_effect=AttributeError("'NoneType' object has no attribute 'eglQueryString'"))
    monkeypatch.setattr(f"mujoco.{os.environ['MUJOCO_GL']}.GLContext", broken)
    with pytest.raises(RendererError, match="apt-get install"):
        Renderer(types.SimpleNamespace(model=mujoco.MjSpec().compile(), textures={}), scene, Recipe(scene).split)


def test_a_sun_that_does_not_shine_casts_no_shadows_and_none_are_missed():
    with FrameGenerator(small_scene(light={"sun": 0.0, "sky": 0.5})) as generator:
        scene, moment = generator.scene(0), generator.project(0).moment
        model, renderer = scene.world.model, scene.renderer
        assert not model.light_castshadow.any()
        without = renderer.rgb(moment)
        model.light_castshadow[model.light("sun").id] = True
        np.testing.assert_array_equal(renderer.rgb(moment), without)
    with FrameGenerator(small_scene(light={"sun": 0.5})) as generator:
        assert generator.scene(0).world.model.light_castshadow.any()


def test_opengl_without_memory_for_a_model_raises_before_it_renders(caplog):
    with gl._out_of_memory_raises():
        mujoco.get_mju_user_warning()("OpenGL error 0x502 in or before mjr_makeContext")
    assert "0x502" in caplog.text
    with pytest.raises(MemoryError, match="0x505"), gl._out_of_memory_raises():
        mujoco.get_mju_user_warning()("OpenGL error 0x505 in or before mjr_makeContext")
    assert mujoco.get_mju_user_warning() is None
