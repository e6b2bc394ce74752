"""The LiDAR's points against the surfaces of the world, its noise, and what the weather takes."""

import numpy as np
import pyarrow.parquet as pq
import pytest
import trimesh
import yaml

import simgrab
from simgrab.dataset import sensors as files
from simgrab.dataset.tables import into
from simgrab.errors import ScenarioError
from simgrab.lab.sensors.lidar import LidarDevice, extinction
from simgrab.model import geometry
from simgrab.model.rng import stream
from simgrab.model.scenario import Draws, Lidar, Weather, variant
from simgrab.world.extensions import Recipe
from simgrab.world.scenery.grabs import design_of
from simgrab.world.scenery.model import NOTHING
from simgrab.world.sensors.device import Setting
from simgrab.world.sensors.motion import motions

PLAIN = {
    "frames": 3, "place": {"model": "plain"}, "display.layout": "none", "swing.start.yaw_deg": 10.0,
    "suspension": {"model": "four-rope", "tilt_ratio": 0.2},
}  # fmt: skip
CLEAN = {"range_noise_m": 0.0, "angle_noise_deg": 0.0, "resolution_m": 0.0, "dropout": 0.0, "clock_offset_ms": 0.0,
         "clock_drift_ppm": 0.0}  # fmt: skip


def scene(weather=None, **keys):
    table = {"model": "lidar", "rings": 40, "columns": 41, **keys}
    return simgrab.load("free-swing", PLAIN | {"sensors": {"lidar0": table}, "weather": weather or {}})


@pytest.fixture(scope="module")
def clean():
    scenario = scene(**CLEAN)
    return scenario, simgrab.sensors(scenario)["lidar0"]


def test_points_lie_on_the_surfaces_that_they_name(clean):
    """The ground's height, and the nearest triangle of the grab's steel in the pose of the frame at that time."""
    scenario, scan = clean
    frames = [frame for frame in range(3) if (abs(scan.true("time [s]") - frame / 9) < 1e-9).any()]
    assert frames == [0]
    now = scan.true("time [s]") == 0.0
    points, ids = scan.values[now, :3], scan.true("id")[now]
    assert {0, 2, 3} <= {*ids}
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), scan.true("range [m]")[now], atol=1e-12)
    platform = points + scan.body_from_sensor[:3, 3]
    np.testing.assert_allclose(platform[ids == 0, 2], 0.0, atol=1e-9)
    jib = platform - (scenario.swing.radius_m, 0.0, scenario.jib.head_height_m)
    from simgrab.world.trajectory.trajectory import Trajectory

    grab, design = Trajectory(scenario).at(0).grab, design_of(scenario.grab)
    own = (jib[ids == 3] - grab.jib_from_grab.translation) @ grab.jib_from_grab.rotation
    placed = design.frames(grab.jaw)
    steel = trimesh.util.concatenate(
        [trimesh.Trimesh(trimesh.transform_points(b.steel.vertices, placed[b.name]), b.steel.faces, process=False)
         for b in design.bodies]
    )  # fmt: skip
    assert len(own) > 20
    _, apart, _ = trimesh.proximity.closest_point_naive(steel, own[::10])
    assert apart.max() < 1e-6  # single precision of the meshes
    ends = grab.jib_from_grab.translation + grab.jib_from_grab.rotation @ design.terminations[0]
    ropes = jib[ids == 2]
    assert ropes[:, 2].min() > ends[2] - 3.0
    assert ropes[:, 2].max() < 0.1


def test_the_moment_that_is_scanned_is_the_frames():
    from simgrab.world.trajectory.trajectory import Trajectory

    busy = {"swing.work": {"model": "cycles", "dig_s": 1.0}, "swing.start.yaw_deg": -20.0, "frames": 20}
    for suspension in ("one-body", "double-pendulum"):
        scenario = simgrab.load("free-swing", PLAIN | busy | {"suspension": {"model": suspension}})
        (motion, *_) = motions(scenario, 0, lambda begin, end: np.array([2.0]) if begin <= 2.0 < end else np.zeros(0))
        found, frame = motion.moment(0), Trajectory(scenario).at(18)
        np.testing.assert_allclose(found.grab.jib_from_grab, frame.grab.jib_from_grab, atol=1e-12)
        np.testing.assert_allclose(found.jib.jib_from_place, frame.jib.jib_from_place, atol=1e-12)
        assert (found.grab.jaw, found.grab.load) == pytest.approx((frame.grab.jaw, frame.grab.load), abs=1e-9)


def scanned(distance=25.0, weather=None, **keys):
    """One scan of a wall that is as far away in every direction, with its truth."""
    sensor = Lidar(rings=60, columns=120, **CLEAN | keys)
    device = LidarDevice(
        sensor, Setting(scene(weather), Draws(), lambda name: stream(1, 0, name), range(1), lambda _: "train")
    )
    true = np.full(7200, distance)
    device.cast = lambda *_: (true, np.zeros(7200, int))
    return device._scan(None, 0)


