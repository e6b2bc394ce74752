"""Files of sensors: read back by a reader of EuRoC's layout that shares no code with what wrote them."""

import csv
import json
import shutil

import numpy as np
import pytest
from conftest import digests, small_scene

import simgrab
from simgrab.dataset import sensor_files
from simgrab.dataset.export import export
from simgrab.errors import DatasetError
from simgrab.instrument.controller_file import read_controller
from simgrab.judge.audit.audit import _manifest_proof, _read
from simgrab.model.scenario import HoistEncoder, Imu, Inclinometer, LuffEncoder, SlewEncoder

yaml = pytest.importorskip("yaml")

SENSORS = {
    "imu0": {"model": "imu", "mount": "grab"},
    "imu1": {"model": "imu", "mount": "camera", "noise": "mems", "rate_hz": 100.0},
    "tilt": {"model": "inclinometer", "mount": "jib-head"},
    "hoist": {"model": "hoist-encoder"},
    "plc": {"model": "controller", "clock_offset_ms": 0.0},
}


def euroc(folder):
    """Read a sensor's folder as EuRoC's development kit does: time stamps, values, and the description."""
    with (folder / "data.csv").open(newline="") as file:
        header, *rows = csv.reader(file)
    assert header[0] == "#timestamp [ns]"
    stamps = np.array([int(row[0]) for row in rows])
    values = np.array([[float(cell) for cell in row[1:]] for row in rows])
    return stamps, values, header[1:], yaml.safe_load((folder / "sensor.yaml").read_text())


def sensor_digests(folder):
    return {file: digest for file, digest in digests(folder).items() if file.startswith("sensors")}


@pytest.fixture(scope="module")
def scene():
    return small_scene("work-cycles", frames=4, clip__clip_frames=2, display__layout="none", sensors=SENSORS)


@pytest.fixture(scope="module")
def rendered(scene, tmp_path_factory):
    path = tmp_path_factory.mktemp("sensors") / "small"
    simgrab.render(scene, path)
    return path


IMU = [
    "w_RS_S_x [rad s^-1]", "w_RS_S_y [rad s^-1]", "w_RS_S_z [rad s^-1]",
    "a_RS_S_x [m s^-2]", "a_RS_S_y [m s^-2]", "a_RS_S_z [m s^-2]",
]  # fmt: skip
HEADERS = {"imu0": IMU, "imu1": IMU, "hoist": ["rope_length [m]"], "tilt": ["tilt_x [deg]", "tilt_y [deg]"]}


def test_files_are_read_back_as_eurocs(rendered, scene):
    for clip in range(2):
        recorded = simgrab.sensors(scene, clip)
        for name, columns in HEADERS.items():
            stamps, values, header, about = euroc(rendered / f"sensors/clip_{clip:03d}/{name}")
            np.testing.assert_array_equal(stamps, recorded[name].stamp_ns)
            np.testing.assert_array_equal(values, recorded[name].values)
            assert header == columns
            if not name.startswith("imu"):
                assert about["sensor_type"] == {"tilt": "inclinometer", "hoist": "encoder"}[name]
                continue
            rate = {"imu0": 200, "imu1": 100}[name]
            assert len(stamps) == pytest.approx(2 / 9 * rate, abs=1)
            assert np.diff(stamps) == pytest.approx(1e9 / rate, abs=1)
            assert about["rate_hz"] == rate
            pose = about["T_BS"]
            data = np.array(pose["data"]).reshape(pose["rows"], pose["cols"])
            np.testing.assert_array_equal(data, recorded[name].body_from_sensor)
            # Below the ropes' ends, in the grab's frame.
            assert data[2, 3] == pytest.approx(1.64 if name == "imu0" else 0, abs=0.001)
    _, _, _, about = euroc(rendered / "sensors/clip_000/hoist")
    assert about["resolution_m"] == 0.005
    _, _, _, about = euroc(rendered / "sensors/clip_000/imu0")
    assert {key: about[key] for key in about if "scope" in key or "meter" in key} == {
        "gyroscope_noise_density": 1.6968e-4, "gyroscope_random_walk": 1.9393e-5,
        "accelerometer_noise_density": 2.0e-3, "accelerometer_random_walk": 3.0e-3,
    }  # fmt: skip


