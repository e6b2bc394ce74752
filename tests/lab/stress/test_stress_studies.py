"""Studies are read strictly, estimators are anybody's, and the command line does what one function does."""

import json
import tomllib
from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest
import tomli_w
from commands import run
from equations import eq2_cos_alpha
from stress_runs import bundled, refused, small, summed

import simgrab
from simgrab.errors import StressError
from simgrab.instrument.estimate import MeanRay
from simgrab.lab.stress import catalogue, estimators, geometric
from simgrab.lab.stress import summary as summaries
from simgrab.lab.stress.catalogue import STUDIES
from simgrab.lab.stress.laboratory import outcome
from simgrab.lab.stress.study import Study, Sweep, quickened, resized, situation
from simgrab.lab.stress.summary import LimitVerdict, StudyResult, figure, judge
from simgrab.model.records.estimates import Estimate, Intervals

GOOD = tomllib.loads((STUDIES / "focal.toml").read_text(encoding="utf-8"))
BAD = {
    "misspelt axis": ({"axes": [{"axis": "fokal", "values": [0.0]}]}, ("fokal", "did you mean 'focal'", "lean-along")),
    "empty axis": ({"axes": [{"axis": "focal", "values": []}]}, ("axes.0.values", "no values", "lean-along")),
    "no axis": ({"axes": []}, ("1 to 2", "lean-along")),
    "a value twice": ({"axes": [{"axis": "focal", "values": [0.0, 0.0]}]}, ("twice",)),
    "an axis that is given too": (
        {"given": {"camera.beta_deg": 3.0}, "axes": [{"axis": "beta", "values": [1.0]}]},
        ("given.camera.beta_deg", "leave it out"),
    ),
    "unknown estimator": ({"estimators": ["mean-rai"]}, ("mean-rai", "geometric-median", "package.module:Class")),
    "no estimator": ({"estimators": ["json:JSONDecoder"]}, ("json:JSONDecoder", "estimate(pixels")),
    "an axis that the fidelity cannot reach": (
        {"axes": [{"axis": "weather.visibility_m", "values": [100.0]}]},
        ("weather.visibility_m", "is not available", "camera.beta_deg", "lean-along"),
    ),
    "consistent but not tried": (
        {"consistent": ["rope-aware"], "estimators": ["mean-ray"]},
        ("rope-aware", "mean-ray"),
    ),
    "unknown law": ({"axes": [{"axis": "alpha-law", "values": ["cauchy"]}]}, ("cauchy", "half-normal")),
    "unknown scene of motion": ({"axes": [{"axis": "motion", "values": ["quay-day"]}]}, ("quay-day", "work-cycles")),
    "out of range": ({"axes": [{"axis": "missing", "values": [1.5]}]}, ("missing", "[0, 1]")),
    "a name for a number": ({"axes": [{"axis": "focal", "values": ["long"]}]}, ("focal", "long")),
    "tilt of 95": ({"axes": [{"axis": "beta", "values": [95.0]}]}, ("beta_deg", "<= 30")),
    "accepted nowhere": ({"accept": [{"at": [2.0], "estimator": "mean-ray", "quantity": "miss"}]}, ("accept", "[2.0]")),
    "unknown quantity": ({"accept": [{"at": [5.0], "estimator": "mean-ray", "quantity": "mis"}]}, ("mis", "miss")),
    "moving base": ({"base": "work-cycles"}, ("base", "motion")),
}


@pytest.mark.parametrize("case", BAD)
def test_a_study_that_cannot_be_is_refused_with_what_is_valid(case, tmp_path):
    change, words = BAD[case]
    data = {k: v for k, v in GOOD.items() if k not in ("accept", "holds")} | change
    path = tmp_path / "bad.toml"
    path.write_text(tomli_w.dumps(data), encoding="utf-8")
    refused(lambda: catalogue.load(path), words)


