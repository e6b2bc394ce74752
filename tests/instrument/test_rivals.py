"""Each rival recovers the swing where its assumptions hold, and fails where they do not; bad sensors get a reason."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

import simgrab
from simgrab.calibration import Calibration
from simgrab.errors import RecordError
from simgrab.geometry import to_camera
from simgrab.instrument.contract import Frame, flaw
from simgrab.instrument.estimate import PendulumSmoother, ZeroTilt
from simgrab.instrument.estimate.inertial.readings import ImuReadings
from simgrab.instrument.rivals.camera import CAMERA, Tracked, conclude, kawai, sight
from simgrab.instrument.rivals.contract import Sensors, Series, Swing, read_series
from simgrab.instrument.rivals.inertial import INERTIAL
from simgrab.instrument.rivals.kalman import Model, kalman
from simgrab.instrument.rivals.tracking import Place, flow, template
from simgrab.records.observations import Detection
from simgrab.world.output.tables import calibration_of
from simgrab.world.trajectory.trajectory import Trajectory

FRAMES = 180
MOUNTS = ("jib-head", "rope", "grab", "camera")
TURNING = {"swing.work": {"model": "turn", "rope_length_m": 18.0, "slew_rpm": 0.6, "ramp_s": 6.0, "wait_s": 5.0}}


def clip(noise, **changes):
    """Sensors of a clip of 20 s with a level camera at the rope exit, the frames' times, and the true swing."""
    sensors = {mount: {"model": "imu", "mount": mount, "noise": noise} for mount in MOUNTS}
    sensors |= {"tilt": {"model": "inclinometer", "mount": "rope"}, "hoist": {"model": "hoist-encoder"}}
    keys = {f"sensors.{name.replace('-', '_')}": sensor for name, sensor in sensors.items()}
    keys |= {f"camera.offset_{axis}_m": 0.0 for axis in "xyz"}
    keys |= {"camera.beta_deg": 0.0, "camera.mount": {"model": "fixed"}, "frames": FRAMES}
    scene = simgrab.load("free-swing", keys | {key.replace("__", "."): value for key, value in changes.items()})
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
    centres = np.array([m.grab.jib_from_grab[:3, 3] for m in moments])
    rotations = np.array([m.tilt.jib_from_camera for m in moments])
    camera = scene.camera
    pixels = camera.intrinsics.project(to_camera(centres, rotations, np.array([0.0, 0.0, 0.0])))
    pixels = pixels + np.random.default_rng(0).normal(0, 1 / 3, pixels.shape)
    places = [
        Place(t, None if i % 10 == 9 else (u, v), "missed" if i % 10 == 9 else "ok", "none" if i % 10 == 9 else "")
        for i, (t, (u, v)) in enumerate(zip(time.tolist(), pixels.tolist(), strict=True))
    ]
    return sight(places, calibration_of(scene))


@pytest.fixture(scope="module")
def calm():
    return clip("adis16448")


@pytest.fixture(scope="module")
def exact():
    return clip("none")


@pytest.fixture(scope="module")
def turning():
    return clip("adis16448", **{key.replace(".", "__"): value for key, value in TURNING.items()})


def rmse(found, true):
    """RMSE in degrees over the frames with an angle, which must be most."""
    assert np.isfinite(found.alpha).mean() > 0.9
    return np.degrees(np.sqrt(np.nanmean((found.alpha - true[0]) ** 2)))


@pytest.mark.parametrize(("method", "bound"), [("gyro-pendulum", 0.2), ("schaper", 0.2), ("kim", 0.15), ("jung", 0.15)])
def test_filters_recover_a_free_swing(calm, method, bound):
    sensors, time, true = calm
    found = INERTIAL[method](sensors, time)
    assert rmse(found, true) < bound
    settled = (time > 5) & (found.reason == "")
    error = np.abs(found.alpha - true[0])[settled]
    assert np.degrees(error.max()) < 2 * bound
    assert np.degrees(np.median(found.sd[settled])) < bound
    if method in ("schaper", "kim", "jung"):  # whose axes are those of the jib
        turn = np.angle(np.exp(1j * (found.azimuth - true[1])))[settled & (true[0] > np.radians(3))]
        assert np.degrees(np.abs(turn).max()) < 3


def test_an_accelerometer_on_the_grab_measures_next_to_nothing(exact):
    sensors, time, true = exact
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


def test_attitude_systems_on_the_grab_follow_its_apparent_gravity(exact):
    pytest.importorskip("imufusion")
    sensors, time, true = exact
    assert rmse(INERTIAL["ahrs-grab"](sensors, time), true) > 1
    assert rmse(INERTIAL["gao"](sensors, time), true) > 1


def test_only_who_knows_the_pivots_acceleration_stays_right_when_the_jib_moves(turning):
    sensors, time, true = turning
    assert rmse(INERTIAL["kim"](sensors, time), true) < 0.15
    for method in ("gyro-pendulum", "schaper", "jung"):
        assert rmse(INERTIAL[method](sensors, time), true) > 0.25


def test_jung_finds_a_tilt_that_the_template_takes_for_swing():
    sensors, time, true = clip("adis16448", camera__beta_deg=5.0, camera__tilt_azimuth_deg=60.0)
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
def test_gaps_jumping_clocks_and_other_times_give_reasons(calm, method):
    sensors, time, true = calm
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


