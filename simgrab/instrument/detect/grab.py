"""The detector of a grab of any kind, of two nets: a coarse one over the whole picture, and one on crops of it.

The coarse net proposes boxes in the shrunken picture. The pose net gets a crop of the whole picture around each of the
best few, with its surroundings, until one is clearly the grab, and predicts whether it is, its box, centre and yaw, and
how sure each is. Of the best one it gets a closer crop too, mirrored, in which a pixel of the picture is larger; the
mean counts, of places with the closer crop twice, and is the less sure the more both differ. The presence is a logistic
regression on the scores of both nets: the coarse one's heat, and that mean of the pose net's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from simgrab.errors import DetectorError, one_line
from simgrab.instrument.detect import contract
from simgrab.instrument.detect.boxes import about
from simgrab.instrument.detect.patches import (
    COARSE_HEIGHT,
    COARSE_WIDTH,
    POSE_CHANNELS,
    POSE_SIZE,
    Patch,
    Picture,
    around,
    cut,
    cut_crop,
    mirror,
    whole,
)
from simgrab.instrument.net import Net, open_net
from simgrab.io.resources import ASSETS
from simgrab.io.strict import Checked, convert
from simgrab.model.geometry import Array
from simgrab.model.records.observations import Detection

WEIGHTS = ASSETS / "weights"
BUNDLED = "bundled"
# Tasks that the files' metadata name.
COARSE, POSE = "coarse-grab", "grab-pose"
_STRIDE = 8
_MAP = (COARSE_HEIGHT // _STRIDE, COARSE_WIDTH // _STRIDE)
# Shapes of their outputs for each picture.
_MAPS: Shapes = (_MAP, (4, *_MAP))
_ROWS: Shapes = ((16,),)
_LEAST_SIDE = 8.0  # px of the picture, of a box
_LIMIT = 50.0  # of a net's outputs, logits and shares alike: beyond it exponentials are 0 or 1 all the same
_CLOSER = 2 / 3  # weight of the closer crop in places
MOST_YAW_SD = math.pi / 2 / 1.96  # beyond it the interval of 95 % is a quarter turn each way: every direction

Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
Factor = Annotated[float, msgspec.Meta(ge=0, le=1000)]
Room = Annotated[float, msgspec.Meta(ge=0.5, le=3)]
Shapes = tuple[tuple[int, ...], ...]


class Settings(Checked, frozen=True):
    """Thresholds and sizes; a file's metadata may replace them."""

    error = DetectorError

    least_heat: Share = 0.02  # least heat of a candidate
    least_presence: Share = 0.5  # least presence at which a candidate is a grab
    candidates: Annotated[int, msgspec.Meta(ge=1, le=8)] = 3  # how many candidates the pose net gets at most
    rivals: Share = 0.1  # share of the hottest candidate's heat from which others are candidates too
    # logit of the presence in the first crop above which no further candidate is tried
    clear: Annotated[float, msgspec.Meta(ge=-50, le=50)] = 2.0
    # room, close: side of the pose net's crop, over the box's longer side: of the first, and of the closer one about
    # the result
    room: Room = 2.1
    close: Room = 1.4


class Calibration(Checked, frozen=True):
    """Corrections of the pose net's outputs, measured on validation frames."""

    error = DetectorError

    # slope, heat, offset: the presence is the logistic function of `slope` times the net's mean logit, plus `heat`
    # times the logit of the candidate's heat, plus `offset` (Platt 1999, here with two scores)
    slope: Factor = 1.0
    heat: Factor = 0.0
    offset: Annotated[float, msgspec.Meta(ge=-50, le=50)] = 0.0
    # box, centre, yaw: factors of the stated standard deviations
    box: Factor = 1.0
    centre: Factor = 1.0
    yaw: Factor = 1.0

    def presence(self, logits: Array) -> float:
        """Probability that the grab is there, from the pose net's logit and that of the candidate's heat, (2,)."""
        return _logistic(float(logits @ [self.slope, self.heat]) + self.offset)


@dataclass(frozen=True)
class Candidate:
    """A place that may be the grab: box, shape (4,), px of the picture, and the logit of its heat."""

    box: Array
    logit: float

    @property
    def heat(self) -> float:
        """How surely the coarse net sees the grab there, 0 to 1."""
        return _logistic(self.logit)


@dataclass(frozen=True, eq=False)
class Pose:
    """Output of the pose net for a crop."""

    places: Array  # (6,), edges x0, y0, x1, y1 of the box and centre of the grab, px of the picture
    sd: Array  # (6,), standard deviation of each
    # yaw, yaw_sd: yaw of the grab, rad, from 0 to π
    yaw: float
    yaw_sd: float
    presence: float  # logit of the probability that the grab is there

    @property
    def box(self) -> Array:
        """Edges, (4,), which may lie beyond the picture."""
        return self.places[:4]


