"""Datasets whose frames come from several worlds."""

import json
from contextlib import closing
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from conftest import slow_but, small_scene

from simgrab.dataset import pool, stored
from simgrab.dataset.pool import Workers
from simgrab.dataset.render import render
from simgrab.errors import ScenarioError
from simgrab.judge.audit.audit import audit
from simgrab.model import scenes
from simgrab.model.rng import stream
from simgrab.model.scenario import variant
from simgrab.model.truth import columns
from simgrab.world.extensions import Recipe
from simgrab.world.frames import FrameGenerator
from simgrab.world.scenery.clearance import HeightMap
from simgrab.world.scenery.model import GRAB, PLACE, ROPE
from simgrab.world.scenery.parked import parked_grabs
from simgrab.world.scenery.places import build

VARY = {
    "camera.beta_deg": {"dist": "uniform", "low": 0.0, "high": 6.0},
    "camera.distortion.k1": {"dist": "one-of", "values": [0.0, -0.1]},
    "grab.paint_rgb": {"dist": "one-of", "values": [[0.8, 0.1, 0.1], [0.1, 0.3, 0.6]], "names": ["red", "blue"]},
    "grab.cargo": {"dist": "one-of", "values": ["coal", "grain"]},
    "weather.rain_mm_h": {"dist": "choice", "values": [0.0, 20.0]},
}


def scene(**changes):
    return small_scene(vary=VARY, clip__clip_frames=2, swing__load={"dist": "constant", "value": 1.0}, **changes)


