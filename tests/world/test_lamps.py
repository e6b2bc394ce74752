import numpy as np
import pytest
from conftest import small_scene

from simgrab.model.geometry import camera_rotation
from simgrab.model.scenario import Light
from simgrab.world.camera.lamps import REFERENCE_M, illumination

NIGHT = Light(sun=0.0, sky=0.02, floodlights=0.5)


def lit(depth, light=NIGHT):
    k = small_scene().camera.intrinsics
    picture, rotation = np.full((k.height_px, k.width_px), depth, np.float32), camera_rotation(0.0, 0.0, 0.0)
    return illumination(light, picture, intrinsics=k, jib_from_camera=rotation, offset=np.zeros(3))


def middle(picture):
    return float(picture[picture.shape[0] // 2, picture.shape[1] // 2])


def test_straight_below_they_give_what_is_asked_for_and_fall_with_the_square_of_the_distance():
    assert middle(lit(REFERENCE_M)) == pytest.approx(0.02 + 0.5, rel=0.12)  # the lamps hang a metre aside and lower
    near, far = (middle(lit(d)) - 0.02 for d in (15.0, 30.0))
    assert near / far == pytest.approx((30.0 - 1.24) ** 2 / (15.0 - 1.24) ** 2, rel=0.05)


def test_the_beam_falls_off_to_the_side_and_without_floodlights_only_the_sky_is_left():
    picture = lit(28.0)
    assert picture[135, 5] < 0.75 * middle(picture)
    np.testing.assert_allclose(picture[:, ::-1], picture, rtol=1e-3)
    np.testing.assert_allclose(lit(20.0, Light(sun=0.0, sky=0.1)), 0.1)
