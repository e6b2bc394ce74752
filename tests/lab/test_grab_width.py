"""The paper's validation by grab width (section 4.6) validates nothing.

It compares α̂ with arcsin(m·b/(x·l)), which x·l·cosα = h·b and tanα = m/h give for β = 0. This does not use the tilt:
for a camera at the rope exit it is the angle ψ of the ray from the optical axis.
"""

import numpy as np
from equations import eq2_cos_alpha
from hypothesis import given
from hypothesis import strategies as st


@given(st.floats(0, 800), st.floats(-np.pi, np.pi), st.floats(0, 0.5))
def test_the_papers_check_cannot_fail(m, theta, any_beta):
    """|ψ − α̂| ≤ β̂ for any β̂ whatever, by the triangle inequality: nothing is checked."""
    psi = np.arctan2(m, 1644.82)
    alpha = np.arccos(np.clip(eq2_cos_alpha(m, theta, any_beta, 1644.82), -1, 1))
    assert abs(psi - alpha) <= any_beta + 1e-7
