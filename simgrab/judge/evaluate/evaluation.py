"""Compare a run with the truth, stage by stage: the work of `simgrab evaluate`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from simgrab.instrument.contract import Measurement
from simgrab.instrument.run.runs import Run
from simgrab.judge.evaluate import detection, reading, swings, warnings
from simgrab.judge.evaluate.budget import budget, camera_errors
from simgrab.judge.evaluate.detection import Case
from simgrab.judge.evaluate.opened import opened
from simgrab.judge.evaluate.reading import Read
from simgrab.judge.evaluate.swings import HARDLY_SWINGS_DEG
from simgrab.judge.evaluate.truths import Truths
from simgrab.judge.evaluate.values import Evaluation, Provenance, ReadingScore
from simgrab.model.geometry import Array
from simgrab.model.records.observations import Detection

_ABOUT_ONE, _FOLLOWS = 0.2, 0.9  # of angles in radians: distance of their factor from 1, and least correlation


def evaluate(run: Run | str | Path, known: Truths | str | Path, start_s: float | None = None) -> Evaluation:
    """Compare a run with the truth of its frames.

    Parameters
    ----------
    run : Run or path
        A run, its folder, or a table by another program, CSV or parquet: columns as in a run's ``angles.csv``, of which
        ``alpha_deg`` and ``frame`` (from 0), ``time_s`` of a video or ``file`` of a dataset are needed.
    known : Truths or path
        As `simgrab.judge.evaluate.truths.of` finds them: a dataset, a rendered video, or its truth table.
    start_s : float, optional
        Time of the rendered video at which the run's first frame lies; by default it is found.

    Returns
    -------
    Evaluation
        A part is None if there is nothing to compare.

    Raises
    ------
    RunError, DatasetError, RecordError
        If the run or the truth is invalid, or they do not belong together.
    """
    run, known = opened(run, known, start_s)
    found = {
        "run": _provenance(run, known),
        "frames": {
            "all": len(run.measurements),
            "known": sum(r is not None for r in known.rows),
            **run.about["counts"],
            "without_grab": int((np.isfinite(run.alpha) & known.absent).sum()),
        },
        "detection": of_detection(run, known),
        "reading": of_reading(run, known),
        "angle": swings.angles(run.alpha, known.alpha, known.rope_length, known.weather),
        "interval": swings.coverage(run.ends, known.alpha),
        "alarm": None if run.time is None else swings.alarms(run.time, run.measurements, run.events, known.alpha),
        "warning": None
        if run.time is None or all(m.warning is None for m in run.measurements)
        else warnings.score(run.time, run.measurements, known.alpha),
        "budget": budget(run, known),
    }
    return msgspec.convert(found, Evaluation, from_attributes=True)


def _provenance(run: Run, known: Truths) -> Provenance:
    still, unit = _still(known.alpha), _unit(run.alpha, known.alpha)
    return Provenance(run.source, run.instrument, known.matched, still, unit, camera_errors(run, known))


def _still(true: Array) -> str:
    known = np.degrees(true[np.isfinite(true)])
    if not len(known) or known.std() >= HARDLY_SWINGS_DEG:
        return ""
    return f"The grab hardly swings (standard deviation {known.std():.2f}°), so these errors say little."


def _unit(measured: Array, true: Array) -> str:
    """Note that degrees seem to be radians: as such they would follow the true angles, rad, closely."""
    both = np.isfinite(measured) & np.isfinite(true)
    taken, known = np.degrees(measured[both]), true[both]
    if not len(known) or np.nanmax(np.degrees(measured)) > np.pi / 2 or not (taken.std() and known.std()):
        return ""
    factor, follows = taken @ known / (known @ known), np.corrcoef(taken, known)[0, 1]
    if abs(factor - 1) > _ABOUT_ONE or follows < _FOLLOWS:
        return ""
    rmse = np.degrees(np.sqrt(np.mean((taken - known) ** 2)))
    return f"The angles seem to be in radians, not degrees: in degrees, their RMSE would be {rmse:.3f}°."


def of_detection(run: Run, known: Truths) -> dict[str, Any] | None:
    """Score boxes and centres; None if the instrument measured frames but outputs neither."""
    boxes = any(m.box is not None for m in run.measurements)
    centres = any(m.centre is not None for m in run.measurements)
    statuses = {m.status for m in run.measurements}
    if not (boxes or centres) and ("ok" in statuses or "missed" not in statuses):
        return None
    found = detection.figures(cases(run, known)) | {"jitter_px": jitter(run, known)}
    return found | dict.fromkeys(_OF_BOXES) if centres and not boxes else found


def cases(run: Run, known: Truths) -> list[Case]:
    """Join the frames of known truth with what was found in them."""
    return [
        Case(row, bool(labelled), _detection(m), weather)
        for row, labelled, weather, m in zip(known.rows, known.labelled, known.weather, run.measurements, strict=True)
        if row is not None
    ]


UNREAD = "???? ????"
# Metrics without a value where an instrument outputs centres alone.
_OF_BOXES = (
    "map50_95", "map50", "recall", "recall_interval", "missed_worlds", "longest_miss",
    "false_boxes", "false_share", "false_interval", "false_worlds",
)  # fmt: skip


def jitter(run: Run, known: Truths) -> float | None:
    """Root mean square of the change of the centre's error from one frame to the next, per coordinate, over √2."""
    change = np.diff(run.pixels - known.centre, axis=0)
    change = change[np.isfinite(change).all(axis=-1)]
    return float(np.sqrt(np.mean(change**2) / 2)) if len(change) else None


def _detection(m: Measurement) -> Detection:
    if m.box is None and m.centre is None:
        return Detection("none", m.reason or "nothing found", m.score)
    return Detection(
        "found", "", m.score,
        None if m.box is None else np.array(m.box), None if m.centre is None else np.array(m.centre),
        centre_sd_px=None if m.centre_sd is None else np.array(m.centre_sd),
    )  # fmt: skip


def of_reading(run: Run, known: Truths) -> ReadingScore | None:
    """Score readings of the display and lengths; None if the instrument outputs neither.

    If it outputs a text for any frame, a frame without one counts as refused.
    """
    texts = any(m.rope_text is not None for m in run.measurements)
    reads = [
        Read(str(i), *map(_digits, (row.rope_text, row.rope_text_below or row.rope_text, m.rope_text or UNREAD)))
        for i, (m, row) in enumerate(zip(run.measurements, known.rows, strict=True))
        if texts and row is not None and row.rope_text is not None and m.status != "lost"
    ]
    off = np.abs(run.rope_length - known.rope_length)
    off = off[np.isfinite(off)]
    if not reads and not len(off):
        return None
    return reading.score(reads, sum(m.rope_status == "jump" for m in run.measurements), off)


def _digits(text: str) -> str:
    """Both numbers of a display without the points that some show."""
    return text.replace(".", "")
