"""The contract of every estimator: frozen settings, a pure function of pixels, a value with its uncertainty."""

from __future__ import annotations

import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simgrab.errors import RecordError
from simgrab.instrument.controller import Controller
from simgrab.instrument.estimate import intervals as iv
from simgrab.instrument.estimate.frames import Frames, check_record, groups, tangent_basis
from simgrab.instrument.estimate.intervals import IntervalSettings
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array
from simgrab.model.records.estimates import Estimate, Estimates, Intervals

# Below this scatter (radians; a ten-thousandth of a pixel) all frames are the same frame.
NO_SCATTER = 1e-7


@dataclass(frozen=True)
class Solution:
    """An estimator's result for M records, without uncertainty. Rows with a reason hold NaN."""

    reason: Sequence[str]  # empty where the record was solved
    beta: Array  # (M,)
    azimuth: Array  # (M,)
    # (M, p, n), influence of each frame on gravity's direction along and across the tilt (p = 2) and, where it is
    # estimated, on minus the horizontal offset in the same two directions (p = 4); zero where the frame is missing
    influence: Array
    # (M, 3, n), unit direction OA along and across the tilt and down; by default the ray itself, which is right
    # without offset
    swing: Array | None = None
    lever: Array | None = None  # (M, n), rotation of OA by a unit error of the offset: 1/l, for p = 4
    # (M, p + 1, p + 1), part of the covariance of gravity, minus offset, and σ̂² that comes from a prior and not from
    # the frames
    known: Array | None = None
    radial: Array | None = None  # (M, n), variance of each α due to parameters that no frame can determine
    # from the covariance (M, p, p) and a quantile (M,), how far β's interval extends down and up, both (M,), for
    # estimates whose error a variance does not describe
    reach: Callable[[Array, Array], tuple[Array, Array]] | None = None
    offset: Array | None = None  # (M, 3)
    diagnostics: Mapping[str, NDArray[Any]] = field(default_factory=dict)  # (M, ...)


@dataclass(frozen=True)
class Estimator(ABC):
    """Base of all estimators: frozen settings, and one pure function of a record's pixels."""

    name: ClassVar[str]
    parameters: ClassVar[int] = 3  # β, its azimuth, σ: as many frames at least
    needs_rope: ClassVar[bool] = False
    needs_time: ClassVar[bool] = False

    intervals: IntervalSettings = field(default=IntervalSettings(), kw_only=True)

    @property
    def needs_imu(self) -> bool:
        """Whether it has readings of an inertial sensor, which belong to one record."""
        return False

    def in_wind(self, controller: Controller | None, time: Array | None) -> Self:
        """Return a copy with the wind that a controller reports at times (m,), unless one was stated."""
        if controller is None or controller.wind is None or time is None or self.intervals.wind_m_s:
            return self
        return replace(self, intervals=replace(self.intervals, wind_m_s=controller.wind_m_s(time)))

    @abstractmethod
    def _conclude(self, frames: Frames, calibration: Calibration) -> Estimates:
        """Estimate from M records, each with enough frames."""

    def estimate(
        self,
        pixels: ArrayLike,
        calibration: Calibration,
        *,
        rope_length: ArrayLike | None = None,
        time: ArrayLike | None = None,
        pixel_sd: ArrayLike | None = None,
    ) -> Estimate:
        r"""Estimate tilt and swing from one record.

        Parameters
        ----------
        pixels : array_like, shape (n, 2)
            Grab centre of each frame as the picture has it; NaN where it was not found.
        rope_length : array_like, shape (n,), optional
            \|OA\|, m: the display's length plus the calibration's display constant.
        time : array_like, shape (n,), optional
            Seconds. Without it there are no intervals by blocks.
        pixel_sd : array_like, shape (n,), optional
            Standard deviation of each pixel coordinate, px, as the detector states it. It widens the intervals of α.
            The smoother estimates the noise itself.

        Returns
        -------
        Estimate
            A refusal is a result too: see its ``status`` and ``reason``.

        Raises
        ------
        RecordError
            For wrong shapes, and for a rope length or time that is required but missing, or is invalid.
        """
        uv = np.asarray(pixels, float)
        if uv.ndim != 2 or uv.shape[-1] != 2:
            raise RecordError(f"pixels must have shape (n, 2), got {uv.shape}")
        return self.batch(uv[None], calibration, rope_length=rope_length, time=time, pixel_sd=pixel_sd)[0]

    def batch(
        self,
        pixels: ArrayLike,
        calibration: Calibration,
        *,
        rope_length: ArrayLike | None = None,
        time: ArrayLike | None = None,
        pixel_sd: ArrayLike | None = None,
    ) -> Estimates:
        """Estimate M records at once: pixels (M, n, 2), time (n,), the others (n,) or (M, n). See `estimate`."""
        if self.needs_rope and rope_length is None:
            raise RecordError(f"{self.name} needs the rope length of every frame")
        if self.needs_time and time is None:
            raise RecordError(f"{self.name} needs the time of every frame")
        uv, rope, t, sd = check_record(pixels, rope_length, time, self.needs_time, pixel_sd)
        parts: list[tuple[NDArray[np.int64], Estimates]] = []
        done = 0
        for frames in groups(uv, rope, t, calibration, sd):
            rows = done + np.arange(len(frames.count))
            done += len(rows)
            enough = frames.count >= self.parameters
            if enough.any():
                with np.errstate(invalid="ignore", divide="ignore"):
                    parts.append((rows[enough], self._conclude(frames.rows(enough), calibration)))
            if not enough.all() or not done:
                few = frames.rows(~enough)
                why = [f"{int(c)} frames: fewer than the {self.parameters} parameters" for c in few.count]
                parts.append((rows[~enough], self._refuse(few, why)))
        return joined(parts, len(uv))

    def _refuse(self, frames: Frames, reasons: Sequence[str]) -> Estimates:
        m = len(frames.count)
        nothing, alpha = np.full(m, np.nan), np.full((m, frames.rays.shape[-1]), np.nan)
        return Estimates(
            self.name, np.zeros(m, bool), np.array(reasons, str), frames.count.astype(np.int64),
            nothing, nothing, nothing, alpha, None, (), {},
        )  # fmt: skip


