"""The result without correcting the camera's tilt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from simgrab.instrument.estimate.contract import FrameEstimator, Solution
from simgrab.instrument.estimate.frames import Frames
from simgrab.model.calibration import Calibration


@dataclass(frozen=True)
class ZeroTilt(FrameEstimator):
    """Takes the optical axis as gravity, the simplification of Wu et al. (2020), whose camera hangs straight.

    β is 0 by assumption, so its interval has no width; σ and α contain the tilt as error.
    """

    name: ClassVar[str] = "zero-tilt"
    parameters: ClassVar[int] = 2  # σ and its scatter

    def _solve(self, frames: Frames, calibration: Calibration) -> Solution:  # noqa: ARG002
        m, _, n = frames.rays.shape
        return Solution([""] * m, np.zeros(m), np.zeros(m), influence=np.zeros((m, 2, n)))
