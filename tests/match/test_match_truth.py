import json
from contextlib import contextmanager

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from msgspec.structs import replace

from scripts import match_truth
from scripts.match_truth import Video
from simgrab.match.footage.footage import BT709, slope
from simgrab.model.scenario import FixedExposure, Plain, Sensor, Sharpening
from simgrab.model.srgb import decoded
from simgrab.world.camera.optics import Exposure, expose


@pytest.mark.parametrize("grey", ["on", "off"])
@pytest.mark.parametrize("mask", [Sharpening(), Sharpening(amount=1.5, radius_px=2.0)])
def test_the_true_noise_is_that_of_pictures(mask, grey):
    scenario = match_truth.drawn(0)
    optics = replace(
        scenario.optics, vignetting_stops=0.0, defocus_px=0.0, exposure=FixedExposure(), sharpening=mask,
        night_mode=grey, white_balance=(0.8, 1.3, 1.1),
        sensor=Sensor(full_well_e=5000.0, read_noise_e=10.0, fixed_pattern_percent=0.0),
    )  # fmt: skip
    camera = scenario.camera
    known = match_truth.truths(replace(scenario, optics=optics))
    for light in (0.2, 0.4):
        shown = expose(
            optics, np.full((camera.height_px, camera.width_px, 3), light, np.float32), intrinsics=camera.intrinsics,
            seed=1, frame=0, exposure=Exposure(0.0, grey == "on"),
        )  # fmt: skip
        level = decoded(shown.mean(axis=(0, 1)) / 255)
        weights = np.array((1.0, 0.0, 0.0) if grey == "on" else BT709)
        each = (weights * slope(level)) ** 2
        stated = known["noise gain"] * (each @ level) + known["read noise"] ** 2 * each.sum()
        assert (shown[20:-20, 20:-20] @ weights).var() == pytest.approx(stated, rel=0.06)


def grey(table):
    """Path-trace lines that do not move."""
    with np.load(table["scene"]) as file:
        width, height = file["camera"][:2].astype(int)
    assert not table["grain"]
    light = np.full((height, width, 3), 0.05, np.float16)
    light[::40, :] = 0.4

    class Tracer:
        def render(self, _frame):
            pass

        def save(self, path):
            np.save(path, light)

    return Tracer()


def test_path_traced_videos_have_the_noise_of_their_sensor_alone(tmp_path, monkeypatch):
    @contextmanager
    def opened(table):
        yield grey(table)

    asked: list[str] = []
    monkeypatch.setattr(match_truth, "blender", lambda python: asked.append(python) or opened)
    monkeypatch.setattr(match_truth, "FOREIGN_SECONDS", 0.7)
    scenario = Video(5, True).scenario
    assert isinstance(scenario.place, Plain)
    assert scenario.weather.rain_mm_h == scenario.weather.snow_mm_h == scenario.light.floodlights == 0
    assert scenario.optics.exposure == FixedExposure()
    arguments = [str(tmp_path), "--first", "5", "--count", "1"]
    done = CliRunner().invoke(match_truth.main, ["render", *arguments, "--blender", "python-with-bpy"])
    assert done.exit_code == 0, done.output
    assert asked == ["python-with-bpy"]
    clean = sorted((tmp_path / "foreign-005").iterdir())
    first, second = (cv2.imread(str(path)).astype(float) for path in clean[:2])
    seen = cv2.VideoCapture(str(tmp_path / "foreign-005.mp4"))
    frames = [seen.read()[1].astype(float) for _ in range(2)]
    assert np.abs(first - second).mean() < 0.2 * np.abs(frames[0] - frames[1]).mean()
    done = CliRunner().invoke(match_truth.main, ["score", *arguments])
    assert done.exit_code == 0, done.output
    (row,) = [json.loads(line) for line in (tmp_path / "score.jsonl").read_text().splitlines()]
    assert row["foreign"]
    assert "hue" not in row["intervals"]
    assert row["display"][0] == (scenario.display_layout is not None)
    assert "of 1 |" in done.output
