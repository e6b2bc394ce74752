"""Cameras at the side recover the swing of drawn ropes and balls, and give reasons where they cannot."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from simgrab.errors import RecordError
from simgrab.instrument.contract import Frame
from simgrab.lab.rivals import balls as ball_module
from simgrab.lab.rivals import ropes
from simgrab.lab.rivals.balls import balls, meet, tysse
from simgrab.lab.rivals.contract import Series
from simgrab.lab.rivals.ropes import okubanjo, rope_lines, rope_plane
from simgrab.lab.rivals.side import SideView, read_view
from simgrab.model import geometry
from simgrab.model.geometry import STANDARD_GRAVITY

SIZE, FOCAL = (360, 640), 600.0
LEVEL = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # jib frame from a camera that looks outboard
ROPE = Series(np.array([0.0, 100.0]), np.full((2, 1), 18.0))
TIME = np.arange(45) / 9
PHASE = np.sqrt(STANDARD_GRAVITY / 18.4) * TIME
LEAN = np.tan(np.radians(6)) * np.column_stack([np.cos(PHASE), 0.5 * np.sin(PHASE)])
ALPHA = np.arctan(np.hypot(*LEAN.T))
ENDS = np.array([(0.2, 0.5), (-0.2, 0.45), (-0.2, -0.5), (0.2, -0.45)])


def camera(name, azimuth, centre):
    turn = np.radians(azimuth)
    cos, sin = np.cos(turn), np.sin(turn)
    rotation = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]) @ LEVEL
    return SideView(name, rotation, np.array(centre, float), FOCAL, (SIZE[0] / 2, SIZE[1] / 2), [])


def project(view, points):
    seen = (np.asarray(points) - view.centre) @ view.rotation
    return seen[:, :2] / seen[:, 2:] * FOCAL + view.principal


def drawn(view, lean, lines=True, spots=True):
    """Four ropes from O in the lean's direction over grey with a slanted beam, and green balls 2 and 8 m below O."""
    large = np.full((SIZE[1] * 2, SIZE[0] * 2, 3), 180, np.uint8)
    cv2.line(large, (0, 1200), (700, 1000), (60, 60, 60), 5)

    def pixel(point):
        return tuple(np.rint(16 * (2 * project(view, [point])[0] - 0.5)).astype(int).tolist())

    down = np.array([*lean, -1.0])
    for x, y in ENDS if lines else ():
        top = np.array([x, y, 0.0])
        cv2.line(large, pixel(top), pixel(top + 17 * down), (30, 30, 30), 2, cv2.LINE_AA, 4)
    for distance in (2.0, 8.0) if spots else ():
        middle = down * distance / np.linalg.norm(down)
        radius = 0.15 * FOCAL / np.linalg.norm(middle - view.centre)
        cv2.circle(large, pixel(middle), round(32 * radius), (20, 160, 30), -1, cv2.LINE_AA, 4)
    return cv2.resize(large, SIZE, interpolation=cv2.INTER_AREA)


def filming(view):
    """Give a camera the frames of the swing."""
    return replace(view, frames=[Frame(drawn(view, lean), t) for t, lean in zip(TIME.tolist(), LEAN, strict=True)])


@pytest.fixture(autouse=True, scope="module")
def each_picture_is_searched_once():
    with pytest.MonkeyPatch.context() as patch:
        for module, name, find in ((ropes, "rope_lines", rope_lines), (ball_module, "balls", balls)):
            found = {}

            def once(picture, found=found, find=find):
                if id(picture) not in found:
                    found[id(picture)] = picture, find(picture)  # the picture stays, and so does its id
                return found[id(picture)][1]

            patch.setattr(module, name, once)
        yield


@pytest.fixture(scope="module")
def pair():
    return [filming(camera("side0", 0, (-23, 0, -10))), filming(camera("side1", 90, (0, -22, -10)))]


@pytest.fixture(scope="module")
def three():
    return [filming(camera(f"king{i}", -10 * i, (-23, 4 * i, -10))) for i in (-1, 0, 1)]


