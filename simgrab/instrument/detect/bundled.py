"""The detector of the grab, of three or four nets; simgrab comes with two, by the names in `SHIPPED`.

One finds the grab in the shrunken picture, one refines it in a crop of the whole one, and one predicts centre and yaw,
and whether it is the grab, in what is left when the picture is turned level: with size, place and yaw known, only small
corrections remain. A fourth, where there is one, gets more of the surroundings, and predicts the last as well. For the
default detector, refining twice makes boxes no better (mAP50-95 0.967 either way) and takes a fifth of the time. Where
the first pass is uncertain, more candidates are refined, and more often: an inaccurate box hides the grab.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from simgrab.errors import DetectorError, one_line
from simgrab.instrument.detect import contract
from simgrab.instrument.detect.boxes import about
from simgrab.instrument.detect.flips import FLIPS, averaged, flipped
from simgrab.instrument.detect.patches import (
    FIND_HEIGHT,
    FIND_WIDTH,
    LEVEL_ROOM,
    REFINE_SIZE,
    VERIFY_ROOM,
    VERIFY_SIZE,
    Level,
    Patch,
    Picture,
    around,
    cut,
    cut_level,
    cut_with_mask,
    whole,
)  # fmt: skip
from simgrab.instrument.net import Net, open_net
from simgrab.io.resources import ASSETS
from simgrab.io.strict import Checked, convert
from simgrab.model.geometry import Array
from simgrab.model.records.observations import Detection

WEIGHTS = ASSETS / "weights"
FOUR_ROPE, GENERIC = "bundled", "any-grab"
#: Folders of the detectors that simgrab comes with, by name.
SHIPPED = {FOUR_ROPE: WEIGHTS, GENERIC: WEIGHTS / GENERIC}
# Tasks that the files' metadata names.
FIND, REFINE, SETTLE, VERIFY = "find-grab", "refine-grab", "settle-grab", "verify-grab"
_CROP = (REFINE_SIZE, REFINE_SIZE, 4)
_STRIDE = 8
# Shapes of their outputs for each picture.
_MAPS = ((FIND_HEIGHT // _STRIDE, FIND_WIDTH // _STRIDE), (4, FIND_HEIGHT // _STRIDE, FIND_WIDTH // _STRIDE))
_ROWS = ((16,),)
_VERDICT = ((3,),)
_MOST = 3  # hottest candidates, which are refined
_LEAST_SIDE = 8.0  # px of the picture, of a refined box
_SURE = 0.9  # presence threshold above which a detection is not refined again
_AGAIN_HEAT, PASSES = 0.015, 4  # heat threshold, and number of passes, of candidates refined again
_SIZES = (0.6, 1.5)  # of the hottest candidate's box, at which it is refined again too
_LIKELY = 0.5  # presence in the first of these passes above which a candidate after the hottest gets the others


_VERIFIED = 0.75  # weight of verify's logit in the presence
# Of a box's mean standard deviation over its longer side, larger where the box is wrong: its weight, and the values
# that leave the presence unchanged and from which on it counts.
_UNSURE, _USUAL_SD, _LEAST_SD = 2.0, 0.02, 0.005
_PRESENCES = (1e-20, 1 - 1e-15)  # bounds within which a logit is finite
_LIMIT = 50.0  # of a net's outputs, logits and shares alike: beyond it exponentials are 0 or 1 all the same


Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
Factor = Annotated[float, msgspec.Meta(ge=0, le=1000)]


class Settings(Checked, frozen=True):
    """Thresholds for candidates; a file's metadata may replace them.

    Attributes
    ----------
    least_heat : float
        Least heat of a candidate.
    least_presence : float
        Least output of settle at which it is a grab.
    rivals : float
        Share of the best candidate's heat above which other candidates are refined in the first pass too.
    room : float
        Side of refine's crop, over the box's longer side.
    passes : int
        How often refine runs on the best candidate, each time around the box that it gave before.
    flips : int
        In how many of four mirror images, the crop itself among them, settle gets a crop, and refine in its last
        pass; their outputs are averaged.
    """

    error = DetectorError

    least_heat: Share = 0.05
    least_presence: Share = 0.5
    rivals: Share = 0.3
    room: Annotated[float, msgspec.Meta(ge=0.5, le=3)] = 1.5
    passes: Annotated[int, msgspec.Meta(ge=1, le=5)] = 1
    flips: Annotated[int, msgspec.Meta(ge=1, le=len(FLIPS))] = 1


class Trust(Checked, frozen=True):
    """Corrections of the nets' outputs, measured on validation frames.

    Attributes
    ----------
    box, centre, yaw : float
        Factors of the stated standard deviations.
    outward : float
        Outward error of predicted centres, in longer sides of the box at a picture's width from its middle. Crops do
        not show how obliquely the grab is seen, so the nets underestimate the parallax.
    """

    error = DetectorError

    box: Factor = 1.0
    centre: Factor = 1.0
    yaw: Factor = 1.0
    outward: Annotated[float, msgspec.Meta(ge=-1, le=1)] = 0.0


@dataclass(frozen=True)
class Candidate:
    """A place that may be the grab: box, shape (4,), px of the picture, and heat, 0 to 1."""

    box: Array
    heat: float


@dataclass(frozen=True, eq=False)
class Refined:
    """Outputs for n crops.

    Attributes
    ----------
    boxes, box_sd : ndarray, shape (n, 4)
        Edges, px of the picture, and the standard deviations of each.
    centres, centre_sd : ndarray, shape (n, 2)
        Centre of the grab, px of the picture.
    yaw, yaw_sd : ndarray, shape (n,)
        Yaw of the grab, rad, from 0 to π.
    presence : ndarray, shape (n,)
        Probability that the grab is there.
    """

    boxes: Array
    centres: Array
    box_sd: Array
    centre_sd: Array
    yaw: Array
    yaw_sd: Array
    presence: Array

    def one(self, i: int) -> Refined:
        """Keep one crop."""
        return Refined(**{field.name: getattr(self, field.name)[[i]] for field in fields(self)})

    def level(self) -> Level:
        """Crops of settle's first pass."""
        box = _sound(self.boxes[0])
        return Level(self.centres[0], LEVEL_ROOM * float((box[2:] - box[:2]).max()), float(self.yaw[0]))


