"""The tables open in the tools that people use."""

import json

import duckdb
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from pycocotools.coco import COCO

from simgrab.records import KEYPOINT_NAMES
from simgrab.world.export import SPLITS


def boxes(path):
    table = pd.read_parquet(path / "labels.parquet").set_index("frame")
    return table[["box_x0_px", "box_y0_px", "box_x1_px", "box_y1_px"]], table


def test_duckdb_and_pandas_read_the_labels(dataset):
    _, table = boxes(dataset)
    query = f"select count(*), max(alpha_deg) from '{dataset / 'labels.parquet'}'"
    count, most = duckdb.sql(query).fetchall()[0]
    assert (count, most) == (len(table), table.alpha_deg.max())


@pytest.mark.parametrize("name", ["dataset", "crooked_dataset"])
def test_coco(name, request, capsys):
    path = request.getfixturevalue(name)
    box, table = boxes(path)
    seen = 0
    for split in SPLITS:
        coco = COCO(str(path / "annotations" / f"instances_{split}.json"))
        assert sorted(coco.imgs) == sorted(table.index[table.split == split])
        for annotation in coco.loadAnns(coco.getAnnIds()):
            x, y, w, h = annotation["bbox"]
            assert [x, y, x + w, y + h] == list(box.loc[annotation["image_id"]])
            mask = coco.annToMask(annotation)
            rows, columns = np.nonzero(mask)
            assert [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1] == [x, y, x + w, y + h]
            assert annotation["area"] == mask.sum()
            assert len(annotation["keypoints"]) == 3 * len(KEYPOINT_NAMES)
            assert (path / coco.imgs[annotation["image_id"]]["file_name"]).is_file()
            seen += 1
    assert seen == len(table)
    capsys.readouterr()


def test_yolo(dataset):
    """As a trainer's loader does: data.yaml names folders of pictures, labels lie beside them."""
    supervision = pytest.importorskip("supervision")
    box, table = boxes(dataset)
    seen = 0
    for split in SPLITS:
        if not (table.split == split).any():
            continue
        loaded = supervision.DetectionDataset.from_yolo(
            images_directory_path=str(dataset / "images" / split),
            annotations_directory_path=str(dataset / "labels" / split),
            data_yaml_path=str(dataset / "data.yaml"),
        )
        assert loaded.classes == ["grab"]
        for path, image, detections in loaded:
            frame = int(path.rsplit("/", 1)[1].split(".")[0])
            assert image.shape == (table.height_px[frame], table.width_px[frame], 3)
            np.testing.assert_allclose(detections.xyxy[0], box.loc[frame], atol=1e-3)
            seen += 1
    assert seen == len(table)


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
