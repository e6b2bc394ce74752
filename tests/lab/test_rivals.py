"""Each rival recovers the swing where its assumptions hold, and fails where they do not; bad sensors get a reason."""

import functools
from dataclasses import replace

import cv2
import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import simgrab
from simgrab.dataset.tables import calibration_of
from simgrab.errors import CalibrationError, RecordError
from simgrab.instrument.contract import Frame, flaw
from simgrab.instrument.estimate import ZeroTilt
from simgrab.instrument.estimate.chain import linear, prior, state_covariances
from simgrab.instrument.estimate.inertial.readings import ImuReadings
from simgrab.instrument.observation import Observation
from simgrab.lab.rivals import tracking
from simgrab.lab.rivals.camera import conclude, kawai, matsuo, optical_flow, target_angles
from simgrab.lab.rivals.contract import Sensors, Series, Swing, read_series
from simgrab.lab.rivals.inertial import INERTIAL, MOUNT
from simgrab.lab.rivals.kalman import kalman
from simgrab.lab.rivals.lidar import COLUMNS, Scans, clusters, lidar, read_scans
from simgrab.lab.rivals.marks import TAGS, Fiducial, Layered, Mark, circles, level_layers, target
from simgrab.lab.rivals.tracking import flow, template
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import to_camera
from simgrab.model.records.observations import Detection
from simgrab.world.trajectory.trajectory import Trajectory

FRAMES = 180
MOUNTS = ("jib-head", "rope", "grab", "camera")
TURN = {"model": "turn", "rope_length_m": 18.0, "slew_rpm": 0.6, "ramp_s": 6.0, "wait_s": 5.0}
CLIPS = {
    "calm": ("adis16448", {}),
    "exact": ("none", {}),
    "turning": ("adis16448", {"swing.work": TURN}),
    "tilted": ("adis16448", {"camera.beta_deg": 5.0, "camera.tilt_azimuth_deg": 60.0}),
}


@functools.cache
def clip(name):
    """Sensors of a clip of 20 s with a level camera at the rope exit, the frames' times, and the true swing."""
    noise, changes = CLIPS[name]
    sensors = {mount: {"model": "imu", "mount": mount, "noise": noise} for mount in MOUNTS}
    sensors |= {"tilt": {"model": "inclinometer", "mount": "rope"}, "hoist": {"model": "hoist-encoder"}}
    keys = {f"sensors.{name.replace('-', '_')}": sensor for name, sensor in sensors.items()}
    keys |= {f"camera.offset_{axis}_m": 0.0 for axis in "xyz"}
    keys |= {"camera.beta_deg": 0.0, "camera.mount": {"model": "fixed"}, "frames": FRAMES}
    scene = simgrab.load("free-swing", keys | changes)
    recorded = simgrab.sensors(scene)
    imus = {
        mount: ImuReadings(r.stamp_ns / 1e9, r.values[:, :3], r.values[:, 3:], np.eye(3))
        for mount, r in ((mount, recorded[mount.replace("-", "_")]) for mount in MOUNTS)
    }
    tilt, hoist, rope = (recorded[name] for name in ("tilt", "hoist", "rope"))
    time = np.arange(FRAMES) / 9
    true = [np.interp(time, rope.true("time [s]"), rope.true(f"{name} [deg]")) for name in ("alpha", "azimuth")]
    found = Sensors(
        imus, Series(tilt.stamp_ns / 1e9, np.radians(tilt.values)), Series(hoist.stamp_ns / 1e9, hoist.values),
        target=_target(scene, time),
    )  # fmt: skip
    return found, time, np.radians(true)


def _target(scene, time):
    """The grab in pictures, to a third of a pixel, with every tenth frame missing."""
    trajectory = Trajectory(scene)
    moments = [trajectory.at(frame) for frame in range(FRAMES)]
    centres = np.array([m.grab.jib_from_grab.translation for m in moments])
    rotations = np.array([m.tilt.jib_from_camera for m in moments])
    camera = scene.camera
    pixels = camera.intrinsics.project(to_camera(centres, rotations, np.array([0.0, 0.0, 0.0])))
    pixels = pixels + np.random.default_rng(0).normal(0, 1 / 3, pixels.shape)
    places = [
        Observation(t, missed="none") if i % 10 == 9 else Observation(t, centre=(u, v))
        for i, (t, (u, v)) in enumerate(zip(time.tolist(), pixels.tolist(), strict=True))
    ]
    return target_angles(places, calibration_of(scene))