class GrabDetector:
    """A detector of nets of our own (`simgrab.instrument.detect.contract.Detector`).

    Parameters
    ----------
    folder : path
        Holds ``find.onnx``, ``refine.onnx`` and ``settle.onnx``, and ``verify.onnx`` where settle's metadata say so.
    settings : Settings, optional
        Replace the settings in the file.

    Attributes
    ----------
    name : str
        Name in reports: a name in `SHIPPED`, or the folder's.

    Raises
    ------
    DetectorError
        If a file is missing or is not the network of its name.
    """

    def __init__(self, folder: str | Path, settings: Settings | None = None) -> None:
        folder = Path(folder)
        self._find = _opened(folder / "find.onnx", FIND, (FIND_HEIGHT, FIND_WIDTH, 3), _MAPS)
        self._refine = _opened(folder / "refine.onnx", REFINE, _CROP, _ROWS)
        self._settle = _opened(folder / "settle.onnx", SETTLE, _CROP, _ROWS)
        facts = self._settle.facts
        if not settings and "settings" not in facts:
            raise DetectorError(f"{self._settle.path} has no settings in its metadata: train it again")
        path = self._settle.path
        self.settings = settings or convert(facts["settings"], Settings, DetectorError, f"{path}: settings")
        self.trust = convert(facts.get("trust", {}), Trust, DetectorError, f"{path}: trust")
        self._verify = (
            _opened(folder / "verify.onnx", VERIFY, (VERIFY_SIZE, VERIFY_SIZE, 4), _VERDICT)
            if facts.get("verified") is True else None
        )  # fmt: skip
        self.name = FOUR_ROPE if folder.resolve() == WEIGHTS.resolve() else folder.resolve().name

    def __call__(self, picture: Picture) -> Detection:
        """Detect the grab in a picture."""
        contract.check(picture)
        candidates = self.candidates(picture)
        if not candidates or candidates[0].heat < self.settings.least_heat:
            return Detection("none", "nothing found", candidates[0].heat if candidates else 0.0)
        enough = max(self.settings.least_heat, self.settings.rivals * candidates[0].heat)
        close = [candidate for candidate in candidates[:_MOST] if candidate.heat >= enough]
        refined = self.refine(picture, [candidate.box for candidate in close])
        best = refined.one(int(np.argmax(refined.presence * [candidate.heat for candidate in close])))
        for left in reversed(range(self.settings.passes - 1)):
            best = self.refine(picture, [best.boxes[0]], last=not left)
        found = self.predict_pose(picture, best)
        if found.presence[0] < max(_SURE, self.settings.least_presence):
            found = max([found, *self._again(picture, candidates)], key=lambda one: float(one.presence[0]))
        presence = float(found.presence[0])
        if presence < self.settings.least_presence:
            return Detection("none", f"it looks like something else (presence {presence:.2f})", presence)
        return _detection(found, presence, picture, self.trust)

    def _again(self, picture: Picture, candidates: list[Candidate]) -> list[Refined]:
        """Refine more candidates more often, each time from where the grab was seen, and predict the pose in each.

        The hottest candidates alone may all be other, parked grabs. And even if find marks the right grab, its box may
        be so much too large or small that refine fails.
        """
        places = [_scaled(candidates[0].box, by) for by in _SIZES]
        surely = len(places) + _MOST
        places += [candidate.box for candidate in candidates if candidate.heat >= _AGAIN_HEAT]
        refined = self.refine(picture, places)
        boxes = [box for i, box in enumerate(refined.boxes) if i < surely or refined.presence[i] >= _LIKELY]
        for left in reversed(range(PASSES - 1)):
            refined = self.refine(picture, boxes, last=not left)
            boxes = list(refined.boxes)
        return [self.predict_pose(picture, refined.one(i)) for i in range(len(boxes))]

    def candidates(self, picture: Picture) -> list[Candidate]:
        """Places where find detects the grab, the hottest first."""
        patch = whole(picture.shape[1], picture.shape[0])
        small = cut(picture, patch, FIND_WIDTH, FIND_HEIGHT)
        logits, reach = _run(self._find, small[None], _MAPS)
        limits = np.array([picture.shape[1], picture.shape[0]] * 2, float)
        return [
            Candidate(np.clip(patch.to_picture(box.reshape(2, 2) / (FIND_WIDTH, FIND_HEIGHT)).ravel(), 0, limits), heat)
            for box, heat in peaks(logits[0], reach[0])
        ]

    def refine(self, picture: Picture, boxes: list[Array], *, last: bool = False) -> Refined:
        """Refine crops around n boxes, each of shape (4,), px; in the last pass at mirror images too."""
        patches = [around(_sound(box), self.settings.room) for box in boxes]
        crops = np.stack([cut_with_mask(picture, patch, REFINE_SIZE) for patch in patches])
        rows = self._rows(self._refine, crops, self.settings.flips if last else 1)
        return read(rows, patches, picture.shape[1], picture.shape[0])

    def _rows(self, net: Net, crops: Picture, ways: int) -> NDArray[np.floating]:
        """Run refine or settle on n crops and their mirror images, (n, 16)."""
        rows = _run(net, flipped(crops, ways), _ROWS)[0]
        return rows if ways == 1 else averaged(_sane(rows), ways)

    def predict_pose(self, picture: Picture, refined: Refined) -> Refined:
        """Predict presence, centre and yaw of one refined box (n = 1) again."""
        level = refined.level()
        crop = cut_level(picture, level, REFINE_SIZE)[None]
        found = with_pose(refined, self._rows(self._settle, crop, self.settings.flips), level)
        return found if self._verify is None else self._verified(picture, found, self._verify)

    def _verified(self, picture: Picture, found: Refined, net: Net) -> Refined:
        """Presence of one box (n = 1): the mean of settle's and verify's logits, less where the box is unsure."""
        box = _sound(found.boxes[0])
        crop = cut_with_mask(picture, around(box, VERIFY_ROOM), VERIFY_SIZE)[None]
        own = _bounded(_run(net, crop, _VERDICT)[0][:, 0].astype(float), -_LIMIT)
        before = logit(np.clip(found.presence, *_PRESENCES))
        sd = max(float(found.box_sd[0].mean() / (box[2:] - box[:2]).max()), _LEAST_SD)
        unsure = _UNSURE * math.log(sd / _USUAL_SD)
        return replace(found, presence=expit((1 - _VERIFIED) * before + _VERIFIED * own - unsure))


