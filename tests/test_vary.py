"""Factors: drawn by their laws, each from a stream of its own, and refused where they cannot be."""

import json
import re
import tomllib
from collections.abc import Mapping

import msgspec
import numpy as np
import pytest
import tomli_w
from conftest import slow_but, toml
from scipy import stats

from simgrab.errors import ScenarioError
from simgrab.io.strict import _fields as types_of
from simgrab.io.strict import _structs_of as structs_of
from simgrab.io.strict import convert
from simgrab.model import scenes
from simgrab.model.scenario import Hold, Plain, Scenario, merged, variant, variants, vary
from simgrab.model.scenario.vary import at, laid_over, nested

UNIFORM = {"dist": "uniform", "low": 1.0, "high": 5.0}
PLACES = {
    "dist": "one-of",
    "values": [{"model": "hold", "fill": 0.2}, {"model": "plain"}],
    "weights": [3.0, 1.0],
    "names": ["hold", "yard"],
}


def varied(frames=4000, clip_frames=2, vary=None, **changes):
    vary = {"camera.beta_deg": UNIFORM, "place": PLACES} if vary is None else vary
    return scenes.load(
        "quay-day", {"seed": 1, "frames": frames, "clip.clip_frames": clip_frames, "vary": vary} | changes
    )


def test_draws_follow_their_laws():
    every = [v for v, _ in variants(varied())]
    beta = [v.scenario.camera.beta_deg for v in every]
    assert stats.kstest(beta, stats.uniform(1, 4).cdf).pvalue > 0.01
    holds = sum(isinstance(v.scenario.place, Hold) for v in every)
    assert stats.binomtest(holds, len(every), 0.75).pvalue > 0.01
    assert holds + sum(isinstance(v.scenario.place, Plain) for v in every) == len(every) == 2000
    assert all(v.scenario.place.fill == 0.2 for v in every if isinstance(v.scenario.place, Hold))


def test_what_is_drawn_is_recorded_by_name_or_value():
    one = variant(varied(), 7)
    assert one.number == 3
    drawn = json.loads(one.varied)
    assert drawn["camera.beta_deg"] == one.scenario.camera.beta_deg
    assert drawn["place"] == ("hold" if isinstance(one.scenario.place, Hold) else "yard")