def test_frames_are_refused_where_an_axis_sets_them():
    refused(lambda: simgrab.stress("n", frames=20), ("axis n", "leave frames out"))
    assert "axis n" in run("stress", "n", "--frames", 20)[2]


@pytest.mark.parametrize(
    ("counts", "values", "axes", "key"),
    [
        ({"n": 3}, 1, 1, "n: must be a whole"),
        ({}, 1000, 2, "points"),
        ({"replications": 10**6}, 100, 1, "replications"),
    ],
)
def test_impossible_studies_are_refused_in_one_line(counts, values, axes, key):
    with pytest.raises(StressError) as problem:
        Study("mine", "x", (Sweep("beta", tuple(map(float, range(values)))),) * axes, ("mean-ray",), **counts)
    assert key in str(problem.value)
    assert "\n" not in str(problem.value)


def test_unknown_studies_are_refused_with_the_list():
    with pytest.raises(StressError, match=r"did you mean 'focal'.*lean-along"):
        catalogue.load("focl")


def test_every_bundled_study_reads_under_its_own_name_and_quickly():
    for name in catalogue.names():
        study = bundled(name)
        assert study.name == name
        quick = quickened(study)
        assert quick.replications <= 30
        assert "pendulum-smoother" not in quick.estimators


def test_the_draws_obey_the_papers_equation():
    from simgrab.model.geometry import vertical_direction

    here = situation(small("noise", n=50), (0.0,))
    records = geometric.draw(here, 1, range(3))
    m, theta = here.lens.polar(records.pixels, vertical_direction(records.azimuth, 0.0))
    np.testing.assert_allclose(np.cos(records.alpha), eq2_cos_alpha(m, theta, records.beta, here.lens.f_px), atol=1e-12)


class Stubborn:
    """An estimator of a stranger: no base class, one record at a time, and it refuses what is short."""

    def estimate(self, pixels, calibration, *, rope_length=None, time=None):  # noqa: ARG002
        if len(pixels) < 30:
            return Estimate(status="refused", reason="too short")
        return MeanRay().estimate(pixels, calibration)


class AnglesOnly:
    def estimate(self, pixels, calibration, *, rope_length=None, time=None):  # noqa: ARG002
        return Estimate(alpha=MeanRay().estimate(pixels, calibration).alpha)


class Broken:
    def estimate(self, pixels, calibration, *, rope_length=None, time=None):  # noqa: ARG002
        raise ZeroDivisionError("oh")


def test_anybodys_estimator_is_judged_like_the_packages_own():
    name = f"{__name__}:Stubborn"
    summary = summed(small("n", (10.0,), (100.0,), replications=20, estimators=("mean-ray", name)))
    for column in summary.study.columns:
        if column != "iterations":
            ours, theirs = (summary.at((100.0,), e, column) for e in (name, "mean-ray"))
            assert (ours.count, ours.mean) == pytest.approx((theirs.count, theirs.mean), rel=1e-12, nan_ok=True), column
    assert summary.at((10.0,), name, "refused").mean == 1.0
    assert summary.at((10.0,), name, "miss").count == 0


def test_of_an_estimator_that_returns_angles_alone_the_rest_is_computed_or_empty():
    name = f"{__name__}:AnglesOnly"
    summary = summed(small("missing", (0.3,), replications=20, estimators=("mean-ray", name)))
    for column in ("sigma_error_deg", "alpha_rms_deg", "alpha_most_deg", "used"):
        ours, theirs = (summary.at((0.3,), e, column) for e in (name, "mean-ray"))
        assert (ours.count, ours.mean) == pytest.approx((theirs.count, theirs.mean), rel=1e-12), column
    for column in ("beta_error_deg", "alpha10_rms_deg", "miss", "cover_beta"):
        assert summary.at((0.3,), name, column).count == 0, column