def rmse(found, converged=TIME > 1):
    assert (found.reason[converged] == "").all()
    return np.degrees(np.sqrt(np.mean((found.alpha - ALPHA)[converged] ** 2)))


def test_the_plane_of_drawn_ropes_holds_their_lean():
    for view in (camera("a", 0, (-23, -1.5, -10)), camera("b", 90, (0, -22, -10)), camera("c", 30, (-20, -12, -14))):
        for lean in np.tan(np.radians([(0, 0), (6, -3), (-4, 9)])):
            plane = rope_plane(rope_lines(drawn(view, lean)), view)
            assert np.linalg.norm(plane[:2]) == pytest.approx(1, abs=0.01)
            assert np.degrees(plane[:2] @ lean - plane[2]) == pytest.approx(0, abs=0.2)
        assert rope_plane(rope_lines(drawn(view, lean, lines=False, spots=False)), view) is None


def test_two_cameras_at_the_side_recover_a_swing_from_its_ropes_and_one_measures_its_plane(pair):
    found = okubanjo(pair, ROPE, TIME)
    assert rmse(found) < 0.15
    assert rmse(okubanjo(pair[1:], ROPE, TIME)) > 0.3  # across the jib it sees the swing along it
    single = okubanjo(pair[:1], ROPE, TIME)
    along = np.degrees(single.alpha - np.arctan(np.abs(LEAN[:, 1])))[TIME > 1]
    assert np.sqrt(np.mean(along**2)) < 0.15


def test_three_cameras_recover_a_swing_from_balls(three):
    found = tysse(three, ROPE, TIME)
    assert rmse(found) < 0.2
    converged = TIME > 2
    assert np.mean(np.abs(found.alpha - ALPHA)[converged] < 2 * found.sd[converged]) > 0.8
    with pytest.raises(RecordError, match="two or more cameras"):
        tysse(three[:1], ROPE, TIME)


@pytest.mark.parametrize(("method", "cameras"), [(okubanjo, "pair"), (tysse, "three")])
def test_a_lean_of_the_crane_is_taken_for_swing(method, cameras, request):
    turn = geometry.lean(-np.radians(2.0), 0.0)
    views = request.getfixturevalue(cameras)
    leaning = [replace(view, rotation=turn @ view.rotation, centre=turn @ view.centre) for view in views]
    assert rmse(method(leaning, ROPE, TIME)) > 0.5  # the filter's pendulum hangs straight and takes part of it away


@pytest.mark.parametrize(("method", "cameras", "words"), [
    (okubanjo, "pair", "ropes were not seen"), (tysse, "three", "both balls were not seen"),
])  # fmt: skip
def test_what_is_out_of_sight_gives_a_reason(method, cameras, words, request):
    views = request.getfixturevalue(cameras)
    gone = range(9, 36)  # 3 s
    frames = [[Frame(None, f.time_s, "cut off") if i in gone else f for i, f in enumerate(v.frames)] for v in views]
    found = method([replace(view, frames=some) for view, some in zip(views, frames, strict=True)], ROPE, TIME)
    without = (TIME > 8 / 9 + 1.05) & (TIME < 36 / 9 - 1.05)
    assert without.any()
    assert np.isnan(found.alpha[without]).all()
    assert all(words in reason or "not converged" in reason for reason in found.reason[without])
    assert rmse(found, TIME > 4.2) < 0.4
    for some in ([each[9:36] for each in frames], [[] for _ in views]):
        nothing = method([replace(view, frames=few) for view, few in zip(views, some, strict=True)], ROPE, TIME)
        assert np.isnan(nothing.alpha).all()
        assert f"{words} in fewer than two pictures" in nothing.reason[0]


