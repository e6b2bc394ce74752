import json
import os
import pickle
import shutil
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest
from conftest import altered
from pycocotools.coco import COCO

import simgrab
from simgrab.dataset import datasets
from simgrab.dataset.export import export
from simgrab.errors import DatasetError
from simgrab.instrument.source import open_source
from simgrab.model import calibration
from simgrab.model.records import frame_files


def test_what_is_no_dataset_is_refused(copy, tmp_path):
    with pytest.raises(DatasetError, match="not a dataset"):
        datasets.read(tmp_path)
    with pytest.raises(DatasetError, match="no dataset given"):
        datasets.read_all([])
    with pytest.raises(DatasetError, match="no frames in the split 'moon'"):
        datasets.read_all([copy], "moon")
    picture = copy / datasets.read(copy).rows[3].file
    picture.unlink()
    with pytest.raises(DatasetError, match="frame 3 has labels but no image"):
        datasets.read(copy)
    labels = copy / "labels.parquet"
    table = pq.read_table(labels)
    pq.write_table(table.slice(0, 0), labels)
    with pytest.raises(DatasetError, match="no frames in labels"):
        datasets.read(copy)
    pq.write_table(table.drop_columns(["alpha_deg"]), labels)
    with pytest.raises(DatasetError, match="not a simgrab dataset"):
        datasets.read(copy)
    labels.unlink()
    with pytest.raises(DatasetError, match="not a dataset"):
        datasets.read(copy)
    (copy / ".partial").mkdir()
    with pytest.raises(DatasetError, match="unfinished"):
        datasets.read(copy)


@pytest.mark.parametrize("name", ["../picture.jpg", "images/../../picture.jpg", "{outside}", "/etc/hostname"])
def test_a_dataset_names_no_picture_outside(copy, name):
    outside = copy.parent / "picture.jpg"
    shutil.copy(copy / datasets.read(copy).rows[0].file, outside)
    altered(copy, "file", lambda names: [*names[:2], name.format(outside=outside), *names[3:]])
    for read in (datasets.read, open_source):
        with pytest.raises(DatasetError, match=r"frame 2 names the image .*, which is not in the dataset"):
            read(copy)


@pytest.mark.parametrize("what", ["a file", "a folder", "a file through itself"])
def test_a_link_leads_to_no_other_picture_outside(copy, what):
    picture = copy / datasets.read(copy).rows[2].file
    if what == "a folder":
        shutil.move(picture.parent, copy.parent / "elsewhere")
        picture.parent.symlink_to("../../elsewhere")
    else:
        shutil.move(picture, copy.parent / "picture.jpg")
        picture.symlink_to(copy.parent / "picture.jpg" if what == "a file" else picture.name)
    if "itself" not in what:  # as in a cache that keeps files by their digests
        assert datasets.read(copy)[2].picture.any()
        with picture.open("ab") as file:
            file.write(b"\n")
    why = "Too many levels" if "itself" in what else "does not match the digest in its labels"
    for read in (datasets.read, open_source):
        with pytest.raises(DatasetError, match=why):
            read(copy)


def test_a_dataset_may_be_a_link_and_hold_links_within(copy):
    picture = copy / datasets.read(copy).rows[2].file
    picture.rename(copy / "picture.jpg")
    picture.symlink_to("../../picture.jpg")
    (copy.parent / "link").symlink_to("copy")
    assert datasets.read(copy.parent / "link")[2].picture.any()


def test_paths_that_cannot_be_are_refused_in_one_line(copy):
    for path in ("a" * 300, copy / ("b" * 300), "a\0b"):
        for read in (datasets.read, frame_files.is_dataset):
            with pytest.raises(DatasetError, match=r"cannot read .*: (File name too long|embedded null byte)"):
                read(path if read is datasets.read else Path(path))
    for name, why in (("c" * 300, "File name too long"), ("a\0b", "embedded null byte")):
        altered(copy, "file", lambda names, name=name: [*names[:-1], name])
        with pytest.raises(DatasetError, match=why):
            datasets.read(copy)


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("fx_px", float("nan")), ("fx_px", 0.0), ("alpha_deg", 1e308), ("alpha_deg", -1.0), ("beta_deg", float("inf")),
        ("width_px", -1), ("height_px", 10**9), ("frame", -1), ("split", "moon"), ("k1", None), ("k1", float("-inf")),
        ("keypoints", [0.0] * 3), ("keypoints", [float("nan")] * 30), ("jib_from_camera", [0.0] * 11),
        ("oriented_box", [0.0] * 7), ("m_px", float("nan")), ("box_x0_px", -1),
    ],
)  # fmt: skip
def test_a_label_that_cannot_be_is_refused_with_its_row(copy, column, value, monkeypatch):
    monkeypatch.setattr(frame_files, "_CONVERTED_TOGETHER", 2)
    altered(copy, column, lambda values: [*values[:3], value, *values[4:]])
    with pytest.raises(DatasetError, match=rf"not a simgrab dataset .*\$\[3\]\.{column}"):
        datasets.read(copy)


