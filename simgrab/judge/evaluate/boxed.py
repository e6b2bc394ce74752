"""Accuracy of a detector on frames whose boxes alone are known, such as real frames: by video, with intervals."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from pycocotools.cocoeval import COCOeval

from simgrab.judge.evaluate import detection
from simgrab.judge.evaluate.detection import Boxes, matched
from simgrab.judge.evaluate.intervals import LEVEL
from simgrab.model.geometry import Array
from simgrab.model.records.observations import Detection
from simgrab.model.rng import stream
from simgrab.model.truth import Boxed

RESAMPLES = 1000
FEWEST_VIDEOS = 6  # for an interval: resamples of fewer cannot cover 95 %


def score(rows: Sequence[Boxed], detections: Sequence[Detection], *, resamples: int = RESAMPLES) -> dict[str, Any]:
    """Score detections, in the rows' order, in frames whose boxes alone are known.

    The interval of the precision is of ``resamples`` resamples of videos.

    Returns
    -------
    dict
        Counts of frames and videos; COCO's ``map50_95``, with its 95 % interval over resampled videos (None for fewer
        than six videos), and ``map50``, with at most one box a frame; ``recall`` at an IoU of 0.5 and ``false_share``
        of empty frames, with intervals after Clopper and Pearson, which assume independent frames; ``missed_videos``
        and ``false_videos``, the videos with a missed grab and those with a box in an empty frame; and ``by_video``,
        the counts of each.
    """
    some, videos = list[Boxes](), dict[str, list[Boxes]]()
    for row, found in zip(rows, detections, strict=True):
        some.append(Boxes(row, row.box_x0_px is not None, found))
        videos.setdefault(row.video, []).append(some[-1])
    counts = {
        video: {
            "frames": len(cases),
            "labelled": sum(case.labelled for case in cases),
            "hits": sum(case.hit for case in cases),
            "empty": sum(case.empty for case in cases),
            "false_boxes": sum(case.false for case in cases),
        }
        for video, cases in sorted(videos.items())
    }
    return detection.shares(some) | {
        "videos": len(videos),
        "map50_95_interval": _interval(list(videos.values()), resamples),
        "missed_videos": sum(one["hits"] < one["labelled"] for one in counts.values()),
        "false_videos": sum(one["false_boxes"] > 0 for one in counts.values()),
        "by_video": counts,
    }


def _interval(videos: Sequence[Sequence[Boxes]], resamples: int) -> tuple[float, float] | None:
    """95 % interval of the mAP50-95 over videos, by the bootstrap's percentiles; None for fewer than six."""
    if len(videos) < FEWEST_VIDEOS:
        return None
    values = resampled_precision(videos, resamples)
    if np.isnan(values).all():
        return None
    low, high = np.nanquantile(values, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return float(low), float(high)


def resampled_precision(groups: Sequence[Sequence[Boxes]], resamples: int) -> Array:
    """COCO's mAP50-95 over resampled groups of frames, shape (resamples,): NaN where none of them shows the grab.

    The same number of groups is resampled alike, so that differences are paired.
    """
    evaluation, count = matched([case for group in groups for case in group]), len(groups)
    if not isinstance(evaluation, COCOeval):
        return np.full(resamples, np.nan if evaluation is None else evaluation)
    parts = np.split(np.arange(sum(map(len, groups))), np.cumsum([len(group) for group in groups])[:-1])
    picks = stream(0, 0, "videos.bootstrap").integers(count, size=(resamples, count))
    # Boxes are matched image by image: an average over other images needs no other matches.
    evaluation.params.areaRng, evaluation.params.maxDets = evaluation.params.areaRng[:1], [1]
    matches, values = list(evaluation.evalImgs), np.full(resamples, np.nan)
    for i, some in enumerate(picks):
        images = np.concatenate([parts[k] for k in some])
        evaluation.params.imgIds, evaluation.evalImgs = images.tolist(), [matches[k] for k in images]
        with contextlib.redirect_stdout(io.StringIO()):  # it reports progress
            evaluation.accumulate()
        precision = evaluation.eval["precision"]
        if (precision >= 0).any():
            values[i] = precision.mean()
    return values
