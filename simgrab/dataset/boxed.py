"""Datasets of frames that simgrab did not render, such as real ones: boxes in YOLO's or COCO's layout, split by video.

`simgrab.dataset.box_files` parses the files. Paths that lead out of the dataset are refused.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

import msgspec
import numpy as np

from simgrab.dataset.box_files import SPLIT_NAMES, BoxDataset, BoxedImage, parse
from simgrab.errors import DatasetError
from simgrab.io import pictures
from simgrab.io.parse import read_bytes, shown
from simgrab.model.geometry import Array
from simgrab.model.records import frame_files
from simgrab.model.truth import SPLITS, Boxed

SHARES = (0.7, 0.15)  # of the hashes, for train and val
ROUNDING_PX = 1.0  # by which an edge may lie outside the picture
_LAYOUT_FOLDERS = {"images", "labels", "jpegimages", "data", "obj_train_data", "annotations", *SPLIT_NAMES}
_ROBOFLOW = re.compile(r"(_(jpe?g|png|bmp|webp))?\.rf\.[0-9A-Za-z]+$")  # what it appends to a file's name
_FRAME_NUMBER = re.compile(r"[-_. ]*(frame|img|image)?[-_. ]*[0-9]+$", re.IGNORECASE)


@dataclass(frozen=True)
class BoxedDataset:
    """A dataset of boxes: its folder, rows by file, and whether it names train, val and test itself."""

    path: Path
    rows: tuple[Boxed, ...]
    named: bool

    def split(self, *names: str) -> BoxedDataset:
        """Keep the frames of some splits. The result may be empty."""
        return replace(self, rows=tuple(row for row in self.rows if row.split in names))

    @property
    def counts(self) -> str:
        """How many frames and videos there are, in a line."""
        empty, videos = sum(row.box_x0_px is None for row in self.rows), len({row.video for row in self.rows})
        return f"{self.path}: {len(self.rows)} frames, {empty} without a grab, of {videos} videos"

    @property
    def summary(self) -> str:
        """The same, by split."""
        videos = {split: len({row.video for row in self.split(split).rows}) for split in SPLITS}
        parts, how = ", ".join(f"{split} {count}" for split, count in videos.items()), "by a hash of their names"
        if not self.named and 2 * sum(videos.values()) > len(self.rows) > 2:
            how += "; so few frames a video: does each video have a folder, or a name, of its own?"
        return f"{self.counts} ({parts}, {'as the dataset names them' if self.named else how})"


@np.errstate(over="ignore", invalid="ignore")  # of numbers in files, which are refused as boxes outside the image
def read(path: str | Path, grab_classes: Collection[str] = ()) -> BoxedDataset:
    """Read a dataset of boxes: a folder in YOLO's or COCO's layout, a ``data.yaml`` or a COCO file.

    Every picture is decoded once, to get its size and to find files that cannot be read. ``grab_classes`` are those
    that are the grab; required if the dataset has several classes. Boxes of other classes are left out. Raises
    `DatasetError` in one line: the file, and what is wrong with it.
    """
    path = Path(path)
    if frame_files.is_dataset(path):
        raise DatasetError(f"{path} is a dataset that simgrab rendered, not one of real frames")
    layout = parse(path)
    if not layout.images:
        raise DatasetError(f"{path} contains no images that its labels name")
    wanted = _grabs(layout, grab_classes, path)
    rows = [_row(layout, image, wanted, i) for i, image in enumerate(layout.images)]
    named = {image.split for image in layout.images} == set(SPLITS)
    chosen = _named(rows, path) if named else splits(row.video for row in rows)
    return BoxedDataset(
        layout.root, tuple(msgspec.structs.replace(row, split=chosen[row.video]) for row in rows), named
    )


def read_all(paths: Sequence[str | Path], grab_classes: Collection[str] = ()) -> tuple[BoxedDataset, ...]:
    """Read datasets as `read` does. If there are several datasets, each video's name begins with its dataset's name."""
    found = [(str(path), read(path, grab_classes)) for path in paths]
    if len(found) < 2:
        return tuple(dataset for _, dataset in found)
    return tuple(
        replace(one, rows=tuple(msgspec.structs.replace(row, video=f"{path}: {row.video}") for row in one.rows))
        for path, one in found
    )


def video_of(file: str) -> str:
    """Name the video that a frame is of, by its file relative to the dataset, with forward slashes.

    These are the folders that the file is in, without those of the layout (``images``, ``train``, …). Without such a
    folder: the file's name without its frame number. If that leaves no name: the dataset's folder.

    Examples
    --------
    >>> video_of("images/train/crane-3/000812.jpg")
    'crane-3'
    >>> video_of("images/train/night-07_frame_000812.jpg")
    'night-07'
    >>> video_of("images/train/000812.jpg")
    'images/train'
    """
    path = PurePosixPath(file)
    folders = [part for part in path.parts[:-1] if part.lower() not in _LAYOUT_FOLDERS]
    return "/".join(folders) or _FRAME_NUMBER.sub("", _ROBOFLOW.sub("", path.stem)) or str(path.parent)


def splits(videos: Iterable[str]) -> dict[str, str]:
    """Split videos by a hash of their names: 70 % train, 15 % val, 15 % test.

    Adding videos does not change the split of the others, unless a split would be empty. A single video is train; of
    two, one is test; of three or more, each split gets at least one.
    """
    ordered = sorted(set(videos), key=lambda name: (_hash(name), name))
    hashes = np.array([_hash(name) for name in ordered])
    count = len(ordered)
    tests = max(int((hashes >= sum(SHARES)).sum()), int(count >= 2))
    vals = max(int((hashes >= SHARES[0]).sum()) - tests, int(count >= 3))
    tests = min(tests, count - 1 - int(count >= 3))
    vals = min(vals, count - 1 - tests)
    return {
        name: "test" if i >= count - tests else "val" if i >= count - tests - vals else "train"
        for i, name in enumerate(ordered)
    }


def _hash(name: str) -> float:
    return int.from_bytes(hashlib.sha256(name.encode("utf-8", "surrogateescape")).digest()[:8], "big") / 2**64


def _named(rows: Sequence[Boxed], path: Path) -> Mapping[str, str]:
    """Look up the splits of the videos as the dataset names them; refuse a video that lies in two."""
    found: dict[str, str] = {}
    for row in rows:
        other = found.setdefault(row.video, row.split)
        if other != row.split:
            raise DatasetError(
                f"{path}: the video {shown(row.video)} lies in {other} and in {row.split} ({row.file}), and frames of "
                "a video are much alike; put whole videos into one split, or name none and they are split by video"
            )
    return found


def _grabs(layout: BoxDataset, wanted: Collection[str], path: Path) -> set[str]:
    """Choose the classes that are the grab."""
    known = ", ".join(map(shown, layout.classes))
    if wanted:
        if not set(wanted) & set(layout.classes):
            raise DatasetError(f"{path} has no class {' or '.join(map(shown, wanted))}; its classes: {known or 'none'}")
        return set(wanted)
    if len(layout.classes) > 1:
        raise DatasetError(f"{path} has several classes; name the grab's class by --grab-class. Its classes: {known}")
    return set(layout.classes)


def _row(layout: BoxDataset, image: BoxedImage, wanted: set[str], number: int) -> Boxed:
    """Decode an image, and make its row."""
    file = layout.root / image.file
    data = read_bytes(file, DatasetError, most_bytes=pictures.MOST_BYTES)
    height, width = pictures.decode(data, file).shape[:2]
    if image.size not in (None, (width, height)):
        raise DatasetError(f"{image.where}: the labels are of {image.size} px, and {file} has {(width, height)} px")
    size = np.array([width, height] * 2, float)
    scale = size if image.shares else np.ones(4)
    boxes = {tuple(_inside(box * scale, size, image)) for name, box in image.boxes if name in wanted}
    if len(boxes) > 1:
        raise DatasetError(
            f"{image.where}: {len(boxes)} boxes of the grab in one frame, of which one alone hangs from the crane; "
            "label others as another class"
        )
    if not boxes and image.crowds & wanted:
        raise DatasetError(
            f"{image.where}: the grab has only a region marked iscrowd; if the region shows one grab, set iscrowd to 0"
        )
    edges = dict(zip(("box_x0_px", "box_y0_px", "box_x1_px", "box_y1_px"), *boxes, strict=True)) if boxes else {}
    return Boxed(
        frame=number, split=image.split, file=image.file, image_sha256=hashlib.sha256(data).hexdigest(),
        video=video_of(image.file), width_px=width, height_px=height, **edges,
    )  # fmt: skip


def _inside(box: Array, size: Array, image: BoxedImage) -> list[float]:
    """Clip a box to the picture, within rounding; refuse a box that is empty or lies outside."""
    clipped = np.clip(box, 0, size)
    sides, what = clipped[2:] - clipped[:2], f"{image.where}: a box ({', '.join(f'{edge:.1f}' for edge in box)})"
    if not np.isfinite(box).all() or np.abs(box - clipped).max() > ROUNDING_PX:
        raise DatasetError(f"{what} lies outside the image of {size[0]:.0f} x {size[1]:.0f} px")
    if not (sides > 0).all():
        raise DatasetError(f"{what} has no area")
    if (sides < 1).all():
        raise DatasetError(f"{what} is smaller than a pixel{'' if image.shares else '; is it in px?'}")
    return clipped.tolist()
