"""The same view at another size of picture."""

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest
from conftest import CROOKED, SMALL, small_scene

from simgrab.errors import ScenarioError
from simgrab.model.distributions import Uniform
from simgrab.model.scenario import variant
from simgrab.model.scenes import load, resized

FOCALS = {
    "pixels": {"model": "pixels", "focal_length_px": 1500.0},
    "lens": {"model": "lens", "focal_length_mm": 5.2},
    "sensor": {"model": "sensor", "focal_length_mm": 4.1},
}
LAWS = {
    "uniform": {"low": 0.5, "high": 2.0},
    "normal": {"mean": 1.0, "sd": 0.4, "low": 0.0, "high": 2.5},
    "choice": {"values": [0.5, 1.5, 2.5], "weights": [1, 2, 3]},
    "rayleigh": {"scale": 0.5, "high": 3.0},
    "half-normal": {"scale": 0.5},
    "exponential": {"mean": 0.5},
    "constant": {"value": 1.5},
}
JOINT = {
    "camera.focal+optics": [
        {"camera.focal": {"model": "lens", "focal_length_mm": 4.0}, "optics": {"defocus_px": 2.0}},
        {"camera.focal": {"model": "sensor"}, "optics": {"chromatic_px": -1.0}},
    ],
    "camera": [{"principal_offset_px": [30.0, -12.0], "roll_deg": 5.0}, {"width_px": 1920, "beta_deg": 4.0}],
}


def flat(value, key=""):
    """Leaves of plain data by dotted key."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else None
    if items is None:
        return {key: value}
    return {k: v for name, inner in items for k, v in flat(inner, f"{key}.{name}").items()}


def differences(a, b):
    """Keys in which two scenarios differ by more than rounding."""
    a, b = flat(a.to_dict()), flat(b.to_dict())
    numbers = {key for key in a if isinstance(a[key], float) and isinstance(b.get(key), float)}
    off = {key for key in numbers if a[key] != pytest.approx(b[key], rel=1e-12)}
    return off | {key for key in a.keys() | b.keys() if key not in numbers and a.get(key) != b.get(key)}


@pytest.mark.parametrize("focal", FOCALS)
@pytest.mark.parametrize("size", [(640, 360), (854, 480), (640, 640), (3840, 1000)])
def test_each_column_of_pixels_sees_the_same(focal, size):
    changes = {key: value for key, value in CROOKED.items() if key.startswith("camera")}
    scene = load("quay-day", changes | {"camera.focal": FOCALS[focal], "camera.distortion": {"k1": -0.05}})
    big, small = scene.camera.intrinsics, resized(scene, *size).camera.intrinsics
    scale = size[0] / 1920
    assert (small.width_px, small.height_px) == size
    points = np.array([(0.0, 0.0), (300.0, -120.0), (-900.0, 80.0)])  # from the middle of the picture
    rays = big.rays(points + (960, 540))
    np.testing.assert_allclose(small.rays(scale * points + np.array(size) / 2), rays, atol=1e-12)


def varying(vary):
    return load("quay-day", {"clip.clip_frames": 1, "vary": vary})


VARYING = (
    {name: load(name) for name in ("training", "digits")}
    | {law: varying({"optics.defocus_px": {"dist": law} | keys}) for law, keys in LAWS.items()}
    | {key: varying({key: {"dist": "one-of", "values": values}}) for key, values in JOINT.items()}
)


@pytest.mark.parametrize("case", VARYING)
def test_what_varies_scales_as_what_does_not(case):
    scene = VARYING[case]
    size = (scene.camera.width_px // 2, scene.camera.height_px * 3 // 4)
    small = resized(scene, *size)
    for frame in range(0, 8 * scene.clip.clip_frames, scene.clip.clip_frames):
        drawn, expected = variant(small, frame).scenario, resized(variant(scene, frame).scenario, *size)
        assert not differences(drawn, expected)


@pytest.mark.parametrize("name", ["quay-day", "digits", "qingdao-twin"])
def test_a_scenes_own_size_changes_nothing(name):
    scene = load(name)
    assert resized(scene, scene.camera.width_px, scene.camera.height_px) == scene


def test_what_is_physical_stays():
    scene = load("qingdao-twin", {"optics.defocus_px": 3.0})
    before, after = flat(scene.to_dict()), flat(resized(scene, 640, 360).to_dict())
    changed = {key for key in before if before[key] != after[key]}
    assert changed == {
        ".camera.width_px", ".camera.height_px", ".camera.focal.pixels_per_mm", ".optics.defocus_px",
    }  # fmt: skip


def test_sharpening_scales_where_there_is_some():
    sharp = load("quay-day", {"optics.sharpening": {"amount": 1.0, "radius_px": 1.5}})
    assert resized(sharp, 640, 360).optics.sharpening.radius_px == pytest.approx(0.5)
    assert resized(load("quay-day"), 640, 360).optics.sharpening == load("quay-day").optics.sharpening
    varied = msgspec.structs.replace(
        load("quay-day", {"clip.clip_frames": 1}), vary={"optics.sharpening.amount": Uniform(0.5, 2.0)}
    )
    drawn = resized(varied, 640, 360)
    assert drawn.optics.sharpening.radius_px == pytest.approx(1 / 3)
    assert drawn.vary == varied.vary


def test_the_display_is_fitted_or_refused():
    scene = load("calm-day")
    assert resized(scene, 640, 360).display_layout == scene.display_layout.scaled(640, 360)
    with pytest.raises(ScenarioError, match=r"display.layout.*cannot be read: at least 5 x 8"):
        resized(scene, 320, 180)


def test_a_varied_display_without_room_is_refused():
    with pytest.raises(ScenarioError, match=r"^vary\.display.*cannot be read"):
        resized(load("digits"), 160, 90)


@pytest.mark.parametrize("size", [(0, 0), (640, 0), (-640, 360), (63, 64), (4097, 100)])
def test_sizes_out_of_range_are_refused(size):
    with pytest.raises(ScenarioError, match=r"^camera\.(width|height)_px: must be a whole number"):
        resized(load("quay-day"), *size)


def test_labels_of_a_smaller_picture_are_the_same_but_for_scale(dataset, tmp_path):
    from simgrab.dataset.render import render

    render(resized(small_scene(), 240, 135), tmp_path / "half")
    rows, halves = (pq.read_table(p / "labels.parquet").to_pylist() for p in (dataset, tmp_path / "half"))
    assert SMALL["camera.width_px"] == 480
    for row, half in zip(rows, halves, strict=True):
        for key in ("alpha_deg", "gamma_deg", "rope_length_m", "theta_deg", "jib_from_camera", "jib_from_grab"):
            assert half[key] == pytest.approx(row[key]), key
        for key in ("grab_u_px", "grab_v_px", "ideal_u_px", "m_px", "fx_px", "cx_px", "amodal_x0_px"):
            assert half[key] == pytest.approx(row[key] / 2), key
        for key in ("box_x0_px", "box_y0_px", "box_x1_px", "box_y1_px"):
            assert abs(half[key] - row[key] / 2) <= 1, key
