"""A check as one HTML page that states why it failed."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import cv2
import numpy as np

from simgrab.dataset import preview
from simgrab.instrument.contract import Measurement, Picture
from simgrab.io import pictures
from simgrab.judge.check.metrics import TIME
from simgrab.judge.check.report import Outcome, Report, anchor
from simgrab.judge.check.table import cells
from simgrab.judge.check.trial import Trial
from simgrab.judge.check.verdicts import Verdict
from simgrab.judge.check.worst import WorstFrame
from simgrab.judge.evaluate.budget import of_tilt
from simgrab.judge.evaluate.page import chain, trace
from simgrab.model import label_arrays as labels
from simgrab.model.geometry import grab_centre, swing_of
from simgrab.model.truth import Row
from simgrab.reports import html

_HEAD = ("figure", "result", "value", "limit", "baseline (may be worse by)", "best constant answer", "last value")
_MEASURED = (255, 60, 0)  # BGR: blue, as the measured angle in the figures
_GOLDEN_WIDTH_PX = 1200
_MEANINGS = {
    "angle.overall.rmse_deg": "root mean square error of the swing angle, degrees",
    "angle.overall.bias_deg": "mean error of the swing angle, degrees",
    "angle.overall.p95_deg": "error of the swing angle that 95 % of the frames stay below, degrees",
    "angle.overall.max_deg": "largest error of the swing angle, degrees",
    "frames.ok": "number of frames with an angle",
    "frames.without_grab": "number of frames with an angle, but without a grab",
    "detection.recall": "share of the visible grabs that were found",
    "detection.map50_95": "mean average precision of the boxes",
    "detection.centre.median_px": "median error of the grab's centre, pixels",
    "reading.digits_right.value": "share of the digits read that are right",
    "reading.frames_refused.value": "share of the frames whose display was not read",
}


def page(report: Report) -> str:
    """Write the page, which needs no other file."""
    failures = [verdict for verdict in report.verdicts if verdict.status == "failed"]
    return html.page(
        "check.html",
        report=report,
        failures=[(anchor(v.scene), v, _MEANINGS.get(v.what, "")) for v in failures],
        general=_table([verdict for verdict in report.general if verdict.status != "passed"]),
        tile_px=preview.TILE_WIDTH,
        scenes=[_scene(name, outcome) for name, outcome in report.scenes.items()],
    )


def _scene(name: str, outcome: Outcome) -> dict[str, Any]:
    trial = outcome.trial
    budget = trial.evaluation["budget"] if trial else None
    return {
        "name": name,
        "anchor": anchor(name),
        "failed": any(verdict.status == "failed" for verdict in outcome.verdicts),
        "notes": outcome.notes,
        "causes": outcome.causes,
        "table": _table(outcome.verdicts),
        "trace": trace(trial.run, trial.known) if trial else None,
        "stated": _stated(trial) if trial else "",
        "worst": list(_drawn(trial, outcome.worst)) if trial else [],
        "budget": None if budget is None else chain(budget),
        "golden": [(file, _golden(picture)) for file, picture in outcome.pictures.items()],
    }


def _stated(trial: Trial) -> str:
    """State how often intervals cover the truth, the tilt beside the true one, and how long the pipeline took."""
    share, found = trial.metrics.get("interval.share"), []
    if share is not None:
        found.append(f"The intervals cover the true angle in {share:.0%} of the frames that have one; 95 % is stated.")
    if tilt := of_tilt(trial.run, trial.known):
        own, true = (f"{one.beta_deg:.2f}° with an azimuth of {one.tilt_azimuth_deg:.0f}°" for one in tilt[:2])
        found.append(f"The pipeline's tilt is {own}; the best constant one is {true}.")
    if (taken := trial.metrics.get(TIME)) is not None:
        found.append(f"The pipeline took {taken:.3g} s per frame.")
    return " ".join(found)


def _table(verdicts: Sequence[Verdict]) -> dict[str, Any]:
    """Lay verdicts out as rows, without columns that are empty throughout."""
    rows = []
    for verdict in verdicts:
        _, what, *values = cells(verdict)
        naive = ("" if v is None else f"{v:.4g}" for v in (verdict.constant, verdict.last_value))
        rows.append((what, verdict.status, *values, *naive))
    used = [i for i in range(len(_HEAD)) if i < 2 or any(row[i] for row in rows)]
    return {
        "head": [_HEAD[i] for i in used],
        "rows": [[row[i] for i in used] for row in rows],
        "bad": [i for i, verdict in enumerate(verdicts) if verdict.status == "failed"],
    }


def _drawn(trial: Trial, frames: Sequence[WorstFrame]) -> Iterator[tuple[bytes, str]]:
    """Draw truth and measurement of frames, with a caption each."""
    for one in frames:
        picture = pictures.read(trial.dataset.image(one.row))[..., ::-1]
        caption = _caption(one.row, one.measured)
        caption += "" if one.centre_off_px is None else f", centre {one.centre_off_px:.1f} px off"
        yield pictures.encode(_annotated(picture, one.row, one.measured), "jpeg", 80), caption


def _annotated(picture: Picture, row: Row, measured: Measurement) -> Picture:
    """Draw truth and measurement into a reduced picture, BGR."""
    tile, scale = preview.annotate(picture, row)[: -preview.CAPTION_HEIGHT].copy(), preview.TILE_WIDTH / row.width_px
    if measured.box is not None:
        first, last = preview.at(measured.box[:2], scale), preview.at(measured.box[2:], scale)
        cv2.rectangle(tile, first, last, _MEASURED, 1, cv2.LINE_AA)
    if measured.centre is not None:
        cv2.drawMarker(tile, preview.at(measured.centre, scale), _MEASURED, cv2.MARKER_CROSS, 18, 2, cv2.LINE_AA)
    if measured.alpha is not None:
        _, azimuth, rope = swing_of(labels.pose(row.jib_from_grab).translation)
        there = labels.pose(row.jib_from_camera).local(grab_centre(measured.alpha, azimuth, rope))
        pixel = labels.intrinsics(row).project(there)
        if np.isfinite(pixel).all():
            cv2.circle(tile, preview.at(pixel, scale), 9, _MEASURED, 2, cv2.LINE_AA)
    return tile


def _caption(row: Row, measured: Measurement) -> str:
    if measured.alpha is None:
        return f"Frame {row.frame}: true {row.alpha_deg:.2f}°, no angle: {measured.status} ({measured.reason})"
    alpha = math.degrees(measured.alpha)
    return f"Frame {row.frame}: true {row.alpha_deg:.2f}°, measured {alpha:.2f}°, error {alpha - row.alpha_deg:+.2f}°"


def _golden(picture: Picture) -> bytes:
    """Reduce the comparison of a golden frame, RGB."""
    scale = min(_GOLDEN_WIDTH_PX / picture.shape[1], 1.0)
    small = cv2.resize(picture[..., ::-1], None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return pictures.encode(small, "jpeg", 80)
