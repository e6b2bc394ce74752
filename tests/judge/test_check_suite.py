"""Suites are strict, and those that are bundled can be."""

import re

import numpy as np
import pytest
import tomli_w

import simgrab
from simgrab.errors import SuiteError
from simgrab.judge.check import suite
from simgrab.world.trajectory import iid

GOOD = {"name": "mine", "scenes": {"calm": {"scene": "quay-day", "frames": 4}}}


def put(folder, **changes):
    path = folder / "mine.toml"
    path.write_text(tomli_w.dumps(GOOD | changes))
    return path


@pytest.mark.parametrize("name", ["suites", "\udcff\udcfe"], ids=["text", "no text"])
def test_a_suite_is_read_and_finds_what_lies_beside_it(name, tmp_path):
    tmp_path = tmp_path / name
    tmp_path.mkdir()
    (tmp_path / "own.toml").write_text('base = "quay-day"\nname = "own"\nframes = 5\n')
    scenes = {"own": {"scene": "own.toml", "changes": {"camera.beta_deg": 7.0}}}
    found = suite.load(put(tmp_path, seed=9, scenes=scenes, changes={"camera.beta_deg": 1.0, "camera.roll_deg": 2.0}))
    scenario = found.scenario("own")
    assert (scenario.name, scenario.frames) == ("own", 5)
    assert (scenario.camera.beta_deg, scenario.camera.roll_deg) == (7.0, 2.0)
    assert found.baseline == str(tmp_path / "baselines" / "mine")


def test_each_scene_has_draws_of_its_own(tmp_path):
    calm = GOOD["scenes"]["calm"]
    scenes = {"calm": calm, "again": calm, "stated": calm | {"seed": 7}, "the same": calm | {"seed": 7}}
    found = suite.load(put(tmp_path, seed=9, scenes=scenes))
    seeds = {(name, seed): found.scenario(name, seed).seed for name in scenes for seed in (9, 10)}
    assert seeds["stated", 9] == seeds["the same", 9] == 7
    assert len(set(seeds.values())) == 7
    assert not {9, 10} & set(seeds.values())
    assert seeds["calm", 9] == found.scenario("calm").seed
    assert found.scenario("calm", 0) == suite.load(put(tmp_path, seed=0, scenes={"calm": calm})).scenario("calm")


def test_a_size_is_that_of_a_smaller_picture_of_the_same_view(tmp_path):
    calm = GOOD["scenes"]["calm"]
    found = suite.load(put(tmp_path, size="640x360", scenes={"calm": calm, "wide": calm | {"size": "960x360"}}))
    assert found.scenario("calm") == simgrab.load(
        "quay-day", {"seed": found.scenario("calm").seed, "frames": 4}, size=(640, 360)
    )
    camera = found.scenario("wide").camera
    assert (camera.width_px, camera.height_px) == (960, 360)


def test_limits_of_a_scene_win(tmp_path):
    scenes = {"calm": GOOD["scenes"]["calm"] | {"limits": {"alarm.missed": {"upper": 2}}}}
    found = suite.load(put(tmp_path, limits={"alarm.missed": {"upper": 1}, "frames.ok": {"lower": 0}}, scenes=scenes))
    limits = {name: str(limit) for name, limit in found.limits_of("calm").items()}
    assert limits == {"alarm.missed": "≤ 2", "frames.ok": "≥ 0"}


def scene(**changes):
    return {"scenes": {"calm": GOOD["scenes"]["calm"] | changes}}