def rmse(found, true):
    """RMSE in degrees over the frames with an angle, which must be most."""
    assert np.isfinite(found.alpha).mean() > 0.9
    return np.degrees(np.sqrt(np.nanmean((found.alpha - true[0]) ** 2)))


@pytest.mark.parametrize(("method", "bound"), [("gyro-pendulum", 0.2), ("schaper", 0.2), ("kim", 0.15), ("jung", 0.15)])
def test_filters_recover_a_free_swing(method, bound):
    sensors, time, true = clip("calm")
    found = INERTIAL[method](sensors, time)
    assert rmse(found, true) < bound
    converged = (time > 5) & (found.reason == "")
    error = np.abs(found.alpha - true[0])[converged]
    assert np.degrees(error.max()) < 2 * bound
    assert np.degrees(np.median(found.sd[converged])) < bound
    if method in ("schaper", "kim", "jung"):  # whose axes are those of the jib
        turn = np.angle(np.exp(1j * (found.azimuth - true[1])))[converged & (true[0] > np.radians(3))]
        assert np.degrees(np.abs(turn).max()) < 3


def test_an_accelerometer_on_the_grab_measures_next_to_nothing():
    sensors, time, true = clip("exact")
    nothing = np.degrees(np.sqrt(np.mean(true[0] ** 2)))
    lean = np.stack([true[0] * np.cos(true[1]), true[0] * np.sin(true[1])]).ravel()
    gains = {}
    for mount in ("grab", "rope"):
        found = INERTIAL[f"accelerometer-{mount}"](sensors, time)
        seen = np.stack([found.alpha * np.cos(found.azimuth), found.alpha * np.sin(found.azimuth)]).ravel()
        gains[mount] = lean @ seen / (lean @ lean)
    assert abs(gains["grab"]) < 0.15
    assert 0.9 < gains["rope"] < 1
    assert rmse(INERTIAL["accelerometer-grab"](sensors, time), true) > 0.8 * nothing
    assert rmse(INERTIAL["accelerometer-rope"](sensors, time), true) < 0.3


def test_attitude_systems_on_the_grab_follow_its_apparent_gravity():
    pytest.importorskip("imufusion")
    sensors, time, true = clip("exact")
    assert rmse(INERTIAL["ahrs-grab"](sensors, time), true) > 1
    assert rmse(INERTIAL["gao"](sensors, time), true) > 1


def test_only_who_knows_the_pivots_acceleration_stays_right_when_the_jib_moves():
    sensors, time, true = clip("turning")
    assert rmse(INERTIAL["kim"](sensors, time), true) < 0.15
    for method in ("gyro-pendulum", "schaper", "jung"):
        assert rmse(INERTIAL[method](sensors, time), true) > 0.25


def test_jung_finds_a_tilt_that_the_template_takes_for_swing():
    sensors, time, true = clip("tilted")
    assert rmse(INERTIAL["jung"](sensors, time), true) < 0.2
    level = Swing.of(sensors.target.at(time))
    assert rmse(level, true) > 3


@pytest.mark.parametrize("method", INERTIAL)
def test_without_its_sensors_a_method_says_which_it_needs(method):
    if method in ("gao", "ahrs-grab"):
        pytest.importorskip("imufusion")
    found = INERTIAL[method](Sensors(), np.arange(3.0))
    assert np.isnan(found.alpha).all()
    assert all("needed" in reason for reason in found.reason)
    assert all(m.status == "refused" for m in found.measurements())


@pytest.mark.parametrize("method", ["accelerometer-rope", "schaper", "gyro-pendulum", "kim", "jung"])
def test_gaps_jumping_clocks_and_other_times_give_reasons(method):
    sensors, time, true = clip("calm")
    heard = {}
    for mount, imu in sensors.imus.items():
        kept = (imu.time < 9) | (imu.time > 10)  # rows are missing
        heard[mount] = ImuReadings(imu.time[kept], imu.rate[kept], imu.force[kept], np.eye(3))
    found = INERTIAL[method](replace(sensors, imus=heard), np.append(time, [time[-1] + 5, -5.0]))
    gone = (time > 9.1) & (time < 9.9)
    assert (found.reason[:-2][gone] == "the sensor was silent").all()
    assert "after" in found.reason[-2] or "last" in found.reason[-2]
    assert "before" in found.reason[-1] or "last" in found.reason[-1]
    assert np.isfinite(found.alpha[:-2][~gone]).mean() > 0.9
    if method != "accelerometer-rope":
        late = (time > 12) & (found.reason[:-2] == "")
        assert np.degrees(np.abs(found.alpha[:-2] - true[0])[late].max()) < 0.6
    assert all(not flaw(m) for m in found.measurements())
    other = {mount: replace(imu, time=imu.time + 1000) for mount, imu in sensors.imus.items()}
    nothing = INERTIAL[method](replace(sensors, imus=other), time)
    assert np.isnan(nothing.alpha).all()
    assert (nothing.reason != "").all()


