"""Exports, read back by the tools that they are for: boxes to 1e-6 px, truth bit for bit."""

import gc
import io
import json
import xml.etree.ElementTree as ET

import cv2
import msgspec
import numpy as np
import pandas as pd
import PIL.Image
import pytest
import yaml
from commands import run
from conftest import by_yolo, digests
from pycocotools import mask as coco_mask
from pycocotools.coco import COCO
from test_dataset import stopping

import simgrab
from simgrab.cli import export as command
from simgrab.dataset import preview
from simgrab.dataset.box_files import parse
from simgrab.dataset.card import HF_SPLITS
from simgrab.dataset.export import FORMATS, export
from simgrab.dataset.yolo import outline, straightened
from simgrab.errors import DatasetError
from simgrab.model.truth import KEYPOINT_NAMES, Row


@pytest.fixture(scope="module")
def source(split_dataset):
    """Frames in all splits, one of them at least without a box."""
    data = simgrab.open(split_dataset)
    assert set(data.splits) == {"train", "val", "test"}
    return data


@pytest.fixture(scope="module")
def exported(source, tmp_path_factory):
    out = tmp_path_factory.mktemp("exports")
    for name in FORMATS:
        export(source, out / name, format=name, shard_frames=3)
    return out


def test_the_command_offers_every_format():
    assert tuple(FORMATS) == command.FORMATS  # a copy, so that --help need not import what writes them


def plain(row):
    """As Parquet and JSON give it back: lists in place of tuples."""
    return json.loads(msgspec.json.encode(row))


def same_picture(picture, frame):
    np.testing.assert_array_equal(
        np.asarray(picture.convert("RGB")), np.asarray(PIL.Image.open(io.BytesIO(frame.content)))
    )


def test_labels_parquet_is_the_truth_bit_for_bit(source, exported):
    for name in ("yolo", "yolo-seg", "coco", "hf", "simgrab"):
        table = pd.read_parquet(exported / name / "labels.parquet", dtype_backend="pyarrow").to_dict("records")
        rows = [{key: None if value is pd.NA else value for key, value in row.items()} for row in table]
        assert msgspec.convert(rows, list[Row]) == [frame.truth for frame in source]


def numbers(folder, frame):
    """What follows the class in a frame's label file."""
    row = frame.truth
    return np.array((folder / "labels" / row.split / f"{row.frame:06d}.txt").read_text().split()[1:], float)


def test_yolo_key_points(source, exported):
    for frame in source:
        values, size = numbers(exported / "yolo-pose", frame), (frame.truth.width_px, frame.truth.height_px)
        assert len(values) == 34 * frame.labelled
        if frame.labelled:
            np.testing.assert_array_equal(values[:4], numbers(exported / "yolo", frame))
            points = values[4:].reshape(-1, 3) * (*size, 1)
            np.testing.assert_allclose(points, frame.keypoints, rtol=0, atol=1e-6)


def test_yolo_polygons_are_the_masks(source, exported):
    """By COCO's rule, and by that of trainers that round corners down to pixels in 32 bits and include the edge."""
    for frame in source:
        values, size = numbers(exported / "yolo-seg", frame), (frame.truth.width_px, frame.truth.height_px)
        assert (len(values) > 0) == frame.labelled
        if frame.labelled:
            corners, mask = values.reshape(-1, 2) * size, np.zeros(size[::-1], np.uint8)
            (coded,) = coco_mask.frPyObjects([corners.ravel().tolist()], *size[::-1])
            np.testing.assert_array_equal(coco_mask.decode(coded), frame.mask)
            shares = values.astype(np.float32).reshape(-1, 2)
            cv2.fillPoly(mask, [(shares * np.array(size, np.float32)).astype(np.int32)], 1)
            assert (mask != frame.mask).sum() <= 1e-3 * frame.mask.sum()  # lines between parts
            bounds = np.array([corners.min(axis=0), corners.max(axis=0)]) / size
            np.testing.assert_allclose(bounds, frame.box.reshape(2, 2) / size, rtol=0, atol=1e-6)


