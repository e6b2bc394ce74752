"""A user's own YOLO, in the ONNX layout of its exporter.

Layouts, which differ in their shapes:

- YOLOv5 (three anchors a cell): 1 x n x (5 + classes), a row being centre, size, objectness, class scores;
- YOLOX, of Megvii or libreyolo (one a cell): the same, decoded to pixels or raw, in which case a row's place and the
  logarithm of its size count in strides of its cell;
- YOLOv6: as YOLOX decoded, with an objectness of 1 everywhere (that of its first release looks like a YOLOX);
- YOLOv8 and later: 1 x (4 + classes) x n, without objectness.

Of several classes, only the class named ``grab`` in the file's metadata counts. Pictures go in as the trainers feed
them: letterboxed with grey in the middle, RGB from 0 to 1; for YOLOX at the top left, BGR from 0 to 255. They are
shrunk by area, where trainers interpolate.
"""

from __future__ import annotations

import ast
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from simgrab.errors import DetectorError, one_line
from simgrab.instrument.detect import contract
from simgrab.instrument.detect.patches import Picture, cut, whole
from simgrab.instrument.net import Net, open_net
from simgrab.model.geometry import Array
from simgrab.model.records.observations import Detection
from simgrab.text import printable

LEAST_SCORE = 0.25  # of a grab
_MOST_SCORE = 1.001  # a product of half-precision sigmoids may be rounded to more than 1
_STRIDES = (8, 16, 32)
MOST_SIDE = 4096  # px of a picture that a net takes
_SIZE = 640  # px of a picture, where the file leaves it free and names none
GRAB = "grab"  # the class, of several
_ANCHORS = 3  # a cell, in YOLOv5
EXPECTED = (
    "a detector takes floats 1 x 3 x height x width and gives 1 x n x (5 + classes), as YOLOv5, v6 and YOLOX do, or "
    "1 x (4 + classes) x n, as YOLOv8 does, n being the cells of strides 8, 16 and 32 (three times as many in YOLOv5)"
)


@dataclass(frozen=True)
class OutputLayout:
    """Layout of an output: its YOLO version, and whether positions must still be decoded."""

    family: Literal["yolov5", "yolov6", "yolox", "yolov8"]
    raw: bool = False

    @property
    def columns(self) -> int:
        """How many columns come before the classes."""
        return 4 if self.family == "yolov8" else 5


