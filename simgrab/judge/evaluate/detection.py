"""Accuracy of a detector: its output for frames against the truth."""

from __future__ import annotations

import contextlib
import io
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from simgrab.dataset.datasets import Dataset
from simgrab.instrument.detect.boxes import iou
from simgrab.instrument.detect.pictures import centre
from simgrab.judge.evaluate.intervals import clopper_pearson, standard_error
from simgrab.model import label_arrays as labels
from simgrab.model.geometry import Array
from simgrab.model.records.observations import Detection
from simgrab.model.scenario import OrangePeel
from simgrab.model.truth import Boxed, Row

_NORMAL = 1.96
ROPE_BINS_M = {
    f"{low:g} m and more" if math.isinf(high) else f"{low:g} to {high:g} m": (low, high)
    for low, high in itertools.pairwise((0.0, 11.0, 15.0, 20.0, 25.0, 30.0, math.inf))
}
HALF = 0.5


@dataclass(frozen=True, eq=False)
class Boxes:
    """Boxes of a frame: the labelled one, if detection labels hold one, and the detected one."""

    truth: Row | Boxed
    labelled: bool
    detection: Detection

    @property
    def empty(self) -> bool:
        """Whether no part of the grab is visible. A sliver too small for a label is neither empty nor labelled."""
        return self.truth.box_x0_px is None

    @property
    def false(self) -> bool:
        """Whether a box was output although no grab is visible."""
        return self.empty and self.detection.found

    @property
    def hit(self) -> bool:
        """Whether the labelled grab was found where it is (IoU of at least 0.5)."""
        found = self.detection.box
        return self.labelled and found is not None and float(iou(found, _box(self))) >= HALF


@dataclass(frozen=True, eq=False)
class Case(Boxes):
    """One frame whose truth is known.

    The name of its dataset separates its worlds from those of other datasets. ``has_yaw`` is whether the grab looks the
    same after half a turn only: the tines of an orange-peel grab look alike.
    """

    truth: Row
    weather: str = ""
    dataset: str = ""
    has_yaw: bool = True

    @property
    def world(self) -> tuple[str, int | None]:
        """Key of its world, whose frames are much alike."""
        return self.dataset, self.truth.variant

    @property
    def hits(self) -> bool:
        """Whether a labelled grab's centre was output, with a true positive box or without a box."""
        centre_only = self.detection.box is None and self.detection.centre is not None
        return self.hit or (self.labelled and centre_only)

    @property
    def half_visible(self) -> bool:
        """Whether at least half of the grab is visible behind obstacles and weather."""
        return self.truth.visible_fraction >= HALF and self.truth.weather_hidden_fraction <= HALF

    @property
    def cut_off(self) -> bool:
        """Whether the picture's edge cuts a part of the grab off."""
        return self.labelled and self.truth.in_frame_fraction < 1


def cases(dataset: Dataset, detections: Sequence[Detection]) -> list[Case]:
    """Join a dataset's rows with their detections, in the rows' order."""
    scenario = dataset.scenario
    has_yaw = "grab" in scenario.vary or not isinstance(scenario.grab, OrangePeel)
    return [
        Case(row, dataset.is_labelled(row), found, dataset.weather(row), str(dataset.path), has_yaw)
        for row, found in zip(dataset.rows, detections, strict=True)
    ]


def score(some: Sequence[Case]) -> dict[str, Any]:
    """Score a detector.

    Returns
    -------
    dict
        ``overall``; ``half_visible``, for frames without a grab and frames that show at least half of it; ``cut_off``,
        for grabs that the picture's edge cuts; ``by_weather``; each as `figures` gives. ``by_rope``: centre errors in
        bins of rope length.
    """
    weathers = sorted({case.weather for case in some})
    return {
        "overall": figures(some),
        "half_visible": figures([case for case in some if case.empty or case.half_visible]),
        "cut_off": figures([case for case in some if case.cut_off]),
        "by_weather": {name: figures([case for case in some if case.weather == name]) for name in weathers},
        "by_rope": {
            name: centre_errors([c for c in some if c.hits and low <= c.truth.rope_length_m < high])
            for name, (low, high) in ROPE_BINS_M.items()
        },
    }


