"""Gravity as the mean direction of the rays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from simgrab.instrument.estimate.contract import FrameEstimator, Solution
from simgrab.instrument.estimate.frames import Frames, tangent_basis, tilt_of
from simgrab.model.calibration import Calibration

_LEAST = 1e-16  # of 1 − R̄², which rounds to 0 if all rays are equal


@dataclass(frozen=True)
class MeanRay(FrameEstimator):
    """Spherical mean of the rays: the most likely direction of von Mises–Fisher rays (Mardia & Jupp 2000, 10.3.1).

    The estimate is unbiased if swings to opposite sides are equally likely. For small angles, the paper's iteration
    gives the projection of this mean on the line of zero direction. Diagnostics: ``kappa``, the concentration
    R̄ (3 − R̄²) / (1 − R̄²) of Banerjee et al. (2005), eq. 4.4, with the mean's length R̄.
    """

    name: ClassVar[str] = "mean-ray"

    def _solve(self, frames: Frames, calibration: Calibration) -> Solution:  # noqa: ARG002
        mean = frames.mean(frames.rays)
        length = np.linalg.norm(mean, axis=-1)
        beta, azimuth = tilt_of(mean)
        kappa = length * (3 - length**2) / np.maximum(1 - length**2, _LEAST)
        # A ray moves the mean direction by its part across that direction, over the mean's length R̄.
        influence = tangent_basis(beta, azimuth)[:, :2] @ frames.rays / length[:, None, None]
        return Solution([""] * len(mean), beta, azimuth, influence, diagnostics={"kappa": kappa})
