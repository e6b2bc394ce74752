"""Where the assumption holds no consistent estimator is biased, intervals cover; and a hidden tilt is found."""

import math

import msgspec
import numpy as np
import pytest
from stress_runs import bundled, small, summed

from simgrab.lab.stress import catalogue, geometric
from simgrab.lab.stress.axes import AXES
from simgrab.lab.stress.study import situation
from simgrab.lab.stress.summary import judge

CONSISTENT = ("paper-iteration", "mean-ray", "geometric-median", "rope-aware")
FREE = {"rope", "rope-range", "n"}  # no assumption of anything
# Beside a known offset only one estimator is consistent.
BESIDE = ("roll", "rope-bias", "rope-lag", "rope-misread")


@pytest.fixture(scope="module")
def base():
    return small("noise", (0.0,), replications=1000, n=1000)


def test_no_bias_and_true_coverage_where_every_assumption_holds(base):
    verdicts = judge(summed(base))
    assert len(verdicts) == 4 * len(CONSISTENT)
    assert all(v.passed for v in verdicts), [v for v in verdicts if not v.passed]


def test_a_hidden_tilt_of_a_twentieth_of_a_degree_is_found(base):
    verdicts = judge(summed(msgspec.structs.replace(base, given={"planted": 0.05})))
    for name in CONSISTENT:
        assert not next(v for v in verdicts if v.text.startswith(f"{name}: no bias of beta")).passed


@pytest.mark.parametrize("name", [a for a in AXES if a not in FREE])
def test_every_axis_begins_where_its_assumption_holds(name, base):
    axis = AXES[name]
    there = situation(base, (0.0,))
    if axis.key:
        changed = situation(small("noise", (0.0,), n=1000, given={name: axis.holds}), (0.0,))
    else:
        changed = axis.apply(there, axis.holds)
    one, other = (geometric.draw(s, 0, [0, 7]) for s in (there, changed))
    np.testing.assert_array_equal(one.pixels, other.pixels)
    np.testing.assert_array_equal(one.rope, other.rope)
    assert one.calibration == other.calibration
    assert (one.beta, *one.sigma) == (other.beta, *other.sigma)


@pytest.mark.parametrize("name", [a for a in AXES if a not in FREE])
def test_every_axis_changes_what_is_drawn(name):
    study = next(s for s in map(bundled, catalogue.names()) if s.axes[0].axis == name and s.holds)
    there, far = (situation(small(study, n=40), p) for p in _ends(study))
    one, other = (geometric.draw(s, 0, [0]) for s in (there, far))
    same = np.array_equal(one.pixels, other.pixels, equal_nan=True) and np.array_equal(one.rope, other.rope)
    assert not same or one.calibration != other.calibration or one.beta != other.beta


def _ends(study):
    """Where the first axis holds and where it is farthest from that, the other axis being at its end."""
    values, rest = study.axes[0].values, tuple(s.values[-1] for s in study.axes[1:])
    far = values[-1] if isinstance(values[0], str) else max(values, key=lambda v: abs(v - study.holds[0]))
    return (study.holds[0], *rest), (far, *rest)


@pytest.mark.parametrize("name", BESIDE)
def test_beside_a_known_offset_the_rope_aware_is_unbiased(name):
    study = small(name, bundled(name).holds, replications=1000, n=1000)
    verdicts = judge(summed(study))
    assert len(verdicts) == 4
    assert all(v.passed for v in verdicts), [v for v in verdicts if not v.passed]


def test_every_assumption_has_a_bundled_study():
    studies = [*map(bundled, catalogue.names())]
    studied = {s.axis for study in studies for s in study.axes if study.holds}
    assert set(AXES) - studied <= {"rope", "rope-range"}
    for study in studies:
        if study.kind == "estimators" and any(s.axis not in FREE for s in study.axes):
            assert study.holds or study.accept or study.given, study.name


def test_limits_can_fail():
    assert not judge(summed(small("focal", (5.0,), replications=20, holds=(5.0,))))[-1].passed
    assert math.isnan(summed(small("focal", (0.0,), replications=2)).at((9.0,), "mean-ray", "miss").mean)
