"""Find estimators: the package's own by name, anybody's as ``package.module:Class``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, cast, runtime_checkable

import numpy as np

from simgrab.errors import StressError
from simgrab.instrument.estimate import ESTIMATORS, Estimator
from simgrab.lab.stress.records import Records
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array
from simgrab.model.records.estimates import Estimate, Estimates, Intervals
from simgrab.runtime import modules

KINDS, LEVEL = ("iid", "blocks", "posterior"), 0.95
"""Of the intervals whose coverage is counted."""


@runtime_checkable
class Estimating(Protocol):
    """What the laboratory asks of an estimator, which can be made without arguments; see `Estimator.estimate`."""

    def estimate(
        self, pixels: Array, calibration: Calibration, *, rope_length: Array | None = None, time: Array | None = None
    ) -> Estimate:
        r"""Estimate from one record, whose arrays are read-only.

        Parameters
        ----------
        pixels : ndarray, shape (n, 2)
            Grab centre in the distorted picture, px: u to the right and v down from the outer corner of the top-left
            pixel. NaN where the frame is missing.
        calibration : Calibration
            ``calibration.intrinsics.rays(pixels)`` are the unit rays, shape (n, 3), in the camera frame: x right, y
            down, z forward. With roll 0 the top of the picture is outboard, and gravity is
            ``(sinβ sin az, sinβ cos az, cosβ)``, where az is the tilt azimuth.
        rope_length : ndarray, shape (n,)
            \|OA\|, m.
        time : ndarray, shape (n,), or None
            Seconds; None in rendered studies of independent frames.
        """


def find(name: str) -> Estimating:
    """Make an estimator of `ESTIMATORS`, or ``package.module:Class``; raises `StressError` naming what there is."""
    if name in ESTIMATORS:
        return ESTIMATORS[name]()
    module, colon, attribute = name.partition(":")
    if not colon:
        raise StressError(
            f"estimators: unknown estimator {name!r}; one of: {', '.join(ESTIMATORS)}, or package.module:Class"
        )
    try:
        kind = modules.find(module, attribute)
        made = kind() if isinstance(kind, type) and hasattr(kind, "estimate") else None  # no function is called
    except (ImportError, AttributeError, TypeError, ValueError) as problem:
        raise StressError(f"estimators: cannot make {name!r}: {problem}") from problem
    return checked(name, made)


def sources(names: Sequence[str]) -> dict[str, str | None]:
    """SHA-256 of the source file of each estimator that is not of the package, by name; None where it is not known."""
    return {name: modules.source_sha256(type(find(name))) for name in names if name not in ESTIMATORS}


def checked(name: str, made: object) -> Estimating:
    """Give an estimator back; raises `StressError` if it is none."""
    if isinstance(made, type):
        raise StressError(f"estimators: {name!r} is a class; give an object, such as {made.__name__}()")
    if not isinstance(made, Estimating):
        raise StressError(f"estimators: {name!r} has no method estimate(pixels, calibration, *, rope_length, time)")
    return made


def run(name: str, records: Records, own: Mapping[str, Estimating] | None = None) -> Estimates:
    """Estimate from every record, in a batch where the estimator has one; ``own`` are estimators besides `find`'s."""
    estimator = own[name] if own and name in own else find(name)
    pixels, ropes = (_unchangeable(values) for values in _known(estimator, records))
    time = None if records.time is None else _unchangeable(records.time)
    options: dict[str, Any] = {"rope_length": ropes, "time": time}
    if isinstance(estimator, Estimator):
        options["pixel_sd"] = records.pixel_sd
    try:
        if hasattr(estimator, "batch"):
            return cast(Estimates, estimator.batch(pixels, records.calibration, **options))
        each = [
            estimator.estimate(uv, records.calibration, rope_length=rope, time=time)
            for uv, rope in zip(pixels, ropes, strict=True)
        ]
    except Exception as problem:
        raise StressError(f"{name} failed with {type(problem).__name__}: {problem}") from problem
    for one in each if name not in ESTIMATORS else ():
        if wrong := flaw(one, records.alpha.shape[1]):
            raise StressError(f"{name}: {wrong}")
    return stacked(name, each, records.alpha.shape[1])


def _unchangeable(values: Array) -> Array:
    """View values that are the next estimator's too, and may not be written to."""
    view = values.view()
    view.flags.writeable = False
    return view


