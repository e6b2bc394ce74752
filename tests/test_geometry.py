import cv2
import numpy as np
import pytest
from equations import eq1_residual, eq2_cos_alpha
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from simgrab.model import geometry as g
from simgrab.model.calibration import Calibration

angle = st.floats(-np.pi, np.pi)
small = st.floats(0.0, np.radians(30))
PAPER = g.Intrinsics(1920, 1080, g.PAPER_FOCAL_LENGTH_MM * g.PAPER_PIXELS_PER_MM, 960.0, 540.0)
LENS = g.Distortion(-0.27, 0.09, 1e-3, -5e-4, -0.012)


def test_paper_focal_length():
    assert PAPER.f_px == pytest.approx(1644.82, abs=0.005)
    assert g.pixels_per_mm(1920, 1080, 6.43) == pytest.approx(342.60, abs=0.005)


def test_camera_pose_is_pinned_by_numbers():
    """Azimuth 0 tilts the axis outboard; the picture's top is outboard; roll turns about the axis alone."""
    straight = g.camera_rotation(0.0, 0.0, 0.0)
    np.testing.assert_allclose(straight @ [1, 0, 0], [0, -1, 0], atol=1e-14)
    np.testing.assert_allclose(straight @ [0, 1, 0], [-1, 0, 0], atol=1e-14)
    np.testing.assert_allclose(straight @ [0, 0, 1], [0, 0, -1], atol=1e-14)
    beta, azimuth = np.radians((5.0, 30.0))
    axis = g.camera_rotation(beta, azimuth, 0.7) @ [0, 0, 1]
    expected = [np.sin(beta) * np.cos(azimuth), np.sin(beta) * np.sin(azimuth), -np.cos(beta)]
    np.testing.assert_allclose(axis, expected, atol=1e-14)
    # The product that the convention states, from another library.
    down = Rotation.from_matrix([[0, -1, 0], [-1, 0, 0], [0, 0, -1]])
    product = Rotation.from_euler("ZYZ", [30, -5, -30], degrees=True) * down * Rotation.from_euler("z", 0.7)
    np.testing.assert_allclose(g.camera_rotation(beta, azimuth, 0.7), product.as_matrix(), atol=1e-14)


def test_outboard_swing_moves_the_grab_up_in_an_upright_picture():
    centre = g.grab_centre(np.radians(3), 0.0, 20.0)
    pixel = PAPER.project(g.to_camera(centre, g.camera_rotation(0, 0, 0), (0, 0, 0)))
    np.testing.assert_allclose(pixel, [960, 540 - PAPER.f_px * np.tan(np.radians(3))])


@given(small, angle, st.floats(6, 45))
def test_swing_survives_the_round_trip(alpha, azimuth, length):
    a, p, r = g.swing_of(g.grab_centre(alpha, azimuth, length))
    assert abs(a - alpha) < 1e-12
    assert abs(r - length) < 1e-12 * length
    if alpha > 1e-6:
        assert abs(g.wrap(p - azimuth)) < 1e-9


@given(small, angle, small, angle, angle, st.floats(6, 45))
def test_paper_equations_hold_with_the_camera_at_the_rope_exit(alpha, gamma, beta, azimuth, roll, length):
    centre = g.grab_centre(alpha, gamma + azimuth, length)
    ideal = PAPER.ideal(g.to_camera(centre, g.camera_rotation(beta, azimuth, roll), (0, 0, 0)))
    m, theta = PAPER.polar(ideal, g.vertical_direction(azimuth, roll))
    assert abs(eq1_residual(m, alpha, gamma, beta, PAPER.f_px)) < 1e-9
    assert abs(eq2_cos_alpha(m, theta, beta, PAPER.f_px) - np.cos(alpha)) < 1e-9
    assert g.image_radius(alpha, gamma, beta, PAPER.f_px) == pytest.approx(float(m), abs=1e-4)
    np.testing.assert_allclose(PAPER.from_polar(m, theta, g.vertical_direction(azimuth, roll)), ideal, atol=1e-9)


@given(st.floats(0.01, 0.5), angle, angle)
def test_vertical_direction_points_at_the_image_of_gravity(beta, azimuth, roll):
    far_below = PAPER.ideal(g.to_camera([0, 0, -1.0], g.camera_rotation(beta, azimuth, roll), (0, 0, 0)))
    m, theta = PAPER.polar(far_below, g.vertical_direction(azimuth, roll))
    assert abs(theta) < 1e-9
    assert m == pytest.approx(PAPER.f_px * np.tan(beta))