def test_the_controllers_data_are_read_by_the_instrument_and_so_are_encoders(rendered, scene, tmp_path):
    recorded = simgrab.sensors(scene, 1)
    found, plc = read_controller(rendered / "sensors/clip_001/plc"), recorded["plc"]
    np.testing.assert_allclose(found.time, plc.stamp_ns / 1e9 - 0.1)
    assert np.abs(found.time - plc.true("time [s]")).max() < 0.05  # the jitter
    np.testing.assert_allclose(np.degrees(found.slew), plc.values[:, 0])
    np.testing.assert_allclose([found.radius, found.rope], plc.values[:, 1:3].T)
    np.testing.assert_allclose(found.wind, np.column_stack([found.time, plc.values[:, 3]]))
    np.testing.assert_allclose(found.load, np.column_stack([found.time, 1000 * plc.values[:, 4]]))
    assert found.notes == ()
    shutil.copy(rendered / "sensors/clip_001/hoist/data.csv", tmp_path / "hoist.csv")
    (tmp_path / "crane.toml").write_text("""
        time = {column = "#timestamp [ns]", unit = "ns"}
        rope = {column = "rope_length [m]", resolution = 0.005, rate_hz = 20.0, file = "hoist.csv"}
        radius = {column = "rope_length [m]", resolution = 0.005, rate_hz = 20.0, file = "hoist.csv"}
    """)
    bare = read_controller(tmp_path / "crane.toml")
    np.testing.assert_allclose(bare.rope, recorded["hoist"].values[:, 0])
    for name in ("rope", "radius"):
        assert sum(f"{name}.constant_m is not stated, and taken as 0" in note for note in bare.notes) == 1


def test_truth_lies_apart_and_agrees_with_the_labels(rendered, scene):
    names = {path.name for path in (rendered / "sensors").rglob("*") if path.is_file()}
    assert names == {"data.csv", "sensor.yaml", "data.toml"}
    with (rendered / "sensors_truth/clip_001/imu0/truth.csv").open(newline="") as file:
        header, *rows = csv.reader(file)
    truth = np.array(rows, float)
    recorded = simgrab.sensors(scene, 1)["imu0"]
    assert header[1:] == list(recorded.truth_columns)
    np.testing.assert_array_equal(truth[:, 1:], recorded.truth)
    np.testing.assert_array_equal(truth[:, 0], recorded.stamp_ns)
    time, alpha = truth[:, header.index("time [s]")], truth[:, header.index("alpha [deg]")]
    for frame in simgrab.open(rendered):
        if frame.truth.clip == 1:
            assert np.interp(frame.truth.time_s, time, alpha) == pytest.approx(frame.truth.alpha_deg, abs=1e-5)


def test_the_manifest_lists_the_files_and_an_audit_sees_one_that_was_changed(rendered, scene, tmp_path):
    files = json.loads((rendered / "manifest.json").read_text())["files"]
    found = sensor_digests(rendered)
    assert len(found) == 2 * len(SENSORS) * 3
    assert {name: files[name] for name in found} == found
    assert sorted(found) == sorted(sensor_files.names(scene))
    again = simgrab.load(rendered / "manifest.json")
    assert again == scene
    assert _manifest_proof(_read(rendered)).findings == ()
    shutil.copytree(rendered, tmp_path / "changed")
    with (tmp_path / "changed/sensors/clip_001/imu1/data.csv").open("a") as file:
        file.write("0,0,0,0,0,0,0\n")
    (finding,) = _manifest_proof(_read(tmp_path / "changed")).findings
    assert finding.where == "sensors/clip_001/imu1/data.csv"
    with pytest.raises(DatasetError, match=r"imu1/data\.csv was changed since it was written"):
        export(tmp_path / "changed", tmp_path / "out", format="coco")


def test_exports_and_shards_carry_the_files(rendered, tmp_path):
    export(rendered, tmp_path / "shards", format="webdataset")
    assert sensor_digests(tmp_path / "shards") == sensor_digests(rendered)
    export(tmp_path / "shards", tmp_path / "back", format="simgrab")
    assert digests(tmp_path / "back") == digests(rendered)
    for format in ("yolo", "hf"):
        export(rendered, tmp_path / format, format=format)
        assert sensor_digests(tmp_path / format) == sensor_digests(rendered)
        listed = json.loads((tmp_path / format / "manifest.json").read_text())["files"]
        assert listed.items() >= sensor_digests(rendered).items()


def test_bytes_are_the_same_in_shards(rendered, scene, tmp_path):
    """By any number of workers: see `test_presets`."""
    simgrab.render(scene, (tmp_path / "shards").as_uri(), shard_frames=2)
    assert sensor_digests(tmp_path / "shards") == sensor_digests(rendered)


@pytest.mark.parametrize(
    "sensor",
    [
        Imu(mount="rope", noise="none"),
        Imu(mount="platform"),
        Inclinometer(mount="grab"),
        SlewEncoder(),
        LuffEncoder(),
        HoistEncoder(),
    ],
)
def test_every_description_is_yaml_of_numbers(sensor):
    pose = np.diag([1.0, 1.0, 1e-7, 1.0]) if isinstance(sensor, Imu | Inclinometer) else None
    about = yaml.safe_load(sensor_files.describe(sensor, pose, 10_500.0))
    assert about["rate_hz"] == sensor.rate_hz
    numbers = [value for name, value in about.items() if name not in ("sensor_type", "comment", "T_BS")]
    assert {type(value) for value in numbers} == {float}
    if pose is not None:
        assert about["T_BS"]["data"][::5] == [1.0, 1.0, 1e-7, 1.0]