@pytest.mark.parametrize("blur", [0.3, 2.0])
def test_a_polygon_is_any_mask_with_parts_and_holes(blur):
    rng = np.random.default_rng(0)
    for share in (0.2, 0.5, 0.8):
        noise = cv2.GaussianBlur(rng.random((50, 60)), (0, 0), blur)
        mask = (noise > np.quantile(noise, share)).astype(np.uint8)
        x, y, w, h = cv2.boundingRect(mask)
        (coded,) = coco_mask.frPyObjects([outline(mask, x, y, x + w, y + h).ravel().tolist()], *mask.shape)
        np.testing.assert_array_equal(coco_mask.decode(coded), mask)


def test_a_polygon_has_no_corners_on_a_straight_line():
    assert len(outline(np.tri(90, dtype=np.uint8), 0, 0, 90, 90)) <= 6


def test_yolo_oriented_boxes(source, exported):
    """Of the whole silhouette where that is in the picture."""
    inside = 0
    for frame in source:
        values, size = numbers(exported / "yolo-obb", frame), (frame.truth.width_px, frame.truth.height_px)
        assert len(values) == 8 * frame.labelled
        if frame.labelled:
            corners, expected = values.reshape(4, 2) * size, np.reshape(frame.truth.oriented_box, (4, 2))
            if ((expected < 0) | (expected > size)).any():
                x0, y0, x1, y1 = frame.box
                expected = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
            else:
                inside += 1
            np.testing.assert_allclose(corners, expected, rtol=0, atol=1e-6)
    assert 0 < inside < len(source)
    labelled = [frame for frame in source if frame.labelled]
    assert straightened(exported / "yolo-obb").startswith(f"{len(labelled) - inside} of {len(labelled)} oriented boxes")


@pytest.mark.parametrize("url", [False, True])
def test_the_command_counts_upright_boxes_in_folders(source, url, tmp_path):
    out = (tmp_path / "obb").as_uri() if url else tmp_path / "obb"
    status, printed, noted = run("export", source.path, "--format", "yolo-obb", "--out", out)
    assert status == 0
    assert ("oriented boxes are the upright visible box" in printed + noted) == (not url)


@pytest.mark.parametrize(
    ("kind", "stated"),
    [
        ("", {}),
        ("-pose", {"task": "pose", "kpt_shape": [len(KEYPOINT_NAMES), 3], "kpt_names": {0: list(KEYPOINT_NAMES)}}),
        ("-seg", {"task": "segment"}),
        ("-obb", {"task": "obb"}),
    ],
)
def test_tools_read_every_kind_of_yolo_label(source, exported, kind, stated):
    folder, seen = exported / f"yolo{kind}", 0
    assert stated.items() <= yaml.safe_load((folder / "data.yaml").read_text()).items()
    for split in source.splits:
        for number, image, detections in by_yolo(folder, split, oriented=kind == "-obb"):
            frame, seen = source.frame(number), seen + 1
            np.testing.assert_array_equal(image[..., ::-1], frame.picture)
            assert len(detections) == frame.labelled
            if frame.labelled and kind == "-seg":  # it rounds, so that edges to the right and below gain a pixel
                wider = cv2.dilate(frame.mask.astype(np.uint8), np.ones((2, 2)), anchor=(1, 1)).astype(bool)
                assert (detections.mask[0] >= frame.mask).all()
                assert (detections.mask[0] <= wider).all()
            if frame.labelled and kind in ("", "-pose"):
                np.testing.assert_allclose(detections.xyxy[0], frame.box, rtol=0, atol=1e-4)  # which it has in 32 bits
    assert seen == len(source)
    for image in parse(folder).images:  # simgrab itself, as it reads others' datasets
        frame = source.frame(int(image.file[-10:-4]))
        assert len(image.boxes) == frame.labelled
        if frame.labelled and kind != "-obb":
            size, atol = np.tile([frame.truth.width_px, frame.truth.height_px], 2), 1e-6 if kind == "-seg" else 1e-9
            np.testing.assert_allclose(image.boxes[0][1], frame.box / size, rtol=0, atol=atol)


