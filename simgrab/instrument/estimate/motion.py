"""Base of the estimators that fit a model of the motion to one record, and therefore state a posterior."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from simgrab.instrument.estimate import intervals as iv
from simgrab.instrument.estimate.contract import Estimator, joined
from simgrab.instrument.estimate.frames import Frames
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array
from simgrab.model.records.estimates import Estimates, Intervals


@dataclass(frozen=True)
class EstimatedMotion:
    """Result of fitting a model of the motion to one record of n frames.

    Attributes
    ----------
    beta, azimuth : float
    tilt_variance : tuple of 2 ndarrays, shape ()
        Variance of gravity along and across the tilt, rad².
    swing : ndarray, shape (n, 2)
        Horizontal part of the unit direction OA.
    covariance : ndarray, shape (n, 2, 2)
        Covariance of the swing.
    sigma2_variance : float
        Variance of σ².
    offset : ndarray, shape (3,)
    diagnostics : mapping of str to float or array
    sigma_across : float
        Variance across σ, which only lengthens it.
    stretch_variance : ndarray, shape (n,), or float
        Variance of α due to parameters that scale all swings.
    """

    beta: float
    azimuth: float
    tilt_variance: tuple[Array, Array]
    swing: Array
    covariance: Array
    sigma2_variance: float
    offset: Array
    diagnostics: Mapping[str, float]
    sigma_across: float = 0.0
    stretch_variance: Array | float = 0.0

    @property
    def alpha(self) -> Array:
        """Swing angles (n,): sinα is the length of the horizontal part."""
        return np.arcsin(np.minimum(np.hypot(self.swing[:, 0], self.swing[:, 1]), 1.0))


@dataclass(frozen=True)
class PathEstimator(Estimator):
    """Base of the smoothers, which need every frame's rope length and time."""

    needs_rope: ClassVar[bool] = True
    needs_time: ClassVar[bool] = True

    @abstractmethod
    def _motion(self, frames: Frames, calibration: Calibration) -> EstimatedMotion | str:
        """Fit one record; returns the reason of a refusal."""

    def _conclude(self, frames: Frames, calibration: Calibration) -> Estimates:
        m, parts = len(frames.count), []
        for i in range(m):
            one = frames.rows(np.arange(m) == i)
            motion = self._motion(one, calibration)
            found = self._refuse(one, [motion]) if isinstance(motion, str) else self._state(one, motion)
            parts.append((np.array([i]), found))
        return joined(parts, m)

    def _state(self, frames: Frames, motion: EstimatedMotion) -> Estimates:
        """State a record's motion with its intervals by the posterior."""
        quantile = iv.student(self.intervals.level, np.inf)
        alpha, beta, sigma = motion.alpha, np.array([motion.beta]), np.sqrt(np.mean(motion.alpha**2))[None]
        along, across = iv.split(motion.covariance, motion.swing)
        of_sigma = motion.sigma2_variance / np.maximum(4 * sigma**2, 1e-300)
        posterior = Intervals(
            "posterior", self.intervals.level, iv.radial(beta, *motion.tilt_variance, quantile),
            iv.radial(sigma, of_sigma, np.array(motion.sigma_across), quantile),
            iv.radial(alpha, along + motion.stretch_variance, across, quantile)[None],
            None, "sigma is that of this record",
        )  # fmt: skip
        return Estimates(
            self.name, np.ones(1, bool), np.array([""]), frames.count.astype(np.int64), beta,
            np.array([motion.azimuth]), sigma, alpha[None], motion.offset[None], (posterior,),
            {name: np.array([value]) for name, value in motion.diagnostics.items()},
        )  # fmt: skip
