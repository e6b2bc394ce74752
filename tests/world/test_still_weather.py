"""What weather makes of what stands still is kept, and the result is the same as when each frame computes it."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from conftest import slow_but
from test_weather import render_pass

import simgrab
from simgrab.model.geometry import Intrinsics
from simgrab.model.scenario import Weather
from simgrab.world import gl
from simgrab.world.camera import changes
from simgrab.world.camera.weather import Still, apply
from simgrab.world.frames import FrameGenerator
from simgrab.world.scenery.model import GRAB, ROPE

SIZE = (400, 225)
PLAIN = {"frames": 6, "place": {"model": "plain"}}
SCENES = {name: simgrab.load(name, PLAIN, size=SIZE) for name in ("rain", "fog", "glare")}
SCENES["lens"] = simgrab.load("rain", PLAIN | {"camera.distortion.k1": -0.1}, size=SIZE)
SCENES["heavy-snow"] = simgrab.load("heavy-snow", {"frames": 6}, size=SIZE)  # its own place
EVERYTHING = {"rain_mm_h": 20.0, "visibility_m": 90.0, "wetness": 0.9, "snow_cover": 0.4}


def frames(scene, indices):
    with FrameGenerator(scene) as generator:
        return [generator.frame(i) for i in indices]


@pytest.mark.parametrize("name", slow_but(SCENES, "rain"))
def test_weather_over_what_was_kept_is_the_weather_of_each_frame_alone_in_any_order(name, monkeypatch):
    order = [4, 0, 1, 4, 0]
    kept = frames(SCENES[name], order)
    monkeypatch.setattr("simgrab.world.camera.pipeline.Camera._kept", lambda *_: None)
    alone = dict(zip((0, 1, 4), frames(SCENES[name], (0, 1, 4)), strict=True))
    for frame, one in zip(order, kept, strict=True):
        np.testing.assert_array_equal(one.rgb, alone[frame].rgb)
        assert msgspec.to_builtins(one.truth) == msgspec.to_builtins(alone[frame].truth)


@pytest.mark.parametrize("seed", range(4))
def test_whatever_stands_before_what_stands_still(seed):
    """Boxes of any size and depth, at the picture's edges too, over ground that was kept from another picture."""
    rng = np.random.default_rng(seed)
    bare = render_pass(0.05, intrinsics=Intrinsics(501, 299, 430.0, 250.0, 150.0))
    still = Still(bare.depth, bare.ids)
    for _ in range(3):
        depth, ids = bare.depth.copy(), bare.ids.copy()
        for _ in range(rng.integers(0, 6)):
            x, y = (int(rng.integers(-20, n)) for n in (501, 299))
            w, h = rng.integers(1, 90, 2)
            at = slice(max(y, 0), max(y + h, 0)), slice(max(x, 0), max(x + w, 0))
            depth[at], ids[at] = rng.uniform(5, 20), rng.choice([ROPE, GRAB])
        seen = replace(bare, depth=depth, ids=ids)
        kept, fresh = (apply(Weather(**EVERYTHING), seen, seed=4, frame=1, still=s) for s in (still, None))
        np.testing.assert_array_equal(kept.light, fresh.light)
        np.testing.assert_array_equal(kept.attenuation, fresh.attenuation)
    assert set(still.made) == {"wet", "snow", "haze"}


def test_nothing_is_kept_where_everything_is_drawn_whole(monkeypatch):
    monkeypatch.setenv(gl.REUSE, "0")
    with FrameGenerator(SCENES["rain"]) as generator:
        scene = generator.scene(0)
        assert scene.draw(generator.project(0)).still is None


def test_tiles_near_hold_all_that_is_within_a_cell():
    rng = np.random.default_rng(0)
    for shape in ((1080, 1920), (299, 501), (31, 33)):
        pixels = np.zeros(shape, bool)
        rows, columns = (rng.integers(0, n, 5) for n in shape)
        pixels[rows, columns] = True
        tiles = changes.tiles_near(pixels)
        for row, column in zip(rows, columns, strict=True):
            reach = changes.CELL_PX
            low, high = (np.clip(np.array([row, column]) + d, 0, np.array(shape) - 1) for d in (-reach, reach))
            (top, left), (bottom, right) = low // changes.TILE_PX, high // changes.TILE_PX
            assert tiles[top : bottom + 1, left : right + 1].all()
    assert not changes.tiles_near(np.zeros((64, 64), bool)).any()