def test_an_estimator_object_is_studied_from_python():
    study = {"name": "n", "title": "n", "estimators": ["paper"], "axes": [{"axis": "n", "values": [10, 100]}]}
    steps = []
    rows = simgrab.stress(
        study, {"mine": Stubborn()}, replications=20, progress=lambda *step: steps.append(step)
    ).to_pylist()
    assert steps == sorted(set(steps))
    assert steps[-1] == (40, 40)
    named = summed(catalogue.read(study | {"replications": 20, "estimators": ["paper", f"{__name__}:Stubborn"]}))
    expected = named.table().to_pylist()
    assert [row["estimator"] for row in rows] == [
        row["estimator"].replace(f"{__name__}:Stubborn", "mine") for row in expected
    ]
    for mine, other in zip(rows, expected, strict=True):
        assert mine | {"estimator": ""} == pytest.approx(other | {"estimator": ""}, nan_ok=True)
    for own, why in (({"paper": Stubborn()}, "bundled paper-iteration"), ({"mine": Stubborn}, r"such as Stubborn\(\)")):
        with pytest.raises(StressError, match=why):
            simgrab.stress(study, own)


@pytest.mark.parametrize("name", ["os:abort", "os:environ", "pathlib:Path"])
def test_what_is_no_class_of_estimators_is_refused_and_not_called(name):
    with pytest.raises(StressError, match="has no method estimate"):
        estimators.find(name)


def test_an_estimator_that_fails_is_named():
    records = geometric.draw(situation(small("noise", n=20), (0.0,)), 0, [0])
    with pytest.raises(StressError, match=r":Broken failed with ZeroDivisionError: oh"):
        estimators.run(f"{__name__}:Broken", records)


class Centred:
    """Writes into what it is given."""

    def estimate(self, pixels, calibration, *, rope_length=None, time=None):
        for values in (time, rope_length, pixels):
            with pytest.raises(ValueError, match="read-only"):
                values[0] = 1.0
        pixels -= 20.0
        return MeanRay().estimate(pixels, calibration, rope_length=rope_length, time=time)


def test_an_estimator_cannot_change_what_the_next_one_is_given():
    records = geometric.draw(situation(small("noise", n=20), (0.0,)), 0, [0])
    before = records.pixels.copy()
    with pytest.raises(StressError, match=r"Centred failed with ValueError: .*read-only"):
        estimators.run(f"{__name__}:Centred", records)
    np.testing.assert_array_equal(records.pixels, before)


def test_without_intervals_their_coverage_is_not_a_number():
    name = f"{__name__}:AnglesOnly"
    study = small("missing", (0.0,), replications=20, estimators=(name,), holds=(0.0,), consistent=(name,), accept=())
    found = [verdict.found for verdict in judge(summed(study)) if "covers" in verdict.text]
    assert found == ["no interval in any replication"] * 2


def test_own_estimators_are_for_studies_without_pictures():
    with pytest.raises(
        StressError, match=r"at the depth 'rendered', name 'mine' in estimators, as package.module:Class"
    ):
        simgrab.stress("rendered-calm", {"mine": MeanRay()})


ENDS = Intervals("iid", 0.95, np.array([0.1, 0.2]))