class Yolo:
    """A user's YOLO (`simgrab.instrument.detect.contract.Detector`).

    Parameters
    ----------
    net : Net or path

    Raises
    ------
    DetectorError
        If the file is not a detector of a known layout, or none of its several classes is the grab. The message states
        what was expected and what was found.
    """

    def __init__(self, net: Net | str | Path) -> None:
        self._net = net if isinstance(net, Net) else open_net(net)
        self.height, self.width = _input(self._net)
        # Its output on a blank picture shows shapes that the file leaves free, and whether places are decoded.
        blank = self._run(np.full((1, 3, self.height, self.width), 0.5, np.float32))
        found = layout(blank, self.height, self.width)
        # Coefficients of masks or key points would be taken for class scores.
        masks = any(s[2:] == (self.height // 4, self.width // 4) for s in self._net.outputs.values() if len(s) == 4)
        if found is None or self._net.metadata.get("task", "detect") != "detect" or masks:
            raise DetectorError(f"{self._net.path} is not a detector: {EXPECTED}; this has {self._net}")
        self.layout = found
        self.column = _column(self._net, blank.shape[1 if found.family == "yolov8" else 2] - found.columns)
        highest = decode(blank, found, self.column, self.height, self.width)[1].max()
        if not 0 <= highest <= _MOST_SCORE:
            raise DetectorError(f"{self._net.path} outputs scores of {highest:.3g}, outside [0, 1]: {EXPECTED}")

    @property
    def name(self) -> str:
        """Name in reports."""
        return printable(self._net.path.name)

    def __call__(self, picture: Picture) -> Detection:
        """Detect the grab in a picture."""
        contract.check(picture)
        yolox = self.layout.family == "yolox"
        patch = whole(picture.shape[1], picture.shape[0], self.width / self.height, centred=not yolox)
        small = cut(picture, patch, self.width, self.height)
        pixels = small[..., ::-1].astype(np.float32) if yolox else small.astype(np.float32) / 255
        out = self._run(np.ascontiguousarray(pixels.transpose(2, 0, 1)[None]))
        boxes, scores = decode(out, self.layout, self.column, self.height, self.width)
        sound = np.isfinite(boxes).all(axis=1) & (scores >= 0) & (scores <= _MOST_SCORE)
        scores = np.where(sound, np.minimum(scores, 1.0), 0.0)
        best = int(scores.argmax())
        score = float(scores[best])
        if score < LEAST_SCORE:
            return Detection("none", f"no box scores {LEAST_SCORE} or more", score)
        corners = patch.to_picture(boxes[best].reshape(2, 2) / (self.width, self.height))
        x0, y0, x1, y1 = np.clip(corners, 0, [picture.shape[1], picture.shape[0]]).ravel()
        if x0 >= x1 or y0 >= y1:
            return Detection("none", "its box lies outside the picture", score)
        return Detection("found", "", score, box=np.array([x0, y0, x1, y1]))

    def _run(self, pictures: NDArray[np.float32]) -> NDArray[np.floating[Any]]:
        """Return the first output; exporters may add others, of any type."""
        return self._net(pictures, [next(iter(self._net.outputs))])[0]


def layout(out: NDArray[np.generic], height: int, width: int) -> OutputLayout | None:
    """Recognize an output's layout from its values on a blank picture; None if it is unknown."""
    if out.ndim != 3 or out.shape[0] != 1:
        return None
    cells = sum((height // s) * (width // s) for s in _STRIDES)
    rows, columns = out.shape[1:]
    if columns == cells and 5 <= rows < columns:
        return OutputLayout("yolov8")
    if columns < 6:
        return None
    if rows == _ANCHORS * cells:
        return OutputLayout("yolov5")
    if rows == cells:  # decoded, centres lie all over the picture
        raw = bool(np.median(np.abs(out[0, :, :2])) < _STRIDES[0])
        return OutputLayout("yolov6" if not raw and (out[0, :, 4] == 1).all() else "yolox", raw)
    return None


def decode(out: NDArray[np.generic], how: OutputLayout, column: int, height: int, width: int) -> tuple[Array, Array]:
    """Read an output.

    Parameters
    ----------
    out : ndarray, shape (1, n, 5 + classes) or (1, 4 + classes, n)
    column : int
        Index of the grab among the classes.
    height, width : int
        Size of the net's picture.

    Returns
    -------
    boxes : ndarray, shape (n, 4)
        x0, y0, x1, y1, px of the net's picture.
    scores : ndarray, shape (n,)
    """
    rows = np.asarray(out[0].T if how.family == "yolov8" else out[0], float)
    centre, size = rows[:, :2], rows[:, 2:4]
    with np.errstate(over="ignore", invalid="ignore"):  # a net may output infinite numbers
        if how.raw:
            grid, stride = _grid(height, width)
            centre, size = (centre + grid) * stride, np.exp(size) * stride
        scores = rows[:, how.columns + column]
        if how.family != "yolov8":
            scores = rows[:, 4] * scores
        return np.concatenate([centre - size / 2, centre + size / 2], axis=1), scores


def _column(net: Net, classes: int) -> int:
    """Index of the grab's class: the only class, or the one named ``grab``."""
    given = _literal(net, "names")
    names = list(given.values()) if isinstance(given, dict) else given if isinstance(given, list) else []
    if names and len(names) != classes:
        raise DetectorError(f"{net.path} is not a detector: it names {len(names)} classes and outputs {classes}")
    if classes == 1:
        return 0
    if names.count(GRAB) != 1:
        listed = ", ".join(one_line(name, 40) for name in names[:10]) or "no names"
        raise DetectorError(f"{net.path} outputs {classes} classes ({listed}), one of which must be named {GRAB!r}")
    return names.index(GRAB)


def _literal(net: Net, key: str) -> object:
    """Read metadata that ultralytics and others write as Python literals; None if missing or not a literal."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of odd escapes in the text
            return ast.literal_eval(net.metadata.get(key, "None"))
    except (ValueError, SyntaxError, TypeError, RecursionError, MemoryError):
        return None


def _grid(height: int, width: int) -> tuple[Array, Array]:
    """Column and row of each cell, (n, 2), and its stride, (n, 1), stride by stride and row by row."""
    grids, strides = [], []
    for stride in _STRIDES:
        rows, columns = np.mgrid[: height // stride, : width // stride]
        grids.append(np.stack([columns.ravel(), rows.ravel()], -1))
        strides.append(np.full((rows.size, 1), stride))
    return np.concatenate(grids).astype(float), np.concatenate(strides).astype(float)


def _input(net: Net) -> tuple[int, int]:
    """Height and width of the picture that a net takes as input."""
    shape = next(iter(net.inputs.values()), ())
    fits = len(net.inputs) == 1 and net.types[0] == "tensor(float)" and len(shape) == 4
    if not fits or shape[0] not in (1, None) or shape[1] not in (3, None):
        raise DetectorError(f"{net.path} is not a detector: {EXPECTED}; this has {net}")
    usual = _literal(net, "imgsz")
    if not isinstance(usual, list) or len(usual) != 2 or not all(isinstance(side, int) for side in usual):
        usual = [_SIZE] * 2
    height, width = (own or size for own, size in zip(shape[2:], usual, strict=True))
    if any(side % _STRIDES[-1] or not 0 < side <= MOST_SIDE for side in (height, width)):
        raise DetectorError(
            f"{net.path} takes pictures of {one_line(width, 20)}x{one_line(height, 20)}; sides must be multiples of "
            f"{_STRIDES[-1]}, {MOST_SIDE} at most"
        )
    return height, width
