"""docs/convergence.md holds."""

import math

import numpy as np
import pytest
from stress_runs import small, summed

from simgrab.instrument.estimate import PaperIteration
from simgrab.lab.stress import geometric
from simgrab.lab.stress.convergence import population, starts_at_zero
from simgrab.lab.stress.laws import LAWS
from simgrab.lab.stress.study import situation

DEG = math.pi / 180


@pytest.fixture(scope="module")
def chart():
    points = [(law, n, b, s) for law in ("half-normal", "rayleigh", "exponential") for n in (10000.0,)
              for b in (0.0, 1.0, 5.0) for s in (2.0, 8.0)]  # fmt: skip
    return summed(small("convergence", *points, replications=6))


def test_the_measured_contraction_is_the_linearised_one(chart):
    rates = []
    for point in chart.study.points:
        measured, linear = (chart.at(point, "paper-iteration", c) for c in ("rate", "rate_linear"))
        if measured.count:
            assert measured.mean == pytest.approx(linear.mean, abs=1e-3)
            rates.append(measured.mean)
    assert max(np.abs(rates)) > 0.1  # there is something to be measured


def test_start_0_keeps_its_domain_where_the_kurtosis_says_so(chart):
    for law, n, beta, sigma in chart.study.points:
        # So near the border that chance decides: with β = 0 by every law, with the half-normal one by any small β.
        if beta == 0 or (law == "half-normal" and beta < sigma):
            continue
        share = chart.at((law, n, beta, sigma), "paper-iteration", "domain").mean
        assert share == starts_at_zero(beta * DEG, sigma * DEG, LAWS[law].kurtosis)
        assert chart.at((law, n, beta, sigma), "paper-iteration", "foretold").mean == share


def test_the_fixed_point_lies_where_the_fourth_order_puts_it(chart):
    """At σ = 8° and β = 5° Rayleigh's lies above the truth, the exponential's below."""
    for law in ("rayleigh", "exponential"):
        found = chart.at((law, 10000.0, 5.0, 8.0), "paper-iteration", "fixed_error_deg")
        foretold = population(5 * DEG, 8 * DEG, LAWS[law].kurtosis)[0] / DEG - 5
        assert abs(found.mean - foretold) < 4 * found.mean_se + 0.01


def test_theory_at_its_corners():
    assert population(0.1, 0.05, 3.0) == (0.1, 0.0)
    assert all(map(math.isnan, population(0.001, 0.1, 6.0)))
    fixed, rate = population(0.0, 0.1, 2.0)
    assert rate == -1
    assert fixed == pytest.approx(math.sqrt(0.1**4 / 24))
    above, below = population(0.1, 0.1, 2.0), population(0.1, 0.1, 6.0)
    assert above[0] > 0.1 > below[0]
    assert above[1] < 0 < below[1]


def test_it_closes_in_by_squares():
    """w ← 1 − √(1 − w²) with w = 1 − β/P, which is w²/2 once near."""
    here = situation(small("convergence"), ("half-normal", 10000.0, 5.0, 0.5))
    records = geometric.draw(here, 0, [0])
    found = PaperIteration(epsilon=1e-14).batch(records.pixels, records.calibration)
    w = 1 - found.diagnostics["beta_history"][0] / found.beta[0]
    w = w[np.isfinite(w) & (w < 0.9) & (w > 1e-4)]
    assert len(w) >= 3
    np.testing.assert_allclose(w[1:], 1 - np.sqrt(1 - w[:-1] ** 2), rtol=0.05)