class Wrong:
    """Returns what is planted."""

    changes: ClassVar[dict] = {}

    def estimate(self, pixels, calibration, *, rope_length=None, time=None):  # noqa: ARG002
        return replace(MeanRay().estimate(pixels, calibration), **self.changes) if self.changes else {"beta": 0.1}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, "must return a simgrab.Estimate, got dict"),
        ({"alpha": np.zeros(5)}, r"alpha must have the shape \(20,\), got \(5,\)"),
        ({"alpha": None}, "alpha is None"),
        ({"beta": "steep"}, "beta must hold numbers, got 'steep'"),
        ({"status": "refused", "offset": np.zeros(2)}, r"offset must have the shape \(3,\), got \(2,\)"),
        ({"intervals": (replace(ENDS, beta=np.zeros(1)),)}, r"intervals: beta must have the shape \(2,\), got \(1,\)"),
        ({"alpha": np.full(20, np.nan)}, "alpha is NaN in every frame"),
        ({"alpha": np.full(20, 5.0)}, "alpha reaches 5 rad, beyond the horizontal; angles are in radians"),
        ({"beta": 3.0}, "beta reaches 3 rad, beyond the horizontal; angles are in radians"),
        ({"status": "fine"}, "status must be 'ok' or 'refused', got 'fine'"),
        ({"status": "refused"}, "a refusal needs a reason"),
        ({"alpha": np.full(20, -0.1)}, "alpha is below 0"),
        ({"intervals": ENDS}, "intervals must be a tuple of Intervals"),
        ({"intervals": (replace(ENDS, kind="foo"),)}, "of the kind 'foo'; one of: iid, blocks, posterior"),
        ({"intervals": (replace(ENDS, level=0.8),)}, "intervals of 80 %: their coverage is compared with that of 95 %"),
        ({"intervals": (replace(ENDS, beta=np.array([0.2, 0.1])),)}, "the lower end of an interval of beta is above"),
    ],
)
def test_what_an_estimator_must_not_return_is_refused_in_one_line(changes, said, monkeypatch):
    records = geometric.draw(situation(small("noise", n=20), (0.0,)), 0, [0])
    monkeypatch.setattr(Wrong, "changes", changes)
    with pytest.raises(StressError, match=f":Wrong: .*{said}"):
        estimators.run(f"{__name__}:Wrong", records)


def test_how_many_limits_are_met_is_said_where_some_were_set():
    def of(*passed):
        return StudyResult(None, tuple(LimitVerdict("a study", "a limit", "found", one) for one in passed))

    assert outcome([of(True, False), of(), of(True)]) == "2 of 3 limits are met"
    assert outcome([of(), of()]) == "no limits were set"


def test_the_list_names_every_study():
    assert set(json.loads(run("stress", "--json")[1])) == set(catalogue.names())


def test_a_replay_shows_diagnostics_and_its_picture(tmp_path):
    again = ("stress", "--out", tmp_path, "--replay", "focal")
    told = json.loads(run(*again, 3, "--at", "5", "--json")[1])
    assert told["at"] == {"focal": 5.0}
    found = told["estimators"]["paper-iteration"]
    assert found["status"] == "ok"
    assert -0.5 < found["beta_error_deg"] < 0
    assert len(found["diagnostics"]["beta_history"]) == found["iterations"] + 1
    assert (tmp_path / "replay-focal-3.png").read_bytes()[1:4] == b"PNG"
    assert "not a combination of axis values" in run(*again, 3, "--at", "7")[2]
    assert "0 to 999" in run(*again, 1000)[2]


def test_a_verb_takes_one_thing_at_a_time():
    assert run("stress", "focal", "--all")[0] == 2
    assert "--at goes with --replay" in run("stress", "focal", "--at", "5")[2]
    assert run("stress", "focal", "--workers", 0)[0] == 2
    assert "cannot write to /proc/nowhere" in run("stress", "focal", "--out", "/proc/nowhere")[2]


def test_limits_of_root_mean_squares_are_of_the_studys_own_frames():
    study = bundled("alpha-law")
    assert any(accept.statistic == "rms" for accept in study.accept)
    assert resized(study, study.n, 10, 1).accept == study.accept
    few = resized(study, study.n - 1, None, None)
    assert {accept.statistic for accept in few.accept} == {accept.statistic for accept in study.accept} - {"rms"}


def test_few_replications_are_judged_by_their_own_quantile():
    """A mean of few values lies beyond three of their own standard errors more often than one of many."""
    rng, beyond = np.random.default_rng(0), 0
    for _ in range(300):
        found = figure(rng.normal(0, 1, 8))
        beyond += not found.z <= summaries._standard_errors(found.count)
    assert beyond <= 4
    assert summaries._standard_errors(1000) == pytest.approx(3.0, abs=0.02)
    assert summaries._standard_errors(0) > 100
