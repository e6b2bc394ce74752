"""The tables open in the tools that people use."""

import itertools
import json

import duckdb
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from conftest import small_scene

from simgrab.dataset.render import render
from simgrab.dataset.yolo import data_yaml
from simgrab.model.truth import KEYPOINT_NAMES, SPLITS


def boxes(path):
    table = pd.read_parquet(path / "labels.parquet").set_index("frame")
    return table[["box_x0_px", "box_y0_px", "box_x1_px", "box_y1_px"]], table


def test_duckdb_and_pandas_read_the_labels(dataset):
    _, table = boxes(dataset)
    query = f"select count(*), max(alpha_deg) from '{dataset / 'labels.parquet'}'"
    count, most = duckdb.sql(query).fetchall()[0]
    assert (count, most) == (len(table), table.alpha_deg.max())


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


def test_keypoints_and_boxes_agree(crooked_dataset):
    """Every keypoint of the grab lies in its amodal box; A lies between the terminations and the lips."""
    _, table = boxes(crooked_dataset)
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


def test_column_metadata_survives(dataset):
    schema = pq.read_schema(dataset / "labels.parquet")
    assert schema.field("rope_length_m").metadata[b"unit"] == b"m"
    assert json.loads(schema.metadata[b"keypoint_names"]) == list(KEYPOINT_NAMES)
    assert json.loads(schema.metadata[b"simgrab"])["scenario"]["name"] == "quay-day"