@pytest.mark.parametrize(
    ("column", "value"), [("box_y0_px", None), ("box_x1_px", 0), ("box_x1_px", 481), ("height_px", 9)]
)
def test_a_box_that_is_none_of_the_picture_is_refused(copy, column, value):
    altered(copy, column, lambda values: [*values[:3], value, *values[4:]])
    with pytest.raises(DatasetError, match=r"frame 3: its box \(.*\) is none of"):
        datasets.read(copy)


def test_a_box_beside_its_mask_has_no_outline(copy, tmp_path):
    for column, value in (("box_x0_px", 0), ("box_y0_px", 0), ("box_x1_px", 2), ("box_y1_px", 2)):
        altered(copy, column, lambda values, value=value: [value, *values[1:]])
    with pytest.raises(DatasetError, match="frame 0: no pixel of its mask lies in its box"):
        export(copy, tmp_path / "out", format="yolo-seg")
    for file in copy.rglob("instances_*.json"):
        known = json.loads(file.read_bytes())
        for one in known["annotations"]:
            one["segmentation"]["counts"] = "zzzzzz"  # beyond whose end COCO's decoder reads
        file.write_text(json.dumps(known))
    with pytest.raises(DatasetError, match=r"the mask of frame 0 does not .*: its run lengths cannot be decoded"):
        export(copy, tmp_path / "out", format="coco")
    for file in copy.rglob("instances_*.json"):
        file.write_text('{"annotations": []}')
    with pytest.raises(DatasetError, match="frame 0: it has a box and no mask"):
        export(copy, tmp_path / "out", format="yolo-seg")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("simgrab", None), ("renderer", [1]), ("renderer", {"renderer": 1}), ("extensions", [1]), ("selection", 3),
        ("files", {"labels.parquet": 3}),
    ],
)  # fmt: skip
def test_a_manifest_that_cannot_be_is_refused_by_its_key(copy, key, value):
    known = json.loads((copy / "manifest.json").read_bytes())
    (copy / "manifest.json").write_text(json.dumps(known | {key: value}))
    with pytest.raises(DatasetError, match=rf"not a simgrab dataset .*\$\.{key}"):
        datasets.read(copy)


@pytest.mark.parametrize(
    ("columns", "why"),
    [
        ({"frame": [0, 1, 1, 3, 4, 5]}, "frame 1 comes after frame 1; they must increase"),
        ({"frame": [0, 2, 1, 3, 4, 5]}, "frame 1 comes after frame 2; they must increase"),
        ({"clip": [0] * 6}, "frame 0: clip and time_s must be given in every frame or in none"),
        ({"time_s": [None] * 5 + [0.0]}, "frame 5: clip and time_s must be given in every frame or in none"),
        ({"clip": [None] * 5 + [1], "time_s": [None] * 5 + [0.0]}, "frame 5: clip and time_s must be given in every"),
        (
            {"clip": [0] * 3 + [1] * 3, "time_s": [0.0, 1.0, 2.0, 0.0, 0.5, 0.5]},
            r"frame 5: clip 1, time_s 0\.5 comes after clip 1, time_s 0\.5; they must increase",
        ),
        ({"clip": [1] + [0] * 5, "time_s": [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]}, "frame 1: clip 0, time_s 1 comes after"),
        ({"clip": [0, 0, 1, 1, 1, 1], "time_s": [0.0, 0.5, 0.0, 1.0, 2.0, 3.0]}, None),
    ],
)
def test_frames_and_times_of_a_clip_increase(copy, columns, why):
    for column, values in columns.items():
        altered(copy, column, lambda _, values=values: values)
    if why is None:
        assert open_source(copy).times == (0.0, 0.5, 60.5, 61.5, 62.5, 63.5)
        return
    with pytest.raises(DatasetError, match=why):
        datasets.read(copy)


def test_a_dataset_is_a_sequence_of_its_frames(split_dataset):
    data = simgrab.open(split_dataset)
    assert data == datasets.read(split_dataset)
    assert len(data) == 12
    assert [frame.truth for frame in data] == list(data.rows)
    assert data[-1] == data[11] == data.frame(11)
    assert data[np.int64(3)].truth.frame == 3
    assert [frame.truth.frame for frame in data[2:9:3]] == [2, 5, 8]
    assert data[4] in data[3:6]
    assert data[4] not in data[5:]
    for index in (12, -13):
        with pytest.raises(IndexError, match=f"index {index} is out of range of 12 frames"):
            data[index]
    with pytest.raises(TypeError):
        data["0"]