def test_balls_are_found_to_parts_of_a_pixel_and_meet_in_their_place():
    views = [camera(f"king{i}", -10 * i, (-23, 4 * i, -10)) for i in (-1, 0, 1)]
    lean = np.tan(np.radians((5, -3)))
    middles = np.array([2.0, 8.0])[:, None] * [*lean, -1.0] / np.linalg.norm([*lean, 1.0])
    two = np.array([balls(drawn(view, lean)) for view in views])
    assert two == pytest.approx(np.array([project(view, middles) for view in views]), abs=0.3)
    assert balls(drawn(views[0], lean, spots=False)) is None
    rays = np.array([view.rays(project(view, middles[:1]))[0] for view in views])
    point, covariance = meet(np.array([view.centre for view in views]), rays, np.full(3, FOCAL))
    assert point == pytest.approx(middles[0], abs=1e-9)
    across = 0.3 / FOCAL * np.linalg.norm([23, 8, 4])  # of one camera; the rays spread by 10° to either side
    deviations = np.sqrt(np.linalg.eigvalsh(covariance))
    assert deviations[0] == pytest.approx(across / np.sqrt(3), rel=0.1)
    assert deviations[2] == pytest.approx(across / (np.sqrt(2) * np.sin(np.radians(10))), rel=0.2)


def test_a_camera_that_looks_down_is_refused():
    with pytest.raises(RecordError, match="steeply"):
        okubanjo([SideView("top", np.diag([1.0, -1.0, -1.0]), np.zeros(3), FOCAL, (180, 320), [])], ROPE, TIME)
    with pytest.raises(RecordError, match="is needed"):
        okubanjo([], ROPE, TIME)


ABOUT = """sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [0, 0, 1, 2, -1, 0, 0, -1.5, 0, -1, 0, 14, 0, 0, 0, 1]
intrinsics: [600.0, 600.0, 180.0, 320.0]
distortion_coefficients: [0.0, 0.0, 0.0, 0.0]
"""
LISTED = "#timestamp [ns],filename\n0,000000.jpg\n111111111,000001.jpg\n"


def folder_of(path, about=ABOUT, listed=LISTED):
    (path / "data").mkdir()
    (path / "sensor.yaml").write_text(about)
    (path / "data.csv").write_text(listed)
    cv2.imwrite(str(path / "data" / "000000.jpg"), np.zeros((64, 48, 3), np.uint8))
    return path


def test_a_folder_is_a_view_whose_unreadable_pictures_are_lost(tmp_path):
    view = read_view(folder_of(tmp_path), (-25.0, 0.0, -28.0))
    assert view.centre == pytest.approx((-23, -1.5, -14))
    assert view.rotation == pytest.approx(LEVEL)
    for _ in range(2):
        first, second = view.frames
        assert first.picture.shape == (64, 48, 3)
        assert second.picture is None
        assert "000001.jpg" in second.reason
        assert second.time_s == pytest.approx(1 / 9)


@pytest.mark.parametrize(("about", "listed", "words"), [
    (ABOUT.replace("camera", "imu"), LISTED, "a camera is needed"),
    (ABOUT.replace("600.0, 600.0", "600.0, 601.0"), LISTED, "intrinsics must be"),
    (ABOUT.replace("[0.0, 0.0, 0.0, 0.0]", "[0.1, 0.0, 0.0, 0.0]"), LISTED, "without distortion"),
    (ABOUT.replace("[0, 0, 1,", "[0, 0, 2,"), LISTED, "rotation matrix"),
    (ABOUT.replace("[0, 0, 1,", "[.nan, 0, 1,"), LISTED, "finite"),
    (ABOUT, LISTED.replace("000001.jpg", "../000000.jpg"), "row 2"),
    (ABOUT, LISTED.replace("111111111,", "0,"), "time, row 2: must increase"),
    (ABOUT, LISTED.replace("filename", "w_RS_S_x"), "columns must be"),
])  # fmt: skip
def test_a_folder_of_another_kind_is_refused_in_one_line(tmp_path, about, listed, words):
    with pytest.raises(RecordError, match=words) as caught:
        read_view(folder_of(tmp_path, about, listed))
    assert "\n" not in str(caught.value)
