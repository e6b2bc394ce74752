"""Tilt and camera offset together, told apart by the rope's length."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from simgrab.calibration import Calibration
from simgrab.geometry import Array, lean
from simgrab.instrument.estimate.contract import Estimator, Solution
from simgrab.instrument.estimate.frames import Frames, tilt_of


@dataclass(frozen=True)
class RopeAware(Estimator):
    """Robust regression of the swing's direction on 1 and 1/l, with the calibration's offset as prior.

    A camera beside the rope exit sees a plumb rope under an angle of offset/l, a tilted one under the same angle
    whatever l is. The estimate is where the mean swing, OA over l, is zero at every rope length; the offset's
    horizontal part is pulled towards its nominal value as strongly as its standard deviation says, its height is
    taken as it is.

    Attributes
    ----------
    huber : float
        Swings beyond so many times their typical size per axis (from the median) keep their direction and lose their
        weight.
    tolerance : float
        Step at which the iteration ends, rad.
    max_iterations : int

    Notes
    -----
    Diagnostics: ``iterations``; ``offset_sd_m``, what is left of the prior's standard deviation.
    """

    name: ClassVar[str] = "rope-aware"
    parameters: ClassVar[int] = 5  # tilt and horizontal offset, two each, and σ
    needs_rope: ClassVar[bool] = True

    huber: float = 2.0
    tolerance: float = 1e-9
    max_iterations: int = 50

    def _solve(self, frames: Frames, calibration: Calibration) -> Solution:
        nominal, precision = _prior(calibration)
        down, offset, step, iterations, sums = self.fit(frames, calibration)
        beta, azimuth = tilt_of(down)
        along = _along(azimuth)
        influence, known = sums.influence(precision)
        higher = _Sums(frames, down, offset + (0.0, 0.0, calibration.offset_sd_m), self.huber, (sums.scale, sums.unit))
        known += _of_height(sums, higher, offset - nominal, precision)
        turned = np.zeros((len(beta), 5, 5))
        turned[:, :2, :2] = turned[:, 2:4, 2:4] = along
        turned[:, 4, 4] = 1
        return Solution(
            reason=[self._why(s, bool(np.isfinite(b))) for s, b in zip(step, beta, strict=True)],
            beta=beta,
            azimuth=azimuth,
            influence=turned[:, :4, :4] @ influence,
            swing=np.concatenate([along @ sums.swing[:, :2], -sums.swing[:, 2:]], axis=1),
            lever=sums.lever,
            known=turned @ known @ turned.swapaxes(1, 2),
            radial=(calibration.offset_sd_m * sums.size * sums.lever) ** 2,
            offset=offset,
            diagnostics={"iterations": iterations, "offset_sd_m": sums.offset_sd(precision)},
        )

    def fit(self, frames: Frames, calibration: Calibration) -> tuple[Array, Array, Array, NDArray[np.int64], _Sums]:
        """Gravity in the mount frame (M, 3), offset (M, 3), last step (M,), iterations (M,), and the sums there."""
        assert frames.rope_length is not None
        nominal, precision = _prior(calibration)
        m = len(frames.rays)
        shortest = frames.rope_length.min(axis=-1)
        down = frames.mean(frames.rays)
        offset = np.tile(nominal, (m, 1))
        iterations, fixed = np.zeros(m, np.int64), None
        for i in range(self.max_iterations):
            sums = _Sums(frames, down, offset, self.huber, fixed)
            fixed = (sums.scale, sums.unit) if i < 2 else fixed  # a moving loss never lets the fit come to rest
            turn, shift = sums.step(offset - nominal, precision)
            down = _turned(down, turn)
            offset = offset + np.pad(shift, ((0, 0), (0, 1)))
            step = np.maximum(np.abs(turn).max(axis=-1), np.abs(shift).max(axis=-1) / shortest)
            iterations += step > self.tolerance
            if i > 2 and not np.any(step > self.tolerance):  # NaN rows end too
                break
        return down, offset, step, iterations, sums

    def _why(self, step: float, finite: bool) -> str:
        if not finite:
            return "no swing reaches the rays: the rope is shorter than the offset"
        return "" if step <= self.tolerance else f"not converged in {self.max_iterations} iterations"


class _Sums:
    """The swings under one tilt and offset, and the sums over frames that the next step and the sandwich need."""

    def __init__(
        self, frames: Frames, down: Array, offset: Array, huber: float, fixed: tuple[Array, Array] | None
    ) -> None:
        # In place where it can be: these passes over the frames are what the estimator costs.
        self.frames, self.lever = frames, _lever(frames)
        self.swing = swings(frames, down, offset)
        self.size = size = np.sqrt(np.einsum("min,min->mn", self.swing[:, :2], self.swing[:, :2]))
        self.scale = _typical(frames, size) if fixed is None else fixed[0]
        limit = huber * self.scale[:, None]
        weight = limit / np.maximum(size, limit)  # Huber's: 1 within the limit
        if frames.present is not None:
            weight *= frames.present
        slope = weight * 0.5  # mean derivative of the two axes, which within the limit is 1
        slope[size <= limit] *= 2
        self.pull = self.swing[:, :2] * weight[:, None]
        both = np.stack([np.ones_like(self.lever), self.lever], axis=1)
        self.ones, self.k1 = (both @ slope[..., None])[..., 0].T
        self.k2 = np.einsum("mn,mn,mn->m", slope, self.lever, self.lever)
        # One frame's variance per axis, on the scale on which the prior is weighed against the frames.
        unit = np.einsum("min,min->m", self.pull, self.pull) / (2 * np.maximum(self.ones, 1e-300))
        self.unit = unit if fixed is None else fixed[1]

    def step(self, away: Array, precision: float) -> tuple[Array, Array]:
        """By how much to turn the rays and shift the camera, horizontally in the jib frame; (M, 2) each."""
        prior = self.unit * precision
        a, b, c = self.ones[:, None], self.k1[:, None], (self.k2 + prior)[:, None]
        u = -self.pull.sum(axis=-1)
        v = -(self.pull @ self.lever[..., None])[..., 0] - prior[:, None] * away[:, :2]
        det = a * c - b * b
        return (c * u - b * v) / det, (a * v - b * u) / det

    def _inverse(self, precision: float) -> Array:
        c = self.k2 + self.unit * precision
        det = self.ones * c - self.k1**2
        return np.stack([c, -self.k1, -self.k1, self.ones], -1).reshape(-1, 2, 2) / det[:, None, None]

    def influence(self, precision: float) -> tuple[Array, Array]:
        """Influence (M, 4, n) on gravity and minus offset, jib x and y; covariance (M, 5, 5), with σ̂², of the prior."""
        n = self.frames.count[:, None, None]
        inverse = self._inverse(precision)
        of_turn = n * (inverse[:, 0, 0, None] + inverse[:, 0, 1, None] * self.lever)[:, None] * self.pull
        of_shift = n * (inverse[:, 1, 0, None] + inverse[:, 1, 1, None] * self.lever)[:, None] * self.pull
        shares = inverse[:, :, 1] * (self.unit * np.sqrt(precision))[:, None]
        known = np.zeros((len(shares), 5, 5))
        known[:, :4, :4] = np.einsum("mi,mj,ab->miajb", shares, shares, np.eye(2)).reshape(-1, 4, 4)
        return np.concatenate([of_turn, of_shift], axis=1), known

    def offset_sd(self, precision: float) -> Array:
        """Give the standard deviation (M,) of the offset per axis, m, once the frames are known."""
        return np.sqrt(self.unit * self._inverse(precision)[:, 1, 1])


def _prior(calibration: Calibration) -> tuple[Array, float]:
    """Nominal offset (3,), and the precision of each component, 1/m²; no offset is known to less than a micron."""
    return np.asarray(calibration.offset_m, float), 1 / max(calibration.offset_sd_m, 1e-6) ** 2


def _of_height(sums: _Sums, other: _Sums, away: Array, precision: float) -> Array:
    """Covariance (M, 5, 5), as above, of the offset's height, of which ``other`` has a standard deviation more."""
    turn, shift = other.step(away, precision)
    moved = other.swing[:, :2] + turn[..., None] + shift[..., None] * sums.lever[:, None]
    grown = sums.frames.mean(np.sum(moved**2, axis=1) - sums.size**2)
    change = np.concatenate([-turn, -shift, grown[:, None]], axis=-1)
    return np.asarray(change[:, :, None] * change[:, None, :])