def test_readings_that_cannot_be_are_refused(tmp_path):
    time, values = np.arange(4.0), np.ones((4, 1))
    with pytest.raises(RecordError, match="row 3: a finite number"):
        Series(time, np.array([[1.0], [1.0], [np.nan], [1.0]]))
    with pytest.raises(RecordError, match="row 3: must increase"):
        Series(np.array([0.0, 1.0, 0.5, 2.0]), values)
    with pytest.raises(RecordError, match="shapes"):
        Series(time, np.ones((3, 1)))
    short = Sensors(imus={"rope": None}, rope=Series(time, -values))
    assert "row 1: must be above 0 m" in INERTIAL["schaper"](short, time).reason[0]
    with pytest.raises(RecordError, match="time must hold finite numbers"):
        INERTIAL["kim"](Sensors(), np.array([0.0, np.nan]))
    file = tmp_path / "data.csv"
    file.write_text("#timestamp [ns],tilt_x [deg],tilt_y [deg]\n0,1,2\n100000000,3,4\n")
    read = read_series(tmp_path, "tilt_x [deg]", "tilt_y [deg]")
    assert read.time.tolist() == [0, 0.1]
    assert np.degrees(read.values) == pytest.approx(np.array([[1, 2], [3, 4]]))
    with pytest.raises(RecordError, match=r"data.csv: column 'rope_length \[m\]' is missing"):
        read_series(tmp_path, "rope_length [m]")


def test_the_filter_ends_where_the_whole_chain_does():
    rng = np.random.default_rng(0)
    n, step, reading = 12, np.array([[1.0, 0.1], [-0.3, 0.95]]), np.array([[1.0, 0.5], [0.0, 1.0]])
    readings, drive = rng.normal(size=(n, 2)), rng.normal(size=(n, 2))
    readings[3, 0] = readings[7] = np.nan
    start, start_sd, reading_sd = np.array([0.3, -0.2]), np.array([2.0, 3.0]), np.array([0.5, 0.7])
    steps, noise, known = np.tile(step, (n, 1, 1)), np.full((n, 2), 0.04), np.full((n, 2), 0.1)
    states, covariances = kalman(readings, start_sd, steps, noise, reading, reading_sd, start, drive, known)
    none, of_first = np.zeros((n, 2, 0)), np.zeros((n, 2))
    of_first[0] = start_sd**-2
    seen = np.isfinite(readings) / reading_sd**2
    best = (
        linear(-steps[:-1], none[1:], drive[:-1], np.tile(np.eye(2) / 0.04, (n - 1, 1, 1)), np.tile(
            np.eye(2), (n - 1, 1, 1)))
        + linear(np.tile(reading, (n, 1, 1)), none, np.nan_to_num(readings - 0.1), seen[..., None] * np.eye(2))
        + prior(np.tile(-start, (n, 1)), of_first, np.zeros(0), np.zeros(0))
    ).minimise()  # fmt: skip
    assert states[-1] == pytest.approx(best.states[-2:], abs=1e-10)
    assert covariances[-1] == pytest.approx(state_covariances(best, 2)[-1], abs=1e-10)


SIDE, CENTRE = 64, np.array([150.3, 110.8])


