import numpy as np
import pytest
from conftest import small_scene
from hypothesis import given
from hypothesis import strategies as st

import simgrab
from simgrab.model.geometry import to_camera
from simgrab.world.camera.optics.light import to_linear
from simgrab.world.camera.shutter import MOST_INSTANTS, instants, row_time, row_weights
from simgrab.world.frames import FrameGenerator
from simgrab.world.trajectory.trajectory import Trajectory

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


def test_the_exposure_is_a_box_and_without_one_a_row_sees_its_own_instant():
    at = instants(0.02, 0.0, 1000.0)
    weights = row_weights(10, 0.02, 0.0, at)
    inner = weights[0, 1:-1]
    np.testing.assert_allclose(inner, inner[0])
    np.testing.assert_allclose(weights[0, [0, -1]], inner[0] / 2)
    at = instants(0.0, 0.03, 1000.0)
    own = [row_time(r + 0.5, 300, 0.03) for r in range(300)]
    np.testing.assert_allclose(row_weights(300, 0.0, 0.03, at) @ at, own, atol=1e-12)


@pytest.mark.parametrize(("shutter", "readout", "speed"), [(0.0, 0.0, 500.0), (0.04, 0.03, 0.0)])
def test_what_does_not_move_is_drawn_once(shutter, readout, speed):
    assert instants(shutter, readout, speed).tolist() == [0.0]


def swinging(**changes):
    """A grab that swings by at about 5 m/s across the picture's rows and columns, in a clip."""
    return small_scene(
        swing={"model": "dynamic", "work": {"model": "hang", "rope_length_m": 12.0}, "drag_area_m2": 0.0},
        swing__start={"alpha_deg": 25.0, "azimuth_deg": 40.0}, camera__beta_deg=0.0, frames=20, **changes,
    )  # fmt: skip


def grab_px(scene, moment):
    point = to_camera(moment.grab.jib_from_grab.translation, moment.tilt.jib_from_camera, scene.camera.offset_m)
    return np.asarray(scene.camera.intrinsics.project(point))


def draw(scene, frame):
    return next(simgrab.frames(scene, [frame], buffers=False))


def test_a_picture_is_blurred_along_the_way_during_the_exposure():
    """Near the grab it equals the mean of the sharp picture shifted along that way, and of no other length."""
    frame, exposure = 15, 0.04
    sharp, blurred = swinging(), swinging(shutter__exposure_s=exposure)
    crisp, soft = draw(sharp, frame), draw(blurred, frame)
    assert crisp.moment.grab == soft.moment.grab  # labels stay
    moment = Trajectory(blurred).at(frame)
    here, way = grab_px(blurred, moment), grab_px(blurred, moment.shifted(exposure)) - grab_px(blurred, moment)
    assert np.linalg.norm(way) > 6
    u, v = here.astype(int)
    near = np.s_[v - 20 : v + 20, u - 20 : u + 20]

    def apart(length):
        shifts = [np.round(s * length * way[::-1]).astype(int) for s in np.linspace(-0.5, 0.5, 25)]
        mean = np.mean([to_linear(np.roll(crisp.rgb, tuple(s), (0, 1))) for s in shifts], axis=0)
        return np.abs(to_linear(soft.rgb)[near] - mean[near]).mean()

    errors = {length: apart(length) for length in (0.0, 0.5, 1.0, 1.5, 2.0)}
    assert min(errors, key=errors.get) == 1.0
    assert errors[1.0] < 0.4 * errors[0.0]


def test_a_rolling_shutter_shears_what_moves():
    """Every row is the row of a picture taken at that row's instant."""
    frame, readout = 15, 0.033
    scene = swinging(shutter__rolling_s=readout)
    rolled = draw(scene, frame).rgb.astype(int)
    moment = Trajectory(scene).at(frame)
    height, centre = scene.camera.height_px, int(grab_px(scene, moment)[1])
    with FrameGenerator(swinging()) as generator:

        def apart(row, seconds):
            rgb = generator.scene(0).renderer.rgb(moment.shifted(seconds))
            return np.abs(rgb[row].astype(int) - rolled[row]).mean()

        for row in (centre - 25, centre, centre + 25):
            own = row_time(row + 0.5, height, readout)
            assert apart(row, own) < 0.6 * min(apart(row, own - 0.01), apart(row, own + 0.01))


def test_labels_are_of_the_instant_at_which_the_grabs_row_exposes():
    scene = swinging(shutter__rolling_s=0.033, shutter__exposure_s=0.01)
    aimed = draw(scene, 13).moment
    moment = Trajectory(scene).at(13)
    row = grab_px(scene, aimed)[1]
    delay = row_time(row, scene.camera.height_px, 0.033)
    assert aimed.time == pytest.approx(moment.time + delay, abs=1e-6)
    assert abs(delay) > 1e-3
    still = draw(swinging(), 13).moment
    assert np.linalg.norm(grab_px(scene, aimed) - grab_px(scene, still)) > 0.5


def test_a_moment_goes_along_its_way():
    scene = swinging(shutter__exposure_s=0.01, camera__mount={"model": "levelled", "vibration": {"rms_deg": 0.2}})
    moment = Trajectory(scene).at(5)
    ahead = moment.shifted(moment.ahead.time - moment.time)
    np.testing.assert_allclose(ahead.grab.jib_from_grab, moment.ahead.grab.jib_from_grab, atol=1e-9)
    np.testing.assert_allclose(ahead.tilt.jib_from_camera, moment.ahead.tilt.jib_from_camera, atol=1e-9)
    back, forth = (grab_px(scene, moment.shifted(s)) for s in (-0.01, 0.01))
    np.testing.assert_allclose((back + forth) / 2, grab_px(scene, moment), atol=0.1)
