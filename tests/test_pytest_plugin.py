"""The plugin in somebody else's tests: the documented example, limits that hold and do not, a cache between runs."""

import ast
import json
import re
import subprocess
import sys
from importlib.metadata import entry_points
from pathlib import Path
from xml.etree import ElementTree

import pytest
import tomli_w

from simgrab.judge.check import baseline

ROOT = Path(__file__).parents[1]
README, CHECKING = ((ROOT / page).read_text(encoding="utf-8") for page in ("README.md", "docs/checking.md"))
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
    return simgrab_record("quay-day", SMALL, size=(480, 270), frames=3, seed=5)
"""


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("plugin") / "cache"


def outcomes_of(folder, tests, cache):
    """What becomes of each test, run by a pytest of its own: what its JUnit XML says of those that fail; its output."""
    (folder / "test_mine.py").write_text(tests)
    command = [sys.executable, "-m", "pytest", "-q", "--strict-markers", *LOADED, f"--simgrab-cache={cache}"]
    command += ["--junit-xml=junit.xml", "--simgrab-out=out"]
    done = subprocess.run(command, cwd=folder, capture_output=True, check=False, text=True)
    found = {"": done.stdout}
    for case in ElementTree.parse(folder / "junit.xml").iter("testcase"):
        found.setdefault(case.get("name"), "")
        found[case.get("name")] += "".join(problem.get("message") + (problem.text or "") for problem in case)
    return found


def marked(name, limit, body="    simgrab_judge(Still(), record)", fixtures="simgrab_judge, record"):
    return f"\n\n@pytest.mark.simgrab_limit({limit})\ndef test_{name}({fixtures}):\n{body}\n"


LIMITS = OWN + "".join(
    [
        marked("holds", '"angle.overall.rmse_deg", upper=30'),
        marked("exceeded", '"angle.overall.rmse_deg", upper=0.01'),
        marked("misspelt_metric", '"angle.overall.rsme_deg", upper=9', "    raise AssertionError('measured in vain')"),
        marked("misspelt_end", '"angle.overall.rmse_deg", uper=9'),
        marked("slack", '"angle.overall.rmse_deg", upper=9, slack=0.1'),
        marked("nameless", '"angle.overall.rmse_deg", upper=9', "    simgrab_judge(lambda frames, camera: [], record)"),
        marked("never_judged", '"angle.overall.rmse_deg", upper=9', "    pass"),
        marked("without_the_fixture", '"angle.overall.rmse_deg", upper=9', "    pass", "record"),
    ]
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("limits")


@pytest.fixture(scope="module")
def outcomes(folder, cache):
    return outcomes_of(folder, LIMITS, cache)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("exceeded", r"angle.overall.rmse_deg: [\d.]+ misses the limit ≤ 0.01"),
        ("misspelt_metric", "did you mean 'angle.overall.rmse_deg'"),
        ("misspelt_end", "uper"),
        ("slack", "slack is for baselines"),
        ("nameless", "InstrumentError: simgrab_judge: has no name"),
        ("never_judged", "nothing was measured"),
        ("without_the_fixture", "needs the fixture simgrab_judge"),
    ],
)
def test_limits_that_do_not_hold_fail(name, message, outcomes):
    assert re.search(message, outcomes[f"test_{name}"])


def test_limits_that_hold_pass(outcomes):
    assert outcomes["test_holds"] == ""


def test_a_loose_limit_is_warned_of_and_a_failure_names_its_cause_and_its_page(outcomes, folder):
    (warning,) = re.findall(r".*test_mine.py:\d+: UserWarning: quay-day: warning: too loose.*", outcomes[""])
    assert "angle.overall.rmse_deg ≤ 30" in warning
    (page,) = set(re.findall(r"page: (.*/check\.html)", outcomes["test_exceeded"]))
    assert "The measured angle hardly follows the swing" in outcomes["test_exceeded"]
    assert "hardly follows the swing" in (folder / page).read_text()


SUITE = {
    "instrument": "test_mine:Still",
    "size": "480x270",
    "changes": ast.literal_eval(SMALL.strip()),
    "limits": {"angle.overall.rmse_deg": {"upper": 30}},
    "scenes": {"day": {"scene": "quay-day", "frames": 3, "seed": 5}},
}


@pytest.mark.usefixtures("outcomes")  # whose run rendered the record
def test_a_suite_is_checked_with_its_baseline(tmp_path, cache):
    for name in ("small", "bare"):
        (tmp_path / f"{name}.toml").write_text(tomli_w.dumps(SUITE | {"name": name}))
    recorded = tmp_path / "baselines" / "small" / "baseline.json"
    recorded.parent.mkdir(parents=True)
    other = {"suite": "other", "instrument": "still", "simgrab": baseline.version(), "seeds": [0], "scenes": {}}
    recorded.write_text(json.dumps(other))
    tests = "def test_it(simgrab_check): simgrab_check('small.toml')\n"
    tests += "def test_bare(simgrab_check): assert simgrab_check('bare.toml').passed\n"
    found = outcomes_of(tmp_path, OWN + tests, cache)
    assert "baseline: out of date: recorded for the suite 'other'" in found["test_it"]
    assert found["test_bare"] == ""
    assert "no baseline to compare with" in found[""]
    assert len(list(cache.glob("*/manifest.json"))) == 1


KEPT = OWN + (
    "def test_it(record):\n"
    "    pictures = [frame.picture for frame in record.frames]\n"
    "    assert [p.shape for p in pictures] == 3 * [(270, 480, 3)]\n"
    "    assert (next(iter(record.frames)).picture == pictures[0]).all()\n"
    "    assert len(record.truth) == 3 and record.truth[0].seed == 5\n"
    "    assert record.calibration.width_px == 480\n"
)


@pytest.mark.usefixtures("outcomes")  # whose run rendered the record
def test_frames_and_truth_are_kept_between_runs_and_the_documented_example_works(tmp_path, cache):
    codes = re.findall(r"```python\n(.*?)```", README + CHECKING, re.DOTALL)
    (example,) = (code for code in codes if "simgrab_record" in code)
    (mine,) = (code for code in codes if "class Mine" in code)
    # Smaller pictures, for time's sake.
    example = example.replace('"calm-day", ', '"calm-day", SMALL, ')
    assert "SMALL" in example
    (tmp_path / "mine.py").write_text(mine)
    (tmp_path / "test_example.py").write_text(f"SMALL = {SMALL}\n{example}")
    (made,) = cache.glob("*/manifest.json")
    before = made.stat().st_mtime_ns
    found = outcomes_of(tmp_path, KEPT, cache)
    assert found.pop("test_it") == ""
    found.pop("")
    (exceeded,) = filter(None, found.values())  # the example's answer is constant
    assert re.search(r"angle.overall.rmse_deg: [\d.]+ misses the limit ≤ 0.8", exceeded)
    assert len(found) == 2
    assert made.stat().st_mtime_ns == before
