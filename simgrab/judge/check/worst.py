"""The frames of a scene that a pipeline measured worst."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from simgrab.instrument.contract import Measurement
from simgrab.judge.check.trial import Trial
from simgrab.judge.check.verdicts import Verdict
from simgrab.model.truth import Row

_WORST, _WITHOUT = 4, 2  # of the largest errors, and without an angle


@dataclass(frozen=True, eq=False)
class WorstFrame:
    """Truth and measurement of a frame, and how far off its centre is, px, where one was output."""

    row: Row
    measured: Measurement
    centre_off_px: float | None

    def plain(self) -> dict[str, Any]:
        """Return plain data; angles in degrees."""
        alpha = None if self.measured.alpha is None else math.degrees(self.measured.alpha)
        return {
            "frame": self.row.frame, "file": self.row.file, "status": self.measured.status,
            "reason": self.measured.reason, "true_deg": self.row.alpha_deg, "measured_deg": alpha,
            "centre_off_px": self.centre_off_px,
        }  # fmt: skip


def worst_frames(trial: Trial, verdicts: Sequence[Verdict]) -> Iterator[WorstFrame]:
    """Give the frames of the largest errors, and the first labelled ones without an angle.

    Errors are those of the angle, and of the centre if a limit on it failed.
    """
    run, known = trial.run, trial.known
    errors = np.abs(run.alpha - known.alpha)
    worst = np.argsort(-errors)[: np.isfinite(errors).sum()]  # NaN comes last
    without = np.flatnonzero(~np.isfinite(run.alpha) & known.labelled)
    apart = 1 if run.time is None else max(len(errors) // 10, 1)  # frames that follow each other look the same
    centres = {c.frame: c.off_px for c in trial.centres}
    astray: list[int] = []
    if any(v.status == "failed" and v.what.startswith("detection.centre") for v in verdicts):
        off_px = {i: centres[row.frame] for i, row in enumerate(known.rows) if row and row.frame in centres}
        astray = sorted(off_px, key=lambda i: -off_px[i])
    chosen = [*_spread(worst.tolist(), apart, _WORST), *_spread(without.tolist(), apart, _WITHOUT)]
    for i in dict.fromkeys([*_spread(astray, apart, _WORST), *chosen]):
        row = known.rows[i]
        if row is not None:
            yield WorstFrame(row, run.measurements[i], centres.get(row.frame))


def _spread(frames: Sequence[int], apart: int, most: int) -> list[int]:
    """Choose the first frames that are so many apart."""
    chosen: list[int] = []
    for i in frames:
        if len(chosen) < most and all(abs(i - other) >= apart for other in chosen):
            chosen.append(i)
    return chosen
