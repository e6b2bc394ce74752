"""The chain from the drawn scene to the stream: what it does to pictures, and that it does nothing to labels."""

import msgspec
import numpy as np
import pytest
from conftest import SMALL, slow_but, small_scene

import simgrab
from simgrab.dataset import stored
from simgrab.model import scenes
from simgrab.world.frames import FrameGenerator

SMALL_CAMERA = SMALL | {"display.layout": "none", "frames": 8}
del SMALL_CAMERA["place"]  # the presets' own
PLAIN = {"place": {"model": "plain"}}
PRESETS = ("calm-day", "windy-day", "night-light-snow", "heavy-snow", "rain", "fog", "dust", "glare")
LAGGING = {"model": "auto", "lag_s": 1.0}


def make(scene, frame):
    with FrameGenerator(scene) as generator:
        return stored.make(generator, frame)


def labels(record):
    row = msgspec.structs.asdict(record.truth)
    for drawn in ("image_sha256", "weather_hidden_fraction"):
        row.pop(drawn)
    return row


CASES = [("heavy-snow", {}), *((preset, PLAIN) for preset in PRESETS)]  # the first in its own place


@pytest.mark.parametrize(("preset", "place"), slow_but(CASES, ("rain", PLAIN)))
def test_no_weather_and_no_lens_moves_a_label(preset, place):
    seen = scenes.load(preset, SMALL_CAMERA | place | {"shutter.rolling_s": 0.0})
    plain = msgspec.structs.replace(seen, weather=small_scene().weather, optics=small_scene().optics)
    ours, theirs = make(seen, 2), make(plain, 2)
    assert labels(ours.record) == labels(theirs.record)
    assert ours.record.mask == theirs.record.mask
    assert ours.record.truth.image_sha256 != theirs.record.truth.image_sha256
    assert theirs.record.truth.weather_hidden_fraction == 0


def test_what_weather_hides_is_a_column():
    hidden = [
        make(scenes.load("fog", SMALL_CAMERA | PLAIN | {"weather.visibility_m": visibility}), 0).record.truth
        for visibility in (1000.0, 100.0, 30.0)
    ]
    assert hidden[0].weather_hidden_fraction < hidden[1].weather_hidden_fraction < hidden[2].weather_hidden_fraction
    row = hidden[1]
    expected = 1 - np.exp(-3.912 / 100 * row.distance_m)  # Koschmieder's law at the grab's distance
    assert row.weather_hidden_fraction == pytest.approx(expected, abs=0.06)


def test_a_lagging_exposure_depends_on_the_clip_and_not_on_who_asks():
    scene = small_scene(
        "work-cycles", frames=8, clip__clip_frames=4, optics__exposure=LAGGING, light={"sun": 0.0, "sky": 0.3}
    )
    with FrameGenerator(scene) as generator:
        whole = [stored.make(generator, frame).files for frame in range(8)]
    with FrameGenerator(scene) as generator:
        assert [stored.make(generator, frame).files for frame in (6, 2, 3)] == [whole[frame] for frame in (6, 2, 3)]


def test_night_is_dark_but_where_the_lamps_shine():
    still = {"swing__rope_length_m": {"dist": "constant", "value": 10.0}, "swing__alpha__sigma_deg": 0.0}
    scenes = small_scene(**still), small_scene(**still, light={"sun": 0.0, "sky": 0.02, "floodlights": 0.3})
    day, drawn = (next(simgrab.frames(scene)) for scene in scenes)
    day, dark = day.rgb.astype(float), drawn.rgb.astype(float)
    x0, y0, x1, y1 = drawn.box.astype(int)
    assert dark[:, :40].mean() < 0.5 * day[:, :40].mean()
    assert dark[y0:y1, x0:x1].mean() / dark[:, :40].mean() > 1.5 * day[y0:y1, x0:x1].mean() / day[:, :40].mean()