def test_splits_are_datasets(split_dataset):
    data = simgrab.open(split_dataset)
    assert list(data.splits) == ["train", "val", "test"]
    for name, count in data.splits.items():
        part = data.split(name)
        assert len(part) == count
        assert part.splits == {name: count}
        assert {frame.truth.frame for frame in part} == {row.frame for row in data.rows if row.split == name}
        last = part[-1].truth.frame
        assert part.frame(last) == part[-1]
        other = next(row.frame for row in data.rows if row.split != name)
        with pytest.raises(KeyError, match=f"no frame {other} among these {count}"):
            part.frame(other)
    assert len(data.split("val").split("train")) == 0
    with pytest.raises(KeyError, match=r"no split 'valid'; one of: train, val, test"):
        data.split("valid")


def test_frames_hold_what_the_files_hold(split_dataset):
    data = simgrab.open(split_dataset)
    table = pq.read_table(split_dataset / "labels.parquet").to_pylist()
    annotated = {}
    for split in data.splits:
        coco = COCO(str(split_dataset / "annotations" / f"instances_{split}.json"))
        annotated |= {a["image_id"]: coco.annToMask(a) for a in coco.loadAnns(coco.getAnnIds())}
    assert 0 < len(annotated) < len(data)
    for frame, row in zip(data, table, strict=True):
        assert msgspec.structs.asdict(frame.truth) == {
            k: tuple(v) if isinstance(v, list) else v for k, v in row.items()
        }
        assert frame.picture.shape == (row["height_px"], row["width_px"], 3)
        np.testing.assert_array_equal(frame.picture[..., ::-1], cv2.imread(str(split_dataset / row["file"])))
        assert frame.labelled == (row["frame"] in annotated)
        if frame.labelled:
            np.testing.assert_array_equal(frame.mask, annotated[row["frame"]])
            assert frame.mask.dtype == bool
        else:
            assert frame.mask is None
        for box, name in ((frame.box, "box"), (frame.amodal_box, "amodal")):
            corners = [row[f"{name}_{corner}_px"] for corner in ("x0", "y0", "x1", "y1")]
            assert (corners if box is None else box.tolist()) == corners
            assert (box is None) == (corners[0] is None)


def test_the_camera_of_a_frame_projects_the_grab_where_the_picture_has_it(crooked_dataset):
    for frame in simgrab.open(crooked_dataset):
        camera_from_grab = np.linalg.inv(frame.jib_from_camera) @ frame.jib_from_grab
        at = frame.intrinsics.project(camera_from_grab[:3, 3])
        np.testing.assert_allclose(at, [frame.truth.grab_u_px, frame.truth.grab_v_px], atol=1e-6)
        np.testing.assert_allclose(frame.keypoints[0, :2], at, atol=1e-6)


def test_scenario_and_calibration_are_those_of_the_dataset(dataset, scene):
    data = simgrab.open(dataset)
    assert data.scenario == scene
    assert data.calibration == calibration.load(dataset / "camera.toml")


def test_pictures_and_masks_are_read_only_when_asked_for(copy):
    for file in (*copy.rglob("*.jpg"), *copy.rglob("instances_*.json")):
        file.write_bytes(b"damaged")
    frame = simgrab.open(copy)[2]
    with pytest.raises(DatasetError, match="changed or damaged"):
        _ = frame.picture
    with pytest.raises(DatasetError, match="not readable COCO labels"):
        _ = frame.mask
    (copy / "annotations" / f"instances_{frame.truth.split}.json").unlink()
    with pytest.raises(DatasetError, match="cannot read"):
        _ = frame.mask


@pytest.mark.parametrize("mark", ["utf-8", "utf-8-sig"])
def test_masks_are_found_wherever_they_stand(copy, mark):
    masks = [frame.coded_mask for frame in simgrab.open(copy)]
    assert any(masks)
    for file in copy.rglob("instances_*.json"):
        known = json.loads(file.read_bytes())
        known["annotations"] = [dict(reversed(one.items())) for one in reversed(known["annotations"])]
        file.write_text(json.dumps(known, indent=2), encoding=mark)
    data = simgrab.open(copy)
    assert [frame.coded_mask for frame in data] == masks
    for file in copy.rglob("instances_*.json"):
        file.write_bytes(file.read_bytes()[::-1])
    with pytest.raises(DatasetError, match="not readable COCO labels"):
        _ = data[0].coded_mask


def test_a_picture_file_is_not_read_beyond_its_limit(copy):
    frame = simgrab.open(copy)[2]
    with frame.file.open("wb") as file:
        file.truncate(40 * 2**30)
    with pytest.raises(DatasetError, match="the limit is 763 MiB"):
        _ = frame.picture
    frame.file.unlink()
    os.mkfifo(frame.file)  # which would be waited for
    with pytest.raises(DatasetError, match="it is a pipe, not a file"):
        _ = frame.picture


def test_a_dataset_goes_to_another_process(dataset):
    data = simgrab.open(dataset)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(data))[1].mask, data[1].mask)
