"""The rendered fidelity: what is drawn is the scene, what is told is what the pipeline sees of it, always the same."""

import json
from dataclasses import replace

import cv2
import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import tomli_w
from commands import run
from equations import eq2_cos_alpha
from stress_runs import refused

from simgrab.dataset.render import render
from simgrab.instrument.observation import observe
from simgrab.instrument.pipeline import assemble
from simgrab.instrument.source import open_source
from simgrab.lab.stress import catalogue, estimators, geometric, laboratory, rendered, replay
from simgrab.lab.stress.laboratory import TRIALS, make, parts
from simgrab.lab.stress.rendered import Watched, watch
from simgrab.lab.stress.study import quickened, situation
from simgrab.model import calibration
from simgrab.model.geometry import camera_rotation, vertical_direction

TINY = {
    "place.model": "plain", "camera.width_px": 480, "camera.height_px": 270, "camera.focal.model": "pixels",
    "camera.focal.focal_length_px": 411.0, "image.samples": 0, "image.shadow_map_px": 0,
    "display.layout": "two-by-four",
}  # fmt: skip
SNOW = {
    "name": "pictures", "title": "Pictures at the size of a test", "depth": "rendered", "n": 10, "replications": 2,
    "estimators": ["mean-ray", "rope-aware"], "given": TINY, "axes": [{"axis": "weather.snow_mm_h", "values": [0, 8]}],
}  # fmt: skip
TRUTH = ("alpha", "sigma", "probe_pixels", "probe_rope")


def records(point, *trials):
    return rendered.draw(rendered.prepare(catalogue.read(SNOW), point), 0, trials)


@pytest.fixture(scope="module")
def clear():
    return records((0.0,), 0, 1)


@pytest.fixture(scope="module")
def watched() -> Watched:
    return watch(rendered.prepare(catalogue.read(SNOW), (8.0,)), 0, 1)


def test_a_replication_depends_on_its_number_alone(clear):
    alone = records((0.0,), 1)
    for field in ("pixels", "rope", "pixel_sd", *TRUTH):
        np.testing.assert_array_equal(getattr(clear, field)[1], getattr(alone, field)[0])
    assert not np.isin(clear.alpha[0], clear.alpha[1]).any()


def test_all_points_share_their_draws(clear, watched):
    np.testing.assert_array_equal(watched.truth[0], clear.alpha[1])
    assert not np.array_equal(watched.arrays.pixels, clear.pixels[1], equal_nan=True)  # but are not seen alike


def test_the_truth_obeys_the_papers_equation(watched):
    camera = watched.scenario.camera
    alpha, _, _, beta, azimuth, roll = watched.truth
    m, theta = camera.intrinsics.polar(watched.centre, vertical_direction(azimuth[0], roll[0]))
    foretold = eq2_cos_alpha(m, theta, beta[0], camera.intrinsics.f_px)
    np.testing.assert_allclose(np.cos(alpha), foretold, atol=1e-12)
    assert np.degrees(beta) == pytest.approx(camera.beta_deg)


def test_probes_are_swings_of_ten_degrees_all_around(clear):
    rays = clear.calibration.intrinsics.rays(clear.probe_pixels)
    down = camera_rotation(clear.beta, clear.azimuth, 0.0).T @ (0.0, 0.0, -1.0)
    np.testing.assert_allclose(np.degrees(np.arccos(rays @ down)), 10.0, atol=1e-9)


@pytest.mark.slow
def test_it_is_what_rendering_and_looking_give(watched, tmp_path):
    """The same scene through files on the disk: the pictures of a dataset, and its camera file."""
    assert render(watched.scenario, tmp_path / "set").frames == watched.scenario.frames
    camera, pipeline = calibration.load(tmp_path / "set" / "camera.toml"), assemble()
    assert watched.calibration == camera
    seen = list(observe(open_source(tmp_path / "set"), pipeline.detector, pipeline.reader, camera))
    assert [(s.centre, s.rope_text, s.score) for s in seen] == [
        (s.centre, s.rope_text, s.score) for s in watched.arrays.observations
    ]


def test_physics_brings_times_and_a_camera_that_moves():
    moving = TINY | {"swing.work.wait_s": 0, "clip.frame_rate_hz": 3}
    changes = {"base": "slew-alarm", "given": moving, "axes": [{"axis": "beta", "values": [3.0]}]}
    found = rendered.draw(rendered.prepare(catalogue.read(SNOW | changes), (3.0,)), 0, [0])
    np.testing.assert_allclose(np.diff(found.time), 1 / 3)
    assert found.sigma[0] == pytest.approx(np.sqrt(np.mean(found.alpha**2)))  # nobody knows what to expect
    rays = found.calibration.intrinsics.rays(found.probe_pixels)
    down = camera_rotation(found.beta, found.azimuth, 0.0).T @ (0.0, 0.0, -1.0)
    off = np.degrees(np.arccos(rays @ down))[0] - 10  # a camera that leans with the slewing jib sees them elsewhere
    assert 1 < np.abs(off).max() < 6
    around = 2 * np.pi * np.arange(len(off)) / len(off)
    still = np.stack([np.ones_like(around), np.cos(around), np.sin(around)], axis=-1)
    assert np.std(off - still @ np.linalg.lstsq(still, off)[0]) > 0.3  # by another angle in each frame


