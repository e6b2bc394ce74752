"""YOLO's label files, in the layouts of its four tasks: boxes, key points, polygons of the mask, oriented boxes."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray
from pycocotools import mask as coco_mask
from scipy.spatial import KDTree

from simgrab.dataset.datasets import named, read_manifest
from simgrab.dataset.summary import least_visible
from simgrab.io.stores import Store
from simgrab.model import label_arrays as arrays
from simgrab.model.geometry import Array
from simgrab.model.masks import Coded
from simgrab.model.records import frame_files
from simgrab.model.scenario import Scenario
from simgrab.model.truth import KEYPOINT_NAMES, SPLITS, Row

INSET = 4e-7
"""Share of the picture by which polygons lie within their pixels: readers that round down in 32 bits get these."""
_NEEDED = ("train", "val")


class YoloKind(NamedTuple):
    """A kind of label files: numbers after the class, lines of ``data.yaml`` besides those of all, and decimals."""

    values: Callable[[Row, Array, Coded | None], Array]
    yaml: tuple[str, ...] = ()
    digits: int = 10


def _box(row: Row, box: Array, _mask: Coded | None) -> Array:
    return (np.array([(box[:2] + box[2:]) / 2, box[2:] - box[:2]]) / _size(row)).ravel()


def _pose(row: Row, box: Array, _mask: Coded | None) -> Array:
    points = np.reshape(row.keypoints, (-1, 3)) / (*_size(row), 1)
    return np.concatenate([_box(row, box, None), points.ravel()])


def _polygon(row: Row, box: Array, mask: Coded | None) -> Array:
    if mask is None:
        raise ValueError("it has a box and no mask")
    return (outline(np.asarray(coco_mask.decode(msgspec.structs.asdict(mask))), *map(int, box)) / _size(row)).ravel()


def _oriented(row: Row, box: Array, _mask: Coded | None) -> Array:
    """Corners of the whole silhouette's oriented box; of the visible box where one of them is not in the picture."""
    corners = _corners(row)
    return (box[[0, 1, 2, 1, 2, 3, 0, 3]].reshape(4, 2) / _size(row)).ravel() if corners is None else corners.ravel()


def _corners(row: Row | OrientedColumns) -> Array | None:
    """Corners of the oriented box (4, 2) in shares of the picture; None where one of them is outside."""
    corners = np.reshape(row.oriented_box or [np.nan] * 8, (4, 2)) / _size(row)
    return corners if ((corners >= 0) & (corners <= 1)).all() else None


class OrientedColumns(msgspec.Struct, frozen=True):
    """The columns of labels that `straightened` needs."""

    width_px: int
    height_px: int
    visible_fraction: float
    oriented_box: tuple[float, ...] | None


def straightened(folder: Path) -> str:
    """State in a line how many oriented boxes of a dataset's label files are upright; empty where none is."""
    rows, _, _ = frame_files.read_rows(folder, OrientedColumns)
    scenario = named(read_manifest(Store(str(folder))), folder).scenario
    least = least_visible(scenario.labels.least_visible_fraction)
    outside = [_corners(row) is None for row in rows if row.visible_fraction >= least]
    return (
        f"{sum(outside)} of {len(outside)} oriented boxes are the upright visible box, because a corner is outside the "
        "image; the column oriented_box of labels.parquet has all as they are"
        if any(outside)
        else ""
    )


_KEY_POINTS = (
    "task: pose",
    f"kpt_shape: [{len(KEYPOINT_NAMES)}, 3]",
    f"kpt_names: {{0: [{', '.join(KEYPOINT_NAMES)}]}}",  # by class
)
KINDS = {
    "box": YoloKind(_box),
    "pose": YoloKind(_pose, _KEY_POINTS),
    "seg": YoloKind(_polygon, ("task: segment",), 7),
    "obb": YoloKind(_oriented, ("task: obb",)),
}
"""By the names that ``labels.yolo`` has for them."""