def swings(frames: Frames, down: Array, offset: Array) -> Array:
    """Find the unit directions OA, (M, 3, n), jib frame: where each ray meets the sphere of radius l about O."""
    k = _lever(frames)
    result = np.asarray(lean(*tilt_of(down)) @ frames.rays)
    ahead = (offset[:, None] @ result)[:, 0]
    ahead *= k
    # From the camera to A over l: the root of |offset + λ·ray| = l, λ ahead.
    way = k * k
    way *= -np.sum(offset**2, axis=-1)[:, None]
    way += 1
    way += ahead * ahead
    np.sqrt(way, out=way)
    way -= ahead
    result *= way[:, None]
    for axis in range(3):
        result[:, axis] += offset[:, axis, None] * k
    return result


def _lever(frames: Frames) -> Array:
    assert frames.rope_length is not None
    return 1 / frames.rope_length


def _turned(down: Array, turn: Array) -> Array:
    """Gravity in the mount frame once the rays are turned by ``turn`` (M, 2) in the jib frame."""
    straight = np.concatenate([-turn, -np.ones_like(turn[:, :1])], axis=-1)
    turned = np.einsum("mji,mj->mi", lean(*tilt_of(down)), straight)
    return np.asarray(turned / np.linalg.norm(turned, axis=-1, keepdims=True))


def _along(azimuth: Array) -> Array:
    """From jib x and y to along and across the tilt, as gravity moves in the mount frame; shape (M, 2, 2)."""
    c, s = np.cos(azimuth), np.sin(azimuth)
    return np.stack([-c, -s, s, -c], axis=-1).reshape(-1, 2, 2)


def _typical(frames: Frames, size: Array) -> Array:
    """Size of the swings per axis, from their median, which under Rayleigh's law is √(2 ln 2) of it."""
    seen = size if frames.present is None else np.where(frames.present, size, np.nan)
    middle = np.median(seen, axis=-1) if frames.present is None else np.nanmedian(seen, axis=-1)
    return np.asarray(np.maximum(middle, 1e-12) / np.sqrt(2 * np.log(2)))