def test_theta_runs_clockwise_in_the_picture():
    _, theta = PAPER.polar([[1060, 540], [960, 640], [860, 540], [960, 440]])
    np.testing.assert_allclose(theta, [0, np.pi / 2, np.pi, -np.pi / 2])


@given(st.floats(-0.55, 0.55), st.floats(-0.32, 0.32))
def test_distortion_is_opencvs(x, y):
    ours = LENS.apply([x, y])
    theirs, _ = cv2.projectPoints(
        np.array([[[x, y, 1.0]]]), np.zeros(3), np.zeros(3), np.eye(3),
        np.array([LENS.k1, LENS.k2, LENS.p1, LENS.p2, LENS.k3]),
    )  # fmt: skip
    np.testing.assert_allclose(ours, theirs.ravel(), atol=1e-14)
    np.testing.assert_allclose(LENS.remove(ours), [x, y], atol=1e-11)


def test_rays_go_through_their_pixels():
    lens = g.Intrinsics(1920, 1080, 1644.82, 950.0, 548.0, LENS)
    pixels = np.stack(np.meshgrid(np.linspace(0, 1920, 9), np.linspace(0, 1080, 7)), -1)
    rays = lens.rays(pixels)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1.0)
    np.testing.assert_allclose(lens.project(rays * 17.0), pixels, atol=1e-8)
    np.testing.assert_allclose(lens.distort(lens.undistort(pixels)), pixels, atol=1e-8)


def test_points_behind_the_camera_and_beyond_the_fold_have_no_pixel():
    assert np.isnan(PAPER.project([0.0, 0.0, -1.0])).all()
    folding = g.Intrinsics(1920, 1080, 1644.82, 960.0, 540.0, g.Distortion(k1=-0.3))
    edge = folding.distortion.fold_radius
    assert np.isfinite(folding.project([edge * 0.999, 0.0, 1.0])).all()
    assert np.isnan(folding.project([edge * 1.001, 0.0, 1.0])).all()
    beyond = folding.cx_px + folding.f_px * (2 / 3 * edge) + 1.0  # the fold's image is at 2/3 of its radius
    assert np.isnan(folding.undistort([beyond, 540.0])).all()


@pytest.mark.parametrize("k3", [5e-324, -5e-324, 1e-300, 1e9, -1e9])
def test_a_fold_is_found_whatever_the_size_of_a_coefficient(k3):
    radius = g.Distortion(k3=k3).fold_radius
    assert radius == pytest.approx((-7 * k3) ** (-1 / 6) if k3 < 0 else np.inf)


def test_a_long_lens_has_large_coefficients():
    """Its rays have slopes below 0.1, whose sixth power the last of them multiplies."""
    lens = Calibration(1920, 1080, 12_000.0, 960.0, 540.0, k2=60.0, k3=-3500.0).intrinsics
    pixels = np.stack(np.meshgrid(np.linspace(0, 1920, 33), np.linspace(0, 1080, 19)), axis=-1)
    np.testing.assert_allclose(lens.distort(lens.undistort(pixels)), pixels, atol=1e-9)


def test_everything_broadcasts_over_frames():
    alpha, gamma = np.radians(np.random.default_rng(1).uniform(0, 10, (2, 50)))
    centre = g.grab_centre(alpha, gamma, 20.0)
    rotation = g.camera_rotation(np.full(50, 0.05), 0.3, 0.1)
    pixels = LENS_CAMERA.project(g.to_camera(centre, rotation, (0.1, 0.6, -0.3)))
    assert pixels.shape == (50, 2)
    one = LENS_CAMERA.project(g.to_camera(centre[7], rotation[7], (0.1, 0.6, -0.3)))
    np.testing.assert_array_equal(pixels[7], one)


LENS_CAMERA = g.Intrinsics(1920, 1080, 1644.82, 960.0, 540.0, LENS)


@given(st.floats(-50, 50))
def test_wrap(value):
    wrapped = float(g.wrap(value))
    assert -np.pi < wrapped <= np.pi
    assert np.isclose(np.exp(1j * wrapped), np.exp(1j * value))
