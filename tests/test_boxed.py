"""Datasets of boxes in YOLO's and COCO's layouts, and their split by video."""

import json
import os
import shutil

import cv2
import numpy as np
import pytest

from simgrab.dataset import boxed, datasets
from simgrab.dataset.export import export
from simgrab.errors import DatasetError
from simgrab.model import label_arrays as arrays

WIDTH, HEIGHT = 64, 40
BOX = (8.0, 4.0, 24.0, 20.0)
LINE = "0 0.25 0.3 0.25 0.4\n"  # the same


def image(path, light=0):
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.full((HEIGHT, WIDTH, 3), light, np.uint8))
    return path


def as_yolo(folder, files, text=LINE, description="train: images\nnames: [grab]\n"):
    """A dataset in YOLO's layout, each image in a light of its own."""
    for light, file in enumerate(files):
        image(folder / "images" / file, light)
        label = (folder / "labels" / file).with_suffix(".txt")
        label.parent.mkdir(parents=True, exist_ok=True)
        label.write_text(text)
    folder.mkdir(exist_ok=True)
    if description:
        (folder / "data.yaml").write_text(description)
    return folder


def coco_of(files, boxes=(BOX,), classes=("grab",), size=(WIDTH, HEIGHT)):
    images = [{"id": i, "file_name": file, "width": size[0], "height": size[1]} for i, file in enumerate(files)]
    annotations = [
        {"id": 9 * i + k, "image_id": i, "category_id": 1, "bbox": [x0, y0, x1 - x0, y1 - y0]}
        for i in range(len(files))
        for k, (x0, y0, x1, y1) in enumerate(boxes)
    ]
    categories = [{"id": i + 1, "name": name} for i, name in enumerate(classes)]
    return {"images": images, "annotations": annotations, "categories": categories}


def as_coco(folder, files, content=None, **changes):
    """A dataset in COCO's layout; the file's content may be any other."""
    for light, file in enumerate(files):
        image(folder / "images" / file, light)
    (folder / "annotations").mkdir(parents=True, exist_ok=True)
    data = content if isinstance(content, bytes) else json.dumps(content or coco_of(files, **changes)).encode()
    (folder / "annotations" / "instances_default.json").write_bytes(data)
    return folder


# Reading ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [as_yolo, as_coco])
def test_a_box_is_read_in_pixels(tmp_path, make):
    row, other = boxed.read(make(tmp_path, ["a/1.png", "b/2.png"])).rows
    np.testing.assert_allclose(arrays.box(row), BOX)
    assert (row.file, row.video, row.width_px, row.height_px) == ("images/a/1.png", "a", WIDTH, HEIGHT)
    assert row.image_sha256 != other.image_sha256
    assert np.isnan([*arrays.centre(row), arrays.yaw(row)]).all()


TWO_POINTS = LINE.strip() + " 0.2 0.25 0.3 0.35\n"
FOUR_POINTS = LINE.strip() + " 0.2 0.25 1 0.3 0.35 2 0.25 0.2 1 0 0 0\n"
POLYGON = "0 0.25 0.1 0.375 0.3 0.3 0.5 0.125 0.45\n"
SLANTED = "0 0.25 0.1 0.375 0.3 0.25 0.5 0.125 0.3\n"  # as an oriented box
ODD = LINE.strip() + " 0.2 0.25 2\n"