@pytest.fixture(scope="module")
def varied(tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "varied"
    render(scene(), path)
    return path


def rows(path: Path):
    return pq.read_table(path / "labels.parquet").to_pylist()


def test_labels_hold_what_was_drawn(varied):
    for row in rows(varied):
        one = variant(scene(), row["frame"])
        assert (row["variant"], json.loads(row["varied"])) == (row["frame"] // 2, one.drawn)
        assert row["beta_deg"] == pytest.approx(one.scenario.camera.beta_deg)
        assert row["k1"] == one.scenario.camera.distortion.k1
    assert len({row["varied"] for row in rows(varied)}) == 3


def test_frames_of_a_variant_stay_in_one_split():
    many = Recipe(scene(frames=200))
    assert all(many.split(f) == many.split(f + 1) for f in range(0, 200, 2))
    assert {many.split(f) for f in range(200)} == {"train", "val", "test"}


@pytest.mark.slow
def test_the_paint_is_the_one_drawn():
    """Reds and blues among the grab's own pixels go by the drawn name."""
    plain = small_scene(
        vary={"grab.paint_rgb": VARY["grab.paint_rgb"]}, clip__clip_frames=1, frames=12, grab__wear=0.0,
        grab__residue=0.0,
    )  # fmt: skip
    seen = set()
    with FrameGenerator(plain) as generator:
        for frame in range(12):
            name = variant(plain, frame).drawn["grab.paint_rgb"]
            if name in seen:
                continue
            seen.add(name)
            drawn = generator.frame(frame)
            red, _, blue = np.median(drawn.rgb[drawn.mask].astype(float), axis=0)
            assert (red > blue) == (name == "red")
    assert seen == {"red", "blue"}


@pytest.fixture(scope="module")
def half_empty(tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "half"
    render(small_scene(swing__absent=0.5, frames=8, swing__load={"dist": "constant", "value": 1.0}), path)
    return path


def test_an_absent_grab_leaves_nothing_but_its_pose(half_empty):
    table = rows(half_empty)
    away = [row for row in table if not row["present"]]
    assert 0 < len(away) < 8
    for row in away:
        assert all(row[c] is None for c in columns() if c.startswith(("box_", "amodal_", "oriented_")))
        assert row["visible_fraction"] == row["in_frame_fraction"] == row["weather_hidden_fraction"] == 0
        assert not any(row["keypoints"])
        assert (half_empty / f"labels/{row['split']}/{row['frame']:06d}.txt").read_text() == ""
    there = small_scene(frames=8, swing__load={"dist": "constant", "value": 1.0})
    with FrameGenerator(
        there
    ) as generator:  # the same frames, all with a grab: being absent changes nothing else that is drawn
        for row in table:
            full = stored.make(generator, row["frame"]).record.truth
            assert (full.alpha_deg, full.rope_length_m, full.grab_u_px) == (
                row["alpha_deg"], row["rope_length_m"], row["grab_u_px"]
            )  # fmt: skip
            assert (full.image_sha256 == row["image_sha256"]) == row["present"]


def test_an_absent_grab_is_not_drawn_nor_are_its_ropes():
    with FrameGenerator(small_scene(swing__absent=1.0)) as generator:
        renderer, moment = generator.scene(0).renderer, generator.project(0).moment
        groups = set(np.unique(renderer.view(moment).ids))
        assert not groups & {GRAB, ROPE}
        assert not renderer.silhouette(moment, renderer.full).any()


@pytest.mark.slow
@pytest.mark.parametrize("made", ["varied", "half_empty"])
def test_the_audit_passes(made, request):
    assert [p.findings for p in audit(request.getfixturevalue(made)).proofs if p.status == "failed"] == []


def test_a_scene_without_any_grab_is_refused():
    with pytest.raises(ScenarioError, match="the grab is outside the image"):
        pool.vetted(Workers(Recipe(small_scene(swing__absent=1.0))))


@pytest.mark.parametrize("place", slow_but(["plain", "quay", "hold", "water"], "plain", "hold"))
def test_other_grabs_stand_on_level_ground_out_of_the_way(place):
    cluttered = small_scene(place={"model": place}, clutter__other_grabs=3)
    bare = build(cluttered.place, head_height=28.0, rng=stream(0, 0, "place"))
    parts = parked_grabs(cluttered.clutter, bare, head_height=28.0, rng=stream(0, 0, "clutter.grabs"))
    assert len({p.name for p in parts}) == len(parts)
    ground = HeightMap.of((p.mesh for p in bare), 20.0)
    numbers = {p.name.split("/")[0] for p in parts}
    assert numbers
    for number in numbers:
        points = np.concatenate([p.mesh.vertices for p in parts if p.name.startswith(f"{number}/")])
        assert np.hypot(*points[:, :2].T).min() > 5.0
        assert points[:, 2].min() > -28.0 - 0.5
        foot = points[points[:, 2] < points[:, 2].min() + 0.3]
        assert -0.05 < ground.gap(foot) < 0.3
        assert np.ptp(points, axis=0).max() < 6.0


def test_other_grabs_are_seen_and_never_labelled():
    """They change the picture, and neither box nor mask where they hide nothing of the grab."""
    alone, among = (small_scene(clutter__other_grabs=n, swing__alpha__sigma_deg=0.0) for n in (0, 4))
    with FrameGenerator(alone) as generator:
        before = [generator.frame(frame) for frame in range(2)]
    with FrameGenerator(among) as generator:
        for frame, drawn in enumerate(before):
            now = generator.frame(frame, full=True)
            assert now.truth == drawn.truth
            assert np.array_equal(now.mask, drawn.mask)
            ids = now.ids
            changed = np.abs(now.rgb.astype(int) - drawn.rgb).max(axis=-1) > 40
            assert changed.sum() > 500
            assert (ids[changed] == PLACE).mean() > 0.95  # the rest is their shadow on others


@pytest.mark.slow
def test_the_training_scene_runs():
    """One small world of the bundled scene, whole: drawn, labelled, encoded."""
    fast = {"image.samples": 0, "image.shadow_map_px": 1024}
    with FrameGenerator(scenes.load("training", fast, size=(480, 270))) as generator:
        row = stored.make(generator, 9).record.truth
    assert row.variant == 1
    assert len(json.loads(row.varied)) > 20


def test_an_impossible_world_among_many_is_refused_before_anything_is_drawn(tmp_path):
    rope = {
        "swing.rope_length_m": {"dist": "one-of", "values": [{"dist": "constant", "value": v} for v in (10.0, 27.0)]}
    }
    scenario = small_scene(frames=6, clip__clip_frames=1, vary=rope)
    with pytest.raises(ScenarioError, match="lowers the grab into the ground or the cargo"):
        render(scenario, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("workers", slow_but([1, 2], 1))
def test_many_worlds_are_counted_while_they_are_checked(workers):
    told = []
    with closing(Workers(Recipe(scene(frames=6)), workers)) as processes:
        pool.vetted(processes, lambda *counts: told.append(counts))
    assert (told[0], told[-1]) == ((0, 3), (3, 3))
    assert told == sorted(told)


def test_frames_that_were_found_possible_are_not_looked_at_again(tmp_path, monkeypatch):
    scenario = small_scene(frames=2)
    render(scenario, tmp_path / "out")
    monkeypatch.setattr(pool, "vetted", None)
    assert render(scenario, tmp_path / "out", resume=True).made == 0
