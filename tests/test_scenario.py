import itertools
import json
import math
import re
import tomllib

import msgspec
import numpy as np
import pytest

import simgrab
from simgrab.errors import ScenarioError
from simgrab.io.resources import SCENES
from simgrab.io.strict import convert
from simgrab.model import scenes
from simgrab.model.distributions import Choice
from simgrab.model.scenario import Scenario, merged, schema, vary
from simgrab.model.scenario.whole import difference

BAD = [
    ("camera.betta_deg", 1.0, "did you mean 'beta_deg'"),
    ("camera.beta_deg", 95.0, "<= 30"),
    ("camera.beta_mrad", 5.0, "valid here: .*beta_deg"),
    ("camera.offset_y_m", math.nan, "finite"),
    ("camera.height_px", 1080.5, "a whole number, got 1080.5"),
    ("camera.distortion.k1", -0.99, "not invertible"),
    ("swing.alpha.sigma_deg", -2.0, ">= 0"),
    ("swing.alpha.law.dist", "cauchy", "one of: half-normal"),
    ("swing.alpha.law", {"dist": "constant", "value": 0.0}, "sigma_deg = 0"),
    ("swing.alpha", {"law": {"dist": "rayleigh", "scale": 1e-200, "high": 1.0}}, "sigma_deg = 0"),
    ("swing.rope_length_mm", 8000, "rope_length_m"),
    ("swing.rope_length_m", {"dist": "normal", "mean": 15.0}, "stay within"),
    ("swing.load", {"dist": "constant", "value": 2.0}, "stay within"),
    ("swing.jaw_deg", {"dist": "choice", "values": []}, "length >= 1"),
    ("swing.gamma_deg", {"dist": "uniform", "low": 5.0, "high": 1.0}, "exceed"),
    ("swing.gamma_deg", {"dist": "normal", "low": 2.0, "high": 1.0}, "low must lie below high"),
    ("swing.gamma_deg", {"dist": "normal", "low": 50.0}, "almost no probability"),
    ("swing.gamma_deg", {"dist": "normal", "sd": 0.0, "low": 1.0}, "with sd = 0 the mean must lie in"),
    ("swing.gamma_deg", {"dist": "choice", "values": [1.0], "weights": [1.0, 2.0]}, "1 values need as many weights"),
    ("swing.gamma_deg", {"dist": "choice", "values": [1.0], "weights": [0.0]}, "one weight must be above 0"),
    ("swing.model", "iidd", "did you mean 'iid'"),
    ("place.model", "moon", "quay, hold, water, plain"),
    ("place", {"model": "hold", "receiver": "truck"}, "unknown key"),
    ("light", {"sun": 0.0, "sky": 0.0}, "all be 0"),
    ("display.layout", "twobyfour", "one of: none, four-point-four, two-by-four, or a layout's table"),
    ("display.start", "2022-02-29T14:05:37", "local date and time such as"),
    ("display.readout_s", 0.21, "exceed the 0.2 s"),
    ("splits.train", 0.5, "must be 1"),
    ("image.format", "gif", "must be one of: jpeg, png; got 'gif'"),
    ("seed", -1, ">= 0"),
    ("frames", 0, ">= 1"),
    ("frames.count", 3, "a whole number, got"),
    ("name", "a b", "regex"),
    ("grab.paint_rgb", [1.0, 2.0], "length 3"),
    ("display.start", "2022-01-26T14:05:37Z", "local"),
    ("display.start", "noon", "such as 2022"),
    ("display.start", "9999-12-31T23:59:59", "year 9999"),
    ("light", {"floodlights": 0.3}, "for the night"),
    ("camera.mount", {"model": "fixed", "vibration": {"rms_deg": 0.1}}, "independent frames have no time"),
    ("suspension.model", "double-pendulum", "independent frames cannot have it"),
    ("swing", {"model": "dynamic", "work": {"model": "cycles", "carry_rope_m": 24.0}}, "not be above dig_rope_m"),
    ("swing", {"model": "dynamic", "work": {"model": "hang", "jaw_deg": 95.0}}, "jaw_deg: .*<= 90"),
    ("swing.clamp", ["x"], "of: jaw_deg, rope_length_m; got"),
    ("swing.clamp", "jaw_deg", "of: jaw_deg, rope_length_m; got"),
    ("shutter.exposure_s", 0.2, "longer than a frame"),
    ("optics.sensor.read_noise_e", 3.0, "needs full_well_e, the electron count of white"),
    ("optics.sensor.full_well_e", 5.0, "full_well_e must be 0 .* or at least 100"),
    ("optics.night_mode", "auto", "needs exposure.model"),
    ("optics", {"night_mode": "auto", "exposure": {"model": "auto", "max_gain_db": 12.0}},
     r"night_gain_db \(18\) is never reached: exposure.max_gain_db is 12"),
    ("optics.exposure", {"model": "fixed", "lag_s": 1.0}, "optics.exposure.lag_s"),
    ("weather", {"rain_mm_h": 5.0, "snow_mm_h": 4.0}, "heavy snow falls without rain"),
    ("weather.fog", 1.0, "fog"),
    ("weather", {"lens_dirt": 0.7, "lens_snow": 0.5}, "cover the same glass"),
    ("weather.wetness", 1.5, "wetness"),
]  # fmt: skip


