"""Estimate tilt and camera offset together, separated by the rope's length."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from simgrab.instrument.estimate.contract import FrameEstimator, Solution
from simgrab.instrument.estimate.frames import Frames, tilt_of
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array, lean

HUBER = 2.0  # multiple of the swings' typical size per axis, beyond which they keep their direction with less weight
TOLERANCE, MAX_ITERATIONS = 1e-8, 50  # the iteration ends when its next step would be shorter, rad
NOT_CONVERGED = f"not converged in {MAX_ITERATIONS} iterations"
BEYOND_GRAB = "the camera is farther from the rope exit than the grab: is offset_m in metres, and the rope's length?"


@dataclass(frozen=True)
class RopeAware(FrameEstimator):
    """Robust regression of the swing's direction on 1 and 1/l, with the calibration's offset as prior.

    A camera beside the rope exit sees a plumb rope at an angle of offset/l; a tilted camera sees it at the same angle
    for any l. The estimate makes the mean swing, OA over l, zero at every rope length. The offset's horizontal part has
    its nominal value and standard deviation as prior; its height is taken as exact.

    Notes
    -----
    Diagnostics: ``iterations``; ``offset_sd_m``, the offset's remaining standard deviation.
    """

    name: ClassVar[str] = "rope-aware"
    parameters: ClassVar[int] = 5  # tilt and horizontal offset, two each, and σ
    needs_rope: ClassVar[bool] = True

    def _solve(self, frames: Frames, calibration: Calibration) -> Solution:
        _, precision = _prior(calibration)
        fit = self.fit(frames, calibration)
        beta, azimuth = tilt_of(fit.down)
        sums, lever = fit.sums, fit.lever
        known = sums.of_prior(precision) + _of_height(frames, fit, calibration)
        along = _along(azimuth)
        turned = np.zeros((len(beta), 5, 5))
        turned[:, :2, :2] = turned[:, 2:4, 2:4] = along
        turned[:, 4, 4] = 1
        swing = along_tilt(fit.swing, azimuth)
        return Solution(
            reason=[
                BEYOND_GRAB if np.isnan(b) else "" if e <= TOLERANCE else NOT_CONVERGED
                for e, b in zip(fit.error, beta, strict=True)
            ],
            beta=beta,
            azimuth=azimuth,
            influence=_influence(frames, fit, swing[:, :2], precision),
            swing=swing,
            lever=lever,
            known=turned @ known @ turned.swapaxes(1, 2),
            radial=_squares(fit.swing) * (calibration.offset_sd_m * lever) ** 2,
            offset=fit.offset,
            diagnostics={"iterations": fit.iterations, "offset_sd_m": sums.offset_sd(precision)},
        )

    def fit(self, frames: Frames, calibration: Calibration) -> RopeFit:
        """Alternate between computing the swings under the present tilt and offset, and the step that centres them."""
        assert frames.rope_length is not None
        nominal, precision = _prior(calibration)
        lever = 1 / frames.rope_length
        longest = lever.max(axis=-1)
        down = frames.mean(frames.rays)
        offset = np.tile(nominal, (len(down), 1))
        unit = None
        live, last = np.ones(len(down), bool), np.zeros(len(down))
        iterations = np.zeros(len(down), np.int64)
        for i in range(MAX_ITERATIONS):
            swing = swings(frames.rays, lever, down, offset)
            if i == 0:  # a moving loss would never let the fit come to rest
                limit = HUBER * _typical(frames, swing)
            sums = _Sums.of(frames, lever, swing, limit, unit)
            unit = sums.unit
            turn, shift = (live[:, None] * move for move in sums.step(offset - nominal, precision))
            down = _turned(down, turn)
            offset = offset + np.pad(shift, ((0, 0), (0, 1)))
            step = np.maximum(np.abs(turn).max(axis=-1), np.abs(shift).max(axis=-1) * longest)
            # Steps shrink by nearly a constant factor, which predicts the next; a thirtieth is the lowest factor used.
            error = step * np.clip(step / np.maximum(last, 1e-300), 1 / 30, 1)
            last, live = step, error > TOLERANCE
            iterations += live
            if not live.any():  # NaN rows end too
                break
        swing = _moved(swing, turn, shift, lever)
        return RopeFit(down, offset, error, iterations, lever, swing, limit, sums)


@dataclass(frozen=True)
class RopeFit:
    """Results of M fits."""

    down: Array  # (M, 3), gravity in the mount frame
    offset: Array  # (M, 3)
    error: Array  # (M,), length of the next step, which was not taken, rad
    iterations: NDArray[np.int64]  # (M,)
    lever: Array  # (M, n), 1/l
    swing: Array  # (M, 2, n), horizontal part of the unit directions OA, jib frame
    limit: Array  # (M,), swing beyond which Huber's loss is linear
    sums: _Sums


@dataclass(frozen=True)
class _Sums:
    """Sums over frames for the next step and for the sandwich."""

    slope: Array  # (M, 3), sums of the loss' slope times 1, 1/l and 1/l²
    pull: Array  # (M, 2, 2), sums of the weighted swing in jib x and y, times 1 and 1/l
    unit: Array  # (M,), one frame's variance per axis, which weighs the prior against the frames

    @staticmethod
    def of(frames: Frames, lever: Array, swing: Array, limit: Array, unit: Array | None) -> _Sums:
        weight, inside = _weight(frames, swing, limit)
        pulls = swing * weight[:, None]
        weight = (weight + inside) / 2  # mean derivative of the two axes: half the weight, and within the limit 1
        slope = np.stack([weight.sum(axis=-1), np.vecdot(weight, lever), np.vecdot(weight, lever * lever)], axis=-1)
        pull = np.stack([pulls.sum(axis=-1), np.vecdot(pulls, lever[:, None])], axis=-1)
        if unit is None:
            unit = np.vecdot(pulls, pulls).sum(axis=-1) / (2 * np.maximum(slope[:, 0], 1e-300))
        return _Sums(slope, pull, unit)

    def step(self, away: Array, precision: float) -> tuple[Array, Array]:
        """Rotation of the rays and horizontal shift of the camera, jib frame; (M, 2) each."""
        prior = self.unit * precision
        a, b, c = self.slope[:, :1], self.slope[:, 1:2], self.slope[:, 2:] + prior[:, None]
        u = -self.pull[..., 0]
        v = -self.pull[..., 1] - prior[:, None] * away[:, :2]
        det = a * c - b * b
        return (c * u - b * v) / det, (a * v - b * u) / det

    def inverse(self, precision: float) -> Array:
        """Inverse (M, 2, 2) of the matrix that divides the step."""
        a, b, c = self.slope[:, 0], self.slope[:, 1], self.slope[:, 2] + self.unit * precision
        return np.stack([c, -b, -b, a], -1).reshape(-1, 2, 2) / (a * c - b * b)[:, None, None]

    def of_prior(self, precision: float) -> Array:
        """Prior's part of the covariance (M, 5, 5) of gravity and minus offset, jib x and y, and σ̂²."""
        shares = self.inverse(precision)[:, :, 1] * (self.unit * np.sqrt(precision))[:, None]
        known = np.zeros((len(shares), 5, 5))
        known[:, :4, :4] = np.einsum("mi,mj,ab->miajb", shares, shares, np.eye(2)).reshape(-1, 4, 4)
        return known

    def offset_sd(self, precision: float) -> Array:
        """Return the posterior standard deviation (M,) of the offset per axis, m."""
        return np.sqrt(self.unit * self.inverse(precision)[:, 1, 1])


