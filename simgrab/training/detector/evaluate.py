"""How a detector does on validation frames: figures for the model card, and how far its stated deviations hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import msgspec
import numpy as np
from scipy.optimize import minimize
from scipy.special import expit, logit

from simgrab.instrument.detect.boxes import iou
from simgrab.instrument.detect.grab import Calibration, GrabDetector
from simgrab.model import label_arrays as labels
from simgrab.model.geometry import Array
from simgrab.model.records.observations import Detection
from simgrab.training.detector import cache

LEVEL = 0.95
_NORMAL = 1.96  # deviations either way that cover LEVEL of a normal distribution
_SURE = (1e-4, 1 - 1e-4)  # presences beyond which none is surer
_BOUNDS = (0.1, 0.9)  # of a least presence
# Missed grabs that a false box weighs: the next frame shows the grab again, a false box may sound an alarm.
_FALSE = 10.0
_UP = 0.9  # how far up the range of equally good ones it lies, in logits
_FEWEST = 20  # detections from which on a factor or a slope is fitted
_FEWEST_EMPTY = 50  # frames without a grab from which on a threshold below the one before is fitted


@dataclass(frozen=True, eq=False)
class DetectedFrame:
    """A frame, what was detected in it, and the logits of the pose and the coarse net for it, (2,)."""

    frame: cache.TrainingFrame
    detection: Detection
    logits: Array = field(default_factory=lambda: np.zeros(2))

    @property
    def overlap(self) -> float:
        """IoU with the labelled box; 0 where there is none of either."""
        box, detected = self.frame.box, self.detection.box
        return 0.0 if box is None or detected is None else float(iou(detected, box))

    @property
    def hit(self) -> bool:
        """Whether the grab was found where it is."""
        return self.overlap >= 0.5


def watch(
    detector: GrabDetector, frames: Sequence[cache.TrainingFrame], progress: cache.Progress
) -> list[DetectedFrame]:
    """Run a detector on frames."""
    detected = []
    for frame in frames:
        detected.append(DetectedFrame(frame, *detector.examine(frame.picture())))
        progress(len(detected), len(frames))
    return detected


def calibrated(
    detector: GrabDetector,
    detected: Sequence[DetectedFrame],
    real: Sequence[DetectedFrame] = (),
    before: GrabDetector | None = None,
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Fit the presence, its threshold and the factors of deviations to what a detector without them outputs.

    Parameters
    ----------
    detector : GrabDetector
        Whose other settings are kept.
    detected, real : sequence of DetectedFrame
        Of rendered frames, and of real ones.
    before : GrabDetector, optional
        The detector that this one began with. Its threshold becomes no lower unless enough of the frames show no grab:
        else too few show what else may be taken for one. Its fit of the presence is kept where frames are too few.

    Returns
    -------
    facts : dict
        ``settings`` and ``calibration``, for the metadata of the pose net.
    figures : dict
        `metrics` of the rendered frames then.
    """
    calibration = regression([*detected, *real]) or (before.calibration if before else Calibration())
    detected, real = (recalibrated(some, calibration) for some in (detected, real))
    presence = round(least_presence([*detected, *real]), 4)
    if sum(not one.frame.labelled for one in [*detected, *real]) < _FEWEST_EMPTY and before:
        presence = max(presence, before.settings.least_presence)
    detected, real = by(presence, detected), by(presence, real)
    settings = msgspec.structs.asdict(msgspec.structs.replace(detector.settings, least_presence=presence))
    factors = {name: _factor(some) for name, some in errors_over_sd([*detected, *real]).items()}
    fitted = msgspec.structs.asdict(calibration) | factors
    rounded = {name: round(value, 4) for name, value in fitted.items()}
    return {"settings": settings, "calibration": rounded}, metrics(detected)


def regression(detected: Sequence[DetectedFrame]) -> Calibration | None:
    """Fit the presence, a logistic regression on the logits of both nets, as Platt (1999) fits one score.

    None where hits or boxes on empty frames are too few.

    Parameters
    ----------
    detected : sequence of DetectedFrame
        By a detector that takes every presence for enough; hits and empty frames count.
    """
    known = _hits_and_false_boxes(detected)
    there = np.array([one.hit for one in known], float)
    if min(there.sum(), (1 - there).sum()) < _FEWEST:
        return None
    logits = np.array([one.logits for one in known])
    # Targets short of 0 and 1, so that a perfect separation has finite slopes.
    wanted = np.where(there == 1, (there.sum() + 1) / (there.sum() + 2), 1 / ((1 - there).sum() + 2))

    def entropy(values: Array) -> float:
        x = logits @ np.exp(values[:2]) + values[2]
        return float((np.logaddexp(0, x) - wanted * x).mean())

    slope, heat, offset = minimize(entropy, np.zeros(3), method="Nelder-Mead").x
    return Calibration(slope=float(np.exp(slope)), heat=float(np.exp(heat)), offset=float(offset))