def figures(some: Sequence[Case]) -> dict[str, Any]:
    """Score cases together.

    Returns
    -------
    dict
        Counts; COCO's ``map50_95`` and ``map50``, with at most one box a frame; ``recall`` at an IoU of 0.5 and
        ``false_boxes`` on empty frames with their 95 % intervals after Clopper and Pearson, which assume independent
        frames; ``labelled_worlds`` and ``empty_worlds``, the worlds of those frames; ``missed_worlds`` and
        ``false_worlds``, those with a miss or a false box; ``longest_miss``, frames in a row of a clip; `centre_errors`
        of the hits, or of centres without a box; and `coverage` of the hits. None if there is nothing to count.
    """
    labelled = [case for case in some if case.labelled]
    return shares(some) | {
        "labelled_worlds": _worlds(labelled),
        "missed_worlds": _worlds([case for case in labelled if not case.hit]),
        "longest_miss": longest_miss(labelled),
        "empty_worlds": _worlds([case for case in some if case.empty]),
        "false_worlds": _worlds([case for case in some if case.false]),
        "centre": centre_errors([case for case in labelled if case.hits]),
        "coverage": coverage([case for case in labelled if case.hit]),
    }


def shares(some: Sequence[Boxes]) -> dict[str, Any]:
    """Count frames, hits and false boxes, with shares, their intervals and the average precision; see `figures`."""
    labelled, empty, hits, false = (
        sum(getattr(case, kind) for case in some) for kind in ("labelled", "empty", "hit", "false")
    )
    return {
        "frames": len(some),
        "labelled": labelled,
        "empty": empty,
        **average_precision([case for case in some if case.labelled or case.empty]),
        "recall": hits / labelled if labelled else None,
        "recall_interval": clopper_pearson(hits, labelled),
        "false_boxes": false,
        "false_share": false / empty if empty else None,
        "false_interval": clopper_pearson(false, empty),
    }


def _worlds(some: Sequence[Case]) -> int:
    return len({case.world for case in some})


def average_precision(some: Sequence[Boxes]) -> dict[str, float | None]:
    """COCO's mean average precision over IoU 0.50 to 0.95, and at 0.50."""
    evaluation = matched(some)
    if not isinstance(evaluation, COCOeval):
        return {"map50_95": evaluation, "map50": evaluation}
    with contextlib.redirect_stdout(io.StringIO()):  # it reports progress
        evaluation.accumulate()
        evaluation.summarize()
    return {"map50_95": float(evaluation.stats[0]), "map50": float(evaluation.stats[1])}


def matched(some: Sequence[Boxes]) -> COCOeval | float | None:
    """Match boxes with the truth, image by image, for COCO's figures; None without truth, 0 without boxes."""
    images = [{"id": i, "width": case.truth.width_px, "height": case.truth.height_px} for i, case in enumerate(some)]
    truth = [
        {"id": i + 1, "image_id": i, "category_id": 1, "iscrowd": 0, "bbox": box, "area": box[2] * box[3]}
        for i, case in enumerate(some)
        if case.labelled
        for box in [_xywh(_box(case))]
    ]
    reported = [
        {"image_id": i, "category_id": 1, "score": case.detection.score, "bbox": _xywh(case.detection.box)}
        for i, case in enumerate(some)
        if case.detection.box is not None
    ]
    if not truth:
        return None
    if not reported:
        return 0.0
    with contextlib.redirect_stdout(io.StringIO()):
        known = COCO()
        known.dataset = {"info": {}, "images": images, "annotations": truth, "categories": [{"id": 1, "name": "grab"}]}
        known.createIndex()
        evaluation = COCOeval(known, known.loadRes(reported), "bbox")
        evaluation.evaluate()
    return evaluation