@pytest.mark.parametrize(("key", "value", "message"), BAD)
def test_bad_input_is_refused_by_its_key(key, value, message):
    with pytest.raises(ScenarioError, match=message) as caught:
        scenes.load("quay-day", {key: value})
    assert key.split(".")[0] in str(caught.value)
    assert "\n" not in str(caught.value)


JAWS = {"dist": "choice", "values": [0.0, 42.0]}  # quay-day's have weights


@pytest.mark.parametrize(
    "changes",
    [{"swing.jaw_deg": JAWS}, {"swing.jaw_deg.values": [0.0, 42.0], "swing.jaw_deg.dist": "choice"},
     {"clip.clip_frames": 1, "vary": {"swing.jaw_deg": {"dist": "one-of", "values": [JAWS]}}}],
)  # fmt: skip
def test_a_table_with_dist_takes_nothing_over(tmp_path, changes):
    (tmp_path / "scene.toml").write_text('base = "quay-day"\nswing.jaw_deg = { dist = "choice", values = [0, 42] }')
    for scene in (scenes.load("quay-day", changes), scenes.load(tmp_path / "scene.toml")):
        assert vary.variant(scene, 0).scenario.swing.jaw_deg == Choice((0.0, 42.0))


def test_keys_of_another_kind_are_set_in_any_order():
    changes = {"place.model": "hold", "place.cargo": "ore"}
    assert scenes.load("quay-day", changes) == scenes.load("quay-day", dict(reversed(changes.items())))


@pytest.mark.parametrize("name", scenes.names())
def test_every_bundled_scene_reads_and_survives_the_round_trip(name):
    scenario = scenes.load(name)
    assert scenario.name == name
    assert scenario.description
    assert convert(tomllib.loads(scenario.to_toml()), Scenario) == scenario
    assert convert(json.loads(json.dumps(scenario.to_dict())), Scenario) == scenario
    assert (SCENES / f"{name}.toml").read_text().startswith("#:schema schema.json\n")


def test_the_schema_file_is_current():
    assert json.loads((SCENES / "schema.json").read_text()) == json.loads(msgspec.json.encode(schema()))


def test_every_key_of_the_schema_is_described():
    keys = [key for table in schema()["$defs"].values() for key in table.get("properties", {}).values()]
    assert all(key["description"].endswith(".") for key in keys)


def test_digest_sees_every_change_and_nothing_else():
    scene = scenes.load("quay-day")
    assert scene.digest() == scenes.load("quay-day").digest()
    for changes in ({"seed": 1}, {"frames": 65}, {"camera.roll_deg": 1e-9}, {"swing.alpha.sigma_deg": 2.0000001}):
        assert scenes.load("quay-day", changes).digest() != scene.digest()


@pytest.mark.parametrize(("key", "usual", "other"), [
    ("suspension", {"model": "one-body"}, {"model": "four-rope"}), ("markers", {}, {"target": {}}),
    ("sensors", {}, {"imu0": {"model": "imu", "mount": "grab"}}), ("labels.yolo", "box", "pose"),
    ("display.font", {"model": "bundled"}, {"model": "generated"}), ("optics.sharpening", {}, {"amount": 1.0}),
    ("optics.white_balance", [1.0, 1.0, 1.0], [1.2, 1.0, 1.0]),
])  # fmt: skip
def test_a_key_that_came_later_is_written_and_digested_only_where_it_is_not_as_before(key, usual, other):
    assert scenes.load("quay-day").digest().startswith("a6c89a281ab7")
    before = scenes.load("free-swing")
    assert vary.at(before.to_dict(), key) is None
    assert scenes.load("free-swing", {key: usual}).digest() == before.digest()
    assert scenes.load("free-swing", {key: other}).digest() != before.digest()


def test_sigma_is_the_rms_of_every_law():
    for law in ({"dist": "half-normal"}, {"dist": "uniform", "low": 0.0, "high": 5.0}, {"dist": "exponential"}):
        alpha = scenes.load("quay-day", {"swing.alpha": {"sigma_deg": 3.0, "law": law}}).swing.alpha
        assert alpha.scale_deg * alpha.law.rms() == pytest.approx(3.0)