def _squares(swing: Array) -> Array:
    """Square of the horizontal part of swings (M, 2, n), shape (M, n)."""
    return np.asarray(swing[:, 0] * swing[:, 0] + swing[:, 1] * swing[:, 1])


def _weight(frames: Frames, swing: Array, limit: Array) -> tuple[Array, Array]:
    """Huber's weight min(1, limit/|s|) of swings s (M, 2, n), and 1 within the limit; (M, n), 0 at missing frames."""
    size, limit = np.sqrt(_squares(swing)), limit[:, None]
    return limit / np.maximum(size, limit) * frames.present, np.asarray((size <= limit) * frames.present, float)


def _influence(frames: Frames, fit: RopeFit, swing: Array, precision: float) -> Array:
    """Influence (M, 4, n) on gravity and minus offset, in the axes in which ``swing`` (M, 2, n) is given."""
    inverse = frames.count[:, None, None] * fit.sums.inverse(precision)
    pull = swing * _weight(frames, swing, fit.limit)[0][:, None]
    shares = inverse[..., :1] + inverse[..., 1:] * fit.lever[:, None]
    return np.concatenate([pull * shares[:, i, None] for i in range(2)], axis=1)


def _prior(calibration: Calibration) -> tuple[Array, float]:
    """Nominal offset (3,), and the precision of each component, 1/m²; at best to a micrometre."""
    return np.asarray(calibration.offset_m, float), 1 / max(calibration.offset_sd_m, 1e-6) ** 2


