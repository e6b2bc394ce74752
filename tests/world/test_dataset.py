import itertools
import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from commands import run
from conftest import SMALL, as_options, digests, small_scene

from simgrab.dataset.manifest import identity
from simgrab.dataset.render import render
from simgrab.dataset.yolo import data_yaml
from simgrab.errors import DatasetError, ScenarioError
from simgrab.io.journal import Journal, differences
from simgrab.judge.audit.audit import audit
from simgrab.model import scenes
from simgrab.model.truth import KEYPOINT_NAMES, SPLITS, columns


def test_layout_and_columns(dataset, scene):
    table = pq.read_table(dataset / "labels.parquet")
    assert table.column_names == list(columns())
    assert table["frame"].to_pylist() == list(range(scene.frames))
    for field in table.schema:
        assert set(field.metadata) == {b"unit", b"description"}
    assert table.schema.field("rope_length_m").metadata[b"unit"] == b"m"
    assert json.loads(table.schema.metadata[b"keypoint_names"]) == list(KEYPOINT_NAMES)
    assert json.loads(table.schema.metadata[b"simgrab"])["scenario"]["name"] == "quay-day"
    for row in table.to_pylist():
        assert (dataset / row["file"]).is_file()
        assert row["file"].split("/")[1] == row["split"]
    assert not (dataset / ".partial").exists()
    known = json.loads((dataset / "manifest.json").read_text())
    assert known["digest"] == scene.digest()
    assert known["seed"] == 0
    text = (dataset / "camera.toml").read_text()
    assert "beta" not in text
    assert "tilt" not in text


def test_labels_hold_what_the_scenario_set(crooked_dataset):
    table = pq.read_table(crooked_dataset / "labels.parquet").to_pandas()
    assert (table.beta_deg == 6.5).all()
    assert np.allclose(table.roll_deg, -25.0)
    assert np.allclose(table.tilt_azimuth_deg, 70.0)
    assert table.alpha_deg.between(0, 30).all()
    assert table.gamma_deg.between(0, 360).all()
    assert not np.allclose(table.grab_u_px, table.ideal_u_px)


def test_keypoints_and_boxes_agree(crooked_dataset):
    """Every keypoint of the grab lies in its amodal box; A lies between the terminations and the lips."""
    table = pd.read_parquet(crooked_dataset / "labels.parquet")
    for row in table.itertuples():
        points = np.reshape(row.keypoints, (-1, 3))
        on_steel = points[2:][points[2:, 2] > 0]
        assert (on_steel[:, 0] > row.amodal_x0_px - 0.5).all()
        assert (on_steel[:, 0] < row.amodal_x1_px + 0.5).all()
        assert (on_steel[:, 1] > row.amodal_y0_px - 0.5).all()
        assert (on_steel[:, 1] < row.amodal_y1_px + 0.5).all()
        assert points[1, 2] == 0  # the rope exit is above the camera
        assert tuple(points[0, :2]) == (row.grab_u_px, row.grab_v_px)
        assert (points[2:6, 2] == 2).sum() >= 2  # rope terminations face the camera


def test_metadata_csv_is_what_imagefolder_reads(split_dataset):
    """A name beside the file, one row a picture, and by pandas' guess the same types in every split."""
    table = pd.read_parquet(split_dataset / "labels.parquet")
    kinds = []
    for split in SPLITS:
        found = pd.read_csv(split_dataset / "images" / split / "metadata.csv")
        rows = table[table.split == split].reset_index(drop=True)
        assert (rows.file == f"images/{split}/" + found.file_name).all()
        pictures = [p.name for p in (split_dataset / "images" / split).iterdir() if p.name != "metadata.csv"]
        assert sorted(found.file_name) == sorted(pictures)
        for name in found.columns.drop("file_name"):
            np.testing.assert_array_equal(found[name].astype(float), rows[name].astype(float), err_msg=name)
        kinds.append(dict(found.dtypes))
    assert kinds[0] == kinds[1] == kinds[2]
    assert {"frame", "alpha_deg", "present", "time_s", "box_x0_px", "visible_fraction"} <= set(kinds[0])
    assert table.box_x0_px.isna().any()


def keys_of(text):
    return dict(line.split(": ") for line in text.splitlines() if not line.startswith("#"))


@pytest.mark.parametrize("splits", [c for n in (1, 2, 3) for c in itertools.combinations(SPLITS, n)])
def test_data_yaml_names_only_folders_with_pictures(splits):
    text = data_yaml(splits, "box").decode()
    keys = keys_of(text)
    assert {"train", "val"} <= keys.keys()  # trainers refuse a file without them
    assert {"test"} & keys.keys() == {"test"} & set(splits)
    for split in keys.keys() & set(SPLITS):
        assert keys[split] == f"images/{split if split in splits else splits[0]}"
        assert (f"# {split} has no frames" in text) == (split not in splits)
    assert (keys["nc"], keys["names"]) == ("1", "[grab]")