@pytest.mark.parametrize(
    ("line", "description"),
    [
        (TWO_POINTS, "kpt_shape: [2, 2]"), (FOUR_POINTS, "kpt_shape: [4, 3]"), (FOUR_POINTS, "kpt_shape: [6, 2]"),
        (ODD, "kpt_shape: [1, 3]"), (LINE, "kpt_shape: [4, 3]"), (LINE, "kpt_shape:"),
        (SLANTED, ""), (SLANTED, "task: obb"), (POLYGON, ""), ("0 0.125 0.1 0.375 0.1 0.375 0.5\n", "task: segment"),
        (LINE.replace("0 ", "0.0 ", 1), ""), (LINE.replace("0 ", "0.000000e+00\t", 1).replace("\n", " \t\r\n\r\n"), ""),
        ("\ufeff" + LINE, ""),
        (LINE, "names: {'0': grab}"), (LINE, "names: {0: grab}"), (LINE, "names: [grab, ship]"),
    ],
)  # fmt: skip
def test_lines_of_the_same_box(tmp_path, line, description):
    names = "" if "names" in description else "names: [grab]\n"
    folder = as_yolo(tmp_path, ["a/1.png", "a/2.PNG"], line, f"train: images\n{names}{description}\n")
    for row in boxed.read(folder, ["grab"]).rows:
        np.testing.assert_allclose(arrays.box(row), BOX)


def test_polygons_are_those_that_cannot_be_key_points(tmp_path):
    """Lines of several lengths, and lines that do not begin with a box in the image."""
    several = as_yolo(tmp_path / "several", ["a/1.png", "a/2.png"], "0 0.125 0.1 0.375 0.1 0.375 0.5 0.2 0.5\n")
    (several / "labels/a/2.txt").write_text("0 0.125 0.1 0.375 0.1 0.375 0.5\n")
    beyond = as_yolo(tmp_path / "beyond", ["a/1.png"], "0 0.125 0.5 0.375 0.5 0.375 0.1\n")
    for path in (several, beyond):
        for row in boxed.read(path).rows:
            np.testing.assert_allclose(arrays.box(row), BOX)


@pytest.mark.parametrize(
    ("train", "file"),
    [
        ("images/", ""), ("./images", ""), ("[images/a]", ""), (r".\images\a", ""), ("list.txt", "images/a/1.png"),
        ("list.txt", "./images/a/1.png\r\n"), ("list.txt", ".\\images\\a\\1.png\r\n"),
        ("sets/list.txt", "../images/a/1.png"), ("[list.txt]", "data/images/a/1.png"),
        ("images\npath: .", ""), ("images\npath: data", ""),
        ("images\npath: ./data/", ""), ("a\npath: images", ""), ("list.txt\npath: images", "a/1.png"),
    ],
)  # fmt: skip
def test_places_that_a_description_names(tmp_path, monkeypatch, train, file):
    """Relative to the file that names them, to ``path``, or to the working folder, as trainers have it."""
    monkeypatch.chdir(tmp_path)
    folder = as_yolo(tmp_path / "data", ["a/1.png"], description=f"train: {train}\nnames: [grab]\n")
    (folder / "sets").mkdir()
    place = folder / train.strip("[]").split("\n")[0]
    for path in (place, folder / "images" / place.name):
        if file:
            path.write_text(file)
    (row,) = boxed.read(folder).rows
    np.testing.assert_allclose(arrays.box(row), BOX)


def test_files_of_other_programs_are_left_out(tmp_path):
    """Of macOS, Windows and a Synology NAS, among images and labels, and folders that are named as images."""
    folder = as_yolo(tmp_path / "yolo", ["a/1.png", "a/2.JPG"])
    coco = as_coco(tmp_path / "coco", ["a/1.png"])
    as_coco(tmp_path / "beside", ["a/1.png"])
    (tmp_path / "beside/annotations/instances_default.json").rename(tmp_path / "beside/labels.json")
    for place in (folder / "images/a", coco / "annotations", tmp_path / "beside", tmp_path / "beside/annotations"):
        for name in ("._1.png", ".DS_Store", "Thumbs.db", "desktop.ini", "._instances_default.json", "._x.json"):
            (place / name).write_bytes(b"\0\5\x16\7")
        image(place / "@eaDir/1.png/SYNOPHOTO_THUMB_M.png")
        image(place / ".thumbnails/1.png")
    assert [row.file for row in boxed.read(folder).rows] == ["images/a/1.png", "images/a/2.JPG"]
    for path in (coco, tmp_path / "beside"):
        assert [row.file for row in boxed.read(path).rows] == ["images/a/1.png"]