@pytest.mark.parametrize("layout", ["coco", "simgrab"])
def test_coco(source, exported, layout):
    for split, count in source.splits.items():
        coco = COCO(exported / layout / "annotations" / f"instances_{split}.json")
        assert len(coco.imgs) == count
        (licence,) = coco.dataset["licenses"]
        card = (exported / layout / "README.md").read_text(encoding="utf-8")
        assert card.endswith(f"## Licence\n\n{licence['name']}\n")
        assert {image["license"] for image in coco.imgs.values()} <= {licence["id"]}
        for number, image in coco.imgs.items():
            frame = source.frame(number)
            annotations = coco.imgToAnns[number]
            assert len(annotations) == frame.labelled
            same_picture(PIL.Image.open(exported / layout / image["file_name"]), frame)
            for annotation in annotations:
                x, y, w, h = annotation["bbox"]
                assert [x, y, x + w, y + h] == frame.box.tolist()
                np.testing.assert_array_equal(coco.annToMask(annotation).astype(bool), frame.mask)
                assert annotation["area"] == frame.mask.sum()
                assert len(annotation["keypoints"]) == 3 * len(KEYPOINT_NAMES)


def test_voc(source, exported):
    folder = exported / "voc"
    for split, count in source.splits.items():
        stems = (folder / "ImageSets" / "Main" / f"{split}.txt").read_text().split()
        assert len(stems) == count
        for stem in stems:
            frame, root = source.frame(int(stem)), ET.parse(folder / "Annotations" / f"{stem}.xml").getroot()
            assert (folder / "JPEGImages" / root.findtext("filename")).read_bytes() == frame.content
            assert [int(root.find("size").findtext(k)) for k in ("width", "height")] == list(frame.picture.shape[1::-1])
            boxes = [[int(box.findtext(k)) for k in ("xmin", "ymin", "xmax", "ymax")] for box in root.iter("bndbox")]
            assert boxes == ([(frame.box + (1, 1, 0, 0)).tolist()] if frame.labelled else [])


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # it leaves its files open
def test_webdataset(source, exported):
    webdataset = pytest.importorskip("webdataset")
    seen = set()
    for split, count in source.splits.items():
        urls = sorted(str(path) for path in (exported / "webdataset" / "shards").glob(f"{split}-*.tar"))
        samples = list(webdataset.WebDataset(urls, shardshuffle=False, empty_check=False).decode("pil"))
        assert len(samples) == count
        for sample in samples:
            frame = source.frame(int(sample["__key__"]))
            assert sample["json"]["truth"] == plain(frame.truth)
            assert sample["json"]["labelled"] == frame.labelled
            same_picture(sample["jpg"], frame)
            seen.add(frame.truth.frame)
    assert len(seen) == len(source)
    gc.collect()


def test_hugging_face(source, exported, monkeypatch, tmp_path):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    datasets = pytest.importorskip("datasets")
    loaded = datasets.load_dataset(str(exported / "hf"), cache_dir=str(tmp_path))
    assert {split: len(loaded[HF_SPLITS[split]]) for split in source.splits} == source.splits
    for part in loaded.values():
        for row in part:
            frame = source.frame(row["frame"])
            boxes = [[x, y, x + w, y + h] for x, y, w, h in row["objects"]["bbox"]]
            assert boxes == ([frame.box.tolist()] if frame.labelled else [])
            same_picture(row["image"], frame)
            truth = plain(frame.truth)
            assert {name: row[name] for name in truth} == truth


def test_the_own_layout_is_what_render_writes(split_dataset, exported):
    def contents(folder):
        return {str(p.relative_to(folder)): p.is_dir() or p.read_bytes() for p in folder.rglob("*")}

    assert contents(exported / "simgrab") == contents(split_dataset)


