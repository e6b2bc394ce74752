"""The paper's iteration, exactly: eqs (est-1) to (est-3) of section 4.3."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simgrab.instrument.estimate.contract import FrameEstimator, Solution
from simgrab.instrument.estimate.frames import Frames, mount_from_camera, tangent_basis
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array


@dataclass(frozen=True)
class PaperIteration(FrameEstimator):
    """Yu, Wang & Wang (2025), section 4.3: σ² from α, β from E[h/√(m²+h²)] = cosβ·exp(−σ²/2), and again.

    With ψ the angle of a ray from the optical axis, h/√(m²+h²) = cosψ, and each round computes

    - (est-1) α_i = arccos{(m_i sinβ cosθ_i + h cosβ)/√(m_i² + h²)}
    - (est-2) σ² = mean α_i²
    - (est-3) β = arccos{mean(cosψ_i)·exp(σ²/2)}

    until neither changes by ε. The argument of (est-3) exceeds 1 when the start lies above twice β, and, from start
    0, when the kurtosis mean(ψ⁴)/mean(ψ²)² exceeds 3. Then there is no next step, and the record is refused.

    Notes
    -----
    Diagnostics: ``iterations``; ``beta_history`` and ``sigma2_history``, one column for each t from 0 and NaN beyond
    the last; ``kurtosis`` of ψ about 0.
    """

    name: ClassVar[str] = "paper-iteration"

    # the 0-degree line C'G': by the paper's rule, the line through C' for which the circular median of θ is 0; or
    # given, as in the paper's simulation
    axis: Literal["circular-median", "known"] = "circular-median"
    axis_direction: float = 0.0  # direction of C'G' in the picture, clockwise from its x axis, rad; for `axis="known"`
    # β⁽⁰⁾, rad; the repaired variant starts at the tilt of the mean ray, where (est-3) stays defined
    start: float | Literal["mean-ray"] = 0.0
    epsilon: float = 1e-6  # the paper's 1e-6, absolute, for β (rad) and σ² (rad²)
    max_iterations: int = 50

    def _solve(self, frames: Frames, calibration: Calibration) -> Solution:
        direction = self._axis(frames, calibration)
        c = -frames.rays[:, 2]  # h/√(m²+h²)
        p = np.cos(direction)[:, None] * frames.rays[:, 0] + np.sin(direction)[:, None] * frames.rays[:, 1]
        mean_c = frames.mean(c)
        psi2 = 2 * (1 - c) + (1 - c) ** 2 / 3  # ψ² to sixth order
        kurtosis = frames.mean(psi2**2) / np.maximum(frames.mean(psi2) ** 2, 1e-300)
        beta0 = self._start(frames, direction)
        beta, sigma2, history, reason = self._iterate(frames, p, c, mean_c, beta0, kurtosis)
        azimuth = (direction + np.pi) % (2 * np.pi)
        count = np.sum(np.isfinite(history[0]), axis=-1) - 1
        influence = self._influence(frames, direction, beta, sigma2, c)
        diagnostics = {"beta_history": history[0], "sigma2_history": history[1], "kurtosis": kurtosis}
        return Solution(reason, beta, azimuth, influence, diagnostics={"iterations": count} | diagnostics)

    def _axis(self, frames: Frames, calibration: Calibration) -> Array:
        """Direction of C'G' in the mount frame, counter-clockwise about z, shape (M,)."""
        if self.axis == "known":
            x, y, _ = mount_from_camera(calibration) @ (math.cos(self.axis_direction), math.sin(self.axis_direction), 0)
            return np.full(len(frames.rays), math.atan2(y, x))
        angle = np.arctan2(frames.rays[:, 1], frames.rays[:, 0])
        return np.array([circular_median(a[some]) for a, some in zip(angle, frames.present, strict=True)])

    def _start(self, frames: Frames, direction: Array) -> Array:
        if self.start != "mean-ray":
            return np.full(len(direction), float(self.start))
        mean = frames.mean(frames.rays)
        along = np.cos(direction) * mean[:, 0] + np.sin(direction) * mean[:, 1]
        return np.arctan2(np.maximum(along, 0.0), -mean[:, 2])

    def _iterate(
        self, frames: Frames, p: Array, c: Array, mean_c: Array, beta0: Array, kurtosis: Array
    ) -> tuple[Array, Array, Array, list[str]]:
        m = len(beta0)
        beta, sigma2 = beta0.copy(), np.full(m, np.nan)
        history = np.full((2, m, self.max_iterations + 1), np.nan)
        history[0, :, 0] = beta0
        reason = ["not run"] * m
        active = np.ones(m, bool)
        for t in range(self.max_iterations):
            index = np.flatnonzero(active)
            if not index.size:
                break
            some = frames.rows(active)
            now = beta[index]
            cos_alpha = np.sin(now)[:, None] * p[index] + np.cos(now)[:, None] * c[index]
            alpha = np.arccos(np.minimum(cos_alpha, 1.0))  # (est-1); the cosine between unit vectors, but for rounding
            new_sigma2 = some.mean(alpha**2)  # (est-2)
            argument = mean_c[index] * np.exp(new_sigma2 / 2)  # (est-3)
            new = np.arccos(np.where(argument <= 1, argument, np.nan))
            for i in np.flatnonzero(argument > 1):
                reason[index[i]] = _why(t + 1, argument[i], now[i], kurtosis[index[i]])
            small = (np.abs(new - now) < self.epsilon) & (np.abs(new_sigma2 - sigma2[index]) < self.epsilon)
            for i in index[small]:
                reason[i] = ""
            beta[index], sigma2[index] = new, new_sigma2
            history[:, index, t + 1] = new, new_sigma2
            active[index] = ~small & (argument <= 1)
        for i in np.flatnonzero(active):
            reason[i] = f"not converged in {self.max_iterations} iterations"
        return beta, sigma2, history, reason

    def _influence(self, frames: Frames, direction: Array, beta: Array, sigma2: Array, c: Array) -> Array:
        """Influence (M, 2, n): of the two equations at their fixed point, and of the circular median."""
        x, y, z = np.moveaxis(tangent_basis(beta, (direction + np.pi) % (2 * np.pi)) @ frames.rays, 1, 0)
        sine = np.sqrt(x * x + y * y)
        alpha = np.arctan2(sine, z)
        ratio = np.where(sine > 1e-12, alpha / np.maximum(sine, 1e-12), 1.0)
        # f1 = c·exp(σ²/2) − cosβ and f2 = α² − σ² have mean 0; solve their linearisation for β.
        f1 = c * np.exp(sigma2 / 2)[:, None] - np.cos(beta)[:, None]
        f2 = alpha**2 - sigma2[:, None]
        slope = -2 * frames.mean(ratio * x)
        bottom = np.sin(beta) + slope * np.cos(beta) / 2
        of_beta = -(f1 + f2 * np.cos(beta)[:, None] / 2) / np.where(np.abs(bottom) > 1e-12, bottom, np.inf)[:, None]
        result = np.stack([of_beta, np.zeros_like(of_beta)], axis=1)
        if self.axis == "circular-median":
            result[:, 1] = np.sin(beta)[:, None] * _median_influence(frames, direction)
        return result * frames.present[:, None]


def _why(step: int, argument: float, beta: float, kurtosis: float) -> str:
    text = f"step {step} of (est-3) asks for arccos(1 + {argument - 1:.2g}): "
    if beta == 0:
        return text + f"the kurtosis of the ray angles is {kurtosis:.3g}, and from start 0 it must be below 3"
    too_large = f", or the kurtosis of the ray angles, {kurtosis:.3g}, too large" if kurtosis > 3 else ""
    where = f"{'the start' if step == 1 else 'the last β'}, {math.degrees(beta):.3g} deg"
    return f"{text}{where}, is more than twice the tilt{too_large}"


def _median_influence(frames: Frames, direction: Array) -> NDArray[np.float64]:
    """Influence on the circular median: the sign of the side over twice the density there less the antipode's."""
    angle = np.arctan2(frames.rays[:, 1], frames.rays[:, 0]) - direction[:, None]
    angle -= 2 * np.pi * np.round(angle / (2 * np.pi))
    spread = np.sqrt(frames.mean(np.abs(angle))[:, None] * np.sqrt(2 * np.pi) / 2)
    width = np.minimum(spread * frames.count[:, None] ** -0.4, 1.0)
    near = (np.abs(angle) < width) * 1.0 - (np.abs(angle) > np.pi - width)
    density = frames.mean(near) / (2 * width[:, 0])
    # Without a preferred side the line is not determined at all; a tenth of the uniform density marks that.
    return np.asarray(np.sign(angle) / (2 * np.maximum(density, 0.1 / (2 * np.pi)))[:, None])


