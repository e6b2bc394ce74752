"""What README and docs say is so."""

import importlib.util
import os
import re
import shlex
import sys
import tomllib
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner

import simgrab
from scripts import make_reference
from scripts.make_tables import DOCS, TABLES, filled
from simgrab.cli import cli
from simgrab.dataset.sensor_files import describe
from simgrab.errors import SuiteError
from simgrab.instrument.contract import Frame, Measurement, TakesSensors
from simgrab.instrument.controller_file import ControllerFacts
from simgrab.instrument.estimate.inertial.readings import FORCE, RATE, STAMP
from simgrab.instrument.pipeline import Pipeline
from simgrab.io.strict import convert
from simgrab.judge.check.suite import Suite
from simgrab.model import calibration
from simgrab.model.calibration import Calibration
from simgrab.model.scenario import IMU_CLASSES, Imu, ImuNoise, Scenario, merged
from simgrab.model.scenes import load

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]
TEXTS = {
    str(path.relative_to(DOCS if path.is_relative_to(DOCS) else ROOT)): path.read_text(encoding="utf-8")
    for path in PAGES
}
README, INSTRUMENT, OWN = TEXTS["README.md"], TEXTS["instrument.md"], TEXTS["own-pipeline.md"]


def blocks(language, text=README):
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


def commands(text):
    lines = [line.split(" #")[0] for block in blocks("bash", text) for line in block.splitlines() if line.strip()]
    return [shlex.split(line) for line in lines]


@pytest.mark.parametrize("page", TABLES)
def test_tables_are_current(page):
    assert filled(page) == TEXTS[page]


def test_the_page_of_keys_is_current():
    assert make_reference.scene_keys() == TEXTS["scene-keys.md"]


def test_two_commands_come_first():
    first, second, *_ = commands(README)
    assert first[:2] == ["scripts/simgrab", "render"]
    assert second == ["scripts/test"]


# Those of the tutorials are run (test_tutorials.py).
@pytest.mark.parametrize("page", [page for page in TEXTS if not page.startswith("tutorials/")])
def test_commands_parse(page):
    for program, *arguments in commands(TEXTS[page]):
        if program in ("scripts/simgrab", "simgrab"):
            assert CliRunner().invoke(cli, [*arguments, "--help"]).exit_code == 0
        elif "/" in program:
            assert os.access(ROOT / program, os.X_OK)
        assert program != "python"  # which lacks packages in a checkout
        if program == "scripts/python":
            assert importlib.util.find_spec(arguments[1])


def test_the_table_names_every_command():
    named = set(re.findall(r"^\| `simgrab (\w+)", TEXTS["commands.md"], re.MULTILINE))
    assert named == set(cli.list_commands(click.Context(cli)))


def test_scene_files_and_suites_read():
    found = [*blocks("toml"), *blocks("toml", TEXTS["writing-scenes.md"])]
    assert len(found) == 8
    for block in found:
        data = tomllib.loads(block)
        if "scenes" in data:
            assert set(convert(data, Suite, SuiteError).scenes) == {"calm", "snow"}
            continue
        font = data.get("display", {}).get("font", {})
        if font.get("model") == "file":  # it would lie beside the scene
            font |= {"file": Path(font["file"]).name, "sha256": "0" * 64}
        base = load(data.pop("base"))
        assert convert(merged(base.to_dict(), data), Scenario).name == data["name"]


@pytest.mark.parametrize("page", TEXTS)
def test_named_files_exist(page):
    for target in re.findall(r"`((?:scripts|simgrab|tests|assets|scenes)/[\w/.-]+)`", TEXTS[page]):
        assert (ROOT / target).exists(), target


def test_the_readme_names_every_page():
    assert {path.name for path in DOCS.glob("*.md")} == set(re.findall(r"\(docs/([\w-]+\.md)\)", README))