class GrabDetector:
    """A detector of two nets of our own (`simgrab.instrument.detect.contract.Detector`).

    Parameters
    ----------
    folder : path
        Holds ``coarse.onnx`` and ``pose.onnx``.
    settings : Settings, optional
        Replace the settings in the file.

    Attributes
    ----------
    name : str
        Name in reports: ``"bundled"``, or the folder's.

    Raises
    ------
    DetectorError
        If a file is missing or is not the network of its name.
    """

    def __init__(self, folder: str | Path, settings: Settings | None = None) -> None:
        folder = Path(folder)
        self._coarse = _opened(folder / "coarse.onnx", COARSE, (COARSE_HEIGHT, COARSE_WIDTH, 3), _MAPS)
        self._pose = _opened(folder / "pose.onnx", POSE, (POSE_SIZE, POSE_SIZE, POSE_CHANNELS), _ROWS)
        path, facts = self._pose.path, self._pose.facts
        if not settings and "settings" not in facts:
            raise DetectorError(f"{path} has no settings in its metadata: train it again")
        self.settings = settings or convert(facts["settings"], Settings, DetectorError, f"{path}: settings")
        known = {} if settings else facts.get("calibration", {})
        self.calibration = convert(known, Calibration, DetectorError, f"{path}: calibration")
        self.name = BUNDLED if folder.resolve() == WEIGHTS.resolve() else folder.resolve().name

    def __call__(self, picture: Picture) -> Detection:
        """Detect the grab in a picture."""
        return self.examine(picture)[0]

    def examine(self, picture: Picture) -> tuple[Detection, Array]:
        """Detect the grab in a picture; also returns the logits by `Calibration.presence`, (2,)."""
        contract.check(picture)
        candidates = self.candidates(picture)
        if not candidates:
            return Detection("none", "nothing found", 0.0), np.full(2, -_LIMIT)
        height, width = picture.shape[:2]
        limits = [width, height] * 2
        best, first = candidates[0], self.pose(picture, candidates[0].box, self.settings.room)
        for candidate in candidates[1:]:
            if first.presence > self.settings.clear:
                break
            other = self.pose(picture, candidate.box, self.settings.room)
            if other.presence > first.presence:
                best, first = candidate, other
        near = self.pose(picture, np.clip(first.box, 0, limits), self.settings.close, mirrored=True)
        pose, own = mean(first, near), self.calibration
        logits = np.array([pose.presence, best.logit])
        presence = own.presence(logits)
        if presence < self.settings.least_presence:
            x0, y0, x1, y1 = best.box
            cut_off = min(x0, y0) <= 0 or x1 >= width or y1 >= height
            why = "what the image edge cuts is not clearly a grab" if cut_off else "it looks like something else"
            return Detection("none", f"{why} (presence {presence:.2f})", presence), logits
        yaw_sd = pose.yaw_sd * own.yaw
        turned = yaw_sd < MOST_YAW_SD  # the tines of an orange-peel grab look alike
        found = Detection(
            status="found", reason="", score=presence,
            box=np.clip(_sound(pose.box), 0, limits), centre=pose.places[4:],
            yaw=pose.yaw if turned else None, box_sd_px=pose.sd[:4] * own.box,
            centre_sd_px=pose.sd[4:] * own.centre, yaw_sd=yaw_sd if turned else None,
        )  # fmt: skip
        return found, logits

    def candidates(self, picture: Picture) -> list[Candidate]:
        """Places where the coarse net sees the grab, the hottest first."""
        patch = whole(picture.shape[1], picture.shape[0])
        small = cut(picture, patch, COARSE_WIDTH, COARSE_HEIGHT)
        logits, reach = _run(self._coarse, small[None], _MAPS)
        limits = np.array([picture.shape[1], picture.shape[0]] * 2, float)
        found = [
            Candidate(
                np.clip(patch.to_picture(box.reshape(2, 2) / (COARSE_WIDTH, COARSE_HEIGHT)).ravel(), 0, limits), logit
            )
            for box, logit in peaks(logits[0], reach[0])
        ]
        enough = max(self.settings.least_heat, self.settings.rivals * found[0].heat) if found else 0.0
        return [candidate for candidate in found if candidate.heat >= enough][: self.settings.candidates]

    def pose(self, picture: Picture, box: Array, room: float, *, mirrored: bool = False) -> Pose:
        """Run the pose net on a crop around a box (4,), px, of ``room`` times its longer side, or on its mirror."""
        patch = around(_sound(box), room)
        crop = cut_crop(picture, patch, POSE_SIZE)
        out = _sane(_run(self._pose, (mirror(crop) if mirrored else crop)[None], _ROWS)[0][0])
        return read(mirrored_back(out) if mirrored else out, patch)


