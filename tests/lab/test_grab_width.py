import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simgrab.lab.paper.grab_width import swing_by_width
from simgrab.model.geometry import eq2_cos_alpha


def test_it_is_right_for_a_camera_that_hangs_straight():
    alpha, rope, h, b = np.deg2rad([0.0, 2.0, 9.0]), np.array([10.0, 20.0, 33.0]), 1644.82, 2.9
    width = h * b / (rope * np.cos(alpha))  # x·l·cosα = h·b
    np.testing.assert_allclose(swing_by_width(h * np.tan(alpha), width, rope, b), alpha, atol=1e-12)


def test_a_width_too_small_for_any_angle_gives_none():
    assert np.isnan(swing_by_width([600.0], [10.0], [20.0])).all()


@given(st.floats(0, 800), st.floats(-np.pi, np.pi), st.floats(0, 0.5))
def test_the_papers_check_cannot_fail(m, theta, any_beta):
    """|ψ − α̂| ≤ β̂ for any β̂ whatever, by the triangle inequality: nothing is checked."""
    psi = np.arctan2(m, 1644.82)
    alpha = np.arccos(np.clip(eq2_cos_alpha(m, theta, any_beta, 1644.82), -1, 1))
    assert abs(psi - alpha) <= any_beta + 1e-7


def test_the_papers_example():
    """141 px wide and α̃ = 1.337° leave m·b/l = 3.29: m = 28.4 px at 25 m, a grab near the centre."""
    assert np.rad2deg(swing_by_width(28.36, 141.0, 25.0)) == pytest.approx(1.337, abs=1e-3)
