"""Gravity as the direction of least mean angle to the rays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from simgrab.instrument.estimate.contract import FrameEstimator, Solution
from simgrab.instrument.estimate.frames import Frames, tangent_basis, tilt_of
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array

SMOOTHING = 1e-3  # ε over the mean angle
TOLERANCE, MAX_ITERATIONS = 1e-7, 200  # the iteration ends at a shorter step, rad


@dataclass(frozen=True)
class GeometricMedian(FrameEstimator):
    """Direction of least mean angle to the rays (Fletcher, Venkatasubramanian & Joshi 2009), by a safeguarded Newton.

    The angle α is smoothed to arccos(cosα/√(1+ε²)), with ε a thousandth of the mean angle from the mean ray: far
    below the standard error, and enough to make the median unique on collinear points. Where the density of rays is
    singular at gravity, as under the paper's half-normal α, this beats every mean.
    """

    name: ClassVar[str] = "geometric-median"

    def _solve(self, frames: Frames, calibration: Calibration) -> Solution:  # noqa: ARG002
        start = frames.mean(frames.rays)
        start /= np.linalg.norm(start, axis=-1, keepdims=True)
        x, y, _ = np.moveaxis(tangent_basis(*tilt_of(start)) @ frames.rays, 1, 0)
        epsilon = np.maximum(SMOOTHING * frames.mean(np.hypot(x, y)), 1e-9)
        down, iterations = self._minimise(frames, start, epsilon)
        beta, azimuth = tilt_of(down)
        influence, slope = _influence(frames, beta, azimuth, epsilon)
        reason = ["" if i < MAX_ITERATIONS else f"no minimum in {MAX_ITERATIONS} steps" for i in iterations]
        return Solution(
            reason, beta, azimuth, influence, diagnostics={"iterations": iterations},
            reach=lambda covariance, q: _reach(frames, beta, azimuth, epsilon, slope, covariance, q),
        )  # fmt: skip

    def _minimise(self, frames: Frames, start: Array, epsilon: Array) -> tuple[Array, NDArray[np.int64]]:
        """Newton steps, halved until the gradient shrinks; by convexity it does for short steps."""
        down, base, iterations = start.copy(), start.copy(), np.zeros(len(start), np.int64)
        step, scale, size = np.zeros_like(start), np.ones(len(start)), np.full(len(start), np.inf)
        active = np.ones(len(start), bool)
        while active.any():
            index = np.flatnonzero(active)
            some, at = frames.rows(active), down[index]
            z, w = _weights(some, at, epsilon[index] ** 2)
            pull, hessian = _pull(some, at, w), _hessian(some, at, z, w)
            length = np.linalg.norm(pull, axis=-1)
            worse = (length > size[index]) & (scale[index] > 1e-6)
            good, bad = index[~worse], index[worse]
            base[good], size[good], scale[good] = at[~worse], length[~worse], 1.0
            step[good] = np.linalg.solve(hessian[~worse], pull[~worse][..., None])[..., 0]
            scale[bad] /= 2
            move = step[index] * scale[index, None]
            moved = base[index] + move
            down[index] = moved / np.linalg.norm(moved, axis=-1, keepdims=True)
            iterations[index] += 1
            active[index] = (np.linalg.norm(move, axis=-1) > TOLERANCE) & (iterations[index] < MAX_ITERATIONS)
        return down, iterations


def _weights(frames: Frames, down: Array, epsilon2: Array) -> tuple[Array, Array]:
    """Cosine z of each ray to ``down``, and 1/√(sin² + ε²); both (M, n)."""
    z = (down[:, None] @ frames.rays)[:, 0]
    return z, 1 / np.sqrt(np.maximum(1 + epsilon2[:, None] - z * z, epsilon2[:, None]))


def _pull(frames: Frames, down: Array, w: Array) -> Array:
    """Downhill gradient of the mean smoothed angle, tangent, (M, 3). A missing frame's ray is 0 and pulls nowhere."""
    toward = (frames.rays @ w[..., None])[..., 0] / frames.count[:, None]
    return np.asarray(toward - np.sum(toward * down, axis=-1, keepdims=True) * down)


def _hessian(frames: Frames, down: Array, z: Array, w: Array) -> Array:
    """Second derivative (M, 3, 3) on the tangent plane, and the identity along ``down``."""
    zw = z * w
    second = -(frames.rays * (zw * w**2)[:, None]) @ frames.rays.swapaxes(1, 2) / frames.count[:, None, None]
    along = down[:, :, None] * down[:, None, :]
    plane = np.eye(3) - along
    second = plane @ second @ plane + (zw.sum(axis=-1) / frames.count)[:, None, None] * plane
    # Collinear rays leave one direction flat; a millionth of the other keeps the step finite.
    return np.asarray(second + 1e-6 * np.trace(second, axis1=1, axis2=2)[:, None, None] * plane + along)


def _influence(frames: Frames, beta: Array, azimuth: Array, epsilon: Array) -> tuple[Array, Array]:
    """Influence (M, 2, n), and the slope (M, 2, 2) that divides it: the Hessian smoothed over the standard error.

    E[1/α] is infinite under a singular density, so the Hessian at a point does not predict the slope over the
    estimate's error. Brown & Wang (2005) smooth at that distance, found here by two rounds of substitution.
    """
    basis = tangent_basis(beta, azimuth)
    down = basis[:, 2]
    _, w = _weights(frames, down, epsilon**2)
    unit = basis[:, :2] @ frames.rays * w[:, None]
    scatter = unit @ unit.swapaxes(1, 2) / frames.count[:, None, None]
    error = 1e3 * epsilon / np.sqrt(frames.count)
    for _ in range(2):
        slope = basis[:, :2] @ _hessian(frames, down, *_weights(frames, down, error**2)) @ basis[:, :2].swapaxes(1, 2)
        inverse = np.linalg.inv(slope)
        error = np.sqrt(np.trace(inverse @ scatter @ inverse, axis1=1, axis2=2) / (2 * frames.count))
    return inverse @ unit, slope


def _reach(
    frames: Frames, beta: Array, azimuth: Array, epsilon: Array, slope: Array, covariance: Array, quantile: Array
) -> tuple[Array, Array]:
    """How far β may lie below and above: up to where the mean pull back exceeds its quantile (a score interval).

    Near a singular density the pull grows faster than any slope at the estimate predicts; such a slope would give too
    wide an interval.
    """
    score = slope @ covariance @ slope
    limit = quantile * np.sqrt(score[:, 0, 0])
    reaches = []
    for side in (-1.0, 1.0):
        far = quantile * np.sqrt(covariance[:, 0, 0])
        near, pull_near = np.zeros_like(far), np.zeros_like(far)
        for _ in range(2):
            basis = tangent_basis(beta + side * far, azimuth)
            _, w = _weights(frames, basis[:, 2], epsilon**2)
            pull = -side * np.sum(_pull(frames, basis[:, 2], w) * basis[:, 0], axis=-1)
            secant = (pull - pull_near) / np.where(far == near, np.inf, far - near)
            step = np.where(secant > 0, (limit - pull) / np.where(secant > 0, secant, 1.0), 0.0)
            near, pull_near, far = far, pull, np.clip(far + step, far / 4, far * 4)
        reaches.append(far)
    return reaches[0], reaches[1]