def _box(case: Boxes) -> Array:
    box = labels.box(case.truth)
    assert box is not None
    return box


def _xywh(box: Array) -> list[float]:
    return [float(box[0]), float(box[1]), float(box[2] - box[0]), float(box[3] - box[1])]


def longest_miss(labelled: Sequence[Case]) -> int:
    """Most labelled frames in a row, of one clip or world, in which the grab was not found where it is."""
    longest = run = 0
    before: Case | None = None
    for case in labelled:
        follows = (
            before is not None
            and case.truth.frame > before.truth.frame
            and (case.truth.clip, case.world) == (before.truth.clip, before.world)
        )
        run = 0 if case.hit else 1 + run * follows
        longest, before = max(longest, run), case
    return longest


def centre_errors(hits: Sequence[Case]) -> dict[str, Any]:
    """Errors of the grab centre over hits, and beside them those of the truth's own box centre.

    Returns
    -------
    dict
        ``median_px`` and ``p95_px`` of the distance, and ``…_of_diagonal`` in shares of the box's diagonal; signed
        means in u, v and radially (away from the principal point) with their standard errors, by worlds (of one world
        alone, by frames); the same means in shares of the width, which is the box's longer side; and ``box_radial_…``:
        the error of the centre of a perfect box.
    """
    kept = [c for c in hits if c.truth.grab_u_px is not None]
    if not kept:
        return {"frames": 0}
    truth = np.array([labels.centre(c.truth) for c in kept])
    error = np.array([centre(c.detection) for c in kept]) - truth
    boxes = np.array([_box(c) for c in kept])
    of_box = (boxes[:, :2] + boxes[:, 2:]) / 2 - truth
    width = (boxes[:, 2:] - boxes[:, :2]).max(axis=1)
    diagonal = np.linalg.norm(boxes[:, 2:] - boxes[:, :2], axis=1)
    outward = truth - [(c.truth.cx_px, c.truth.cy_px) for c in kept]
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
    along, of_box_along = (error * outward).sum(axis=1), (of_box * outward).sum(axis=1)
    distance, worlds = np.linalg.norm(error, axis=1), [c.world for c in kept]
    result: dict[str, Any] = {
        "frames": len(kept),
        "median_px": float(np.median(distance)),
        "p95_px": float(np.quantile(distance, 0.95)),
        "median_share": float(np.median(distance / width)),
        "median_of_diagonal": float(np.median(distance / diagonal)),
        "p95_of_diagonal": float(np.quantile(distance / diagonal, 0.95)),
        "width_px": float(np.median(width)),
    }
    for name, values in (("u", error[:, 0]), ("v", error[:, 1]), ("radial", along), ("box_radial", of_box_along)):
        result |= {
            f"{name}_mean_px": float(values.mean()),
            f"{name}_se_px": standard_error(values, worlds),
            f"{name}_mean_share": float((values / width).mean()),
        }
    return result


def coverage(hits: Sequence[Case]) -> dict[str, float | None]:
    """Share of errors within ±1.96 stated deviations: of box edges, centre coordinates and yaw; None without any."""
    inside: dict[str, list[bool]] = {"box": [], "centre": [], "yaw": []}
    for case in hits:
        d, t = case.detection, case.truth
        if d.box is not None and d.box_sd_px is not None:
            inside["box"] += list(np.abs(d.box - _box(case)) <= _NORMAL * d.box_sd_px)
        if d.centre is not None and d.centre_sd_px is not None and t.grab_u_px is not None:
            inside["centre"] += list(np.abs(d.centre - labels.centre(t)) <= _NORMAL * d.centre_sd_px)
        if case.has_yaw and d.yaw is not None and d.yaw_sd is not None:
            inside["yaw"].append(abs(labels.half_turn(d.yaw - labels.yaw(t))) <= _NORMAL * d.yaw_sd)
    return {name: float(np.mean(some)) if some else None for name, some in inside.items()}
