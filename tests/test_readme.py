"""What the README says is so."""

import os
import re
import shlex
import tomllib
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from scripts.make_tables import filled
from simgrab import calibration
from simgrab.calibration import Calibration
from simgrab.cli import cli
from simgrab.errors import SuiteError
from simgrab.instrument.contract import Frame, Measurement
from simgrab.judge.check.suite import Suite
from simgrab.scenario import Scenario, merged
from simgrab.scenes import load
from simgrab.strict import convert

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


INSTRUMENT = (ROOT / "docs" / "instrument.md").read_text(encoding="utf-8")


def blocks(language, text=README):
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


def test_tables_are_current():
    assert filled(README) == README


def test_commands_parse():
    lines = [line.split("#")[0] for block in blocks("bash") for line in block.splitlines() if line.strip()]
    verbs = [shlex.split(line) for line in lines]
    assert verbs[0][:2] == ["scripts/simgrab", "render"]
    assert verbs[1] == ["scripts/test"]
    for program, *arguments in verbs:
        if program == "scripts/simgrab":
            assert CliRunner().invoke(cli, [*arguments, "--help"]).exit_code == 0
        elif "/" in program:
            assert os.access(ROOT / program, os.X_OK)


def test_options_named_in_the_table_exist():
    for row in re.findall(r"^\| `simgrab (\w+)([^|]*(?:\\\|[^|]*)*)` \|", README, re.MULTILINE):
        verb, rest = row
        sub = re.findall(r"^ ([a-z]+) ", rest)  # as in `train detector`
        help_text = CliRunner().invoke(cli, [verb, *sub, "--help"]).output
        for option in re.findall(r"--[a-z-]+", rest):
            assert option in help_text, (verb, option)


def test_scene_files_and_suites_read():
    for block in blocks("toml"):
        data = tomllib.loads(block)
        if "scenes" in data:
            assert set(convert(data, Suite, SuiteError).scenes) == {"calm", "snow"}
            continue
        base = load(data.pop("base"))
        assert convert(merged(base.to_dict(), data), Scenario).name == data["name"]


def test_linked_files_exist():
    for target in re.findall(r"\]\(((?!https?:)[^)#]+)\)", README):
        assert (ROOT / target).exists(), target


def test_code_runs_as_far_as_it_needs_no_drawing():
    code = next(block for block in blocks("python") if "import simgrab" in block)
    space = {"__name__": "imported"}
    exec(code, space)
    assert space["scene"].camera.beta_deg == 5.0


@pytest.mark.parametrize("script", ["scripts/simgrab", "scripts/test", ".ci/run"])
def test_scripts_are_executable(script):
    assert os.access(ROOT / script, os.X_OK)


@pytest.mark.parametrize("kind", [Measurement, Calibration])
def test_the_instruments_page_names_every_field(kind):
    assert [name for name in kind.__struct_fields__ if f"`{name}`" not in INSTRUMENT] == []


def test_the_instruments_page_holds_a_camera_that_loads(tmp_path):
    (block,) = blocks("toml", INSTRUMENT)
    (tmp_path / "camera.toml").write_text(block, encoding="utf-8")
    assert calibration.load(tmp_path / "camera.toml").digit_layout.digit_height_px == 34


def test_the_instruments_page_holds_instruments_that_measure():
    frames = [Frame(np.zeros((540, 960, 3), np.uint8), 0.0), Frame(None, 1.0, "dropped")]
    camera = Calibration(width_px=960, height_px=540, focal_length_px=800.0, cx_px=480.0, cy_px=270.0)
    told = []
    for block in blocks("python", INSTRUMENT):
        names = {}
        exec(block, names)
        make = names["mine"] if "mine" in names else names["Mine"]
        told.append([m.status for m in make()(frames, camera)])
    assert told == [["ok", "lost"], ["missed", "lost"]]