@dataclass(frozen=True)
class FrameEstimator(Estimator):
    """Base of the estimators that treat every frame alike: the estimate is a sum over frames, and so are its errors."""

    @abstractmethod
    def _solve(self, frames: Frames, calibration: Calibration) -> Solution:
        """Solve M records, each with enough frames."""

    def _conclude(self, frames: Frames, calibration: Calibration) -> Estimates:
        """Angles of every frame, σ, and the intervals of all three, from a solution."""
        solution, settings = self._solve(frames, calibration), self.intervals
        ok = np.array([not r for r in solution.reason], bool)
        beta = np.where(ok, solution.beta, np.nan)
        azimuth = np.where(ok, solution.azimuth, np.nan)
        swing = tangent_basis(beta, azimuth) @ frames.rays if solution.swing is None else solution.swing
        alpha, unit = angles_of(swing)
        alpha = np.where(frames.present, alpha, 0.0)
        sigma2 = frames.mean(alpha**2)
        influence = np.concatenate([solution.influence, _of_sigma2(frames, solution, alpha, unit, sigma2)], axis=1)
        sigma = np.sqrt(sigma2)
        # Identical frames have no scatter, whatever rounding makes of it, and so no interval.
        bare = 2 * (1 - np.linalg.norm(frames.mean(frames.rays), axis=-1)) < NO_SCATTER**2

        def made(kind: str, covariance: Array, skew: Array, degrees: Array, blocks: int | None, note: str) -> Intervals:
            q = iv.student(iv.LEVEL, degrees)
            covariance = covariance if solution.known is None else covariance + solution.known
            cov = covariance[:, :-1, :-1].copy()
            cov[:, [0, 1], [0, 1]] += settings.lean_variance
            of_beta = iv.radial(beta, cov[:, 0, 0], cov[:, 1, 1], q)
            if solution.reach is not None:
                below, above = (iv.radial(beta, (far / q) ** 2, cov[:, 1, 1], q) for far in solution.reach(cov, q))
                of_beta = np.stack([below[:, 0], above[:, 1]], axis=-1)
            of_sigma = iv.of_scale(sigma, covariance[:, -1, -1], skew, q)
            of_alpha = alpha_ends(alpha, unit, cov, q, solution.lever, frames.noise, solution.radial)
            of_alpha = np.where(frames.present[..., None], of_alpha, np.nan)
            for ends in (of_beta, of_sigma, of_alpha) if bare.any() else ():
                ends[bare] = np.nan
            return Intervals(kind, iv.LEVEL, of_beta, of_sigma, of_alpha, blocks, note, cov)

        independent, skewness = iv.independent(frames.time, frames.count, settings), iv.skewness(influence[:, -1])
        covariance = iv.iid_covariance(influence, frames.count, independent)
        apart = "" if frames.time is None or not settings.apart_s else f"of frames {settings.apart_s:g} s apart"
        kinds = [made("iid", covariance, skewness, independent - 1, None, apart)]
        if not settings.apart_s:
            kinds.append(_by_blocks(frames, influence, settings, made))
        return Estimates(
            self.name, ok, np.array(solution.reason, str), frames.count.astype(np.int64), beta, azimuth, sigma,
            np.where(frames.present, alpha, np.nan), solution.offset, tuple(kinds), solution.diagnostics,
        )  # fmt: skip