def test_the_filter_ends_at_the_least_squares_solution():
    rng = np.random.default_rng(0)
    n, advance, reading = 12, np.array([[1.0, 0.1], [-0.3, 0.95]]), np.array([[1.0, 0.5], [0.0, 1.0]])
    readings = rng.normal(size=(n, 2))
    readings[3, 0] = readings[7] = np.nan
    drive = rng.normal(size=(n, 2))
    model = Model(
        np.array([0.3, -0.2]), np.array([2.0, 3.0]), np.tile(advance, (n, 1, 1)), drive, np.full((n, 2), 0.04),
        reading, np.full((n, 2), 0.1), np.array([0.5, 0.7]),
    )  # fmt: skip
    states, covariances = kalman(model, readings)
    rows, right = [], []
    for axis in range(2):
        row = np.zeros((n, 2))
        row[0, axis] = 1 / model.start_sd[axis]
        rows.append(row.ravel())
        right.append(model.start[axis] / model.start_sd[axis])
    for i in range(n):
        for axis in range(2):
            if np.isfinite(readings[i, axis]):
                row = np.zeros((n, 2))
                row[i] = reading[axis] / model.reading_sd[axis]
                rows.append(row.ravel())
                right.append((readings[i, axis] - 0.1) / model.reading_sd[axis])
            if i < n - 1:
                row = np.zeros((n, 2))
                row[i + 1, axis] = 1 / 0.2
                row[i] -= advance[axis] / 0.2
                rows.append(row.ravel())
                right.append(drive[i, axis] / 0.2)
    whole = np.array(rows)
    best = np.linalg.solve(whole.T @ whole, whole.T @ np.array(right))
    assert states[-1] == pytest.approx(best[-2:], abs=1e-10)
    assert covariances[-1] == pytest.approx(np.linalg.inv(whole.T @ whole)[-2:, -2:], abs=1e-10)


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


SHIFTS = 25 * np.stack([np.sin(np.arange(40) / 9), np.cos(np.arange(40) / 9) - 1], axis=-1)


@pytest.mark.parametrize(
    ("tracker", "bound"),
    [(template(0.0, Start()), 0.15), (template(0.1, Start()), 0.3), (flow(Start()), 1.5)],  # flow drifts
)
def test_trackers_follow_a_patch_to_parts_of_a_pixel(tracker, bound):
    frames, true = pictures(SHIFTS, lost=(7,))
    frames.insert(0, Frame(np.zeros((240, 320, 3), np.uint8), -0.1))
    places = list(tracker(frames))
    assert places[0].status == "missed"
    assert places[8].status == "lost"
    assert places[8].reason == "cut off"
    seen = [place.pixel for place in places[1:8] + places[9:]]
    assert np.abs(np.array(seen) - np.delete(true, 7, axis=0)).max() < bound


@pytest.mark.parametrize("tracker", [template(0.0, Start()), flow(Start())])
def test_trackers_miss_a_target_that_is_gone(tracker):
    frames, _ = pictures(SHIFTS[:3])
    rng = np.random.default_rng(2)
    frames += [Frame(rng.integers(0, 255, (240, 320, 3), dtype=np.uint8), 1 + i) for i in range(2)]
    places = list(tracker(frames))
    assert [place.status for place in places] == ["ok", "ok", "ok", "missed", "missed"]
    assert all(place.reason for place in places[3:])


CAMERA_FILE = Calibration(width_px=320, height_px=240, focal_length_px=400.0, cx_px=160.0, cy_px=120.0)


def test_a_template_measures_the_angle_from_the_optical_axis():
    frames, true = pictures(SHIFTS, lost=(5,))
    instrument = replace(kawai(), tracker=template(0.0, Start()))
    found = instrument(frames, CAMERA_FILE)
    alpha = np.arctan(np.hypot(*(true - (160, 120)).T) / 400)
    assert [m.status for m in found] == ["lost" if i == 5 else "ok" for i in range(len(frames))]
    assert [m.alpha for i, m in enumerate(found) if i != 5] == pytest.approx(np.delete(alpha, 5), abs=np.radians(0.03))
    assert all(not flaw(m) for m in found)


def test_methods_by_name_are_instruments():
    assert set(CAMERA) == {"kawai", "matsuo", "optical-flow"}
    for name, factory in CAMERA.items():
        assert factory().name == name
        assert factory()([Frame(None, 0.0, "cut off")], CAMERA_FILE)[0].status == "lost"


def test_an_estimator_without_its_rope_refuses_with_the_reason():
    frames, _ = pictures(SHIFTS[:5])
    found = Tracked("x", template(0.0, Start()), PendulumSmoother())(frames, CAMERA_FILE)
    assert {m.status for m in found} == {"refused"}
    assert "needs rope lengths" in found[0].reason
    short = conclude([Place(0.0, (160.0, 120.0))], CAMERA_FILE, ZeroTilt())
    assert short[0].status == "refused"
    assert "fewer than" in short[0].reason
    with pytest.raises(RecordError, match="fewer than two"):
        sight([Place(0.0, None, "missed", "none")], CAMERA_FILE)
