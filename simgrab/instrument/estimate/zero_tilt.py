"""What one gets without correcting the camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from simgrab.instrument.estimate.contract import FrameEstimator, Solution
from simgrab.instrument.estimate.frames import Frames
from simgrab.model.calibration import Calibration


@dataclass(frozen=True)
class ZeroTilt(FrameEstimator):
    """Takes the optical axis for gravity: the simplification of Wu et al. (2020), who hang the camera straight.

    β is 0 by assumption and so has an interval of no width; σ and α carry the tilt as their error.
    """

    name: ClassVar[str] = "zero-tilt"
    parameters: ClassVar[int] = 2  # σ and its scatter

    def _solve(self, frames: Frames, calibration: Calibration) -> Solution:  # noqa: ARG002
        m, _, n = frames.rays.shape
        return Solution([""] * m, np.zeros(m), np.zeros(m), influence=np.zeros((m, 2, n)))