def test_label_files_in_upper_case_and_of_several_images_are_found(tmp_path):
    folder = as_yolo(tmp_path, ["a/1.png", "a/1.jpg", "a/2.png"])
    (folder / "labels/a/2.txt").rename(folder / "labels/a/2.TXT")
    rows = boxed.read(folder).rows
    assert len(rows) == 3
    assert all(np.allclose(arrays.box(row), BOX) for row in rows)


ONE, SIZE = {"id": 1, "file_name": "a/1.png"}, {"width": WIDTH, "height": HEIGHT}
LABEL = {"id": 9, "image_id": 1, "category_id": 1, "bbox": [8, 4, 16, 16]}
CLASS = {"id": 1, "name": "grab"}
CROWD = {"id": 2, "image_id": 1, "category_id": 1, "bbox": [30, 4, 16, 16], "iscrowd": 1}
PARTS = {"polygon": [[1, 1, 9, 1, 9, 9]], "coded": {"size": [40, 64], "counts": "X"}, "plain": {"counts": [9, 9]}}


def instances(*labels, image_fields=ONE | SIZE, classes=(CLASS,)):
    return {"images": [image_fields], "annotations": labels, "categories": classes}


@pytest.mark.parametrize(
    ("labels", "fields"),
    [
        ([LABEL], ONE), ([LABEL | {"image_id": "1", "category_id": 1.0}], ONE | SIZE | {"id": 1.0}),
        ([LABEL | {"image_id": 1.0, "category_id": "1"}], ONE | {"id": "1", "width": 64.0, "height": 40}),
        ([LABEL | {"image_id": "x7"}], ONE | {"id": "x7"}), ([LABEL], ONE | {"file_name": r".\a\1.png"}),
        ([LABEL], ONE | {"file_name": r"images\a\1.png"}), ([LABEL], ONE | {"file_name": "images/a/1.png"}),
        ([LABEL, CROWD], ONE), ([CROWD | {"iscrowd": True}, LABEL | {"iscrowd": False}], ONE), ([LABEL, LABEL], ONE),
        *(([LABEL | {"segmentation": part}], ONE) for part in PARTS.values()),
    ],
)  # fmt: skip
def test_coco_annotations_of_the_same_box(tmp_path, labels, fields):
    (row,) = boxed.read(as_coco(tmp_path, ["a/1.png"], instances(*labels, image_fields=fields))).rows
    np.testing.assert_allclose(arrays.box(row), BOX)


def test_simgrabs_own_exports_are_read_as_it_reads_them(split_dataset, tmp_path):
    known = datasets.read(split_dataset)
    for layout, name in (("yolo", "data.yaml"), ("coco", "annotations/instances_train.json")):
        export(split_dataset, tmp_path / layout, format=layout)
        rows = {row.file: row for row in boxed.read(tmp_path / layout / name).rows}
        wanted = [row for row in known.rows if layout == "yolo" or row.split == "train"]
        assert set(rows) == {row.file for row in wanted}
        for row in wanted:
            found = arrays.box(rows[row.file])
            assert (found is not None) == known.is_labelled(row)
            if found is not None:
                np.testing.assert_allclose(found, arrays.box(row), atol=1e-5)
            assert rows[row.file].image_sha256 == row.image_sha256
            assert layout == "coco" or rows[row.file].split == row.split
    with pytest.raises(DatasetError, match="simgrab rendered"):
        boxed.read(split_dataset)


def test_an_image_with_no_box_is_an_empty_frame(tmp_path):
    yolo, coco = as_yolo(tmp_path / "yolo", ["a/1.png", "a/2.png", "a/3.png"]), tmp_path / "coco"
    (yolo / "labels/a/2.txt").write_text("")
    (yolo / "labels/a/3.txt").unlink()
    as_coco(coco, ["a/1.png"], boxes=())
    assert [arrays.box(row) is None for path in (yolo, coco) for row in boxed.read(path).rows] == [False, *[True] * 3]