def peaks(logits: NDArray[np.float32], reach: NDArray[np.float32], most: int = 8) -> list[tuple[Array, float]]:
    """Highest cells of a heat map, none beside a higher one.

    Parameters
    ----------
    logits : ndarray, shape (rows, columns)
    reach : ndarray, shape (4, rows, columns)
        From a cell's middle to the left, top, right and bottom edge, px of the small picture.

    Returns
    -------
    list of (box, logit)
        Boxes in px of the small picture, and the cells' logits; the hottest first.
    """
    logits, reach = _bounded(logits, -_LIMIT), np.nan_to_num(reach)
    highest = cv2.dilate(logits, np.ones((3, 3), np.uint8))
    rows, columns = np.nonzero(logits >= highest)
    order = np.argsort(-logits[rows, columns], kind="stable")[:most]
    result = []
    for row, column in zip(rows[order], columns[order], strict=True):
        middle = (np.array([column, row, column, row]) + 0.5) * _STRIDE
        box = middle + reach[:, row, column].astype(float) * [-1, -1, 1, 1]
        result.append((box, float(logits[row, column])))
    return result


def mirrored_back(out: Array) -> Array:
    """Output of the pose net (16,) for a crop, from that for its mirror image."""
    x0, y0, x1, y1, u, v = out[:6]
    places = [1 - x1, y0, 1 - x0, y1, 1 - u, v]
    return np.array([*places, *out[[8, 7, 6, 9, 10, 11, 12]], -out[13], *out[14:]])  # a yaw φ is π − φ there


def mean(first: Pose, near: Pose) -> Pose:
    """Mean of the poses by both crops, the closer one counting more: what they differ by widens the deviations."""

    def both(one: Any, other: Any) -> Any:
        return one + _CLOSER * (other - one)

    x, y = both(*(np.array([math.cos(2 * pose.yaw), math.sin(2 * pose.yaw)]) for pose in (first, near)))
    apart = abs((near.yaw - first.yaw + math.pi / 2) % math.pi - math.pi / 2)
    return Pose(
        places=both(first.places, near.places),
        sd=both(first.sd, near.sd) + np.abs(near.places - first.places) / 2,
        yaw=math.atan2(y, x) / 2 % math.pi, yaw_sd=both(first.yaw_sd, near.yaw_sd) + apart / 2,
        presence=(first.presence + near.presence) / 2,
    )  # fmt: skip


def read(out: Array, patch: Patch) -> Pose:
    """Read the pose net's output (16,) on a patch of the picture."""
    sd = math.sqrt(2) * np.exp(out[6:12]).reshape(3, 2) * patch.size  # of a Laplace distribution
    return Pose(
        places=patch.to_picture(out[:6].reshape(3, 2)).ravel(), sd=sd.ravel(),
        yaw=math.atan2(out[13], out[12]) / 2 % math.pi, yaw_sd=math.sqrt(2) * math.exp(out[14]) / 2,
        presence=float(out[15]),
    )  # fmt: skip


def _sane(out: NDArray[np.floating]) -> Array:
    """Bound the pose net's output (16,); where it holds NaN or infinity, no grab is present."""
    result = _bounded(out.astype(float), 0.0)
    if not np.isfinite(out).all():
        result[15] = -_LIMIT
    return result


def _logistic(logit: float) -> float:
    return 1 / (1 + math.exp(-min(max(logit, -_LIMIT), _LIMIT)))


def _bounded(values: NDArray[Any], missing: float) -> NDArray[Any]:
    """Bound a net's outputs, NaN replaced by ``missing``."""
    return np.clip(np.nan_to_num(values, nan=missing, posinf=_LIMIT, neginf=-_LIMIT), -_LIMIT, _LIMIT)


def _sound(box: Array) -> Array:
    """Make sure that a box ends after it begins."""
    middle, half = (box[:2] + box[2:]) / 2, np.maximum((box[2:] - box[:2]) / 2, _LEAST_SIDE / 2)
    return about(middle, half)


def _opened(path: Path, task: str, picture: tuple[int, ...], outputs: Shapes) -> Net:
    net = open_net(path)
    found: Any = net.facts.get("task")
    shapes = [shape[1:] for shape in net.inputs.values()]
    if found != task or shapes != [picture] or net.types != ("tensor(uint8)",) or len(net.outputs) != len(outputs):
        raise DetectorError(f"{path} is not simgrab's {task} network (its task is {one_line(repr(found), 40)}; {net})")
    blank = np.zeros((1, *picture), np.uint8)
    if not all(np.isfinite(out).all() for out in _run(net, blank, outputs)):
        raise DetectorError(f"{path} outputs NaN or infinity")
    return net


def _run(net: Net, pictures: Picture, outputs: Shapes) -> list[Any]:
    """Run a net, whose outputs must have these shapes for each picture."""
    found = net(pictures)
    if [out.shape for out in found] != [(len(pictures), *shape) for shape in outputs]:
        shapes = ", ".join(" x ".join(map(str, out.shape)) for out in found)
        raise DetectorError(f"{net.path} has unexpected output shapes ({one_line(shapes)})")
    return found
