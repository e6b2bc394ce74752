"""Factors: drawn by their laws, each from a stream of its own, and refused where they cannot be."""

import json

import msgspec
import numpy as np
import pytest
from scipy import stats

from simgrab import scenes
from simgrab.errors import ScenarioError
from simgrab.scenario import Hold, Plain, Scenario, variant, variants
from simgrab.utilities.strict import convert

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


def test_what_is_drawn_is_told_by_name_or_value():
    one = variant(varied(), 7)
    assert one.number == 3
    drawn = json.loads(one.varied)
    assert drawn["camera.beta_deg"] == one.scenario.camera.beta_deg
    assert drawn["place"] == ("hold" if isinstance(one.scenario.place, Hold) else "yard")


def test_frames_of_a_clip_share_a_draw_and_the_next_has_another():
    scenario = varied(frames=12, clip_frames=4)
    beta = [variant(scenario, frame).scenario.camera.beta_deg for frame in range(12)]
    assert [beta[i] for i in (0, 4, 8)] == sorted(set(beta), key=beta.index)


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


def test_factors_survive_being_written(tmp_path):
    scenario = varied()
    file = tmp_path / "scene.toml"
    file.write_text(scenario.to_toml())
    assert scenes.load(file) == scenario
    assert convert(scenario.to_dict(), Scenario) == scenario


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


def test_clips_must_have_a_length():
    with pytest.raises(ScenarioError, match=r"clip\.clip_frames"):
        varied(clip_frames=0)


def test_draws_that_contradict_each_other_name_clip_and_key():
    at_once = {"dist": "one-of", "values": [0.0, 1.0]}
    scenario = varied(vary={"light.sun": at_once, "light.sky": at_once}, **{"light.floodlights": 0.0})
    with pytest.raises(ScenarioError, match=r"light: .*the image would be black.*clip \d+"):
        list(variants(scenario))


def test_a_key_set_by_hand_varies_no_more():
    joint = {"dist": "one-of", "values": [{"light.sky": 0.5, "light.sun": 0.3}], "names": ["dim"]}
    factors = {"camera.beta_deg": UNIFORM, "light.sky+light.sun": joint, "place": PLACES}
    every = scenes.load("quay-day", {"clip.clip_frames": 2, "vary": factors, "camera.beta_deg": 2.5, "light.sun": 0.9})
    assert set(every.vary) == {"light.sky", "place"}
    one = variant(every, 0).scenario
    assert (one.camera.beta_deg, one.light.sun, one.light.sky) == (2.5, 0.9, 0.5)
    assert np.isin("place", list(every.vary))
    with pytest.raises(ScenarioError, match="change that factor under vary"):
        scenes.load("quay-day", {"clip.clip_frames": 2, "vary": factors, "place.fill": 0.1, "place.model": "hold"})


def test_what_does_not_vary_is_not_checked_again():
    """It would be for each of thousands of values."""
    scenario = varied()
    one = variant(scenario, 0).scenario
    kept = {name for name in scenario.__struct_fields__ if getattr(one, name) is getattr(scenario, name)}
    assert kept == {*scenario.__struct_fields__} - {"camera", "place", "sensors", "vary"}  # dictionaries are copied


def test_weights_are_summed_once(monkeypatch):
    from simgrab.scenario import factor

    sums = []
    monkeypatch.setattr(factor, "sum", lambda values: sums.append(1) or sum(values), raising=False)
    choice = factor.OneOf(tuple(range(1000)), weights=tuple(range(1000)))
    sums.clear()
    np.testing.assert_allclose(choice.probabilities, np.arange(1000) / 499_500)
    assert len(sums) == 1


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