def test_other_layouts_are_found(tmp_path):
    beside = tmp_path / "beside"
    image(beside / "a_1.png")
    (beside / "a_1.txt").write_text(LINE)
    roboflow = as_yolo(
        tmp_path / "roboflow", [], description="train: ../train/images\nval: ../valid/images\nnames: [grab]\n"
    )
    for folder in ("train", "valid"):
        image(roboflow / folder / "images" / f"{folder}_1_png.rf.0a1b.png", len(folder))
        (roboflow / folder / "labels").mkdir()
        (roboflow / folder / "labels" / f"{folder}_1_png.rf.0a1b.txt").write_text(LINE)
    listed = as_yolo(tmp_path / "listed", ["a/1.png", "b/1.png"], description="train: list.txt\nnames: {0: grab}\n")
    (listed / "list.txt").write_text("images/a/1.png\n\n")
    json_beside = tmp_path / "json"
    image(json_beside / "valid" / "a_1.png")
    (json_beside / "valid" / "_annotations.coco.json").write_text(json.dumps(coco_of(["a_1.png"])))
    for path, videos in {
        beside: ["a"], roboflow: ["train", "valid"], listed: ["a"], json_beside: ["a"],
    }.items():  # fmt: skip
        dataset = boxed.read(path)
        assert [row.video for row in dataset.rows] == videos
        assert all(np.allclose(arrays.box(row), BOX) for row in dataset.rows)


@pytest.mark.parametrize("make", [as_yolo, as_coco])
def test_the_grabs_class_is_chosen(tmp_path, make):
    if make is as_yolo:
        as_yolo(tmp_path, ["a/1.png"], LINE + "1 0.5 0.5 0.1 0.1\n", "train: images\nnames: [grab, ship]\n")
    else:
        as_coco(tmp_path, ["a/1.png"], classes=("grab", "ship"))
    with pytest.raises(DatasetError, match=r"--grab-class\. Its classes: 'grab', 'ship'"):
        boxed.read(tmp_path)
    with pytest.raises(DatasetError, match="no class 'crab'; its classes: 'grab', 'ship'"):
        boxed.read(tmp_path, ["crab"])
    np.testing.assert_allclose(arrays.box(boxed.read(tmp_path, ["grab"]).rows[0]), BOX)


# Videos and splits -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("file", "video"),
    [
        ("images/train/crane-3/000812.jpg", "crane-3"), ("images/2024/crane-3/x.jpg", "2024/crane-3"),
        ("images/train/night-07_frame_000812.jpg", "night-07"), ("night-07_12.png", "night-07"), ("yard.png", "yard"),
        ("valid/images/cam2_0001_jpg.rf.8f2cB1.jpg", "cam2"), ("images/val/000812.jpg", "images/val"),
        ("images/val/frame_000812.jpg", "images/val"), ("a.b-3.jpg", "a.b"),
    ],
)  # fmt: skip
def test_a_video_is_identified_by_folder_or_name(file, video):
    assert boxed.video_of(file) == video


def test_videos_are_split_by_their_names_alone():
    names = [f"video {i}" for i in range(2000)]
    whole = boxed.splits(names)
    shares = [list(whole.values()).count(split) / len(names) for split in ("train", "val", "test")]
    np.testing.assert_allclose(shares, [0.7, 0.15, 0.15], atol=0.03)
    some = boxed.splits(names[:300][::-1])
    assert some == {name: whole[name] for name in names[:300]}
    for count in range(1, 12):
        for start in range(0, 200, 20):
            found = list(boxed.splits(names[start : start + count]).values())
            assert set(found) >= set(("train", "test", "val")[: min(count, 3)])


def test_frames_of_a_video_are_never_split(tmp_path):
    dataset = boxed.read(as_yolo(tmp_path, [f"{video}/{i}.png" for video in "abcdef" for i in range(3)]))
    assert not dataset.named
    assert {len({row.split for row in dataset.rows if row.video == video}) for video in "abcdef"} == {1}
    assert {row.split for row in dataset.rows} == {"train", "val", "test"}
    assert dataset.counts.endswith("18 frames, 0 without a grab, of 6 videos")
    assert dataset.summary.startswith(dataset.counts)