def pictures(shifts, lost=()):
    """A patch of noise that moves by parts of a pixel over another that does not; and its centres."""
    rng = np.random.default_rng(1)
    behind, patch = (
        cv2.GaussianBlur(rng.integers(0, 255, size, dtype=np.uint8), (0, 0), 2) for size in ((240, 320), (SIDE, SIDE))
    )
    frames = []
    for i, shift in enumerate(shifts):
        move = np.array([[1, 0, 0], [0, 1, 0]], float)
        move[:, 2] = CENTRE + shift - SIDE / 2  # both have the corner of a pixel as origin
        on = cv2.warpAffine(patch, move, (320, 240))
        mask = cv2.warpAffine(np.full((SIDE, SIDE), 255, np.uint8), move, (320, 240)) == 255
        grey = np.where(mask, on, behind // 2)
        frames.append(
            Frame(None, i / 9, "cut off") if i in lost else Frame(np.repeat(grey[..., None], 3, axis=2), i / 9)
        )
    return frames, CENTRE + shifts


class Start:
    """Finds the patch where it is at first."""

    name = "start"

    def __call__(self, picture):
        if not picture.any():
            return Detection("none", "empty", 0.0)
        half = SIDE / 2
        return Detection("found", "", 1.0, np.array([*(CENTRE - half), *(CENTRE + half)]), CENTRE)


@pytest.fixture(autouse=True)
def _detected(monkeypatch):
    monkeypatch.setattr(tracking, "detector", Start)


SHIFTS = 25 * np.stack([np.sin(np.arange(40) / 9), np.cos(np.arange(40) / 9) - 1], axis=-1)


@pytest.mark.parametrize(
    ("tracker", "bound"),
    [(template(), 0.15), (template(0.1), 0.3), (flow(), 1.5)],  # flow drifts
)
def test_trackers_follow_a_patch_to_parts_of_a_pixel(tracker, bound):
    frames, true = pictures(SHIFTS, lost=(7,))
    frames.insert(0, Frame(np.zeros((240, 320, 3), np.uint8), -0.1))
    places = list(tracker(frames))
    assert places[0].missed
    assert places[8].lost == "cut off"
    seen = [place.centre for place in places[1:8] + places[9:]]
    assert np.abs(np.array(seen) - np.delete(true, 7, axis=0)).max() < bound


@pytest.mark.parametrize("tracker", [template(), flow()])
def test_trackers_miss_a_target_that_is_gone(tracker):
    frames, _ = pictures(SHIFTS[:3])
    rng = np.random.default_rng(2)
    frames += [Frame(rng.integers(0, 255, (240, 320, 3), dtype=np.uint8), 1 + i) for i in range(2)]
    places = list(tracker(frames))
    assert (
        [bool(place.missed) for place in places]
        == [place.centre is None for place in places]
        == [False] * 3 + [True] * 2
    )


CAMERA_FILE = Calibration(width_px=320, height_px=240, focal_length_px=400.0, cx_px=160.0, cy_px=120.0)


def test_a_template_measures_the_angle_from_the_optical_axis():
    frames, true = pictures(SHIFTS, lost=(5,))
    found = kawai()(frames, CAMERA_FILE)
    alpha = np.arctan(np.hypot(*(true - (160, 120)).T) / 400)
    assert [m.status for m in found] == ["lost" if i == 5 else "ok" for i in range(len(frames))]
    assert [m.alpha for i, m in enumerate(found) if i != 5] == pytest.approx(np.delete(alpha, 5), abs=np.radians(0.03))
    assert all(not flaw(m) for m in found)


def test_methods_by_name_are_instruments():
    for name, factory in {"kawai": kawai, "matsuo": matsuo, "optical-flow": optical_flow}.items():
        assert factory().name == name
        assert factory()([Frame(None, 0.0, "cut off")], CAMERA_FILE)[0].status == "lost"


def test_an_estimator_without_its_rope_refuses_with_the_reason():
    frames, _ = pictures(SHIFTS[:5])
    found = optical_flow()(frames, CAMERA_FILE)
    assert {m.status for m in found} == {"refused"}
    assert "needs rope lengths" in found[0].reason
    short = conclude([Observation(0.0, centre=(160.0, 120.0))], CAMERA_FILE, ZeroTilt())
    assert short[0].status == "refused"
    assert "fewer than" in short[0].reason
    with pytest.raises(RecordError, match="fewer than two"):
        target_angles([Observation(0.0, missed="none")], CAMERA_FILE)


def circled(centre, side=40.0, radius=12.0):
    """A white plate with four black circles on grey, drawn eight times as large; and its middle."""
    scale = 8
    large = np.full((240 * scale, 320 * scale, 3), 90, np.uint8)
    x, y = np.array(centre) * scale
    half = side * scale
    cv2.rectangle(large, (int(x - half), int(y - half)), (int(x + half), int(y + half)), (255, 255, 255), -1)
    for dx in (-0.5, 0.5):
        for dy in (-0.5, 0.5):
            spot = int(x + dx * half), int(y + dy * half)
            cv2.circle(large, spot, int(radius * scale), (0, 0, 0), -1)
    return cv2.resize(large, (320, 240), interpolation=cv2.INTER_AREA)


def test_circles_and_target_are_found_to_parts_of_a_pixel():
    found = circles(circled((150.25, 110.5)))
    assert found.pixel == pytest.approx((150.25, 110.5), abs=0.2)
    assert found.side_px == pytest.approx(40, rel=0.03)
    nothing = np.full((240, 320, 3), 90, np.uint8)
    assert circles(nothing) is None
    assert target(nothing) is None
    large = np.full((960, 1280, 3), 90, np.uint8)
    cv2.circle(large, (400, 500), 40, (255, 40, 10), -1)
    spot = target(cv2.resize(large, (320, 240), interpolation=cv2.INTER_AREA))
    assert spot.pixel == pytest.approx((100.1, 125.1), abs=0.2)
    assert spot.side_px == pytest.approx(20, rel=0.1)


def test_layers_take_out_a_tilt_that_is_taken_for_swing_without_them():
    rope = Series(np.array([0.0, 10.0]), np.array([[20.0], [20.0]]))
    level = level_layers(CAMERA_FILE, np.array([0.0, 0.0, 1.5]), 0.5, [10, 20, 30])
    assert level[20] == Mark((160.0, 120.0), pytest.approx(400 * 0.5 / 18.5))
    swing = np.radians(4)
    u, v = level[20].pixel
    frames = [
        Frame(np.zeros((4, 4, 3), np.uint8), 1.0),
        Frame(None, 2.0, "cut off"),
        Frame(np.ones((4, 4, 3), np.uint8), 3.0),
    ]
    for tilt in (0.0, np.radians(5)):
        shift = 400 * np.tan(tilt)

        def find(picture, shift=shift):
            return None if picture.any() else Mark((u + shift + 400 * np.tan(swing), v), level[20].side_px)

        rest = {length: Mark((mark.pixel[0] + shift, v), mark.side_px) for length, mark in level.items()}
        with_layers = Layered("x", find, rest, 0.5, 1.5, rope)(frames, CAMERA_FILE)
        assert [m.status for m in with_layers] == ["ok", "lost", "missed"]
        assert with_layers[0].alpha == pytest.approx(swing, abs=1e-6)
        without = Layered("x", find, level, 0.5, 1.5, rope)(frames, CAMERA_FILE)
        assert abs(without[0].alpha - swing - tilt) < np.radians(0.2)
    with pytest.raises(CalibrationError, match="increasing rope lengths"):
        Layered("x", find, dict(reversed(level.items())), 0.5, 1.5, rope)


def test_a_tag_gives_the_swing_of_its_plate():
    tag = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(TAGS), 0, 400)
    size, place, alpha, azimuth = 0.8, np.array([1.0, -0.45, 0.0]), np.radians(5), np.radians(30)
    end = 16 * np.array([np.sin(alpha) * np.cos(azimuth), np.sin(alpha) * np.sin(azimuth), -np.cos(alpha)])
    half = size / 2 * 1.25
    corners = np.array([[half, half, 0], [half, -half, 0], [-half, -half, 0], [-half, half, 0]]) + place + end
    camera = msgspec.structs.replace(
        CAMERA_FILE, width_px=960, height_px=720, focal_length_px=1200.0, cx_px=480.0, cy_px=360.0
    )
    seen = corners @ MOUNT  # in the frame of an untilted camera
    pixels = (seen[:, :2] / seen[:, 2:] * 1200 + (480, 360)).astype(np.float32)
    plate = cv2.copyMakeBorder(tag, 50, 50, 50, 50, cv2.BORDER_CONSTANT, value=255)
    # The tag's top is towards the grab's x, its right towards −y.
    source = np.array([[0, 0], [500, 0], [500, 500], [0, 500]], np.float32)
    turn = cv2.getPerspectiveTransform(source - 0.5, 4 * pixels[[0, 1, 2, 3]] - 0.5)
    large = cv2.warpPerspective(plate, turn, (3840, 2880), borderValue=128)
    picture = np.repeat(cv2.resize(large, (960, 720), interpolation=cv2.INTER_AREA)[..., None], 3, axis=2)
    frames = [Frame(picture, 0.0), Frame(np.full_like(picture, 128), 0.1), Frame(None, 0.2, "cut off")]
    found = Fiducial(size, tuple(place))(frames, camera)
    assert [m.status for m in found] == ["ok", "missed", "lost"]
    assert np.degrees(found[0].alpha) == pytest.approx(5, abs=0.2)


