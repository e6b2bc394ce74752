"""What estimators return."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgrab.model.geometry import Array


@dataclass(frozen=True)
class Intervals:
    """Intervals at one level, under one assumption on the frames' dependence. Radians; leading axes as in the estimate.

    Attributes
    ----------
    kind : str
        ``"iid"``: frames are independent. ``"blocks"``: only blocks of seconds are. ``"posterior"``: by a model of
        the motion.
    level : float
        Nominal coverage.
    beta, sigma : ndarray, shape (..., 2), or None
        Lower and upper end; None (NaN within a batch) if there is no interval; `note` then gives the reason.
    alpha : ndarray, shape (..., n, 2), or None
        Interval of α in each frame, given the pixel, from the uncertainty of the tilt (and of the offset).
    blocks : int or None
        How many blocks.
    note : str
        Why there is no interval, or what the interval assumes; empty otherwise.
    tilt : ndarray, shape (..., 2, 2) or (..., 4, 4), or None
        Covariance, rad², of gravity along and across the tilt and, where the offset is estimated, of minus its
        horizontal part in the same two directions, m². Later frames need it.
    """

    kind: str
    level: float
    beta: Array | None = None
    sigma: Array | None = None
    alpha: Array | None = None
    blocks: int | None = None
    note: str = ""
    tilt: Array | None = None


def _of_kind(intervals: tuple[Intervals, ...], kind: str) -> Intervals:
    for interval in intervals:
        if interval.kind == kind:
            return interval
    raise KeyError(f"no {kind!r} intervals; there are: {', '.join(i.kind for i in intervals) or 'none'}")


@dataclass(frozen=True)
class Estimate:
    """Result of an estimator for one record of n frames, or its refusal. Radians, metres, jib frame.

    An estimator of your own returns what it knows, `alpha` at least: ``Estimate(alpha=alpha)``.

    Attributes
    ----------
    estimator : str
        Its name in the registry; empty for one of your own.
    status : str
        ``"ok"`` or ``"refused"``.
    reason : str
        Reason of a refusal; empty when ok.
    frames : int
        How many frames were used; rows without a finite pixel are missing frames. 0: those with a finite `alpha`.
    beta, tilt_azimuth, sigma : float or None
        Tilt, direction of the optical axis' horizontal part in [0, 2π), √E[α²]; None when refused or not estimated. A
        study then leaves the errors of tilt and of α at a true 10° empty, and computes `sigma` from `alpha`.
    alpha : ndarray, shape (n,), or None
        Swing of each frame, NaN where the frame is missing; None when refused.
    swing : ndarray, shape (n, 2), or None
        Horizontal part of the unit directions OA, jib frame, of an estimator that follows the camera's motion.
    offset : ndarray, shape (3,), or None
        Camera centre minus rope exit, m, that the estimate takes into account: one that was estimated, or the camera
        file's. If None, a study takes it to be zero for α at a true 10°.
    intervals : tuple of Intervals
        One for each way of counting.
    diagnostics : mapping
        The estimator's diagnostics: iterations, history, concentration, …
    """

    estimator: str = ""
    status: str = "ok"
    reason: str = ""
    frames: int = 0
    beta: float | None = None
    tilt_azimuth: float | None = None
    sigma: float | None = None
    alpha: Array | None = None
    offset: Array | None = None
    intervals: tuple[Intervals, ...] = ()
    diagnostics: Mapping[str, Any] = field(default_factory=dict)
    swing: Array | None = None

    @property
    def ok(self) -> bool:
        """Whether there is a result."""
        return self.status == "ok"

    def interval(self, kind: str) -> Intervals:
        """Find the intervals of one kind; raises KeyError with the valid kinds."""
        return _of_kind(self.intervals, kind)


@dataclass(frozen=True)
class Estimates:
    """The estimates of M records of n frames each, as arrays; ``estimates[i]`` is the `Estimate` of one."""

    estimator: str
    ok: NDArray[np.bool_]  # (M,)
    reason: NDArray[np.str_]  # (M,), why a record was refused; empty where ok
    frames: NDArray[np.int64]  # (M,)
    beta: Array  # (M,), NaN where not ok; count the refusals before you average over the rest
    tilt_azimuth: Array  # (M,)
    sigma: Array  # (M,)
    alpha: Array  # (M, n)
    offset: Array | None  # (M, 3)
    intervals: tuple[Intervals, ...]
    diagnostics: Mapping[str, NDArray[Any]]  # (M, ...)
    swing: Array | None = None  # (M, n, 2)

    def __len__(self) -> int:
        return len(self.ok)

    def interval(self, kind: str) -> Intervals:
        """Find the intervals of one kind; raises KeyError with the valid kinds."""
        return _of_kind(self.intervals, kind)

    def __getitem__(self, i: int) -> Estimate:
        ok = bool(self.ok[i])

        def one(interval: Intervals) -> Intervals:
            beta, sigma, alpha, tilt = (
                None if a is None or bool(np.isnan(a[i]).all()) else a[i]
                for a in (interval.beta, interval.sigma, interval.alpha, interval.tilt)
            )
            note = interval.note
            if sigma is None and not note:
                note = "no scatter to judge by: the frames are identical"
            return Intervals(interval.kind, interval.level, beta, sigma, alpha, interval.blocks, note, tilt)

        return Estimate(
            estimator=self.estimator,
            status="ok" if ok else "refused",
            reason=str(self.reason[i]),
            frames=int(self.frames[i]),
            beta=float(self.beta[i]) if ok else None,
            tilt_azimuth=float(self.tilt_azimuth[i]) if ok else None,
            sigma=float(self.sigma[i]) if ok else None,
            alpha=self.alpha[i] if ok else None,
            offset=self.offset[i] if ok and self.offset is not None else None,
            intervals=tuple(one(interval) for interval in self.intervals) if ok else (),
            diagnostics={name: value[i] for name, value in self.diagnostics.items()},
            swing=self.swing[i] if ok and self.swing is not None else None,
        )