def anchors(page):
    """Anchors that GitHub makes of a page's headings."""
    heads = re.findall(r"^#+ (.+)$", re.sub(r"```.*?```", "", page, flags=re.DOTALL), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", head.lower()).replace(" ", "-") for head in heads}


@pytest.mark.parametrize("path", PAGES, ids=str)
def test_linked_files_and_headings_exist(path):
    for target, anchor in re.findall(r"\]\(((?!https?:)[^)#]*)(?:#([^)]+))?\)", path.read_text(encoding="utf-8")):
        page = path.parent / target if target else path
        assert page.exists(), target
        assert not anchor or anchor in anchors(page.read_text(encoding="utf-8")), f"{target}#{anchor}"


@pytest.mark.parametrize("page", sorted((DOCS / "tutorials").glob("*.md")), ids=lambda page: page.stem)
def test_tutorials_are_named_where_one_looks(page):
    assert page.stem == "index" or f"(docs/tutorials/{page.name})" in README
    assert page.stem == "index" or f"({page.name})" in TEXTS["tutorials/index.md"]
    assert f"tutorials/{page.name}" in (ROOT / "mkdocs.yml").read_text(encoding="utf-8")


def test_the_citation_names_this_version():
    assert f"\nversion: {simgrab.__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_the_results_index_names_every_result():
    results = DOCS / "results"
    named = set(re.findall(r"\(([\w-]+\.md)\)", (results / "index.md").read_text(encoding="utf-8")))
    assert {path.name for path in results.glob("*.md")} - {"index.md"} == named


def test_code_runs_as_far_as_it_needs_no_drawing():
    code = next(block for block in blocks("python") if "import simgrab" in block)
    space = {"__name__": "imported"}
    exec(code, space)
    assert space["scene"].camera.beta_deg == 5.0


@pytest.mark.parametrize(
    "script", ["scripts/simgrab", "scripts/python", "scripts/test", "scripts/docs", "scripts/check_package", ".ci/run"]
)
def test_scripts_are_executable(script):
    assert os.access(ROOT / script, os.X_OK)


@pytest.mark.parametrize("kind", [Measurement, Calibration])
def test_the_instruments_page_names_every_field(kind):
    assert [name for name in kind.__struct_fields__ if f"`{name}`" not in INSTRUMENT] == []


def test_the_instruments_page_holds_a_camera_that_loads(tmp_path):
    (block,) = blocks("toml", INSTRUMENT)
    (tmp_path / "camera.toml").write_text(block, encoding="utf-8")
    assert calibration.load(tmp_path / "camera.toml").digit_layout.digit_height_px == 34


def test_the_page_on_measuring_describes_a_controller():
    (block,) = blocks("toml", TEXTS["measuring.md"])
    facts = convert(tomllib.loads(block), ControllerFacts)
    assert facts.rope.constant_m == 2.5
    assert facts.luff.jib_m == 30


def test_the_page_on_sensors_records_what_it_says(capsys):
    (block,) = blocks("python", TEXTS["sensors.md"])
    exec(block, {})
    column, _, first = capsys.readouterr().out.split("\n", 1)[0].rpartition(" ")
    assert column == "a_RS_S_x [m s^-2]"
    assert 0 < abs(float(first)) < 3


def test_the_page_on_sensors_has_the_figures_of_each_class():
    rows = re.findall(r"^\| `(\w+)` \|[^|]*\| ([\d.e-]+)[^|]*\| ([\d.e-]+)", TEXTS["sensors.md"], re.MULTILINE)
    told = {key: (float(a), float(b)) for key, a, b in rows}
    named = [name for name in ImuNoise.__struct_fields__ if not name.startswith("clock_")]
    assert told == {key: tuple(getattr(IMU_CLASSES[name], key) for name in ("adis16448", "mems")) for key in named}


def test_the_page_on_own_pipelines_holds_instruments_that_measure(tmp_path):
    frames = [Frame(np.zeros((540, 960, 3), np.uint8), 0.0), Frame(None, 1.0, "dropped")]
    camera = Calibration(width_px=960, height_px=540, focal_length_px=800.0, cx_px=480.0, cy_px=270.0)
    readings = [f"{10_000_000 * i},0,0,0,0,0,-9.81" for i in range(3)]
    (tmp_path / "data.csv").write_text("\n".join([",".join((STAMP, *RATE, *FORCE)), *readings]) + "\n")
    (tmp_path / "sensor.yaml").write_text(describe(Imu(mount="camera"), np.eye(4), 0.0))
    found = []
    for block in blocks("python", OWN):
        names = {}
        exec(block, names)
        if "COMMAND" in names:
            lists = "import os, sys; [print(f'{name},2.5') for name in os.listdir(sys.argv[1]) if name.endswith('png')]"
            names["COMMAND"][:] = [sys.executable, "-c", lists]
        instrument = names.get("mine", names.get("Mine"))()
        found.append([m.status for m in instrument(frames, camera)])
        if isinstance(instrument, TakesSensors) and not isinstance(instrument, Pipeline):
            found.append([m.status for m in instrument.with_sensors({"imu0": tmp_path})(frames, camera)])
    measured, missed = ["ok", "lost"], ["missed", "lost"]
    assert found == [measured, measured, ["refused", "refused"], measured, missed, missed]
