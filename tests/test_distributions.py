import numpy as np
import pytest
from scipy import stats

from simgrab.model.distributions import Choice, Constant, Exponential, HalfNormal, Normal, Rayleigh, Uniform
from simgrab.model.rng import stream

LAWS = {
    "half-normal": (HalfNormal(2.0), stats.halfnorm(scale=2.0)),
    "rayleigh": (Rayleigh(2.0), stats.rayleigh(scale=2.0)),
    "cut rayleigh": (Rayleigh(2.0, high=3.0), stats.truncweibull_min(2.0, 0.0, 3.0 / np.sqrt(8.0), scale=np.sqrt(8.0))),
    "exponential": (Exponential(2.0), stats.expon(scale=2.0)),
    "normal": (Normal(1.0, 2.0), stats.norm(1.0, 2.0)),
    "truncated": (Normal(1.0, 2.0, low=-1.0, high=6.0), stats.truncnorm(-1.0, 2.5, 1.0, 2.0)),
    "one-sided": (Normal(1.0, 2.0, low=0.0), stats.truncnorm(-0.5, np.inf, 1.0, 2.0)),
    "uniform": (Uniform(-1.0, 3.0), stats.uniform(-1.0, 4.0)),
}


@pytest.mark.parametrize("name", LAWS)
def test_a_law_draws_what_it_says(name):
    law, reference = LAWS[name]
    sample = law.sample(stream(0, 0, name), 20_000)
    assert stats.kstest(sample, reference.cdf).pvalue > 1e-3
    assert law.rms() == pytest.approx(np.sqrt(reference.moment(2)), rel=1e-6)
    low, high = law.support()
    assert low == reference.support()[0]
    assert high == reference.support()[1]


def test_discrete_laws():
    law = Choice((1.0, 2.0, 5.0), (1.0, 0.0, 3.0))
    sample = law.sample(stream(0, 0, "choice"), 10_000)
    assert set(sample) == {1.0, 5.0}
    assert np.mean(sample == 5.0) == pytest.approx(0.75, abs=0.02)
    assert law.rms() == pytest.approx(np.sqrt(0.25 + 0.75 * 25))
    assert Constant(3.0).sample(stream(0, 0, "c")) == 3.0
    assert (Constant(3.0).sample(stream(0, 0, "c"), 4) == 3.0).all()
    assert Normal(2.0, 0.0).sample(stream(0, 0, "c")) == 2.0
    assert Normal(low=0.0, high=1e-6).rms() == pytest.approx(1e-6 / np.sqrt(3))