BAD = {
    "unknown key": ({"sede": 1}, "sede: unknown key (did you mean 'seed'?)"),
    "no scenes": ({"scenes": {}}, "a suite needs scenes"),
    "unknown scene": (scene(scene="quay-dya"), "scenes.calm: no scene or file 'quay-dya' (did you mean 'quay-day'?)"),
    "unknown change": (scene(changes={"camera.betta_deg": 1}), "scenes.calm: camera.betta_deg: unknown key"),
    "seed as a change": (scene(changes={"seed": 1}), "set scenes.calm.seed or at the top of the suite instead"),
    "frames as a change": ({"changes": {"frames": 1}}, "frames: set scenes.calm.frames instead"),
    "size without height": ({"size": "640"}, "scenes.calm: size must be WIDTHxHEIGHT in pixels"),
    "size below the least": (scene(size="8x8"), "scenes.calm: camera.width_px"),
    "limit without ends": ({"limits": {"a": {"slack": 1}}}, "limits.a: a limit needs lower, upper or both"),
    "slack of a text": ({"limits": {"a": {"upper": 1, "slack": "20"}}}, "limits.a: slack: must be a number or a share"),
    "slack below 0": ({"limits": {"a": {"upper": 1, "slack": -1}}}, "limits.a.slack: "),
    "limit upside down": ({"limits": {"a": {"lower": 2, "upper": 1}}}, "limits.a: lower (2) must not be above upper"),
    "unknown metric": (
        {"limits": {"angle.overall.rmse_dge": {"upper": 1}}},
        "limits: no metric 'angle.overall.rmse_dge' (did you mean 'angle.overall.rmse_deg'?)",
    ),
    "golden frame beyond": (scene(golden=[4]), "scenes.calm.golden: there is no frame 4; the scene has 4"),
    "camera that varies": (scene(scene="training", frames=16), "scenes.calm: camera.beta_deg, "),
}


@pytest.mark.parametrize("case", BAD)
def test_a_broken_suite_is_reported_by_key(case, tmp_path):
    changes, message = BAD[case]
    with pytest.raises(SuiteError, match=re.escape(message)) as problem:
        suite.load(put(tmp_path, **changes))
    assert str(problem.value).startswith(str(tmp_path))
    assert "\n" not in str(problem.value)
    assert "got {" not in str(problem.value)


def test_an_invalid_scene_file_is_named(tmp_path):
    (tmp_path / "yard.toml").write_text('base = "quay-day"\nname = "yard"\n[camera]\nbeta_dg = 3.0\n')
    place = f"{tmp_path}/mine.toml: scenes.calm: "
    with pytest.raises(SuiteError, match=rf"^{place}{tmp_path}/yard.toml: camera.beta_dg: unknown key"):
        suite.load(put(tmp_path, **scene(scene="yard.toml")))
    (tmp_path / "yard.toml").write_text('base = "quay-day"\nname = "yard"\n')
    with pytest.raises(SuiteError, match=rf"^{place}camera.betta_deg: unknown key"):
        suite.load(put(tmp_path, **scene(scene="yard.toml", changes={"camera.betta_deg": 1})))


def test_a_scene_whose_name_no_file_can_have_is_refused(tmp_path):
    with pytest.raises(SuiteError, match=r"cannot read .*: File name too long"):
        suite.load(put(tmp_path, **scene(scene="x" * 5000)))


def test_a_misspelt_suite_is_refused_with_the_nearest_name():
    with pytest.raises(SuiteError, match="did you mean 'smoke'"):
        suite.load("smok")


@pytest.mark.parametrize("name", suite.names())
def test_bundled_suites_can_be(name):
    found = suite.load(name)
    assert found.name == name
    assert found.instrument == "bundled"
    assert found.description
    assert all(found.limits_of(scene) for scene in found.scenes)


@pytest.mark.parametrize("name", ["smoke", "weather"])
def test_a_constant_answer_fails_each_scene_of_a_bundled_suite(name):
    """The best one answers the mean, and its error is the standard deviation."""
    found = suite.load(name)
    for one in found.scenes:
        scenario = found.scenario(one)
        alpha = [iid.draw(scenario, frame).grab.alpha for frame in range(scenario.frames)]
        assert not found.limits_of(one)["angle.overall.rmse_deg"].holds(np.rad2deg(np.std(alpha)))


def test_there_are_the_suites_that_the_readme_names():
    assert {"smoke", "weather", "paper", "offset", "alarm"} <= set(suite.names())
