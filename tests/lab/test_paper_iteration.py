import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simgrab.instrument.estimate import MeanRay, PaperIteration
from simgrab.instrument.estimate.paper_iteration import circular_median
from simgrab.lab.paper.law import AXIS_DIRECTION, camera, draw
from simgrab.model.geometry import vertical_direction
from tests.instrument import studies

BETA, SIGMA, H = np.deg2rad(5.0), np.deg2rad(2.0), 1600.0
KNOWN = PaperIteration(axis="known", axis_direction=AXIS_DIRECTION)


def law(records, frames):
    return draw(0, "test", records, frames, beta=BETA, sigma=SIGMA, h=H)


def by_hand(m, theta, h, steps):
    """(est-1) to (est-3), a number at a time."""
    beta, history = 0.0, []
    for _ in range(steps):
        alpha = [
            math.acos(min(1.0, (a * math.sin(beta) * math.cos(t) + h * math.cos(beta)) / math.sqrt(a * a + h * h)))
            for a, t in zip(m, theta, strict=True)
        ]
        sigma2 = sum(a * a for a in alpha) / len(alpha)
        beta = math.acos(sum(h / math.sqrt(a * a + h * h) for a in m) / len(m) * math.exp(sigma2 / 2))
        history.append((beta, sigma2))
    return history


def test_the_iterates_are_the_papers():
    pixels, _ = law(1, 60)
    found = KNOWN.estimate(pixels[0], camera(H))
    m, theta = camera(H).intrinsics.polar(pixels[0], AXIS_DIRECTION)
    steps = int(found.diagnostics["iterations"])
    expected = by_hand(m, theta, H, steps)
    history = found.diagnostics["beta_history"][: steps + 1], found.diagnostics["sigma2_history"][: steps + 1]
    assert history[0][0] == 0
    np.testing.assert_allclose(np.transpose(history)[1:], expected, rtol=1e-9)
    assert abs(history[0][-1] - history[0][-2]) < 1e-6
    assert abs(history[0][-2] - history[0][-3]) >= 1e-6 or abs(history[1][-2] - history[1][-3]) >= 1e-6
    assert found.beta == pytest.approx(history[0][-1])


# Must show 1: 0.139° (n = 100), 0.0632°, 0.0455° and 0.0205° (5000), each within 7 %.
@pytest.mark.parametrize(("frames", "rmse_deg"), [(100, 0.139), (500, 0.0632), (1000, 0.0455), (5000, 0.0205)])
def test_the_error_over_n(frames, rmse_deg):
    pixels, _ = law(1000, frames)
    found = KNOWN.batch(pixels, camera(H))
    assert found.ok.all()
    assert found.diagnostics["iterations"].max() <= 8
    rmse = np.rad2deg(np.sqrt(np.mean((found.beta - BETA) ** 2)))
    assert rmse == pytest.approx(rmse_deg, rel=0.07)


def test_from_a_start_above_twice_the_tilt_there_is_no_end():
    pixels, _ = law(200, 1000)
    above = PaperIteration(axis="known", axis_direction=AXIS_DIRECTION, start=np.deg2rad(10.6)).batch(pixels, camera(H))
    assert not above.ok.any()
    assert "step 1" in above[0].reason
    assert "twice the tilt" in above[0].reason
    assert above[0].beta is None


def test_heavy_tails_are_refused_from_0_and_not_from_the_mean_ray():
    d = studies.draw("exponential", 100, 1000, beta_deg=1.0)
    plain = PaperIteration().batch(d.pixels, studies.camera())
    assert not plain.ok.any()  # the kurtosis exceeds 3 in every one
    assert np.all(plain.diagnostics["kurtosis"] > 3)
    assert "kurtosis" in plain[0].reason
    assert plain[0].status == "refused"
    repaired = PaperIteration(start="mean-ray").batch(d.pixels, studies.camera())
    assert repaired.ok.all()
    assert np.rad2deg(np.sqrt(np.mean((repaired.beta - np.deg2rad(1.0)) ** 2))) < 0.06


def test_from_start_0_the_domain_ends_where_the_kurtosis_exceeds_3():
    d = studies.draw("exponential", 400, 100, beta_deg=1.5)
    found = PaperIteration(axis="known", axis_direction=float(vertical_direction(0.7, 0.0))).batch(
        d.pixels, studies.camera()
    )
    left_at_once = np.array(["step 1 of" in r for r in found.reason])
    over = found.diagnostics["kurtosis"] > 3.01
    under = found.diagnostics["kurtosis"] < 2.99
    assert 10 < over.sum() < 390
    assert left_at_once[over].all()
    assert not left_at_once[under].any()


def test_the_fixed_point_is_nearly_the_mean_ray_on_the_line():
    d = studies.draw("rayleigh", 20, 2000)
    one = PaperIteration().batch(d.pixels, studies.camera())
    mean = MeanRay().batch(d.pixels, studies.camera())
    np.testing.assert_allclose(one.beta, mean.beta, atol=np.deg2rad(0.02))


def test_the_estimated_axis_gives_the_tilt_azimuth():
    d = studies.draw("half-normal", 20, 4000)
    found = PaperIteration().batch(d.pixels, studies.camera())
    assert np.abs(found.tilt_azimuth - studies.AZIMUTH).max() < np.deg2rad(1.0)


@given(st.lists(st.floats(-10, 10), min_size=1, max_size=40), st.floats(-7, 7))
@settings(deadline=None, max_examples=200)
def test_no_direction_has_a_smaller_mean_arc_than_the_circular_median(angles, other):
    def arc(direction):
        away = (np.asarray(angles) - direction) % (2 * np.pi)
        return np.minimum(away, 2 * np.pi - away).mean()

    assert arc(circular_median(angles)) <= arc(other) + 1e-9


def test_the_circular_median_does_not_depend_on_where_the_circle_is_cut():
    angles = np.random.default_rng(0).vonmises(3.1, 2.0, 501)
    turned = circular_median(angles + 2.0) - circular_median(angles)
    assert np.exp(1j * turned) == pytest.approx(np.exp(2j), abs=1e-9)
