"""Every second renderer samples the exact pinhole, agrees with MuJoCo, and is replaced openly where it cannot start."""

import multiprocessing
import os
import sys
import tomllib
from contextlib import ExitStack, closing
from itertools import combinations
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from conftest import slow_but
from seconds import SECOND_RENDERERS, needs_embree

from simgrab.errors import RendererError
from simgrab.judge.audit.second_renderer import RENDERERS, choice, install_hint, open_second_renderer
from simgrab.judge.audit.silhouettes import Difference, grab_shapes, samples_a_pixel, silhouette
from simgrab.model import rng
from simgrab.runtime.processes import PLACE
from simgrab.world import gl
from simgrab.world.frames import FrameGenerator

ROOT = Path(__file__).parents[2]
F, CX, CY, WINDOW, SAMPLES = 400.0, 33.7, 21.2, (-4, 3, 60, 41), 5
AT_EDGE = 0.02  # of a sample: OpenGL snaps corners to 1/256 of one, Embree rounds to float32


@pytest.fixture(scope="module", params=SECOND_RENDERERS)
def renderer(request):
    with closing(request.param()) as made:
        yield made


def test_each_sample_lies_in_the_centre_of_its_cell(renderer):
    """Convex polygons of known corners, wound either way; half-planes give the samples that are inside."""
    x, y = (WINDOW[i] + (np.arange((WINDOW[i + 2] - WINDOW[i]) * SAMPLES) + 0.5) / SAMPLES for i in (0, 1))
    x, y = np.meshgrid(x, y)
    for case in range(6):
        draw = rng.stream(5, case, "polygon")
        side = 1 if case % 2 else -1
        turns = side * np.sort(draw.uniform(0, 2 * np.pi, 5))
        corners = np.array([30.0, 20.0]) + draw.uniform(8, 30) * np.stack([np.cos(turns), np.sin(turns)], axis=1)
        depth = draw.uniform(5, 40)
        vertices = np.column_stack([(corners - (CX, CY)) / F * depth, np.full(5, depth)])
        # The pose turns and moves the camera's frame back.
        pose = np.eye(4)
        pose[:3, :3] = np.linalg.qr(draw.normal(size=(3, 3)))[0]
        pose[:3, 3] = draw.normal(size=3)
        polygon = (vertices - pose[:3, 3]) @ pose[:3, :3], np.array([(0, 1, 2), (0, 2, 3), (0, 3, 4)])
        renderer.load({"polygon": polygon})
        mask = renderer.silhouette({"polygon": pose}, F, CX, CY, WINDOW, SAMPLES)

        along = np.roll(corners, -1, axis=0) - corners
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        inside = np.min(
            [side * (a[0] * (y - c[1]) - a[1] * (x - c[0])) for a, c in zip(along, corners, strict=True)], axis=0
        )
        clear = np.abs(inside) > AT_EDGE / SAMPLES
        assert clear.mean() > 0.99
        np.testing.assert_array_equal(mask[clear], inside[clear] > 0)


def test_shapes_left_out_are_not_rendered(renderer):
    far = np.array([(-1.0, -1.0, 20.0), (1.0, -1.0, 20.0), (0.0, 1.0, 20.0)])
    renderer.load({"a": (far, np.array([(0, 1, 2)])), "b": (far + (0, 0, 5), np.array([(0, 1, 2)]))})
    one = renderer.silhouette({"a": np.eye(4)}, F, CX, CY, WINDOW, SAMPLES)
    both = renderer.silhouette({"a": np.eye(4), "b": np.eye(4)}, F, CX, CY, WINDOW, SAMPLES)
    assert one.any()
    assert (both >= one).all()
    assert not renderer.silhouette({}, F, CX, CY, WINDOW, SAMPLES).any()


def test_a_renderer_whose_process_died_renders_on(renderer):
    triangle = np.array([(-1.0, -1.0, 20.0), (1.0, -1.0, 20.0), (0.0, 1.0, 20.0)]), np.array([(0, 1, 2)])
    renderer.load({"a": triangle})
    before = renderer.silhouette({"a": np.eye(4)}, F, CX, CY, WINDOW, SAMPLES)
    for process in multiprocessing.active_children():
        process.kill()
        process.join()
    np.testing.assert_array_equal(renderer.silhouette({"a": np.eye(4)}, F, CX, CY, WINDOW, SAMPLES), before)