def test_a_dataset_of_one_frame_trains_on_what_it_has(tmp_path):
    render(small_scene(frames=1), tmp_path / "one")
    data = keys_of((tmp_path / "one" / "data.yaml").read_text())
    for split in {"train", "val", "test"} & data.keys():
        assert list((tmp_path / "one" / data[split]).glob("*.jpg"))


def test_the_summary_states_what_was_drawn_and_how_much_was_clamped(tmp_path):
    changes = {
        "frames": 8, "image.samples": 0, "image.shadow_map_px": 0, "seed": 3, "clip.clip_frames": 2,
        "place": {"model": "plain"}, "grab": {"model": "scissors"}, "swing.clamp": True,
        "swing.jaw_deg": {"dist": "choice", "values": [0.0, 89.0], "weights": [1, 1]},
        "swing.rope_length_m": {"dist": "uniform", "low": 8.0, "high": 34.0},
        "vary": {"camera.beta_deg": {"dist": "uniform", "low": 1.0, "high": 5.0}},
    }  # fmt: skip
    scene = scenes.load("quay-day", changes, size=(160, 90))
    summary = render(scene, tmp_path / "folder", video=tmp_path / "v.mkv")
    rows = pq.read_table(tmp_path / "folder" / "labels.parquet").to_pylist()
    betas, ropes = ([row[key] for row in rows] for key in ("beta_deg", "rope_length_m"))
    assert summary.beta_deg == (min(betas), max(betas))
    assert len(set(betas)) == 4
    assert summary.rope_length_m == (min(ropes), max(ropes))
    counts = {key: sum(key in row["clamped"] for row in rows) for key in ("jaw_deg", "rope_length_m")}
    assert all(0 < count < 8 for count in counts.values())
    assert summary.clamped == summary.video.clamped == counts
    assert json.loads((tmp_path / "folder" / "manifest.json").read_text())["clamped"] == counts
    assert not audit(tmp_path / "folder").findings
    shards = render(scene, (tmp_path / "shards").as_uri(), shard_frames=4)
    assert (shards.clamped, shards.beta_deg) == (counts, summary.beta_deg)
    assert json.loads((tmp_path / "shards" / "manifest.json").read_text())["clamped"] == counts


def test_the_manifest_and_the_command_line_give_the_same_bytes(dataset, tmp_path):
    render(scenes.load(dataset / "manifest.json"), tmp_path / "again")
    assert digests(tmp_path / "again") == digests(dataset)
    command = ["render", "quay-day", *as_options(SMALL), "--out", tmp_path / "cli", "--quiet", "--workers", 1]
    assert run(*command) == (0, "", "")
    assert digests(tmp_path / "cli") == digests(dataset)


def test_a_longer_dataset_begins_with_the_shorter(dataset, scene, tmp_path):
    render(small_scene(frames=scene.frames + 3), tmp_path / "longer")
    rows, longer = (pq.read_table(p / "labels.parquet").to_pylist() for p in (dataset, tmp_path / "longer"))
    assert longer[: scene.frames] == rows
    assert all((tmp_path / "longer" / r["file"]).read_bytes() == (dataset / r["file"]).read_bytes() for r in rows)


def test_an_unfinished_folder_is_left_alone_without_resume(scene, tmp_path):
    out = tmp_path / "half"
    with pytest.raises(KeyboardInterrupt):
        render(scene, out, progress=stopping(1))
    before = digests(out)
    with pytest.raises(DatasetError, match=r"unfinished.*--resume"):
        render(scene, out)
    with pytest.raises(DatasetError, match="seed differs"):
        render(small_scene(seed=5), out, resume=True)
    assert digests(out) == before


def test_what_differs_is_named_on_whichever_side_it_lies():
    known = {"scenario": {"seed": 0, "cast": 1}, "made_by": "else"}  # of the latter, nothing is asked
    assert differences(known, {"scenario": {"seed": 0}}) == "scenario.cast"
    assert differences(known, {"scenario": {"seed": 1, "cast": 1, "blur": 2}}) == "scenario.seed, scenario.blur"
    assert not differences(known, {"scenario": {"seed": 0, "cast": 1}})


def test_a_finished_folder_is_never_touched(dataset, scene):
    before = digests(dataset)
    with pytest.raises(DatasetError, match=r"finished dataset.*--out"):
        render(scene, dataset)
    with pytest.raises(DatasetError, match="another dataset"):
        render(small_scene(seed=5), dataset, resume=True)
    grown = r"scenario\.frames, frames differs.* cannot grow .*: for more frames, render with another --seed"
    with pytest.raises(DatasetError, match=grown):
        render(small_scene(frames=scene.frames + 3), dataset, resume=True)
    assert render(scene, dataset, resume=True).made == 0
    assert digests(dataset) == before


def test_a_dataset_killed_while_it_cleaned_up_is_finished(dataset, scene, tmp_path):
    shutil.copytree(dataset, tmp_path / "out")
    rows = tmp_path / "out" / ".partial" / "rows"
    rows.mkdir(parents=True)
    assert render(scene, tmp_path / "out", resume=True).made == 0
    assert digests(tmp_path / "out") == digests(dataset)


