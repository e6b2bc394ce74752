"""What is known about the estimators comes out of the bundled studies, within Monte Carlo error."""

import pytest
from stress_runs import bundled, small, summed

from simgrab.lab.stress.summary import judge

KNOWN = ("offset-along", "focal", "lean-along", "gamma-towards", "box-centre-straight", "alpha-exponential")


@pytest.mark.parametrize("name", KNOWN)
def test_a_known_fact_is_measured_again(name):
    study = bundled(name)
    verdicts = judge(summed(small(name, *(a.at for a in study.accept), replications=30)))
    assert len(verdicts) >= len(study.accept) >= 2
    assert all(v.passed for v in verdicts), [v for v in verdicts if not v.passed]


def test_the_papers_error_over_n():
    study = small("n", (100.0,), (500.0,), (1000.0,), replications=400, estimators=("paper-iteration",))
    verdicts = judge(summed(study))
    assert len([v for v in verdicts if "rms" in v.text]) == 3
    assert all(v.passed for v in verdicts), [v for v in verdicts if not v.passed]


def test_a_lean_across_the_tilt_turns_the_vertical_by_as_much():
    summary = summed(small("lean-across", (2.0,), replications=30, estimators=("mean-ray",)))
    assert summary.at((2.0,), "mean-ray", "tilt_error_deg").mean == pytest.approx(2.0, abs=0.05)
    assert abs(summary.at((2.0,), "mean-ray", "beta_error_deg").mean) < 0.5
