import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simgrab.world.shutter import MOST_INSTANTS, instants, row_time, row_weights

TIMES = st.floats(0.0, 0.04)


@given(TIMES, TIMES, st.floats(0, 3000))
def test_rows_see_every_instant_of_their_exposure_and_no_other(shutter, readout, speed):
    at = instants(shutter, readout, speed)
    assert len(at) <= MOST_INSTANTS
    weights = row_weights(108, shutter, readout, at)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    assert (weights >= -1e-12).all()
    if len(at) > 1:
        centres = [row_time(r + 0.5, 108, readout) for r in range(108)]
        np.testing.assert_allclose(weights @ at, centres, atol=1e-9 + shutter / len(at))


def test_the_exposure_is_a_box():
    at = instants(0.02, 0.0, 1000.0)
    weights = row_weights(10, 0.02, 0.0, at)
    inner = weights[0, 1:-1]
    np.testing.assert_allclose(inner, inner[0])
    np.testing.assert_allclose(weights[0, [0, -1]], inner[0] / 2)


def test_without_exposure_a_row_sees_its_own_instant():
    at = instants(0.0, 0.03, 1000.0)
    weights = row_weights(300, 0.0, 0.03, at)
    np.testing.assert_allclose(weights @ at, [row_time(r + 0.5, 300, 0.03) for r in range(300)], atol=1e-12)


@pytest.mark.parametrize(("shutter", "readout", "speed"), [(0.0, 0.0, 500.0), (0.04, 0.03, 0.0)])
def test_what_does_not_move_is_drawn_once(shutter, readout, speed):
    assert instants(shutter, readout, speed).tolist() == [0.0]