def test_named_splits_are_kept_and_a_video_in_two_is_refused(tmp_path):
    named = "train: images/train\nval: images/valid\ntest: images/test\nnames: [grab]\n"
    files = ["train/a_1.png", "train/b_1.png", "valid/c_1.png", "test/d_1.png"]
    for path in (
        as_yolo(tmp_path / "yaml", files, description=named), as_yolo(tmp_path / "none", files, description=""),
    ):  # fmt: skip
        dataset = boxed.read(path)
        assert {row.video: row.split for row in dataset.rows} == {"a": "train", "b": "train", "c": "val", "d": "test"}
        assert dataset.named
    as_yolo(tmp_path / "yaml", [*files, "test/a_2.png"], description=named)
    with pytest.raises(DatasetError, match=r"the video 'a' lies in test and in train \(images/train/a_1.png\)"):
        boxed.read(tmp_path / "yaml")
    (tmp_path / "yaml/data.yaml").write_text("train: images\nval: images\nnames: [grab]\n")
    assert not boxed.read(tmp_path / "yaml").named


def test_videos_of_several_datasets_are_distinguished(tmp_path):
    paths = [as_yolo(tmp_path / name, ["a/1.png"]) for name in ("x", "y")]
    assert [one.rows[0].video for one in boxed.read_all(paths)] == [f"{path}: a" for path in paths]
    assert boxed.read_all(paths[:1])[0].rows[0].video == "a"


# What is refused -------------------------------------------------------------------------------------------------


def refused(path, grab_classes=()):
    with pytest.raises(DatasetError) as problem:
        boxed.read(path, grab_classes)
    text = str(problem.value)
    assert "\n" not in text
    return text


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("hello\n", "expected 'class x y width height' or a polygon, got 'hello'"),
        ("0 0.1 0.1 0.2\n", "3 values after the class are too few"), ("-1 0.5 0.5 0.2 0.2", "got -1"),
        ("0 0.1 0.1 nan 0.1 0.2 0.2", "lies outside the image"), ("0 0.9 0.1 0.9 0.2 0.9 0.3", "has no area"),
        ("0 0.5 0.5 1.2 0.2", "lies outside the image of 64 x 40 px"), ("0 nan 0.5 0.2 0.2", "lies outside the image"),
        ("0 inf 0.5 inf 0.2", "lies outside the image"), ("0 1e308 0.5 1e308 1e308", "lies outside the image"),
        ("0 100 50 20 20", "lies outside the image"),
        ("0 0.5 0.5 0.2 0.2 0.9", "5 values after the class are one too many: a label has no confidence and no angle"),
        ("grab 0.5 0.5 0.2 0.2", "'grab' is not a number"), ("0,0.5,0.5,0.2,0.2", "0.5,0.2,0.2' is not a number"),
        ("0.5 0.5 0.5 0.2 0.2", "a class must be a whole number, got 0.5"), ("nan 0.5 0.5 0.2 0.2", "got nan"),
        (ODD, "7 values after the class are an odd number; if they are a box and key points, state kpt_shape"),
        ("0 0.5 0.5 0.001 0.001", "smaller than a pixel"), ("0 0.5 0.5 0 0.2", "has no area"),
        ("0 0.5 0.5 -0.2 0.2", "has no area"), ("3 0.5 0.5 0.2 0.2", "class 3 is not among the 1 names"),
        (LINE + "0 0.5 0.5 0.1 0.1", "2 boxes of the grab in one frame"),
    ],
)  # fmt: skip
def test_labels_that_are_none_are_refused(tmp_path, text, problem):
    answer = refused(as_yolo(tmp_path, ["a/1.png"], text))
    assert problem in answer
    assert str(tmp_path / "labels/a/1.txt") in answer