def name(row: Row) -> str:
    """Path of a frame's label file in the dataset."""
    return f"labels/{row.split}/{row.frame:06d}.txt"


def label(row: Row, mask: Coded | None, scenario: Scenario, kind: str) -> bytes:
    """One frame's label file: a line of the class and shares of the picture, or nothing.

    ``kind`` is one of `KINDS`. The mask is needed for polygons of a labelled row.
    """
    box = arrays.box(row)
    if box is None or not arrays.is_labelled(row, scenario.labels.least_visible_fraction):
        return b""
    how = KINDS[kind]
    return f"0 {' '.join(f'{value:.{how.digits}f}' for value in how.values(row, box, mask))}\n".encode()


def data_yaml(full: Sequence[str], kind: str) -> bytes:
    """``data.yaml`` of a dataset with frames in these splits; without ``path``, trainers look beside the file itself.

    Trainers need the keys ``train`` and ``val``, and pictures under every key. Without frames, ``test`` is left out,
    and the other two name the folder of another split.
    """
    lines = []
    for split in SPLITS:
        if split in full:
            lines.append(f"{split}: images/{split}")
        elif split in _NEEDED:
            lines += [f"# {split} has no frames, and trainers need some: these are those of {full[0]}."]
            lines += [f"{split}: images/{full[0]}"]
    return "\n".join([*lines, *KINDS[kind].yaml, "nc: 1", "names: [grab]", ""]).encode()


def stand_ins(full: Collection[str], layout: str) -> list[str]:
    """State where a layout's ``data.yaml`` names another split's frames, given the splits that have some, in order."""
    if layout != "simgrab" and not layout.startswith("yolo"):
        return []
    return [
        f"data.yaml: {split} has no frames, so it names those of {next(iter(full))}, as trainers need some. A dataset "
        "of more worlds, or of another seed, has some."
        for split in _NEEDED
        if split not in full
    ]


def outline(mask: NDArray[np.uint8], x0: int, y0: int, x1: int, y1: int) -> Array:
    """Outline the pixels of a mask of the whole picture by one polygon of corners x, y, px, shape (n, 2).

    It joins the middles of the pixels' outer edges, `INSET` within them, and leaves out those on a straight line. So it
    separates the same pixel centres as the edges do. Parts and holes are joined by lines that the polygon passes twice.
    ``x0`` to ``y1`` are the box of its pixels, half open.
    """
    doubled = mask[y0:y1, x0:x1].repeat(2, axis=0).repeat(2, axis=1)  # corners of a pixel are pixels of their own
    found, _ = cv2.findContours(doubled, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    if not found:
        raise ValueError("no pixel of its mask lies in its box")
    paths = sorted((_middles(contour[:, 0]) for contour in found), key=len)
    joined = paths.pop()
    tree = KDTree(joined)
    for path in sorted(paths, key=lambda path: tree.query(path)[0].min()):
        distances, nearest = KDTree(joined).query(path)
        own = int(distances.argmin())
        at = nearest[own]
        joined = np.concatenate([joined[: at + 1], path[own:], path[: own + 1], joined[at:]])
    inset = np.multiply(INSET, mask.shape[::-1])
    return joined // 4 + np.choose(joined % 4 - 1, [inset, 0.5 - inset, 1 - inset]) + (x0, y0)


def _middles(corners: NDArray[np.int32]) -> NDArray[np.int32]:
    """Find the middles of a contour's edges in quarters of a pixel, of which 1 is a left or upper edge and 3 another.

    The contour, shape (n, 2), is of a mask in which each pixel is 2x2.
    """
    following = np.roll(corners, -1, axis=0)
    edges = (corners // 2 == following // 2).all(axis=1)
    quarters = 4 * (corners // 2) + np.where(corners == following, 1 + 2 * (corners % 2), 2)
    return np.asarray(cv2.approxPolyDP(quarters[edges], 0, closed=True)[:, 0])


def _size(row: Row | OrientedColumns) -> tuple[int, int]:
    return row.width_px, row.height_px