def flaw(estimate: Any, frames: int) -> str:
    """Describe what is wrong with what an estimator returned for a record of so many frames; empty where nothing is."""
    if not isinstance(estimate, Estimate):
        return f"estimate must return a simgrab.Estimate, got {type(estimate).__name__}"
    if estimate.status not in ("ok", "refused"):
        return f"status must be 'ok' or 'refused', got {estimate.status!r}"
    shapes = {"alpha": (frames,), "beta": (), "sigma": (), "tilt_azimuth": (), "offset": (3,), "frames": ()}
    if wrong := _misshapen(estimate, shapes):
        return wrong
    if not estimate.ok:
        return "" if estimate.reason else "a refusal needs a reason"
    if estimate.alpha is None:
        return "alpha is None, which is of refusals alone"
    alpha = np.asarray(estimate.alpha, float)
    if np.isnan(alpha).all():
        return "alpha is NaN in every frame; estimate from the frames whose pixels are finite, or refuse the record"
    for key, value in (("beta", estimate.beta), ("sigma", estimate.sigma), ("alpha", alpha)):
        sizes = np.abs(np.asarray(value, float))
        largest = np.max(sizes, where=np.isfinite(sizes), initial=0.0)
        if largest > np.pi / 2:
            return f"{key} reaches {largest:.4g} rad, beyond the horizontal; angles are in radians"
    if (alpha < 0).any():
        return "alpha is below 0; it is the angle from gravity, whatever the direction"
    if not isinstance(estimate.intervals, tuple) or not all(isinstance(i, Intervals) for i in estimate.intervals):
        return "intervals must be a tuple of Intervals"
    return next(filter(None, (_flaw_of_ends(one, frames) for one in estimate.intervals)), "")


def _misshapen(result: Any, shapes: Mapping[str, tuple[int, ...]]) -> str:
    """Describe the first field that holds no numbers in its shape; None holds nothing."""
    for key, shape in shapes.items():
        try:
            found = np.asarray(getattr(result, key), float).shape
        except (TypeError, ValueError):
            return f"{key} must hold numbers, got {getattr(result, key)!r:.40}"
        if getattr(result, key) is not None and found != shape:
            return f"{key} must have the shape {shape}, got {found}"
    return ""


def _flaw_of_ends(intervals: Intervals, frames: int) -> str:
    """Describe what is wrong with intervals, whose coverage stands in a column for all estimators."""
    if wrong := _misshapen(intervals, {"level": (), "beta": (2,), "sigma": (2,), "alpha": (frames, 2)}):
        return f"intervals: {wrong}"
    if intervals.kind not in KINDS:
        return f"intervals are of the kind {intervals.kind!r}; one of: {', '.join(KINDS)}"
    if intervals.level != LEVEL:
        return f"intervals of {100 * intervals.level:g} %: their coverage is compared with that of {100 * LEVEL:g} %"
    for key in ("beta", "sigma", "alpha"):
        ends = np.asarray(getattr(intervals, key), float)
        if ends.ndim and (ends[..., 0] > ends[..., 1]).any():
            return f"the lower end of an interval of {key} is above the upper one"
    return ""


def _known(estimator: Estimating, records: Records) -> tuple[Array, Array]:
    """Pixels (M, n, 2) and ropes (M, n): frames without a rope are missing, but to an estimator that needs none."""
    known = np.isfinite(records.rope)
    pixels = records.pixels
    if not known.all() and getattr(estimator, "needs_rope", True):
        pixels = np.where(known[..., None], pixels, np.nan)
    return pixels, np.where(known, records.rope, 1.0)  # a length for missing frames, where it counts for nothing


def stacked(name: str, each: Sequence[Estimate], frames: int) -> Estimates:
    """Put estimates of single records together; diagnostics, which may differ in kind, are left out."""

    def column(of: Sequence[Any], field: str, *shape: int) -> Array:
        values = (getattr(one, field, None) for one in of)
        return np.array([np.full(shape, np.nan) if v is None else v for v in values], float)

    def interval(kind: Intervals) -> Intervals:
        own = [next((i for i in e.intervals if i.kind == kind.kind), None) for e in each]
        ends = column(own, "beta", 2), column(own, "sigma", 2), column(own, "alpha", frames, 2)
        return Intervals(kind.kind, kind.level, *ends, kind.blocks, kind.note)

    alpha = column(each, "alpha", frames)
    seen = np.isfinite(alpha).sum(axis=1)
    sigma = np.sqrt(np.nansum(alpha**2, axis=1) / np.where(seen, seen, np.nan))
    kinds = max((e.intervals for e in each), key=len, default=())
    offset = None if all(e.offset is None for e in each) else column(each, "offset", 3)
    return Estimates(
        name, np.array([e.ok for e in each], bool), np.array([e.reason for e in each], str),
        np.array([e.frames or n for e, n in zip(each, seen, strict=True)], np.int64),
        column(each, "beta"), column(each, "tilt_azimuth"),
        np.where([e.sigma is None for e in each], sigma, column(each, "sigma")), alpha, offset,
        tuple(interval(kind) for kind in kinds), {},
    )  # fmt: skip