def _hits_and_false_boxes(detected: Sequence[DetectedFrame]) -> list[DetectedFrame]:
    return [one for one in detected if one.detection.found and (one.hit or not one.frame.labelled)]


def recalibrated(detected: Sequence[DetectedFrame], calibration: Calibration) -> list[DetectedFrame]:
    """Apply such a fit to the scores of detections."""
    return [replace(one, detection=replace(one.detection, score=calibration.presence(one.logits))) for one in detected]


def least_presence(detected: Sequence[DetectedFrame]) -> float:
    """Choose the least presence at which a candidate is taken for the grab.

    A false box counts as ten missed grabs. Of the thresholds with the fewest weighted errors, this is the point nine
    tenths up the widest interval, and so closer to the grabs than to other things: validation frames show only few of
    the things that can be mistaken for a grab.

    Parameters
    ----------
    detected : sequence of DetectedFrame
        By a detector that takes every presence for enough; hits and empty frames count.
    """
    known = _hits_and_false_boxes(detected)
    if not known:
        return 0.5
    logits = logit(np.clip([one.detection.score for one in known], *_SURE))
    there = np.array([one.hit for one in known])
    ends = np.sort(np.concatenate([logits, logit(_SURE)]))
    places = ends[:-1] + _UP * np.diff(ends)
    errors = np.array([(there & (logits < t)).sum() + _FALSE * (~there & (logits >= t)).sum() for t in places])
    widths = np.where(errors == errors.min(), np.diff(ends), -1.0)
    return float(np.clip(expit(places[widths.argmax()]), *_BOUNDS))


def by(presence: float, detected: Sequence[DetectedFrame]) -> list[DetectedFrame]:
    """Apply a presence threshold to detections."""
    nothing = "it looks like something else"
    return [
        one if not one.detection.found or one.detection.score >= presence
        else replace(one, detection=Detection("none", nothing, one.detection.score))
        for one in detected
    ]  # fmt: skip


def errors_over_sd(detected: Sequence[DetectedFrame]) -> dict[str, Array]:
    """Errors of found grabs over their stated deviations: of box edges, centre coordinates and yaw."""
    ratios: dict[str, list[Array]] = {"box": [], "centre": [], "yaw": []}
    for one in detected:
        found, row = one.detection, one.frame.row
        if not one.hit or found.box_sd_px is None or found.centre_sd_px is None or found.centre is None:
            continue
        ratios["box"].append((found.box - one.frame.box) / found.box_sd_px)  # type: ignore[operator]
        ratios["centre"].append((found.centre - labels.centre(row)) / found.centre_sd_px)
        if found.yaw is not None and found.yaw_sd is not None:
            ratios["yaw"].append(np.array([labels.half_turn(found.yaw - labels.yaw(row)) / found.yaw_sd]))
    return {name: np.abs(np.concatenate(some)) if some else np.zeros(0) for name, some in ratios.items()}


def _factor(ratios: Array) -> float:
    finite = ratios[np.isfinite(ratios)]
    if len(finite) < _FEWEST:
        return 1.0
    return float(np.quantile(finite, LEVEL) / _NORMAL)


def metrics(detected: Sequence[DetectedFrame]) -> dict[str, Any]:
    """Figures of a model card: overall, and by weather."""
    weathers = sorted({one.frame.weather for one in detected})
    return _figures(detected) | {
        "by_weather": {name: _figures([s for s in detected if s.frame.weather == name]) for name in weathers}
    }


def _figures(detected: Sequence[DetectedFrame]) -> dict[str, Any]:
    there = [one for one in detected if one.frame.labelled]
    empty = [one for one in detected if not one.frame.labelled]
    hits = [one for one in there if one.hit]
    miss = [
        float(np.linalg.norm(one.detection.centre - labels.centre(one.frame.row)))
        for one in hits
        if one.detection.centre is not None
    ]
    finite = np.array(miss)[np.isfinite(miss)]
    return {
        "frames": len(detected),
        "recall": len(hits) / len(there) if there else None,
        "mean_iou": float(np.mean([one.overlap for one in there])) if there else None,
        "centre_median_px": float(np.median(finite)) if len(finite) else None,
        "centre_95_px": float(np.quantile(finite, 0.95)) if len(finite) else None,
        "empty_frames": len(empty),
        "false_boxes": sum(one.detection.found for one in empty),
    }