def angles_of(swing: Array) -> tuple[Array, Array]:
    """α (M, n) of directions OA along and across the tilt and down (M, 3, n), and their horizontal unit (M, 2, n)."""
    sine = np.sqrt(swing[:, 0] * swing[:, 0] + swing[:, 1] * swing[:, 1])
    return np.arctan2(sine, swing[:, 2]), swing[:, :2] * (1 / np.maximum(sine, 1e-300))[:, None]


def _of_sigma2(frames: Frames, solution: Solution, alpha: Array, unit: Array, sigma2: Array) -> Array:
    """Influence on σ̂² = mean α², which also depends on the estimated direction of gravity: shape (M, 1, n)."""
    own = (alpha**2 - sigma2[:, None]) * frames.present
    pull = alpha[:, None] * unit
    slope = [-2 * frames.mean(pull)]
    if solution.lever is not None:
        slope.append(-2 * frames.mean(pull * solution.lever[:, None]))
    return own[:, None] + np.concatenate(slope, axis=-1)[:, None] @ solution.influence


def alpha_ends(
    alpha: Array, unit: Array, cov: Array, quantile: Array, lever: Array | None, noise: Array, known: Array | None
) -> Array:
    """Interval of each α, shape (M, n, 2), from the uncertainty of gravity, the offset and the ray.

    Parameters
    ----------
    alpha : ndarray, shape (M, n)
    unit : ndarray, shape (M, 2, n)
        Direction of the swing along and across the tilt.
    cov : ndarray, shape (M, p, p)
        Covariance of gravity along and across the tilt and, for p = 4, of minus the horizontal offset.
    quantile : ndarray, shape (M,)
    lever : ndarray, shape (M, n), or None
        1/l, for p = 4.
    noise : ndarray, shape (M, n)
        Variance of the ray per axis, rad².
    known : ndarray, shape (M, n), or None
        Variance along the swing from other sources.
    """
    c, x, y = cov[..., None], unit[:, 0], unit[:, 1]
    along, across, mixed = c[:, 0, 0], c[:, 1, 1], c[:, 0, 1]
    if lever is not None:
        along = along + lever * (2 * c[:, 0, 2] + lever * c[:, 2, 2])
        across = across + lever * (2 * c[:, 1, 3] + lever * c[:, 3, 3])
        mixed = mixed + lever * (c[:, 0, 3] + c[:, 1, 2] + lever * c[:, 2, 3])
    radial = np.maximum(across + ((along - across) * x + 2 * mixed * y) * x, 0)
    rest = np.maximum(along + across - radial, 0)
    return iv.radial(alpha, radial + noise + (0.0 if known is None else known), rest + noise, quantile[:, None])


def _by_blocks(frames: Frames, influence: Array, settings: IntervalSettings, made: Any) -> Intervals:
    if frames.time is None:
        return Intervals("blocks", iv.LEVEL, None, None, None, None, "no times were given")
    block, blocks = iv.block_of(frames.time, settings)
    if blocks < iv.MIN_BLOCKS:
        return Intervals("blocks", iv.LEVEL, None, None, None, blocks, iv.too_few(blocks, settings))
    covariance = iv.block_covariance(influence, frames.count, block, blocks)
    few = np.zeros(len(covariance))  # of so few blocks nothing is known about their skewness
    result: Intervals = made("blocks", covariance, few, few + blocks - 1, blocks, "")
    return result


def joined(parts: Sequence[tuple[NDArray[np.int64], Estimates]], m: int) -> Estimates:
    """Join estimates of parts of M records; values that a part lacks are NaN."""
    model = max((part for _, part in parts), key=lambda part: len(part.intervals))
    if len(parts) == 1:
        return model

    def join(get: Callable[[Estimates], NDArray[Any] | None]) -> Any:
        given = [(rows, value) for rows, part in parts if (value := get(part)) is not None]
        if not given:
            return None
        kind = np.result_type(*(value for _, value in given))
        shape = m, *given[0][1].shape[1:]
        whole = sum(len(rows) for rows, _ in given) == m
        result = np.empty(shape, kind) if whole else np.full(shape, np.nan)
        for rows, value in given:
            result[rows] = value
        return result

    def interval(k: int) -> Intervals:
        def ends(name: str) -> Any:
            return join(lambda part: getattr(part.intervals[k], name) if part.intervals else None)

        return replace(model.intervals[k], **{name: ends(name) for name in ("beta", "sigma", "alpha", "tilt")})

    def diagnostic(name: str) -> Callable[[Estimates], NDArray[Any] | None]:
        return lambda part: part.diagnostics.get(name)

    columns = ("ok", "reason", "frames", "beta", "tilt_azimuth", "sigma", "alpha", "offset", "swing")
    return replace(
        model,
        **{name: join(operator.attrgetter(name)) for name in columns},
        intervals=tuple(interval(k) for k in range(len(model.intervals))),
        diagnostics={name: join(diagnostic(name)) for name in model.diagnostics},
    )