def test_set_takes_toml_values():
    changes = scenes.parse_changes(["camera.beta_deg=4", "place.model=hold", 'image.format = "png"', "image.ids=true"])
    assert changes == {"camera.beta_deg": 4, "place.model": "hold", "image.format": "png", "image.ids": True}
    date = scenes.parse_changes(["display.start=2022-01-26T14:05:38"])  # without quotes
    scene = scenes.load("quay-day", changes | date)
    assert (scene.place.depth_m, scene.display.start) == (15.0, "2022-01-26T14:05:38")
    factors = scenes.parse_changes(
        [f'vary."camera.{key}_deg"={{dist="uniform",low=1,high=7}}' for key in ("beta", "roll")]
    )
    assert {"camera.beta_deg", "camera.roll_deg"} <= set(scenes.load("training", factors).vary)
    for broken in ("camera.beta_deg", "=3", "camera.beta_deg="):
        with pytest.raises(ScenarioError, match="key=value"):
            scenes.parse_changes([broken])


def test_another_kind_replaces_a_table_whole():
    assert merged({"a": {"model": "x", "p": 1}}, {"a": {"model": "y"}}) == {"a": {"model": "y"}}
    assert merged({"a": {"model": "x", "p": 1}}, {"a": {"q": 2}}) == {"a": {"model": "x", "p": 1, "q": 2}}


def test_a_difference_merges_to_the_whole():
    weighted = {"dist": "choice", "values": [0, 42], "weights": [3, 1]}
    laws = [
        weighted, {"dist": "choice", "values": [0, 42]}, {"dist": "choice", "values": [1], "weights": [2]},
        {"dist": "normal", "mean": 1.0, "sd": 1.0}, {"dist": "normal", "mean": 2.0},
    ]  # fmt: skip
    for old, new in itertools.permutations(laws, 2):
        base, whole = ({"a": {"law": law, "b": 1}} for law in (old, new))
        assert merged(base, difference(base, whole)) == whole
    null = {"law": weighted | {"weights": None}}
    assert merged({"law": weighted}, difference({"law": weighted}, null)) == {"law": laws[1]}


def test_files_may_name_one_base(tmp_path):
    own = tmp_path / "own.toml"
    own.write_text('base = "quay-day"\nname = "own"\n[camera]\nbeta_deg = 7.0\n')
    scenario = scenes.load(own)
    assert (scenario.name, scenario.camera.beta_deg) == ("own", 7.0)
    assert scenario.swing == scenes.load("quay-day").swing
    own.write_text('base = "heavy-snow"\nname = "own"\n[weather]\nsnow_mm_h = 1.0\n')
    snow, heavy = scenes.load(own), scenes.load("heavy-snow")
    assert (snow.weather.snow_mm_h, snow.weather.snow_cover) == (1.0, heavy.weather.snow_cover)
    assert snow.swing == scenes.load("quay-day").swing  # the base of its base
    for text, message in (
        ('base = "nowhere"', "no bundled scene"), ("beta = [", "TOML"), ("camera.beta = 3", "beta_deg"),
    ):  # fmt: skip
        own.write_text(text)
        with pytest.raises(ScenarioError, match=message):
            scenes.load(own)


def test_unknown_scenes_are_named(tmp_path):
    with pytest.raises(ScenarioError, match="did you mean 'quay-day'"):
        scenes.load("quay-dya")
    (tmp_path / "own.toml").write_text('name = "own"')
    with pytest.raises(ScenarioError, match=r"no scene or file .*\(did you mean '.*own\.toml'\?\)"):
        scenes.load(tmp_path / "own")
    (tmp_path / "manifest.json").write_text("{}")
    with pytest.raises(ScenarioError, match="not a simgrab manifest"):
        scenes.load(tmp_path / "manifest.json")


def test_a_path_opens_the_file_of_that_name(tmp_path, monkeypatch):
    """And not the one beside it that ends in .toml, as the bundled ones do."""
    (tmp_path / "mine").write_text('name = "mine"')
    (tmp_path / "mine.toml").write_text('name = "other"')
    monkeypatch.chdir(tmp_path)
    for path in ("mine", "./mine", str(tmp_path / "mine"), tmp_path / "mine"):
        assert scenes.load(path).name == "mine"
    with pytest.raises(ScenarioError, match="no scene or file"):
        scenes.load("../scenes/calm-day")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((None,), "a scene is a name or a path, got NoneType"),
        (("quay-day", ["frames=3"]), "changes must be a mapping from dotted keys to values, got list"),
    ],
)
def test_what_is_no_scene_is_refused_in_words(arguments, message):
    with pytest.raises(ScenarioError, match=re.escape(message)):
        simgrab.load(*arguments)


def test_a_scene_is_loaded_at_another_size_with_the_same_view():
    full, small = simgrab.load("quay-day"), simgrab.load("quay-day", {"frames": np.int64(3)}, size=(640, 360))
    assert (small.camera.width_px, small.camera.height_px, small.frames) == (640, 360, 3)
    assert small.camera.intrinsics.f_px == pytest.approx(full.camera.intrinsics.f_px / 3)