def circular_median(angles: ArrayLike) -> float:
    """Direction of least mean arc to the angles (Mardia & Jupp 2000, 2.2.2), exactly, in O(n log n).

    Parameters
    ----------
    angles : array_like, shape (n,)
        Radians, any winding.

    Returns
    -------
    float
        In [0, 2π). Half of the angles lie on either side of the diameter through it, and more than half within 90° of
        it. For an even number it is midway between the two middle angles. A median over [0, 2π) as an interval would
        depend on where the circle is cut.
    """
    t = np.sort(np.asarray(angles, float) % (2 * np.pi))
    n = len(t)
    twice = np.concatenate([t, t + 2 * np.pi])
    total = np.concatenate([[0.0], np.cumsum(twice)])
    k = np.arange(n)
    half = np.searchsorted(twice, t + np.pi, side="right")  # first angle that is nearer going backwards
    ahead = total[half] - total[k + 1] - (half - k - 1) * t
    behind = (k + n - half) * (t + 2 * np.pi) - (total[k + n] - total[half])
    arc: Array = ahead + behind
    best = int(np.argmin(arc))
    if n % 2:
        return float(t[best])
    level = arc[best] + 1e-9 * n
    after, before = (best + 1) % n, best - 1
    other = after if arc[after] <= min(level, arc[before]) else before if arc[before] <= level else best
    gap = (t[other] - t[best] + np.pi) % (2 * np.pi) - np.pi
    return float((t[best] + gap / 2) % (2 * np.pi))