@pytest.mark.parametrize(
    ("line", "description", "problem"),
    [
        (TWO_POINTS, "", "may be a polygon, or a box and key points; write 'task: segment' or 'kpt_shape: [2, 2]'"),
        (FOUR_POINTS.replace(" 0 0 0", ""), "", "13 values after the class are an odd number"),
        (FOUR_POINTS.replace("2", "1"), "", "'kpt_shape: [6, 2]' or 'kpt_shape: [4, 3]'"),
        (TWO_POINTS, "kpt_shape: [4, 3]", "8 values after the class do not fit kpt_shape [4, 3]"),
        (SLANTED, "kpt_shape: [4, 2]", "8 values after the class do not fit"),
        *((LINE, f"kpt_shape: {shape}", "kpt_shape must be [number of key points, 2 or 3]")
          for shape in ("4", "[4]", "[4, 4]", "[0, 2]", "'4, 3'", "[4, 3.0]")),
    ],
)  # fmt: skip
def test_key_points_that_are_not_stated_are_refused(tmp_path, line, description, problem):
    description = f"train: images\nnames: [grab]\n{description}\n"
    assert problem in refused(as_yolo(tmp_path, ["a/1.png", "a/2.png"], line, description))


def test_what_rounding_leaves_outside_is_clipped(tmp_path):
    np.testing.assert_allclose(
        arrays.box(boxed.read(as_yolo(tmp_path, ["a/1.png"], "0 0.5 0.5 1.02 1.02")).rows[0]), [0, 0, WIDTH, HEIGHT]
    )


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"{", "not readable COCO labels"),
        (b"[" * 100_000, "not readable COCO labels"),
        (b"\xff", "not readable COCO"),
        (b"{}", "missing required field `images`"),
        (b'{"images": 3}', "Expected `array`"),
        (coco_of(["a/gone.png"]), "the image 'a/gone.png' is missing"),
        (coco_of(["a/\0.png"]), "null byte"),
        (coco_of(["a/1.png"], classes=()), "category 1, which is not listed"),
        (coco_of(["a/1.png"]) | {"images": []}, "image 0, which is not listed"),
        (coco_of([]), "contains no images"),
        (coco_of(["a/1.png"] * 2), "is also an image of"),
        (coco_of(["../../outside.png"]), "is not in the dataset"),
        (coco_of(["a/1.png"], boxes=[(-9.0, 0.0, 20.0, 20.0)]), "lies outside the image"),
        (coco_of(["a/1.png"], boxes=[BOX, (1.0, 1.0, 5.0, 5.0)]), "2 boxes of the grab"),
        (coco_of(["a/1.png"], size=(99, 40)), "the labels are of (99, 40) px"),
        (instances(CROWD), "image 'a/1.png': the grab has only a region marked iscrowd"),
        (instances({"id": 1, "image_id": 1, "category_id": 1, "segmentation": []}), "missing required field `bbox`"),
        (instances(LABEL | {"bbox": [0.125, 0.1, 0.25, 0.4]}), "smaller than a pixel; is it in px?"),
        (instances(LABEL, classes=[CLASS, CLASS | {"name": "ship"}]), "category 1 is listed twice"),
        (instances(LABEL | {"image_id": "01"}), "an annotation is of image 01, which is not listed"),
        (instances(LABEL, image_fields=ONE | {"file_name": r"C:\a\1.png"}), r"image 'C:\\a\\1.png' is missing"),
    ],
)
def test_coco_files_that_are_none_are_refused(tmp_path, content, problem):
    image(tmp_path / "outside.png")
    assert problem in refused(as_coco(tmp_path / "in" / "data", ["a/1.png"], content))


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "keys such as train"),
        ("train: [", "not valid YAML"),
        ("train: !!int ''", "not valid YAML"),
        ("train: !!bool x", "not valid YAML"),
        ("train: !!timestamp x", "not valid YAML"),
        (f"train: {':'.join('1' * 400)}.0", "not valid YAML"),
        ("train: &a [*a]\nnames: [grab]", "must name folders"),
        ("train: images", "names must list the classes"),
        ("names: [grab]", "train, val and test are all missing"),
        ("train: gone\nnames: [grab]", "neither a folder nor"),
        ("train: ../other\nnames: [grab]", "is not in the dataset"),
        ("train: /etc\nnames: [grab]", "is not in the"),
        ("path: /etc\ntrain: images\nnames: [grab]", "is not in the dataset"),
        ("train: {a: b}\nnames: [grab]", "must name folders"),
        ("train: images\nnames: [[a]]", "names must list"),
        ("path: 3\ntrain: images\nnames: [grab]", "path must be text"),
        ("path: /gone\ntrain: images\nnames: [grab]", "path names '/gone', which is not a folder; without this key"),
        ("train: images\nnames: {grab: 0}", "names must list the classes, such as [grab] or {0: grab}"),
        ("train: list.txt\nnames: [grab]", "is not in the dataset"),
    ],
)
def test_a_description_that_is_none_is_refused(tmp_path, text, problem):
    image(tmp_path / "other" / "1.png")
    folder = as_yolo(tmp_path / "data", ["a/1.png"], description=text or "\n")
    (folder / "list.txt").write_text("images/a/1.png\n../other/1.png\n")
    answer = refused(folder)
    assert problem in answer
    assert "data.yaml" in answer or "list.txt" in answer


