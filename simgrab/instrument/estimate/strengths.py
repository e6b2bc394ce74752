"""Estimate the strengths of a pendulum's forcing and of a detector's errors from the record itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from simgrab.instrument.estimate.chain import Quadratic
from simgrab.model.geometry import Array

# Strengths, as logarithms: white acceleration (m²/s³ per axis), pixel noise (over h), slow forcing (rad per axis).
FAST, NOISE, SLOW = 0, 1, 2
WINDOW_S = 2.0  # over which forces are averaged to find a grab that does not swing freely
BEYOND = 9.0  # how many times the usual force is too much
LEAST_NOISE_PX = 0.05
LEAST_FAST, LEAST_SLOW = 1e-5, 1e-3  # the usual forces are those of the record itself, but no less than these


@dataclass(frozen=True)
class Weighed:
    """Twice a negative log posterior, without a constant. Three of its parts have unknown strengths v.

    fixed + e^(−v₀) fast + e^(−2v₁) places + e^(−2v₂) slow.
    """

    fixed: Quadratic
    fast: Quadratic
    places: Quadratic
    slow: Quadratic
    # links, seen, leans: number of terms in the three parts: steps, pixels, and steps with starts
    links: int
    seen: int
    leans: int
    focal_px: float
    least_fast: float  # least white acceleration
    slow_range: tuple[float, float]  # least and greatest slow forcing
    spread: float  # sum of the logarithms of the variances of drifts per axis, which `fixed` has the inverses of

    def at(self, strengths: Array) -> Quadratic:
        """Return the sum of the parts, at strengths (3,)."""
        fast, noise, slow = np.exp(-np.array([1, 2, 2]) * strengths)
        return self.fixed + self.fast * fast + self.places * noise + self.slow * slow

    def cost(self, strengths: Array) -> float:
        """Minus the logarithm of the record's likelihood (Laplace) at strengths (3,), without a constant."""
        terms = np.array([2 * self.links, 2 * self.seen, 2 * self.leans - 0.25])
        return float(0.5 * self.at(strengths).marginal() + terms @ strengths + self.spread)

    def search(self, strengths: Array, *, wide: bool) -> Array:
        """Strengths (3,) of maximum likelihood (Laplace), with a prior as the fourth root of the slow one.

        Without this prior, a short record would set slow forcing to 0 and state its tilt too precisely.
        """
        low = np.log([self.least_fast, LEAST_NOISE_PX / self.focal_px, self.slow_range[0]])
        high = np.log([1.0, 50 / self.focal_px, self.slow_range[1]])

        def minus_log(v: Array) -> float:
            inside = np.clip(v, low, high)
            try:
                return self.cost(inside) + 10 * float(np.sum((v - inside) ** 2))
            except np.linalg.LinAlgError:
                return 1e30

        size = np.array([3.0, 0.7, 1.5]) if wide else np.array([0.7, 0.15, 0.5])
        start = np.clip(strengths, low, high)
        options = {"xatol": 0.05, "fatol": 0.01, "initial_simplex": np.vstack([start, start + np.diag(size)])}
        best = scipy.optimize.minimize(minus_log, start, method="Nelder-Mead", options=options)
        return np.clip(best.x, low, high)


def excess(residual: Array, precision: Array, freedom: int, least: float, across: int) -> Array:
    """Force in each step over the greatest that a grab that swings freely feels, shape (k,).

    The usual squared force is twice the median.

    Parameters
    ----------
    residual : ndarray, shape (k, d)
        States after each step minus predicted ones.
    precision : ndarray, shape (k, d, d)
        Inverse covariance by a force of strength 1.
    freedom : int
        Rank of ``precision``.
    least : float
        Least usual squared force.
    across : int
        Steps that are averaged over.
    """
    force = np.einsum("ni,nij,nj->n", residual, precision, residual) / freedom
    force = scipy.ndimage.uniform_filter1d(force, across)
    return np.asarray(force / (BEYOND * max(2 * float(np.median(force)), least)))
