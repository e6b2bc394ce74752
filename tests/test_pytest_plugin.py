"""The plugin in somebody else's tests: the README's example, limits that hold and do not, a cache between runs."""

import re
import subprocess
import sys
from importlib.metadata import entry_points
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
# Where simgrab was installed before it had the plugin, pytest does not find it by itself.
LOADED = [] if entry_points(group="pytest11", name="simgrab") else ["-p", "simgrab.pytest_plugin"]
SMALL = """{
    "camera.width_px": 480, "camera.height_px": 270, "camera.focal": {"model": "pixels", "focal_length_px": 411.2},
    "image.samples": 0, "image.shadow_map_px": 0, "place": {"model": "plain"},
}"""
OWN = f"""
import pytest
from simgrab.instrument.contract import Measurement

SMALL = {SMALL}


class Still:
    name = "still"

    def __call__(self, frames, calibration):
        return [Measurement(status="ok", alpha=0.0) for frame in frames]


@pytest.fixture
def record(simgrab_record):
    return simgrab_record("quay-day", SMALL, frames=3, seed=5)
"""


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("plugin") / "cache"


def run(folder, tests, cache):
    (folder / "test_mine.py").write_text(tests)
    command = [sys.executable, "-m", "pytest", "-q", "--strict-markers", *LOADED, f"--simgrab-cache={cache}"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout


def test_frames_and_truth_of_a_scene_are_kept_between_runs(tmp_path, cache):
    tests = OWN + (
        "def test_it(record):\n"
        "    pictures = [frame.picture for frame in record.frames]\n"
        "    assert [p.shape for p in pictures] == 3 * [(270, 480, 3)]\n"
        "    assert (next(iter(record.frames)).picture == pictures[0]).all()\n"
        "    assert len(record.truth) == 3 and record.truth[0].seed == 5\n"
        "    assert record.calibration.width_px == 480\n"
    )
    status, out = run(tmp_path, tests, cache)
    assert status == 0, out
    (made,) = cache.glob("*/manifest.json")
    before = made.stat().st_mtime_ns
    assert run(tmp_path, tests, cache)[0] == 0
    assert made.stat().st_mtime_ns == before


def marked(limit, body="    simgrab_judge(Still(), record)\n", fixtures="simgrab_judge, record"):
    return OWN + f"@pytest.mark.simgrab_limit({limit})\ndef test_it({fixtures}):\n{body}"


@pytest.mark.parametrize(
    ("tests", "message"),
    [
        (marked('"angle.overall.rmse_deg", upper=0.01'), r"angle.overall.rmse_deg: [\d.]+ is outside of ≤ 0.01"),
        (marked('"angle.overall.rsme_deg", upper=9'), "angle.overall.rmse_deg"),
        (marked('"angle.overall.rmse_deg", uper=9'), "uper"),
        (marked('"angle.overall.rmse_deg", upper=9', "    pass\n"), "nothing was judged"),
        (marked('"angle.overall.rmse_deg", upper=9', "    pass\n", "record"), "needs the fixture simgrab_judge"),
    ],
    ids=["exceeded", "misspelt metric", "misspelt end", "never judged", "without the fixture"],
)
def test_limits_that_do_not_hold_fail(tests, message, tmp_path, cache):
    status, out = run(tmp_path, tests, cache)
    assert status == 1
    assert re.search(message, out), out


def test_limits_that_hold_pass(tmp_path, cache):
    status, out = run(tmp_path, marked('"angle.overall.rmse_deg", upper=30'), cache)
    assert status == 0, out


def test_the_example_in_the_readme_works(tmp_path, cache):
    codes = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    (example,) = (code for code in codes if "simgrab_record" in code)
    (mine,) = (code for code in codes if "class Mine" in code)
    # Smaller pictures, for time's sake.
    example = example.replace('"calm-day", ', '"calm-day", SMALL, ')
    assert "SMALL" in example
    (tmp_path / "mine.py").write_text(mine)
    status, out = run(tmp_path, f"SMALL = {SMALL}\n{example}", cache)
    assert status == 0, out