@needs_embree
@pytest.mark.parametrize("scene_fixture", slow_but(["scene", "crooked_scene"], "crooked_scene"))
def test_mujoco_and_both_second_renderers_agree(scene_fixture, request):
    with FrameGenerator(request.getfixturevalue(scene_fixture)) as generator, ExitStack() as stack:
        others = [stack.enter_context(closing(kind())) for kind in RENDERERS]
        for frame in range(2):
            scene, projection = generator.scene(frame), generator.project(frame)
            window, row = projection.window, generator.frame(frame).truth
            samples = samples_a_pixel(window)
            masks = [scene.renderer.silhouette(projection.moment, window, samples)]
            for other in others:
                other.load(grab_shapes(generator, frame))
                masks.append(silhouette(other, scene.world.plan.grab, row, window, samples))
            bound = Difference(1 / samples + 1e-6, 0.9995, 0.005)  # an edge may fall on either side of a sample
            for a, b in combinations(masks, 2):
                assert a.any()
                assert Difference.of(a, b, window).worst(bound) == bound


def failing(package, problem):
    return Mock(side_effect=RendererError(problem), package=package)


class Works:
    package, name, open = "numpy", "a renderer", False

    def __init__(self):
        self.open = True

    def close(self):
        self.open = False


def test_the_first_that_works_is_used_and_the_others_are_named(monkeypatch):
    monkeypatch.setattr(choice, "RENDERERS", (failing("numpy", "no\n context"), Works, failing("numpy", "not tried")))
    with open_second_renderer() as (renderer, note):
        assert renderer.open
        assert note == "a renderer; numpy cannot start (no context)"
    assert not renderer.open
    monkeypatch.setattr(choice, "RENDERERS", (failing("no_such_package", ""), Works))
    with open_second_renderer() as (_, note):
        assert note == "a renderer"


def test_without_one_that_works_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setattr(choice, "RENDERERS", (failing("no_such_package", ""),))
    with pytest.raises(RendererError, match="no second renderer is installed; pip install"), open_second_renderer():
        pass
    monkeypatch.setattr(choice, "RENDERERS", (failing("numpy", "no context"),))
    with pytest.raises(RendererError, match=r"^numpy cannot start \(no context\); pip install"), open_second_renderer():
        pass


def test_where_embree_has_no_wheels_the_hint_names_pyrender(monkeypatch):
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(choice.platform, "machine", lambda: "x86_64")
    assert install_hint() == "pip install 'simgrab[audit]'"
    monkeypatch.setattr(choice.platform, "machine", lambda: "aarch64")
    assert "aarch64: pip install pyrender, and after it pip install 'PyOpenGL>=" in install_hint()


@pytest.mark.parametrize("backend", ["", "egl"])
def test_a_pyopengl_too_old_for_mujoco_is_named(monkeypatch, backend):
    import mujoco

    monkeypatch.setenv("MUJOCO_GL", backend)
    monkeypatch.setattr(gl, "version", lambda _: "3.1.0")
    monkeypatch.setattr(gl, "_egl_devices", lambda: ([1], None))
    monkeypatch.setattr(gl, "_loads", lambda _: True)
    assert gl.choose() == "disabled"
    too_old = pytest.raises(RendererError, match=r"PyOpenGL 3\.1\.0.*pip install 'PyOpenGL>=")
    with too_old, gl.offscreen(mujoco.MjSpec().compile(), 8, 8):
        pass
    monkeypatch.setenv("MUJOCO_GL", backend)
    monkeypatch.setattr(gl, "version", lambda _: gl.LEAST_PYOPENGL)
    assert gl.choose() == "egl"


@pytest.mark.parametrize(
    ("place", "given", "chosen"), [("3", None, "2"), ("4", None, "0"), ("3", "1", "1"), ("", None, None)]
)
def test_workers_take_gpus_in_turn(monkeypatch, place, given, chosen):
    monkeypatch.setenv("MUJOCO_GL", "egl")
    monkeypatch.setenv(PLACE, place)
    monkeypatch.setattr(gl, "gpus", lambda: [0, 2])
    monkeypatch.delenv("MUJOCO_EGL_DEVICE_ID", raising=False)
    if given:
        monkeypatch.setenv("MUJOCO_EGL_DEVICE_ID", given)
    gl.choose()
    assert os.environ.pop("MUJOCO_EGL_DEVICE_ID", None) == chosen
    monkeypatch.setenv("MUJOCO_EGL_DEVICE_ID", "5")  # removed again, whatever was there before


def test_the_least_pyopengl_is_the_one_that_the_package_asks_for():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    asked = [*project["project"]["dependencies"], *project["tool"]["uv"]["override-dependencies"]]
    assert asked.count(f"pyopengl>={gl.LEAST_PYOPENGL}") == 2