@pytest.mark.slow
def test_frames_are_counted_once_when_a_run_goes_on_within_a_clip(tmp_path):
    """Each clip a world of its own, whose frames that are there count when the clip is taken up."""
    scene = small_scene(
        frames=6, clip__clip_frames=3, vary={"camera.roll_deg": {"dist": "uniform", "low": 0, "high": 9}}
    )
    folder, counted = tmp_path / "out", []
    with pytest.raises(KeyboardInterrupt):
        render(scene, folder, progress=stopping(4))
    assert render(scene, folder, resume=True, progress=lambda *counts: counted.append(counts)).made == 2
    assert (counted[0], counted[-1]) == ((4, 6), (6, 6))
    assert counted == sorted(counted)


def stopping(after):
    """Progress that interrupts once so many frames are done."""

    def progress(done, _total):
        if done == after:
            raise KeyboardInterrupt

    return progress


def test_foreign_folders_are_refused(scene, tmp_path):
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter1.tex").write_text("…")
    with pytest.raises(DatasetError, match="something other than"):
        render(scene, tmp_path / "thesis")
    with pytest.raises(DatasetError, match="not a folder"):
        render(scene, tmp_path / "thesis" / "chapter1.tex")
    with pytest.raises(DatasetError, match="cannot write"):
        render(scene, tmp_path / "thesis" / "chapter1.tex" / "below")
    with pytest.raises(DatasetError, match="cannot write"):
        render(scene, "/proc/simgrab")
    assert [p.name for p in tmp_path.rglob("*")] == ["thesis", "chapter1.tex"]


def test_a_full_disk_is_reported_and_survived(dataset, scene, tmp_path, monkeypatch):
    real, left = Path.write_bytes, [9]

    def write_bytes(self, data):
        left[0] -= 1
        if left[0] < 0:
            raise OSError(28, "No space left on device")
        return real(self, data)

    monkeypatch.setattr(Path, "write_bytes", write_bytes)
    with pytest.raises(DatasetError, match=r"no space left.*--resume"):
        render(scene, tmp_path / "full")
    monkeypatch.undo()
    (tmp_path / "full/.partial/rows/.DS_Store").touch()  # as macOS does
    assert render(scene, tmp_path / "full", resume=True).made < scene.frames
    assert digests(tmp_path / "full") == digests(dataset)


def test_two_writers_do_not_share_a_folder(scene, tmp_path):
    out = tmp_path / "shared"
    with Journal.of(out).opened(identity(scene)), pytest.raises(DatasetError, match="another simgrab"):
        render(scene, out, resume=True)


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"camera.principal_offset_px": [9000.0, 0.0]}, "camera"),
        ({"swing.rope_length_m": {"dist": "constant", "value": 40.0}}, "swing.rope_length_m"),
        ({"swing.jaw_deg": {"dist": "constant", "value": 120.0}}, "swing.jaw_deg"),
        ({"swing.alpha": {"sigma_deg": 30.0, "law": {"dist": "exponential"}}, "frames": 400}, "swing"),
    ],
)
def test_scenes_that_cannot_be_are_refused_before_anything_is_written(changes, key, tmp_path):
    with pytest.raises(ScenarioError) as caught:
        render(scenes.load("quay-day", SMALL | changes), tmp_path / "out")
    assert caught.value.key.startswith(key)
    assert not (tmp_path / "out").exists()


def test_no_workers(scene, tmp_path):
    with pytest.raises(DatasetError, match="workers"):
        render(scene, tmp_path / "out", workers=0)


def test_a_grab_out_of_the_picture_keeps_its_row(split_dataset):
    rows = pq.read_table(split_dataset / "labels.parquet").to_pylist()
    assert len(rows) == 12
    assert any(row["present"] and row["in_frame_fraction"] < 1 for row in rows)
    for row in rows:
        text = (split_dataset / "labels" / row["split"] / f"{row['frame']:06d}.txt").read_text()
        assert bool(text) == (row["visible_fraction"] >= 0.1)
        assert row["visible_fraction"] <= row["in_frame_fraction"] + 1e-9


@pytest.mark.slow
def test_a_grab_beyond_the_fold_of_the_lens_is_nowhere(tmp_path):
    """Brown-Conrady's polynomial would fold it back into the picture."""
    scenario = small_scene(
        camera__beta_deg=24.0,
        camera__distortion={"k1": -0.3},
        swing__alpha={"sigma_deg": 26.0, "law": {"dist": "choice", "values": [0.5, 1.0]}},
        swing__gamma_deg={"dist": "choice", "values": [0.0, 180.0]},
        frames=10,
    )
    render(scenario, tmp_path / "out")
    rows = pq.read_table(tmp_path / "out" / "labels.parquet").to_pylist()
    beyond = [r for r in rows if r["amodal_x0_px"] is None]
    assert 0 < len(beyond) < 10
    for row in beyond:
        assert (row["visible_fraction"], row["in_frame_fraction"], row["grab_u_px"]) == (0.0, 0.0, None)
        assert row["ideal_u_px"] is not None
    assert audit(tmp_path / "out").status == "passed"