def test_the_card_names_the_files_of_each_split(source, exported):
    for name in FORMATS:
        _, head, body = (exported / name / "README.md").read_text().split("---\n")
        known = yaml.safe_load(head)
        assert (known["license"], known["size_categories"]) == ("apache-2.0", ["n<1K"])
        assert f"| frames | 12 ({', '.join(f'{split} {n}' for split, n in source.splits.items())}) |" in body
        boxes, hidden = (sum(which) for which in zip(*kinds(source), strict=True))
        assert f"| with a box | {boxes} |" in body
        assert f"| without a visible grab | {len(source) - boxes - hidden} |" in body
        assert f"| of a grab too hidden for a box | {hidden} |" in body
        assert f"]({preview.NAME})" in body
        assert ("the camera before it varies" in body) == any("camera" in key for key in source.scenario.vary)
        assert (exported / name / preview.NAME).exists()
        for config in known.get("configs", []):
            assert [part["split"] for part in config["data_files"]] == [HF_SPLITS[split] for split in source.splits]
            assert all(list((exported / name).glob(part["path"])) for part in config["data_files"])
        assert ("configs" in known) == (name != "voc")


def kinds(source):
    """Of each frame, whether it has a box, and whether it shows a grab that is too hidden for one."""
    found = [(frame.labelled, bool(frame.truth.visible_fraction) and not frame.labelled) for frame in source]
    assert any(hidden for _, hidden in found)
    return found


@pytest.mark.parametrize("name", ["yolo", "yolo-pose", "yolo-seg", "yolo-obb", "coco", "voc", "hf", "simgrab"])
def test_hidden_grabs_are_left_out_and_counted(name, source, exported, tmp_path):
    clear = [frame.truth.frame for frame, (_, hidden) in zip(source, kinds(source), strict=True) if not hidden]
    whole = export(source, tmp_path / "whole", format=name)
    part = export(source, tmp_path / "part", format=name, leave_out_hidden=True)
    assert (whole.frames, whole.below_least) == (len(source), len(source) - len(clear))
    assert (part.frames, part.below_least, part.labelled) == (len(clear), 0, whole.labelled)
    assert pd.read_parquet(tmp_path / "part" / "labels.parquet").frame.tolist() == clear
    if name != "hf":
        assert sorted(int(p.stem) for p in (tmp_path / "part").rglob("*.jpg") if p.stem.isdigit()) == clear
    shards = simgrab.open(exported / "webdataset")
    assert export(shards, tmp_path / "other", format=name, leave_out_hidden=True).splits == part.splits
    with pytest.raises(DatasetError, match="as webdataset"):
        export(source, tmp_path / "none", format="webdataset", leave_out_hidden=True)
    with pytest.raises(DatasetError, match="no frame is left"):
        export(source[1:2], tmp_path / "none", format=name, part=True, leave_out_hidden=True)


def test_the_command_states_how_many_grabs_are_background(source, tmp_path):
    hidden, given = sum(some for _, some in kinds(source)), ["export", source.path, "--format", "coco", "--out"]
    kept, left = (
        "".join(run(*given, tmp_path / name, *options)[1:])
        for name, options in (("kept", []), ("left", ["--leave-out-hidden"]))
    )
    assert f"have no label: {hidden};" in kept
    assert f"left out: {hidden} frames" in left
    assert "have no label" not in left


def test_a_split_that_stands_in_for_an_empty_one_is_named(source, tmp_path):
    train = tmp_path / "train-only"
    export(source.split("train"), train, format="simgrab", part=True)
    for layout, named in (("yolo-pose", True), ("simgrab", True), ("coco", False)):
        out = tmp_path / layout
        _, *printed = run("export", train, "--format", layout, "--out", out)
        for text in ("".join(printed), (out / "README.md").read_text()):
            assert ("data.yaml: val has no frames, so it names those of train" in text) == named
        if named:
            assert yaml.safe_load((out / "data.yaml").read_text())["val"] == "images/train"
    _, *printed = run("export", source.path, "--format", "yolo", "--out", tmp_path / "full")
    assert "has no frames" not in "".join(printed)