def test_a_table_may_be_drawn_less_often_than_each_clip():
    often, seldom = varied(frames=48), varied(frames=48, every={"place": 12, "camera": 4})
    drawn = [[variant(scenario, frame).drawn for frame in range(48)] for scenario in (often, seldom)]
    for key, frames in (("place", 12), ("camera.beta_deg", 4)):
        # Draw k of a level is draw k of a clip.
        assert [one[key] for one in drawn[1]] == [drawn[0][2 * (frame // frames)][key] for frame in range(48)]
    assert [variant(seldom, frame).draws.place for frame in (0, 11, 12, 47)] == [0, 0, 1, 3]
    assert [variant(seldom, frame).number for frame in (0, 11, 12, 47)] == [0, 5, 6, 23]


@pytest.mark.parametrize(
    ("every", "message"),
    [
        ({"grab": 8}, "every.grab: nothing of this table varies; camera, place does"),
        ({"place": 9}, "every.place: must be a multiple of clip.clip_frames (2), got 9"),
        ({"place": 12, "camera": 8}, "every.place: must be a multiple of every.camera (8), got 12"),
        ({"place": 0}, "every"),
    ],
)
def test_levels_that_cannot_be_are_refused(every, message):
    with pytest.raises(ScenarioError, match=re.escape(message)):
        varied(every=every)


def test_a_frame_alone_is_the_frame_of_the_whole():
    scenario = varied(frames=40)
    whole = {frame: v for v, span in variants(scenario) for frame in span}
    assert list(whole) == list(range(40))
    assert all(variant(scenario, frame) == whole[frame] for frame in (39, 0, 17))
    assert variant(varied(frames=400), 39) == msgspec.structs.replace(
        whole[39], scenario=msgspec.structs.replace(whole[39].scenario, frames=400)
    )


def test_another_factor_changes_no_other():
    scenario = varied(frames=40)
    more = varied(frames=40, vary={"grab.wear": {"dist": "uniform", "low": 0, "high": 1}, **scenario.to_dict()["vary"]})
    for a, b in zip(variants(scenario), variants(more), strict=True):
        assert a[0].drawn.items() < b[0].drawn.items()


def test_the_order_of_factors_does_not_matter():
    """Manifests and digests sort keys; a table goes before the keys in it."""
    hold = {"dist": "one-of", "values": [{"model": "hold", "fill": 0.1}]}
    factors = {"place.fill": UNIFORM | {"low": 0.5, "high": 0.6}, "place": hold}
    # Alone, place.fill would not fit the quay of the base; so the base has a hold.
    scenes_of = [
        scenes.load("hold-coal", {"frames": 8, "clip.clip_frames": 2, "vary": dict(order)})
        for order in (factors.items(), reversed(factors.items()))
    ]
    a, b = scenes_of
    assert [v.scenario.place for v, _ in variants(a)] == [v.scenario.place for v, _ in variants(b)]
    assert all(0.5 <= v.scenario.place.fill <= 0.6 for v, _ in variants(a))


def test_keys_joined_are_drawn_together():
    values = [{"light": {"sun": 0.0, "floodlights": 0.5}, "weather": {"rain_mm_h": 3.0}}, {"light": {}, "weather": {}}]
    for one, _ in variants(varied(frames=40, vary={"light+weather": {"dist": "one-of", "values": values}})):
        assert (one.scenario.light.floodlights > 0) == (one.scenario.weather.rain_mm_h > 0)


def test_a_variant_varies_no_more():
    one = variant(varied(), 0).scenario
    assert one.vary == {}
    assert variant(one, 9) == variant(one, 0)


def test_without_factors_the_variant_is_the_scenario():
    scenario = scenes.load("quay-day")
    assert variant(scenario, 63).scenario is scenario
    assert (variant(scenario, 63).number, variant(scenario, 63).varied) == (0, "")
    assert [span for _, span in variants(scenario)] == [range(scenario.frames)]


@pytest.mark.parametrize(
    ("key", "factor", "message"),
    [
        ("camera.betta_deg", UNIFORM, "did you mean 'beta_deg'"),
        ("camera.beta_deg", UNIFORM | {"high": 40.0}, "<= 30.0, got 40.0"),
        ("camera.beta_deg", UNIFORM | {"low": "1"}, "must be a number"),
        ("camera.beta_deg", UNIFORM | {"dist": "unifrom"}, "did you mean 'uniform'"),
        ("weather.lens_drops", UNIFORM, "must be a whole number"),
        ("grab.cargo", {"dist": "one-of", "values": ["coal", "cole"]}, "'cole'"),
        ("grab.cargo", {"dist": "one-of", "values": ["coal", "ore"], "weights": [1]}, "2 values need as many weights"),
        ("grab.cargo", {"dist": "one-of", "values": ["coal", "ore"], "names": ["a", "a"]}, "names must differ"),
        ("place+light", {"dist": "one-of", "values": [{"place": {"model": "hold"}}]}, "keys place, light"),
        ("labels.least_visible_fraction", UNIFORM, "cannot vary"),
        ("clip.frame_rate_hz", UNIFORM, "cannot vary"),
        ("camera", {"dist": "one-of", "values": [{"width_px": 640}]}, "camera.width_px: cannot vary"),
        ("swing", {"dist": "one-of", "values": [{"model": "dynamic"}]}, "swing.model: cannot vary"),
        ("camera.distortion.k1", UNIFORM | {"low": -0.9, "high": 0.0}, "is not invertible"),
    ],
)  # fmt: skip
def test_factors_that_cannot_be_are_refused_when_read(key, factor, message):
    with pytest.raises(ScenarioError) as caught:
        varied(vary={key: factor})
    assert caught.value.key.startswith(f"vary.{key}")
    assert message in caught.value.problem
    assert ('dist = "one-of"' in caught.value.problem) == (key == "weather.lens_drops")  # a cure where it would help


@pytest.mark.parametrize(
    ("key", "values"),
    [
        ("grab.drive", ["ropes", "hydraulic"]), ("grab.tines", [3, 5]), ("weather.lens_drops", [0, 3]),
        ("grab.ladder", [False, True]), ("grab.paint_rgb", [[1.0, 0.0, 0.0]]), ("weather", [{"rain_mm_h": 3.0}]),
    ],
)  # fmt: skip
def test_a_choice_among_other_than_decimal_numbers_is_refused_with_a_cure(key, values):
    def load(dist):
        return varied(vary={key: {"dist": dist, "values": values}}, **{"grab.model": "orange-peel"})

    with pytest.raises(ScenarioError, match=r'; .*dist = "one-of"'):
        load("choice")
    assert load("one-of").vary[key].values == tuple(values)


def test_clips_must_have_a_length():
    with pytest.raises(ScenarioError, match=r"clip\.clip_frames"):
        varied(clip_frames=0)


def test_draws_that_contradict_each_other_name_clip_and_key():
    at_once = {"dist": "one-of", "values": [0.0, 1.0]}
    scenario = varied(vary={"light.sun": at_once, "light.sky": at_once}, **{"light.floodlights": 0.0})
    with pytest.raises(ScenarioError, match=r"light: .*the image would be black.*clip \d+"):
        list(variants(scenario))


JOINT = {
    "dist": "one-of",
    "values": [{"light.sky": 0.5, "light.sun": 0.3}, {"light.sky": 0.7, "light.sun": 0.6}],
    "names": ["dim", "bright"],
}


@pytest.fixture(params=["file", "set", "python"])
def state(request, tmp_path):
    """State keys over a bundled scene, each way that there is."""

    def by_file(scene, keys):
        data = {"base": scene}
        for key, value in keys.items():
            data = merged(data, nested(key, value))
        (tmp_path / "scene.toml").write_text(tomli_w.dumps(data))
        return scenes.load(tmp_path / "scene.toml")

    def by_set(scene, keys):
        return scenes.load(scene, scenes.parse_changes(f"{key}={toml(value)}" for key, value in keys.items()))

    return {"file": by_file, "set": by_set, "python": scenes.load}[request.param]


def drawn(scenario, key, frames=range(0, 80, 8)):
    """Values that a key has in the first variants."""
    return [at(msgspec.to_builtins(variant(scenario, frame).scenario), key) for frame in frames]


def test_a_stated_key_does_not_vary(state):
    keys = {"camera.beta_deg": 8.0, "swing.alpha.sigma_deg": 1.0, "optics.exposure.target_level": 0.2}
    scenario = state("training", keys)
    for key, value in keys.items():
        assert drawn(scenario, key) == [value] * 10
    free = scenes.load("training")
    assert drawn(scenario, "camera.roll_deg") == drawn(free, "camera.roll_deg")
    assert len(set(drawn(scenario, "jib.head_height_m"))) > 1  # was joined with the swing
    with pytest.raises(ScenarioError, match=r"camera\.beta_deg: .*<= 30"):
        state("training", {"camera.beta_deg": 31.0})


def test_a_table_whose_kind_is_stated_does_not_vary_but_other_keys_in_it_do(state):
    scenario = state("training", {"grab.model": "scissors", "grab.volume_m3": 7.0, "place.model": "water"})
    assert set(drawn(scenario, "grab.model")) == {"scissors"}
    assert set(drawn(scenario, "grab.volume_m3")) == {7.0}
    assert set(drawn(scenario, "place.model")) == {"water"}
    assert len(set(drawn(scenario, "grab.wear"))) == 10
    assert "grab.tines" not in scenario.vary  # of orange-peel grabs


def test_a_stated_key_that_a_varying_table_would_overwrite_is_refused_with_a_cure(state):
    cases = {"grab.paint_rgb": [0.0, 0.0, 1.0], "light.sun": 0.5, "weather.rain_mm_h": 5.0}
    for key, value in cases.items():
        with pytest.raises(ScenarioError, match=r"would be overwritten.*\[vary\]") as caught:
            state("training", {key: value})
        assert caught.value.key == key
        named = re.search(r"\(vary\.(\S+)\)", caught.value.problem)
        assert named
        assert named[1] in scenes.load("training").vary
        cure = tomllib.loads(caught.value.problem.rpartition("[vary] ")[2])
        cured, free = state("training", {"vary": cure}), scenes.load("training")
        assert [np.ravel(v).tolist() for v in drawn(cured, key)] == [np.ravel(value).tolist()] * 10
        assert drawn(cured, "camera.beta_deg") == drawn(free, "camera.beta_deg")
    with pytest.raises(ScenarioError, match=r"state place\.model too"):
        state("training", {"place.cargo": "coal"})
    # Nothing that is drawn states this key, so it stays.
    assert drawn(state("training", {"light.sun_elevation_deg": 50.0}), "light.sun_elevation_deg") == [50.0] * 10


def test_a_table_that_a_call_sets_as_a_whole_does_not_vary():
    scenario = scenes.load("training", {"light": {"sun": 0.0, "sky": 0.5}})
    assert set(drawn(scenario, "light.sky")) == {0.5}
    assert len(set(drawn(scenario, "light.sun_elevation_deg"))) == 10


def test_what_a_file_varies_replaces_the_factors_of_its_base(state):
    low = {"dist": "uniform", "low": 0.0, "high": 0.01}
    kinds = {"dist": "one-of", "values": [{"model": "four-rope"}, {"model": "scissors"}]}
    scenario = state("training", {"vary": {"camera.roll_deg+camera.beta_deg": {
        "dist": "one-of", "values": [{"camera.roll_deg": 1.0, "camera.beta_deg": 2.0}]}, "grab": kinds}})  # fmt: skip
    assert set(drawn(scenario, "camera.beta_deg")) == {2.0}
    assert set(drawn(scenario, "grab.model")) == {"four-rope", "scissors"}
    scenario = state(
        "exam-calm", {"vary": {"grab.cargo": {"dist": "one-of", "values": ["grain"]}, "camera.roll_deg": low}}
    )
    assert set(drawn(scenario, "grab.cargo")) == {"grain"}  # which the base draws with its places
    assert max(drawn(scenario, "camera.roll_deg")) < 0.01


def test_what_is_left_of_a_joint_factor_is_labelled_by_its_values():
    base = {"clip.clip_frames": 2, "vary": {"light.sky+light.sun": JOINT}}
    scenario = scenes.load("quay-day", base)
    data = laid_over(msgspec.to_builtins(scenario), {"light": {"sun": 0.9}})
    one = variant(convert(data, Scenario), 0)
    assert one.scenario.light.sun == 0.9
    assert one.drawn == {"light.sky": one.scenario.light.sky}


def test_contradictions_are_refused(state):
    with pytest.raises(ScenarioError, match=r"^camera: an empty table states nothing, and camera\.\w+ varies"):
        state("training", {"camera": {}})
    factors = {"camera.beta_deg": UNIFORM, "camera.beta_deg+camera.roll_deg": {
        "dist": "one-of", "values": [{"camera.roll_deg": 1.0, "camera.beta_deg": 2.0}]}}  # fmt: skip
    with pytest.raises(ScenarioError, match=r"camera\.beta_deg: varies twice"):
        state("quay-day", {"clip.clip_frames": 2, "vary": factors})


def test_a_file_states_no_number_that_its_own_factor_cannot_be(tmp_path):
    path, factor = tmp_path / "scene.toml", f"[vary]\n'camera.beta_deg' = {toml(UNIFORM)}\n"
    low, high = UNIFORM["low"], UNIFORM["high"]
    for stated in (low, high, low - 1, high + 1):
        path.write_text(f"base = 'quay-day'\nclip.clip_frames = 2\n[camera]\nbeta_deg = {stated}\n{factor}")
        if low <= stated <= high:
            assert "camera.beta_deg" in scenes.load(path).vary
        else:
            why = rf"^camera\.beta_deg: states {stated:g}, and \[vary\] draws {low:g} to {high:g} instead: change both$"
            with pytest.raises(ScenarioError, match=why):
                scenes.load(path)


VARY = {name: factors for name in scenes.names() if (factors := scenes.load(name).vary)}


@pytest.mark.parametrize("scene", VARY)
def test_a_scene_written_whole_is_the_same(scene, tmp_path):
    (tmp_path / "scene.toml").write_text(scenes.load(scene).to_toml(), encoding="utf-8")
    assert scenes.load(tmp_path / "scene.toml") == scenes.load(scene)


@pytest.mark.parametrize("value", [3, [3], "x", {"camera.beta_deg": "x"}])
def test_what_is_no_factor_is_refused(value, state):
    with pytest.raises(ScenarioError, match="vary"):
        state("training", {"vary": value})


def test_setting_and_varying_a_key_in_one_call_is_refused():
    with pytest.raises(ScenarioError, match=r"camera\.beta_deg: the same call sets and varies"):
        scenes.load("quay-day", {"clip.clip_frames": 2, "vary": {"camera.beta_deg": UNIFORM}, "camera.beta_deg": 2.5})


def every_key(kind, prefix=""):
    """Give all keys of a struct but those that must not vary, each with its default and the kinds of its tables."""
    for field in msgspec.structs.fields(kind):
        key, tables = f"{prefix}{field.encode_name}", structs_of(types_of(kind)[field.name])
        if not prefix and field.name in vary.FIXED:
            continue
        if not tables and field.default is not msgspec.NODEFAULT:
            yield key, {key: msgspec.to_builtins(field.default)}
        for table in tables:
            config = table.__struct_config__
            kinds = {f"{key}.{config.tag_field}": config.tag} if config.tag else {}
            if any(inner.required for inner in msgspec.structs.fields(table)):
                continue  # a file of the user's
            for inner, stated in every_key(table, f"{key}."):
                yield inner, kinds | stated


def tables_of(factors):
    """Those that draw several keys at once: scenes that share them differ in numbers alone."""
    return frozenset(key for key, factor in factors.items() if isinstance(getattr(factor, "values", [0])[0], Mapping))


VARYING = {tables_of(factors): name for name, factors in VARY.items()}.values()


@pytest.mark.parametrize("scene", slow_but(VARYING, "training-shapes", "exam-fog-dust"))
def test_no_stated_key_is_drawn_otherwise(scene):
    """All keys of the schema over a scene that varies: each alone, and with the kinds of the tables that it is in."""
    base, refused, kept = msgspec.to_builtins(scenes.load(scene)), 0, 0
    kind = base["swing"]["model"]
    for _, stated in every_key(Scenario):
        if stated.get("swing.model", kind) != kind:
            continue
        for keys in (stated, dict([list(stated.items())[-1]])):
            layer = {}
            for key, value in keys.items():
                layer = merged(layer, nested(key, value))
            try:
                scenario = convert(laid_over(base, layer), Scenario)
                one = [msgspec.to_builtins(variant(scenario, frame).scenario) for frame in (0, 40, 400)]
            except ScenarioError:
                if keys is stated:
                    refused += 1
                continue
            kept += 1
            for key, value in keys.items():
                assert all(at(data, key) == value for data in one), (keys, [at(data, key) for data in one])
    assert kept > 4 * refused, (kept, refused)


def test_a_key_of_another_kind_than_the_drawn_one_is_left_out():
    factors = {
        "place": {"dist": "one-of", "values": [{"model": "quay"}, {"model": "hold"}, {"model": "plain"}]},
        "place.fill": {"dist": "uniform", "low": 0.1, "high": 0.2},  # of a hold alone
    }
    scene = scenes.load("quay-day", {"frames": 60, "clip.clip_frames": 1, "vary": factors})
    for one, _ in variants(scene):
        place = one.scenario.place
        assert hasattr(place, "fill") == ("place.fill" in one.drawn)
        assert not hasattr(place, "fill") or place.fill == one.drawn["place.fill"]
    with pytest.raises(ScenarioError, match="unknown key"):
        scenes.load("quay-day", {"clip.clip_frames": 1, "vary": {"place.fill": factors["place.fill"]}})
    with pytest.raises(ScenarioError, match=r"place\.fill"):
        scenes.load(
            "quay-day", {"clip.clip_frames": 1, "vary": factors | {"place.fill": {"dist": "uniform", "high": 7}}}
        )