def _of_height(frames: Frames, fit: RopeFit, calibration: Calibration) -> Array:
    """Covariance (M, 5, 5), as above, of the offset's height, from a fit with the camera one deviation higher."""
    nominal, precision = _prior(calibration)
    moved = swings(frames.rays, fit.lever, fit.down, fit.offset + (0.0, 0.0, calibration.offset_sd_m))
    sums = _Sums.of(frames, fit.lever, moved, fit.limit, fit.sums.unit)
    turn, shift = sums.step(fit.offset - nominal, precision)
    grown = frames.mean(_squares(_moved(moved, turn, shift, fit.lever))) - frames.mean(_squares(fit.swing))
    change = np.concatenate([-turn, -shift, grown[:, None]], axis=-1)
    return np.asarray(change[:, :, None] * change[:, None, :])


def _moved(swing: Array, turn: Array, shift: Array, lever: Array) -> Array:
    """Swings (M, 2, n) after a short step."""
    return swing + turn[..., None] + shift[..., None] * lever[:, None]


def swings(rays: Array, lever: Array, down: Array, offset: Array) -> Array:
    """Find the horizontal part (M, 2, n) of the unit directions OA, jib frame, from unit rays (M, 3, n), mount frame.

    A is where a ray meets the sphere of radius l about O.
    """
    jib_from_mount = lean(*tilt_of(down))
    x, y, ahead = np.moveaxis(np.concatenate([jib_from_mount[:, :2], offset[:, None] @ jib_from_mount], axis=1)
                              @ rays, 1, 0)  # fmt: skip
    # From the camera to A over l: the root of |offset + λ·ray| = l.
    ahead = ahead * lever
    way = np.sqrt(1 - np.sum(offset**2, axis=-1)[:, None] * lever**2 + ahead**2) - ahead
    return np.stack([x * way + lever * offset[:, :1], y * way + lever * offset[:, 1:2]], axis=1)


def _turned(down: Array, turn: Array) -> Array:
    """Gravity in the mount frame after turning the rays by ``turn`` (M, 2) in the jib frame."""
    straight = np.concatenate([-turn, -np.ones_like(turn[:, :1])], axis=-1)
    turned = np.einsum("mji,mj->mi", lean(*tilt_of(down)), straight)
    return np.asarray(turned / np.linalg.norm(turned, axis=-1, keepdims=True))


def along_tilt(swing: Array, azimuth: Array) -> Array:
    """Turn horizontal parts of OA (M, 2, n), jib frame, into units (M, 3, n) along and across the tilt and down."""
    down = np.sqrt(np.maximum(1 - _squares(swing), 0))
    return np.concatenate([_along(azimuth) @ swing, down[:, None]], axis=1)


def _along(azimuth: Array) -> Array:
    """Rotation from jib x and y to the directions along and across the tilt, mount frame; shape (M, 2, 2)."""
    c, s = np.cos(azimuth), np.sin(azimuth)
    return np.stack([-c, -s, s, -c], axis=-1).reshape(-1, 2, 2)


def _typical(frames: Frames, swing: Array) -> Array:
    """Size of the swings per axis: their median over √(2 ln 2), the ratio for a Rayleigh distribution."""
    size = np.sqrt(_squares(swing))
    some = frames.present
    middle = np.median(size, -1) if some.all() else np.nanmedian(np.where(some, size, np.nan), -1)
    return np.asarray(np.maximum(middle, 1e-12) / np.sqrt(2 * np.log(2)))
