"""Gravity as the mean direction of the rays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from simgrab.instrument.estimate.contract import FrameEstimator, Solution
from simgrab.instrument.estimate.frames import Frames, tangent_basis, tilt_of
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array


@dataclass(frozen=True)
class MeanRay(FrameEstimator):
    """Spherical mean of the rays: the most likely direction of von Mises–Fisher rays (Mardia & Jupp 2000, 10.3.1).

    Unbiased if the swing has no preferred side. The paper's iteration is, to small angles, this mean projected on
    its 0-degree line. Diagnostics: ``kappa``, the concentration by Banerjee et al. (2005), eq. 4.4.
    """

    name: ClassVar[str] = "mean-ray"

    def _solve(self, frames: Frames, calibration: Calibration) -> Solution:  # noqa: ARG002
        mean = frames.mean(frames.rays)
        length = np.linalg.norm(mean, axis=-1)
        beta, azimuth = tilt_of(mean)
        kappa = length * (3 - length**2) / np.maximum(1 - length**2, 1e-16)
        return Solution(
            reason=[""] * len(mean),
            beta=beta,
            azimuth=azimuth,
            influence=mean_influence(frames, beta, azimuth, length),
            diagnostics={"kappa": kappa},
        )


def mean_influence(frames: Frames, beta: Array, azimuth: Array, length: Array) -> Array:
    """Influence of each frame on the spherical mean, along and across the tilt, shape (M, 2, n)."""
    return tangent_basis(beta, azimuth)[:, :2] @ frames.rays / length[:, None, None]
