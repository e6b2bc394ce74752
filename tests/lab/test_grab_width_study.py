import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest

from simgrab.errors import DatasetError
from simgrab.lab.paper.grab_width import study, summary_lines
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import camera_rotation, grab_centre, grab_rotation, to_camera
from simgrab.model.truth import KEYPOINT_NAMES
from simgrab.world.scenery.grabs.four_rope import four_rope


def synthetic(folder, beta_deg, frames=400, k1=-0.1):
    """Labels as a dataset has them, from the geometry alone."""
    rng = np.random.default_rng(3)
    camera = Calibration(width_px=1920, height_px=1080, focal_length_px=1644.82, cx_px=960.0, cy_px=540.0, k1=k1)
    alpha, azimuth = np.abs(rng.normal(size=frames)) * np.deg2rad(2), rng.uniform(0, 2 * np.pi, frames)
    rope, yaw = rng.uniform(8, 35, frames), rng.uniform(-15, 15, frames)
    centre = grab_centre(alpha, azimuth, rope)
    pose = grab_rotation(alpha, azimuth, np.deg2rad(yaw))
    rotation = camera_rotation(np.deg2rad(beta_deg), 0.7, 0.0)
    shell = four_rope().frames(0.0)["shell_outer"]
    lips = [centre + pose @ (shell[:3, :3] @ p + shell[:3, 3]) for p in four_rope().lips["shell_outer"]]
    points = np.full((frames, len(KEYPOINT_NAMES), 3), 2.0)
    for name, corner in zip(("lip_outer_1", "lip_outer_2"), lips, strict=True):
        points[:, KEYPOINT_NAMES.index(name), :2] = camera.intrinsics.project(to_camera(corner, rotation, np.zeros(3)))
    u, v = camera.intrinsics.project(to_camera(centre, rotation, np.zeros(3))).T
    columns = {
        "alpha_deg": np.rad2deg(alpha), "beta_deg": np.full(frames, beta_deg), "yaw_deg": yaw,
        "jaw_deg": np.zeros(frames),
        "rope_length_m": rope, "grab_u_px": u, "grab_v_px": v, "keypoints": list(points.reshape(frames, -1)),
    }  # fmt: skip
    pa.parquet.write_table(pa.table(columns), folder / "labels.parquet")
    camera.save(folder / "camera.toml")
    return folder


def test_with_the_papers_tilt_all_forty_agree_whatever_the_truth(tmp_path):
    found = study(synthetic(tmp_path, 2.53))
    assert len(found.frames) == 40
    np.testing.assert_allclose(found.by_width, found.axis_angle, atol=np.deg2rad(0.35))  # the width says ψ, no more
    assert np.rad2deg(np.abs(found.by_width - found.estimated)).max() < 2.53 + 0.35
    assert np.rad2deg(found.beta) == pytest.approx(2.53, abs=0.2)


def test_made_up_tilts_pass_the_check_and_are_wrong(tmp_path):
    found = study(synthetic(tmp_path, 5.0))
    for tilt, bound, _ in found.wrong:
        assert bound <= tilt + 1e-9
    assert max(np.rad2deg(wrong) for _, _, wrong in found.wrong) > 10
    assert any("so it passes" in line for line in summary_lines(found))


def test_too_few_frames_are_refused(tmp_path):
    with pytest.raises(DatasetError, match="frames show a closed grab turned by less than"):
        study(synthetic(tmp_path, 5.0, frames=45))
    with pytest.raises(DatasetError, match="cannot read"):
        study(tmp_path / "nothing")