def test_shards_give_the_same_exports(exported, tmp_path):
    shards = simgrab.open(exported / "webdataset")
    for name in FORMATS:
        export(shards, tmp_path / name, format=name, shard_frames=3)
        assert digests(tmp_path / name) == digests(exported / name)


def test_an_export_that_cannot_be_is_refused_in_one_line(source, exported, tmp_path):
    (tmp_path / "file").touch()
    shards = simgrab.open(exported / "webdataset")
    for dataset, out, options, why in (
        (source, tmp_path / "new", {"format": "kitti"}, "no format 'kitti'; one of: yolo"),
        (source, tmp_path / "new", {"format": "hf", "shard_frames": 0}, "1 frame or more"),
        (source, exported / "yolo", {"format": "yolo"}, "exists"),
        (source, (exported / "yolo").as_uri(), {"format": "yolo"}, "is not empty"),
        (source, tmp_path / "file" / "new", {"format": "yolo"}, "not a folder"),
        (source, "nope://x", {"format": "yolo"}, "nope"),
        (source[:2], tmp_path / "new", {"format": "yolo"}, "part of a dataset"),
        (shards.split("train"), tmp_path / "new", {"format": "coco"}, "part of a dataset"),
        (tmp_path, tmp_path / "new", {"format": "coco"}, "not a dataset"),
        ((tmp_path / "none").as_uri(), tmp_path / "new", {"format": "coco"}, "not a dataset"),
        (source[::-1], tmp_path / "new", {"format": "yolo", "part": True}, "in the order"),
        (source[:0], tmp_path / "new", {"format": "yolo", "part": True}, "must contain frames"),
        (source[1:], tmp_path / "new", {"format": "webdataset", "part": True}, "as webdataset"),
        (shards[1:], tmp_path / "new", {"format": "yolo", "part": True}, "of shards"),
    ):
        with pytest.raises(DatasetError, match=why) as problem:
            export(dataset, out, **options)
        assert "\n" not in str(problem.value)
    assert list(tmp_path.iterdir()) == [tmp_path / "file"]


def test_an_interrupted_export_leaves_nothing(source, tmp_path):
    for name in FORMATS:
        with pytest.raises(KeyboardInterrupt):
            export(source, tmp_path / name, format=name, shard_frames=1, progress=stopping(2))
    assert list(tmp_path.iterdir()) == []


def test_a_part_is_a_dataset_that_says_of_what(source, tmp_path):
    part = source[2:9:3]
    for name in ("simgrab", "yolo", "hf"):
        export(part, tmp_path / name, format=name, part=True)
        table = pd.read_parquet(tmp_path / name / "labels.parquet")
        assert table.frame.tolist() == [2, 5, 8]
        manifest = json.loads((tmp_path / name / "manifest.json").read_bytes())
        assert manifest["frames"] == 3
        assert manifest["selection"] == {"of_frames": len(source), "labels_sha256": source.data.labels_sha256}
    made = simgrab.open(tmp_path / "simgrab")
    assert [frame.content for frame in made] == [frame.content for frame in part]
    export(source, tmp_path / "whole", format="yolo", part=True)
    assert "selection" not in json.loads((tmp_path / "whole" / "manifest.json").read_bytes())


@pytest.mark.parametrize("frames", [1, 3, 16, 17, 64, 1000])
def test_a_sheet_shows_frames_from_all_over_a_dataset(frames):
    shown = preview.shown(frames)
    assert len(set(shown)) == len(shown) == min(frames, preview.MOST_TILES)
    assert shown[0] == 0
    assert max(np.diff([*shown, frames])) <= -(-frames // preview.MOST_TILES)


def test_a_sheet_states_how_much_of_the_grab_things_and_weather_leave(source):
    row = msgspec.structs.replace(source[0].truth, present=True, visible_fraction=0.8, weather_hidden_fraction=0.75)
    assert preview.caption(row).endswith("   seen 20%")
    assert preview.caption(msgspec.structs.replace(row, present=False)) == f"#{row.frame} {row.split}   no grab"