def scan(alpha, rng):
    """Echoes of a jib's end, four ropes and a box of 2.5 m that hangs 18 m below O, on the side of the LiDAR."""
    jib = rng.uniform((17, -1.4, 27.5), (26, 1.4, 28.5), (130, 3))
    face = rng.uniform((-1.2, -1.2, -1.5), (-1.1, 1.2, 1.5), (130, 3))
    top = (25.0, 0.0, 28.0)
    lean = np.array([np.sin(alpha), 0.0, -np.cos(alpha)])
    ropes = top + rng.uniform(1, 16, (40, 1)) * lean + rng.choice([-0.5, 0.5], (40, 3)) * (1, 1, 0)
    ground = rng.uniform((10, -20, -0.1), (60, 20, 0.1), (300, 3))
    return np.concatenate([jib, top + 18 * lean + face, ropes, ground]) + rng.normal(0, 0.02, (600, 3))


def test_a_lidar_recovers_a_swing_and_says_what_it_misses():
    rng, time = np.random.default_rng(0), np.arange(0, 20, 0.1)
    true = np.radians(6) * np.cos(np.sqrt(9.80665 / 18.4) * time)
    scans = Scans(time, tuple(scan(a, rng) for a in true))
    rest = Scans(np.arange(5.0), tuple(scan(0.0, rng) for _ in range(5)))
    found = lidar(scans, rest, time, 28.0)
    converged = time > 3
    assert (found.reason[converged] == "").all()
    error = np.degrees(found.alpha - np.abs(true))[converged]
    assert np.sqrt(np.mean(error**2)) < 0.3
    nothing = tuple(points[:0] for points in scans.points)
    assert "no cluster of the jib's end" in lidar(Scans(time, nothing), rest, time, 28.0).reason[0]
    assert "at rest there is no cluster" in lidar(scans, Scans(time, nothing), time, 28.0).reason[0]
    gap = np.flatnonzero((time < 8) | (time > 12))
    sparse = lidar(Scans(time[gap], tuple(scans.points[i] for i in gap)), rest, time, 28.0)
    assert (sparse.reason[(time > 8.1) & (time < 11.9)] == "the sensor was silent").all()