def peaks(logits: NDArray[np.float32], reach: NDArray[np.float32], most: int = 8) -> list[tuple[Array, float]]:
    """Highest cells of a heat map, none beside a higher one.

    Parameters
    ----------
    logits : ndarray, shape (rows, columns)
    reach : ndarray, shape (4, rows, columns)
        From a cell's middle to the left, top, right and bottom edge, px of the small picture.
    most : int

    Returns
    -------
    list of (box, heat)
        Boxes in px of the small picture; the hottest first.
    """
    logits, reach = _bounded(logits, -_LIMIT), np.nan_to_num(reach)
    highest = cv2.dilate(logits, np.ones((3, 3), np.uint8))
    rows, columns = np.nonzero(logits >= highest)
    order = np.argsort(-logits[rows, columns], kind="stable")[:most]
    result = []
    for row, column in zip(rows[order], columns[order], strict=True):
        middle = (np.array([column, row, column, row]) + 0.5) * _STRIDE
        heat = 1 / (1 + math.exp(-float(logits[row, column])))
        result.append((middle + reach[:, row, column].astype(float) * [-1, -1, 1, 1], heat))
    return result


def read(out: NDArray[np.floating], patches: list[Patch], width: int, height: int) -> Refined:
    """Read refine's output (n, 16) on patches of a picture of this size."""
    o = _sane(out)
    corner, extent = np.stack([p.corner for p in patches]), np.stack([p.size for p in patches])
    places = corner[:, None] + o[:, :6].reshape(-1, 3, 2) * extent[:, None]
    boxes = np.clip(places[:, :2], 0, [width, height])
    sd = math.sqrt(2) * np.exp(o[:, 6:12]).reshape(-1, 3, 2) * extent[:, None]  # of a Laplace distribution
    return Refined(
        boxes=boxes.reshape(-1, 4), centres=places[:, 2],
        box_sd=sd[:, :2].reshape(-1, 4), centre_sd=sd[:, 2],
        yaw=np.arctan2(o[:, 13], o[:, 12]) / 2 % np.pi, yaw_sd=math.sqrt(2) * np.exp(o[:, 14]) / 2,
        presence=1 / (1 + np.exp(-o[:, 15])),
    )  # fmt: skip


