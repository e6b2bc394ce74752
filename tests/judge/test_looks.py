import numpy as np
import pytest

from scripts.looks import LOOKS, altered

PICTURE = np.random.default_rng(3).integers(0, 256, (90, 160, 3), np.uint8)


@pytest.mark.parametrize("look", LOOKS)
def test_a_look_changes_a_picture_alike_each_time_and_keeps_its_size(look):
    first, second = (altered(PICTURE, LOOKS[look], np.random.default_rng(5)) for _ in range(2))
    assert (first == second).all()
    assert first.shape == PICTURE.shape
    assert (first == PICTURE).all() == (look == "as rendered")
    assert (np.ptp(first, axis=2) == 0).all() == (look in ("grey", "infrared night"))