def test_what_leads_out_of_the_dataset_is_refused(tmp_path):
    outside = image(tmp_path / "outside.png")
    (tmp_path / "outside.txt").write_text(LINE)
    linked = as_yolo(tmp_path / "linked", ["a/1.png"])
    (linked / "images/a/2.png").symlink_to(outside)
    assert "2.png, which is not in the dataset" in refused(linked)
    labels = as_yolo(tmp_path / "labels", ["a/1.png"])
    (labels / "labels/a/1.txt").unlink()
    (labels / "labels/a/1.txt").symlink_to(tmp_path / "outside.txt")
    assert "1.txt, which is not in the dataset" in refused(labels)
    folder = as_yolo(tmp_path / "folder", ["a/1.png"], description="train: images/more\nnames: [grab]")
    (folder / "images/more").symlink_to(linked / "images")
    assert "more, which is not in the dataset" in refused(folder)
    inside = as_yolo(tmp_path / "inside", ["a/1.png"])
    (inside / "images/a/2.png").symlink_to(inside / "images/a/1.png")
    assert len(boxed.read(inside).rows) == 2
    (tmp_path / "door").symlink_to(inside)
    assert len(boxed.read(tmp_path / "door").rows) == 2
    (inside / "data.yaml").write_text("train: ../door/images\nnames: [grab]\n")
    assert "images, which is not in the dataset" in refused(inside)


def test_images_that_cannot_be_read_are_refused(tmp_path):
    for name, content in {"empty": b"", "noise": b"\x01" * 99, "cut": None}.items():
        path = as_yolo(tmp_path / name, ["a/1.png"]) / "images/a/1.png"
        path.write_bytes(path.read_bytes()[:60] if content is None else content)
        assert f"{path} cannot be read as an image" in refused(tmp_path / name)


def test_a_dataset_with_nothing_in_it_is_refused(tmp_path):
    (tmp_path / "empty").mkdir()
    assert "contains no images" in refused(tmp_path / "empty")
    assert "is needed" in refused(tmp_path / "gone")
    bare = as_yolo(tmp_path / "bare", ["a/1.png"])
    shutil.rmtree(bare / "labels")
    assert "no image has a label file" in refused(bare)


def test_a_name_that_is_no_text_is_refused(tmp_path):
    folder = as_yolo(tmp_path, ["a/1.png"])
    try:
        (folder / "images/a/1.png").rename(folder / "images/a" / os.fsdecode(b"\xff1.png"))
    except OSError:
        pytest.skip("this file system takes no such name")
    assert "can't encode" in refused(folder)
