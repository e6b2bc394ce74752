"""Plates, targets and balls: seen in the picture where their stated points project."""

import cv2
import numpy as np
import pytest
from conftest import small_scene

import simgrab
from simgrab.model.scenario import AprilTag, Balls, Circles, Markers, Scenario, Target
from simgrab.world.scenery.grabs import design_of
from simgrab.world.scenery.markers import mark_points, marked, plate_picture

STEADY = {
    "swing__alpha__sigma_deg": 2.0, "swing__rope_length_m": {"dist": "constant", "value": 12.0},
    "swing__yaw_deg": {"dist": "constant", "value": 5.0}, "place": {"model": "plain"}, "light__sun": 0.0, "frames": 2,
    "camera__width_px": 1280, "camera__height_px": 720, "camera__beta_deg": 2.0,
    "camera__focal": {"model": "pixels", "focal_length_px": 1100},
    "suspension": {"model": "four-rope", "tilt_ratio": 0.3},
}  # fmt: skip


def seen(markers, frame=1):
    """Picture of a frame, and a function from points in the grab's frame to its pixels."""
    scenario = small_scene(**STEADY, markers=markers)
    shown = next(iter(simgrab.frames(scenario, [frame])))
    grab, camera = (np.reshape(pose, (3, 4)) for pose in (shown.truth.jib_from_grab, shown.truth.jib_from_camera))

    def project(points):
        jib = points @ grab[:, :3].T + grab[:, 3]
        return scenario.camera.intrinsics.project((jib - camera[:, 3]) @ camera[:, :3])

    return scenario, shown, project


def test_a_tag_is_detected_where_its_corners_project():
    scenario, shown, project = seen({"plate": {"model": "apriltag", "tag": 17, "position_m": [1.0, -0.6, 0.0]}})
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    detector = cv2.aruco.ArucoDetector(family, settings)
    corners, ids, _ = detector.detectMarkers(cv2.cvtColor(shown.rgb, cv2.COLOR_RGB2GRAY))
    assert ids.ravel().tolist() == [17]
    expected = project(mark_points(scenario.markers.plate, design_of(scenario.grab).terminations[0, 2]))
    np.testing.assert_allclose(corners[0][0] + 0.5, expected, atol=0.5)


def test_circles_and_a_target_are_where_their_centres_project_and_belong_to_the_grab():
    scenario, shown, project = seen({"plate": {"model": "circles", "size_m": 1.0}, "target": {}})
    height = design_of(scenario.grab).terminations[0, 2]
    for centre in project(mark_points(scenario.markers.plate, height)):
        x, y = centre.astype(int)
        window = shown.rgb[y - 18 : y + 19, x - 18 : x + 19].max(axis=2) < 90
        assert window[18, 18]
        rows, columns = np.nonzero(window)
        np.testing.assert_allclose([columns.mean() - 18, rows.mean() - 18], np.array(centre) - (x, y) - 0.5, atol=1.0)
    x, y = project(np.array([scenario.markers.target.position_m]) + (0.0, 0.0, height))[0].astype(int)
    red, green, blue = shown.rgb[y, x].astype(int)
    assert red > 180 > 2 * max(green, blue) - 60
    assert shown.mask[y, x]


def test_balls_hang_between_o_and_the_rope_ends_and_count_as_ropes():
    scenario, frame, _ = seen({"balls": {"distances_m": [3.0, 4.5], "diameter_m": 0.4}})
    grab, camera = (np.reshape(pose, (3, 4)) for pose in (frame.truth.jib_from_grab, frame.truth.jib_from_camera))
    end = grab @ (0.0, 0.0, design_of(scenario.grab).terminations[0, 2], 1.0)
    for distance in (3.0, 4.5):
        point = (distance * end / np.linalg.norm(end) - camera[:, 3]) @ camera[:, :3]
        x, y = scenario.camera.intrinsics.project(point).astype(int)
        assert frame.ids[y, x] == 2
        assert frame.depth[y, x] == pytest.approx(point[2] * (1 - 0.2 / np.linalg.norm(point)), abs=0.01)
        red, green, blue = frame.rgb[y, x].astype(int)
        assert green > 1.5 * max(red, blue)


def test_marks_change_neither_mass_nor_physics():
    design = design_of(Scenario().grab)
    made = marked(design, Markers(plate=Circles(), target=Target()))
    assert made.mass_of(0.3, 0.0) == design.mass_of(0.3, 0.0)
    assert len(made.bodies[0].parts) == len(design.bodies[0].parts) + 4
    assert marked(design, Markers(balls=Balls())) is design


def test_pictures_of_plates():
    tag, circles = plate_picture(AprilTag(tag=3)), plate_picture(Circles())
    assert tag[0].min() == circles[0].min() == 255
    assert (circles == 0).mean() == pytest.approx(4 * np.pi / 4 * 0.3**2, rel=0.01)
    assert (tag[64, 64:-64] == 0).all()
    points = mark_points(AprilTag(size_m=0.6, position_m=(1.0, 0.5, 0.1)), 1.64)
    np.testing.assert_allclose(points[0], (1.3, 0.8, 1.74))
    assert mark_points(Circles(size_m=2.0), 0.0)[0, 0] == pytest.approx(1.5)
