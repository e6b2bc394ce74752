"""Further cameras: their pictures show what their stated pose and intrinsics project, and their files are EuRoC's."""

import cv2
import numpy as np
import pytest
import yaml

import simgrab
from simgrab.dataset import sensors as files
from simgrab.dataset.tables import into
from simgrab.errors import ScenarioError
from simgrab.lab.sensors.camera import looking
from simgrab.model.scenario import SideCamera
from simgrab.world.extensions import Recipe
from simgrab.world.scenery.grabs import design_of
from simgrab.world.trajectory.trajectory import Trajectory

CAMERAS = {
    "cam1": {"model": "camera", "width_px": 960, "height_px": 720, "focal_length_px": 700.0, "azimuth_deg": 4.0},
    "cam2": {"model": "camera", "mount": "jib-head", "position_m": [1.0, 2.0, -1.0], "elevation_deg": -80.0,
             "width_px": 640, "height_px": 480, "rate_hz": 4.0},
}  # fmt: skip
CHANGES = {
    "frames": 3, "place": {"model": "plain"}, "light.sun": 0.0, "display.layout": "none", "sensors": CAMERAS,
    "markers": {"target": {"diameter_m": 1.2, "position_m": [0.0, 0.0, 0.8]}}, "swing.start.alpha_deg": 7.0,
    "swing.work": {"model": "turn", "rope_length_m": 16.0, "wait_s": 0.0, "ramp_s": 1.0},
}  # fmt: skip


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder, scenario = tmp_path_factory.mktemp("cameras"), simgrab.load("free-swing", CHANGES)
    return scenario, folder, files.write(Recipe(scenario), into(folder))


def test_all_files_are_named_before(written):
    _, folder, names = written
    assert sorted(names) == sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
    listed = (folder / "sensors/clip_000/cam2/data.csv").read_text().splitlines()
    assert listed == ["#timestamp [ns],filename", "0,000000.jpg", "250000000,000001.jpg"]


@pytest.mark.parametrize(("name", "frame"), [("cam1", 2), ("cam2", 0)])
def test_a_picture_shows_the_target_where_the_files_project_it(written, name, frame):
    scenario, folder, _ = written
    base = folder / f"sensors/clip_000/{name}"
    about = yaml.safe_load((base / "sensor.yaml").read_text())
    pose, (fu, fv, cu, cv) = np.reshape(about["T_BS"]["data"], (4, 4)), about["intrinsics"]
    grab = Trajectory(scenario).at(frame).grab.jib_from_grab
    height = design_of(scenario.grab).terminations[0, 2]
    truth = np.loadtxt(folder / f"sensors_truth/clip_000/{name}/truth.csv", delimiter=",")[frame]
    body = np.array([truth[2], 0.0, scenario.jib.head_height_m]) if name == "cam1" else np.zeros(3)
    pixels = []
    for point in ((0.0, 0.0, height + 0.8), (0.0, 0.0, 0.0)):
        x, y, z = pose[:3, :3].T @ (grab.apply(point) + body - pose[:3, 3])
        assert z > 0
        pixels.append((fu * x / z + cu, fv * y / z + cv))
    np.testing.assert_allclose(truth[3:5], pixels[1], atol=1e-6)
    picture = cv2.imread(str(base / f"data/{frame:06d}.jpg"))
    assert picture.shape[1::-1] == tuple(about["resolution"])
    blue, green, red = np.moveaxis(picture.astype(float), -1, 0)
    rows, columns = np.nonzero((red > 150) & (red > 2 * blue) & (red > 2 * green))
    assert len(rows) > 30
    middle = (columns.min() + columns.max() + 1) / 2, (rows.min() + rows.max() + 1) / 2
    np.testing.assert_allclose(middle, pixels[0], atol=2.5)  # ropes stand before it


@pytest.mark.parametrize("file", ["yards", "yard.avi"])
def test_a_picture_over_photographs_shows_that_of_its_frame(tmp_path, file):
    (tmp_path / "yards").mkdir()
    film = cv2.VideoWriter(str(tmp_path / "yard.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 9, (128, 96))
    for i in range(9):
        picture = np.full((96, 128, 3), 60 + 20 * i, np.uint8)
        cv2.imwrite(str(tmp_path / f"yards/{i}.png"), picture)
        film.write(picture)
    film.release()
    (tmp_path / "scene.toml").write_text(f'base = "free-swing"\n[place]\nmodel = "photo"\nfile = "{file}"\n')
    top = {
        "model": "camera", "mount": "jib-head", "elevation_deg": -80.0, "width_px": 128, "height_px": 96,
        "focal_length_px": 110.0,
    }  # fmt: skip
    scenario = simgrab.load(tmp_path / "scene.toml", {
        "camera.width_px": 128, "camera.height_px": 96, "camera.focal": {"model": "pixels", "focal_length_px": 110},
        "frames": 8, "clip.clip_frames": 2, "light.sun": 0.0, "display.layout": "none", "sensors": {"top": top},
        "splits": {"train": 0.4, "val": 0.3, "test": 0.3},
    })  # fmt: skip
    files.write(Recipe(scenario), into(tmp_path / "out"))
    own = [np.median(frame.rgb) for frame in simgrab.frames(scenario, buffers=False)]
    data = [tmp_path / f"out/sensors/clip_{i // 2:03d}/top/data/{i % 2:06d}.jpg" for i in range(8)]
    np.testing.assert_allclose([np.median(cv2.imread(str(path))) for path in data], own, atol=3)
    assert np.ptp(own) > 15


def test_in_python_a_camera_gives_its_truth_and_renders_nothing():
    scenario = simgrab.load("free-swing", CHANGES)
    read = simgrab.sensors(scenario)["cam1"]
    np.testing.assert_array_equal(read.values[:, 0], [0, 1, 2])
    assert read.true("radius [m]")[0] == scenario.swing.radius_m


def test_the_number_of_pictures_is_that_of_the_instants_within_the_clip():
    for rate in (0.3, 4.0, 9.0, 25.0, 30.0):
        for seconds in (1 / 3, 1.0, 2.0, 10 / 9, 411.0):
            count = sum(k / rate < seconds for k in range(int(seconds * rate) + 3))
            assert SideCamera(rate_hz=rate).count(seconds) == count


def test_a_camera_stands_upright():
    np.testing.assert_allclose(looking(0.0, 0.0), [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], atol=1e-15)
    for azimuth, elevation in ((30.0, 20.0), (-100.0, -70.0)):
        made = looking(azimuth, elevation)
        np.testing.assert_allclose(made @ made.T, np.eye(3), atol=1e-15)
        assert np.linalg.det(made) > 0
        assert made[2, 0] == 0  # its rows are level
        assert made[2, 1] < 0
    with pytest.raises(ScenarioError, match="position_m"):
        SideCamera(position_m=(0.0, 0.0, 200.0))