def with_pose(refined: Refined, out: NDArray[np.floating], level: Level) -> Refined:
    """Replace refine's output, except for the box, by settle's output (1, 16) on a level part."""
    o = _sane(out)[0]
    sd = math.sqrt(2) * np.exp(o[10:12]) * level.side
    return replace(
        refined,
        centres=level.to_picture(o[None, 4:6]), centre_sd=np.sqrt(level.axes**2 @ sd**2)[None],
        yaw=(level.angle + np.arctan2(o[[13]], o[[12]]) / 2) % np.pi, yaw_sd=math.sqrt(2) * np.exp(o[[14]]) / 2,
        presence=1 / (1 + np.exp(-o[[15]])),
    )  # fmt: skip


def _bounded(values: NDArray[Any], missing: float) -> NDArray[Any]:
    """Bound a net's outputs, NaN replaced by ``missing``."""
    return np.clip(np.nan_to_num(values, nan=missing, posinf=_LIMIT, neginf=-_LIMIT), -_LIMIT, _LIMIT)


def _sane(rows: NDArray[np.floating[Any]]) -> Array:
    """Rows (n, 16) of refine or settle within bounds; one with NaN or infinity gets a presence of 0."""
    result = _bounded(rows.astype(float), 0.0)
    result[~np.isfinite(rows).all(axis=1), 15] = -_LIMIT
    return result


def _sound(box: Array) -> Array:
    """Make sure that a box ends after it begins."""
    middle, half = (box[:2] + box[2:]) / 2, np.maximum((box[2:] - box[:2]) / 2, _LEAST_SIDE / 2)
    return about(middle, half)


def _scaled(box: Array, by: float) -> Array:
    """Scale a box about its middle."""
    return about((box[:2] + box[2:]) / 2, by * (box[2:] - box[:2]) / 2)


def _detection(refined: Refined, presence: float, picture: Picture, trust: Trust) -> Detection:
    height, width = picture.shape[:2]
    box, centre = np.clip(_sound(refined.boxes[0]), 0, [width, height] * 2), refined.centres[0]
    return Detection(
        status="found", reason="", score=presence,
        box=box, centre=centre - trust.outward * lean(centre, box, width, height), yaw=float(refined.yaw[0]),
        box_sd_px=refined.box_sd[0] * trust.box, centre_sd_px=refined.centre_sd[0] * trust.centre,
        yaw_sd=float(refined.yaw_sd[0]) * trust.yaw,
    )  # fmt: skip


def lean(centre: Array, box: Array, width: int, height: int) -> Array:
    """Vector (2,), px, along the parallax: from a picture's middle to a centre, in widths, times the longer side."""
    side = float((box[2:] - box[:2]).max())
    return np.asarray((centre - np.array([width, height]) / 2) * side / width)


Shapes = tuple[tuple[int, ...], ...]


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
    """Run a net, whose outputs have these shapes for each picture.

    Raises
    ------
    DetectorError
        If they have others.
    """
    found = net(pictures)
    if [out.shape for out in found] != [(len(pictures), *shape) for shape in outputs]:
        shapes = ", ".join(" x ".join(map(str, out.shape)) for out in found)
        raise DetectorError(f"{net.path} has unexpected output shapes ({one_line(shapes)})")
    return found