def test_scans_that_cannot_be_are_refused(tmp_path):
    stamps, points = np.array([0, 0, 100], np.int64), np.array([[1.0, 2, 3], [np.nan, 0, 0], [4, 5, 6]])
    scans = Scans.of(stamps, points, np.eye(4))
    assert [len(p) for p in scans.points] == [1, 1]
    with pytest.raises(RecordError, match="row 3: must not decrease"):
        Scans.of(np.array([0, 100, 50], np.int64), points, np.eye(4))
    with pytest.raises(RecordError, match="scan 2: must increase"):
        Scans(np.array([1.0, 0.0]), (points, points))
    (tmp_path / "data.parquet").write_bytes(b"nothing")
    with pytest.raises(RecordError, match=r"data.parquet: it cannot be read as scans"):
        read_scans(tmp_path, np.eye(4))
    for column, values, why in (("x [m]", ["a", "b"], "it cannot be read as scans"), (COLUMNS[0], [None, 2], "row 1")):
        rows = {key: [1, 2] for key in COLUMNS} | {column: values}
        pq.write_table(pa.table(rows), tmp_path / "data.parquet")
        with pytest.raises(RecordError, match=rf"data.parquet: .*{why}"):
            read_scans(tmp_path, np.eye(4))


def test_clusters_leave_sparse_points_out():
    rng = np.random.default_rng(0)
    ball = rng.normal(0, 0.2, (60, 3))
    far = rng.normal(0, 0.2, (30, 3)) + (5, 0, 0)
    line = np.stack([np.linspace(0.8, 4.2, 6), np.zeros(6), np.zeros(6)], axis=-1)
    found = clusters(np.concatenate([far, line, ball]), 0.7, 10)
    assert [len(rows) >= n for rows, n in zip(found, (58, 28), strict=True)] == [True, True]
    assert set(range(32, 34)) & {row for rows in found for row in rows.tolist()} == set()
    assert clusters(ball[:3], 0.7, 10) == []
