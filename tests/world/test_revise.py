"""A generator that goes on with another scenario makes the frames of one that begins with it, to the bit."""

import cv2
import msgspec
import numpy as np
import pytest

import simgrab
from simgrab.errors import ScenarioError
from simgrab.world.camera.renderer import Renderer
from simgrab.world.frames import FrameGenerator
from simgrab.world.scenery import places

START = {"place.model": "plain", "camera.width_px": 320, "camera.height_px": 180, "camera.focal.pixels_per_mm": 57.0,
         "image.shadow_map_px": 1024, "jib.head": "none"}  # fmt: skip
KEPT = [  # what needs no other OpenGL context, each laid over the one before
    {"camera.beta_deg": 6.0, "camera.tilt_azimuth_deg": 40.0, "swing.alpha.sigma_deg": 7.0,
     "light.sun_azimuth_deg": 10.0},
    {"camera.width_px": 200, "camera.height_px": 120, "image.samples": 0, "camera.distortion.k1": -0.1},
    {"seed": 5},
    {"grab.wear": 0.9, "jib.rope_diameter_mm": 50.0},
    {"camera.width_px": 320, "camera.height_px": 180, "image.samples": 4, "camera.distortion.k1": 0.0, "light.sun": 0.0,
     "light.floodlights": 1.0, "weather.visibility_m": 60.0},
    {"light.floodlights": 0.0, "light.sun": 0.7,
     "swing": {"model": "dynamic", "work": {"model": "turn", "wait_s": 0.0}}},
]  # fmt: skip


def scene(*changes):
    merged = {key: value for change in changes for key, value in change.items()}
    return simgrab.load(
        "quay-day", {k: v for k, v in merged.items() if not (k.startswith("swing.") and "swing" in merged)}
    )


def same(one, other):
    np.testing.assert_array_equal(one.rgb, other.rgb)
    np.testing.assert_array_equal(one.depth, other.depth)
    np.testing.assert_array_equal(one.ids, other.ids)
    assert msgspec.structs.asdict(one.truth) == msgspec.structs.asdict(other.truth)


@pytest.fixture
def generator():
    with FrameGenerator(scene(START)) as generator:
        generator.frame(1)
        yield generator


def test_a_revised_generator_makes_what_a_new_one_makes_and_keeps_its_context(generator):
    changes = [START]
    window = generator.scene(1).renderer._buffer.window
    for change in KEPT:
        changes.append(change)
        wanted = scene(*changes)
        generator.revise(wanted)
        found = generator.frame(1, full=True)
        assert generator.scene(1).renderer._buffer.window is window, change
        with FrameGenerator(wanted) as fresh:
            same(found, fresh.frame(1, full=True))


def test_levels_of_variation_give_each_frame_alone_and_in_any_order(monkeypatch):
    """Place every eight frames, grab every four, camera and sun every two."""
    laws = {"place.fill": (0.1, 0.9), "grab.wear": (0, 1), "camera.beta_deg": (1, 5), "light.sun": (0, 1)}
    vary = {key: {"dist": "uniform", "low": low, "high": high} for key, (low, high) in laws.items()}
    small = {"camera.width_px": 200, "camera.height_px": 120, "camera.focal.pixels_per_mm": 38.0, "seed": 0,
             "image.shadow_map_px": 1024, "frames": 16, "clip.clip_frames": 2, "vary": vary}  # fmt: skip
    levels = simgrab.load("hold-coal", small | {"every": {"place": 8, "grab": 4}})
    built, opened = [], []
    build, start = places.build, Renderer.__init__
    monkeypatch.setattr(places, "build", lambda *a, **k: built.append(1) or build(*a, **k))
    monkeypatch.setattr(Renderer, "__init__", lambda self, *a, **k: opened.append(1) or start(self, *a, **k))
    with FrameGenerator(levels) as generator:
        ordered = [generator.frame(frame, full=True) for frame in range(16)]
        assert (len(built), len(opened)) == (2, 1)
    with FrameGenerator(levels) as alone:
        for frame in (13, 2):
            same(alone.frame(frame, full=True), ordered[frame])
    assert len({frame.truth.beta_deg for frame in ordered}) == 8


def test_a_photograph_is_shown_anew_for_each_camera_and_frame(tmp_path):
    for number in range(2):
        noise = np.random.default_rng(number).integers(0, 255, (90, 160, 3), np.uint8)
        cv2.imwrite(str(tmp_path / f"{number}.png"), cv2.resize(noise, (640, 360)))
    (tmp_path / "yard.toml").write_text('base = "quay-day"\n[place]\nmodel = "photo"\nfile = "."\n')
    start = {key: value for key, value in START.items() if key != "place.model"}
    small, rough = {"camera.width_px": 200, "camera.height_px": 120}, {"image.samples": 0}
    scenes = [simgrab.load(tmp_path / "yard.toml", start | change) for change in ({}, small, rough, {})]
    with FrameGenerator(scenes[0]) as generator:
        context = generator.scene(0).renderer._buffer.context
        for wanted in scenes:
            generator.revise(wanted)
            with FrameGenerator(wanted) as fresh:
                for number in range(4):
                    same(generator.frame(number, full=True), fresh.frame(number, full=True))
        assert generator.scene(0).renderer._buffer.context is context


def test_another_shadow_map_opens_another_context(generator):
    wanted = scene(START, {"image.shadow_map_px": 2048, "grab.wear": 0.9})
    window = generator.scene(1).renderer._buffer.window
    generator.revise(wanted)
    found = generator.frame(1, full=True)
    assert generator.scene(1).renderer._buffer.window is not window
    with FrameGenerator(wanted) as fresh:
        same(found, fresh.frame(1, full=True))


def test_a_camera_that_cannot_be_leaves_the_generator_as_it_was():
    start = scene(START, {"jib.head": "portal"})
    with FrameGenerator(start) as generator:
        before = generator.frame(1, full=True)
        generator.revise(scene(START, {"jib.head": "portal", "camera.offset_z_m": 0.5}))
        with pytest.raises(ScenarioError, match="steel"):
            generator.frame(1)
        generator.revise(start)
        same(before, generator.frame(1, full=True))


def test_framebuffers_are_freed(generator):
    from OpenGL import GL

    sizes = [(320, 180), (200, 120)]
    for width, height in sizes * 3:
        generator.revise(scene(START, {"camera.width_px": width, "camera.height_px": height}))
        generator.frame(0)
    alive = sum(bool(GL.glIsRenderbuffer(name)) for name in range(1, 200))
    for width, height in sizes * 3:
        generator.revise(scene(START, {"camera.width_px": width, "camera.height_px": height}))
        generator.frame(0)
    assert sum(bool(GL.glIsRenderbuffer(name)) for name in range(1, 200)) == alive
    assert isinstance(generator.scene(0).renderer, Renderer)