def test_noise_is_what_is_stated():
    points, truth = scanned(range_noise_m=0.03, dropout=0.2)
    assert len(points) / 7200 == pytest.approx(0.8, abs=0.02)
    off = np.linalg.norm(points[:, :3], axis=1) - truth[:, 0]
    assert off.std() == pytest.approx(0.03, rel=0.04)
    assert abs(off.mean()) < 0.002
    np.testing.assert_array_equal(points, scanned(range_noise_m=0.03, dropout=0.2)[0])
    ranges = np.linalg.norm(scanned(24.98, resolution_m=0.05)[0][:, :3], axis=1)
    np.testing.assert_allclose(ranges, 25.0, atol=1e-12)
    assert len(scanned(101.0)[0]) == len(scanned(0.4)[0]) == 0


@pytest.mark.parametrize("weather", [Weather(rain_mm_h=30.0), Weather(snow_mm_h=4.0), Weather(visibility_m=200.0)])
def test_weather_intercepts_beams_as_beer_and_lambert_have_it(weather):
    keys = {"rain_mm_h": weather.rain_mm_h, "snow_mm_h": weather.snow_mm_h}
    fog = {"visibility_m": weather.visibility_m} if weather.visibility_m else {}
    points, truth = scanned(weather=keys | fog, false_echo=0.3)
    assert len(points) == len(truth)
    gamma = extinction(weather)
    caught = 1 - np.exp(-2 * gamma * 25.0)
    assert 0.02 < caught < 0.7
    assert (truth[:, 1] == 0).sum() / 7200 == pytest.approx(1 - caught, abs=4 * np.sqrt(caught / 7200))
    air = truth[truth[:, 1] == NOTHING, 0]
    assert len(air) / 7200 == pytest.approx(0.3 * caught, abs=4 * np.sqrt(0.3 * caught / 7200))
    # Exponentially less with distance: the mean of a truncated exponential distribution.
    depth = 1 / (2 * gamma)
    mean = depth - 25.0 * (1 - caught) / caught
    assert air.mean() == pytest.approx(mean, abs=4 * 7.3 / np.sqrt(len(air)))
    assert extinction(Weather()) == 0.0


def test_extinction_is_that_of_the_recommendation():
    assert extinction(Weather(rain_mm_h=1.0)) == pytest.approx(1.076 / 4342.94, rel=1e-5)
    assert extinction(Weather(snow_mm_h=1.0)) == pytest.approx(5.545 / 4342.94, rel=1e-5)
    assert extinction(Weather(visibility_m=1000.0)) == pytest.approx(3.912e-3)


def test_files_are_read_back(clean, tmp_path):
    scenario, scan = clean
    names = files.write(Recipe(scenario), into(tmp_path))
    assert sorted(names) == sorted(str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*") if p.is_file())
    data = pq.read_table(tmp_path / "sensors/clip_000/lidar0/data.parquet")
    assert data.column_names == ["timestamp [ns]", "x [m]", "y [m]", "z [m]", "ring"]
    np.testing.assert_array_equal(data["timestamp [ns]"], scan.stamp_ns)
    np.testing.assert_allclose(np.array(data["x [m]"]), scan.values[:, 0], rtol=1e-6, atol=1e-6)
    truth = pq.read_table(tmp_path / "sensors_truth/clip_000/lidar0/truth.parquet")
    np.testing.assert_array_equal(truth["id"], scan.true("id").astype(np.uint8))
    np.testing.assert_array_equal(truth["time [s]"], scan.true("time [s]"))
    about = yaml.safe_load((tmp_path / "sensors/clip_000/lidar0/sensor.yaml").read_text())
    assert about["sensor_type"] == "lidar"
    np.testing.assert_array_equal(np.reshape(about["T_BS"]["data"], (4, 4)), scan.body_from_sensor)
    assert about["elevation_deg"] == [-32.0, 40.0]


def test_a_platform_turns_and_does_not_move():
    imu = {"model": "imu", "mount": "platform", "noise": "none", "rate_hz": 50}
    scenario = simgrab.load("slew-alarm", {"frames": 60, "sensors.imu0": imu})
    read = simgrab.sensors(scenario)["imu0"]
    np.testing.assert_allclose(read.values[:, 3:], np.tile([0, 0, geometry.STANDARD_GRAVITY], (len(read.values), 1)))
    assert np.ptp(read.values[:, 2]) > 0.01
    assert not read.values[:, :2].any()


def test_a_pattern_that_makes_no_sense_is_refused():
    for key, value in (("elevation_deg", (10.0, -10.0)), ("range_m", (5.0, 5.0)), ("position_m", (0.0, 0.0, 500.0))):
        with pytest.raises(ScenarioError, match=key):
            Lidar(**{key: value})
    assert variant(scene(), 0).number == 0
