"""What chance does to a sound instrument stays within what a baseline allows; a fault of a few deviations does not."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from simgrab.judge.check import baseline, verdicts
from simgrab.judge.check.baseline import FALSE_FAILURES, Recorded, reference
from simgrab.judge.check.suite import Limit, Suite, SuiteScene


def recorded(values, labels=None):
    return Recorded("digest", labels or tuple(f"labels {i}" for i in range(len(values))), {"rmse": tuple(values)}, {})


def failures(rng, seeds, metrics, worse=0.0, checks=1500):
    """Count checks that fail of an instrument whose metrics are normal, each check with a baseline of its own."""
    upper, count = Limit(upper=1e9), 0
    for _ in range(checks):
        past = rng.normal(1.0, 0.1, (metrics, seeds))
        now = rng.normal(1.0 + worse, 0.1, metrics)
        allowed = (reference(recorded(of_metric), "rmse", upper, "other", metrics) for of_metric in past)
        count += not all(ref.holds(value, upper) for ref, value in zip(allowed, now, strict=True))
    return count


@pytest.mark.parametrize(("seeds", "metrics"), [(3, 4), (10, 12)])
def test_a_sound_check_fails_no_more_often_than_stated(seeds, metrics):
    checks = 1500
    # At the stated rate so many failures are seen once in 10,000 runs of this test.
    most = stats.binom.ppf(1 - 1e-4, checks, FALSE_FAILURES)
    assert failures(np.random.default_rng(5), seeds, metrics, checks=checks) <= most


def test_the_stated_rate_is_that_of_normal_metrics(monkeypatch):
    rate, checks = 0.1, 4000
    monkeypatch.setattr(baseline, "FALSE_FAILURES", rate)
    count = failures(np.random.default_rng(6), 3, 1, checks=checks)
    low, high = stats.binom.interval(1 - 1e-4, checks, rate)
    assert low <= count <= high


def test_a_fault_of_a_dozen_deviations_is_always_seen():
    checks = 300
    assert failures(np.random.default_rng(7), 10, 12, worse=1.2, checks=checks) == checks


def test_on_the_same_frames_only_the_slack_is_allowed():
    limit = Limit(upper=9.0, slack=0.02)
    same = reference(recorded([0.2, 0.5, 0.9]), "rmse", limit, "labels 1", 10)
    assert same.value == 0.5
    assert same.holds(0.52, limit)
    assert not same.holds(0.5201, limit)
    other = reference(recorded([0.2, 0.5, 0.9]), "rmse", limit, "labels 7", 10)
    assert other.holds(0.9, limit)


@pytest.mark.parametrize("labels", ["labels 1", "labels 7"])
def test_a_slack_may_be_a_share_of_the_baseline(labels):
    values = recorded([-0.5, -0.5, -0.5])
    refs = [reference(values, "rmse", Limit(upper=9, slack=slack), labels, 10) for slack in ("20 %", "20.0%", 0.1)]
    assert [ref.allowed for ref in refs] == pytest.approx([0.1] * 3)


@pytest.mark.parametrize(
    ("limit", "worse", "better"),
    [(Limit(upper=5), 1.5, 0.5), (Limit(lower=0), 0.5, 1.5)],
)
def test_which_way_is_worse_is_what_the_limit_says(limit, worse, better):
    ref = reference(recorded([1.0]), "rmse", limit, "labels 0", 1)
    assert ref.holds(better, limit)
    assert not ref.holds(worse, limit)


def test_with_both_ends_it_is_worse_to_come_nearer_to_one_than_the_reference():
    limit = Limit(lower=-5, upper=5, slack=0.1)
    ref = reference(recorded([1.0]), "rmse", limit, "labels 0", 1)
    assert [ref.holds(value, limit) for value in (1.2, 1.05, 0.0, -1.05, -1.2)] == [False, True, True, True, False]


@pytest.mark.parametrize(
    ("value", "limit", "warned"),
    [
        (0.281, Limit(upper=5, slack=0.02), True), (0.281, Limit(upper=5, slack=0.03), False),
        (0.305, Limit(upper=5), False), (0.4, Limit(upper=5, slack=0.02), False),
        (0.281, Limit(lower=-5, upper=5, slack=0.02), True), (0.4, Limit(lower=0, slack=0.02), True),
    ],
)  # fmt: skip
@pytest.mark.parametrize("labels", ["labels 1", "labels 9"])
def test_a_value_that_is_better_by_more_than_it_may_be_worse_is_noticed(value, limit, warned, labels):
    """On the recorded frames by slack alone, on others by that and the spread over seeds."""
    past = reference(recorded([0.305 - 0.05, 0.305, 0.305 + 0.05]), "rmse", limit, labels, 1)
    verdict = verdicts.Verdict(
        scene="", what="rmse", status="passed", value=value, reference=past.value, allowed=past.allowed
    )
    assert verdicts.surpasses(verdict, limit) == (warned and labels == "labels 1")


@pytest.mark.parametrize("values", [[1.0], [None, None], [1.0, None]])
def test_of_less_than_two_seeds_no_spread_is_known(values):
    assert reference(recorded(values), "rmse", Limit(upper=5), "other", 1) is None


def test_both_ends_of_all_limits_share_the_chance():
    scenes = {"x": SuiteScene("quay-day"), "y": SuiteScene("quay-day", limits={"angle.overall.bias_deg": Limit(-1, 1)})}
    some = Suite(name="s", limits={"alarm.missed": Limit(upper=1)}, scenes=scenes)
    assert baseline.ends(some) == 1 + 1 + 2


def test_a_metric_fails_by_its_limit_and_by_the_baseline_alike():
    dataset = SimpleNamespace(data=SimpleNamespace(labels_sha256="labels 0"))
    known = SimpleNamespace(alpha=np.zeros(1))
    trial = SimpleNamespace(
        dataset=dataset, metrics={"rmse": 3.0}, known=known, run=SimpleNamespace(time=None), centres=[]
    )
    past = baseline.Baseline("s", "i", "0", (0,), {"x": recorded([1.0])})
    (verdict,) = verdicts.of_trial("x", trial, {"rmse": Limit(upper=2.0)}, past, 1)
    assert verdict.status == "failed"
    assert "misses the limit ≤ 2" in verdict.message
    assert "worse than the baseline's 1 on the same frames" in verdict.message