@pytest.mark.slow
def test_a_worker_gives_what_this_process_does(tmp_path):
    study = catalogue.read(SNOW)
    laboratory.run([study], tmp_path)
    found = pq.read_table(tmp_path / "pictures" / TRIALS)
    assert found.equals(pa.concat_tables(make(study, part) for part in parts(study)))


def test_a_replay_shows_its_worst_frames(clear, tmp_path):
    path = tmp_path / "pictures.toml"
    path.write_text(tomli_w.dumps(SNOW), encoding="utf-8")
    _, out, _ = run("stress", "--replay", path, 1, "--at", 0, "--out", tmp_path, "--json")
    told = json.loads(out)["estimators"]["mean-ray"]
    assert told["used"] == np.isfinite(clear.pixels[1, :, 0]).mean()
    sheet = cv2.imread(str(tmp_path / "replay-pictures-1-frames.png"))
    assert sheet.shape == (2 * (360 + 24), 4 * 640, 3)
    assert (tmp_path / "replay-pictures-1.png").exists()


def test_one_replication_is_one_part():
    study = catalogue.read(SNOW)
    assert [(p.point, p.first, p.last) for p in parts(study)] == [(0, 0, 1), (0, 1, 2), (1, 0, 1), (1, 1, 2)]


def test_a_frame_whose_rope_was_not_read_is_missing_where_ropes_are_needed():
    here = situation(msgspec.structs.replace(catalogue.load("noise"), n=60), (1.0,))
    whole = geometric.draw(here, 0, [0, 1])
    unread = np.arange(60) % 3 == 0
    told = replace(whole, rope=np.where(unread, np.nan, whole.rope))
    fewer = replace(whole, pixels=whole.pixels[:, ~unread], rope=whole.rope[:, ~unread], time=whole.time[~unread])
    aware = estimators.run("rope-aware", told)
    np.testing.assert_allclose(aware.beta, estimators.run("rope-aware", fewer).beta, rtol=1e-9)
    assert np.isnan(aware.alpha[:, unread]).all()
    np.testing.assert_array_equal(estimators.run("mean-ray", told).beta, estimators.run("mean-ray", whole).beta)


BAD = {
    "an axis without a key": (
        {"axes": [{"axis": "focal", "values": [0.0]}]},
        ("focal", "is not available", "rendered", "beta", "weather", "base"),
    ),
    "a misspelt key": (
        {"axes": [{"axis": "weather.snow", "values": [0.0]}]},
        ("weather.snow", "did you mean 'snow_mm_h'", "visibility_m"),
    ),
    "no scene": ({"axes": [{"axis": "base", "values": ["foggy"]}]}, ("foggy", "did you mean 'fog'")),
    "a scene that varies": (
        {"base": "training", "given": {}, "axes": [{"axis": "n", "values": [10]}]},
        ("training", "varies"),
    ),
    "no display": ({"given": TINY | {"display.layout": "none"}}, ("rope-aware", "display.layout")),
    "no times": ({"estimators": ["pendulum-smoother"]}, ("pendulum-smoother", "independent")),
    "no count": ({"axes": [{"axis": "n", "values": [10.5]}]}, ("frames", "must be a whole number")),
}


@pytest.mark.parametrize("case", BAD)
def test_a_study_that_cannot_be_is_refused_with_what_is_valid(case):
    change, words = BAD[case]
    refused(lambda: catalogue.read(SNOW | change), words)


def test_bundled_studies_go_by_their_depth():
    through = catalogue.of("rendered")
    assert len(through) >= 3
    assert sorted(through + catalogue.of("geometric")) == catalogue.names()
    for name in through:
        study = catalogue.load(name)
        assert study.accept
        quick = quickened(study)
        assert quick.n * quick.replications * len(quick.points) <= 100


def test_a_study_goes_to_another_depth_where_its_axes_reach_it():
    assert "is not available" in run("stress", "lean-along", "--depth", "rendered")[2]
    assert "geometric, rendered" in run("stress", "--all", "--depth", "painted")[2]


def test_the_same_description_goes_without_pictures():
    study = msgspec.structs.replace(catalogue.load("rendered-calm"), depth="geometric")
    again = replay.replay(study, 3, study.points[-1])
    assert again.sheet is None
    assert np.isfinite(again.records.pixels).all()
    assert make(study, parts(study)[0]).num_rows == len(study.estimators) * study.replications
