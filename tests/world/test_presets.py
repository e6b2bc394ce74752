"""Weather, levels of variation and sensors give the same bytes in any process, and after any interruption."""

import os
import signal
import subprocess
import sys
import time

import pytest
from conftest import SMALL, digests
from test_sensor_files import SENSORS

from simgrab.dataset.render import render
from simgrab.model import scenes
from simgrab.model.scenario import Scenario, variants

PRESETS = ("calm-day", "windy-day", "night-light-snow", "heavy-snow", "rain", "fog", "dust", "glare")
KEY = "light+optics+shutter+swing+weather"  # what they differ in
SEED = 315  # with which eight draws give each of them once


def presets() -> Scenario:
    """The presets as worlds of one dataset, a frame each, and another grab every four frames."""
    tables = [{key: scenes.load(name).to_dict()[key] for key in KEY.split("+")} for name in PRESETS]
    wear = {"dist": "uniform", "low": 0.2, "high": 1.0}
    vary = {KEY: {"dist": "one-of", "names": PRESETS, "values": tables}, "grab.wear": wear}
    frames = {"clip.clip_frames": 1, "frames": len(PRESETS), "every": {"grab": 4}}
    return scenes.load("calm-day", SMALL | frames | {"seed": SEED, "vary": vary})


def record() -> Scenario:
    """Two clips of two frames of one of the twins, with sensors."""
    over_the_yard = {"swing.work.dig_rope_m": 20.0, "swing.settle_s": 1.0}
    changes = SMALL | over_the_yard | {"frames": 4, "clip.clip_frames": 2, "sensors": SENSORS}
    return scenes.load("qingdao-heavy-snow", changes)


@pytest.fixture(scope="module", params=[presets, record])
def drawn(request, tmp_path_factory):
    """A scene, and its dataset as one process draws it."""
    scenario, path = request.param(), tmp_path_factory.mktemp("data") / "drawn"
    render(scenario, path)
    return scenario, path


def test_every_preset_is_among_them():
    assert {one.drawn[KEY] for one, _ in variants(presets())} == set(PRESETS)


@pytest.mark.slow
def test_two_workers_give_the_same_bytes_also_when_killed_and_resumed(drawn, tmp_path):
    scenario, path = drawn
    out = tmp_path / "out"
    command = [sys.executable, "-m", "simgrab", "render", path / "manifest.json", "--out", out, "--quiet"]
    process = subprocess.Popen([*command, "--workers", "2"], start_new_session=True)
    rows = out / ".partial" / "rows"
    while process.poll() is None and len(list(rows.glob("*.json"))) < scenario.frames // 2:
        time.sleep(0.005)
    assert process.poll() is None, "it ended before it could be killed"
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    render(scenario, out, resume=True)
    assert digests(out) == digests(path)
