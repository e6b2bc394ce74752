"""What an estimator got wrong, one row a replication, in degrees."""

from __future__ import annotations

from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgrab.instrument.estimate.frames import gravity, mount_from_camera
from simgrab.instrument.estimate.rope_aware import swings
from simgrab.lab.stress.records import PROBE_ALPHA, Records
from simgrab.model.geometry import Array
from simgrab.model.records.estimates import Estimates

MARGIN_DEG = 1.0
"""How far beyond the alarm's limit a swing is that must be heard, and how far within one that must not."""

COLUMNS = MappingProxyType(
    {
        "beta_error_deg": "β̂ − β",
        "tilt_error_deg": "angle between the estimated and the true vertical in the camera frame",
        "sigma_error_deg": "σ̂ − σ, against √E[α²] of the distribution, or of the record where physics moves the grab",
        "alpha_error_deg": "mean of α̂ − α over the frames",
        "alpha_rms_deg": "root mean square of α̂ − α over the frames",
        "alpha_most_deg": "largest |α̂ − α| of a frame",
        "alpha10_error_deg": "mean of α̂ − 10° at a true 10°, over directions",
        "alpha10_rms_deg": "root mean square of the same",
        "alpha10_most_deg": "largest size of the same",
        "miss": "share of directions in which a swing of 11° would stay below 10°",
        "false_alarm": "share of directions in which one of 9° would exceed 10°",
        "cover_beta": "whether the 95 % interval (i.i.d. or posterior) covers β",
        "cover_sigma": "whether it covers σ",
        "cover_alpha": "share of the frames whose interval covers α",
        "blocks_cover_beta": "whether the 95 % interval by blocks covers β; empty where there is none",
        "blocks_cover_sigma": "whether it covers σ",
        "used": "share of the frames that were used",
        "iterations": "iterations; empty where not reported",
    }
)
"""Numbers of a row and what they are. NaN where refused or not to be had."""


def score(estimates: Estimates, records: Records) -> dict[str, NDArray[Any]]:
    """Judge M estimates.

    Returns
    -------
    dict of str to ndarray, shape (M,)
        `COLUMNS`, ``status`` and ``reason``.
    """
    swing = np.where(estimates.ok[:, None], np.rad2deg(estimates.alpha - records.alpha), np.nan)
    probe = np.rad2deg(probe_alpha(estimates, records) - PROBE_ALPHA)
    nothing = np.full(len(estimates), np.nan)
    own = estimates.intervals[0] if estimates.intervals else None
    blocks = next((i for i in estimates.intervals if i.kind == "blocks"), None)

    def held(ends: Array | None, truth: Array | float) -> Array:
        if ends is None:
            return nothing
        inside = ((ends[..., 0] <= truth) & (truth <= ends[..., 1])).astype(float)
        return np.where(np.isfinite(ends).all(axis=-1), inside, np.nan)

    def beyond(side: int) -> Array:
        return np.where(np.isfinite(probe), (side * probe > MARGIN_DEG).astype(float), np.nan)

    def row_mean(values: Array) -> Array:
        count = np.isfinite(values).sum(axis=-1)
        return np.where(count > 0, np.nansum(values, axis=-1) / np.maximum(count, 1), np.nan)

    def most(values: Array) -> Array:
        return np.asarray(np.fmax.reduce(np.abs(values), axis=-1))  # which leaves NaN out

    true = gravity(np.array(records.beta), np.array(records.azimuth))
    iterations = estimates.diagnostics.get("iterations", nothing)
    numbers = {
        "beta_error_deg": np.rad2deg(estimates.beta - records.beta),
        "tilt_error_deg": np.rad2deg(_between(gravity(estimates.beta, estimates.tilt_azimuth), true)),
        "sigma_error_deg": np.rad2deg(estimates.sigma - records.sigma),
        "alpha_error_deg": row_mean(swing),
        "alpha_rms_deg": np.sqrt(row_mean(swing**2)),
        "alpha_most_deg": most(swing),
        "alpha10_error_deg": row_mean(probe),
        "alpha10_rms_deg": np.sqrt(row_mean(probe**2)),
        "alpha10_most_deg": most(probe),
        "miss": row_mean(beyond(-1)),
        "false_alarm": row_mean(beyond(1)),
        "cover_beta": held(own.beta if own else None, records.beta),
        "cover_sigma": held(own.sigma if own else None, records.sigma),
        "cover_alpha": row_mean(held(own.alpha, records.alpha)) if own and own.alpha is not None else nothing,
        "blocks_cover_beta": held(blocks.beta if blocks else None, records.beta),
        "blocks_cover_sigma": held(blocks.sigma if blocks else None, records.sigma),
        "used": estimates.frames / records.alpha.shape[-1],
        "iterations": np.asarray(iterations, float),
    }
    known = {name: np.where(estimates.ok, numbers[name], np.nan) for name in COLUMNS}
    return {"status": np.where(estimates.ok, "ok", "refused"), "reason": estimates.reason, **known}


def probe_alpha(estimates: Estimates, records: Records) -> Array:
    """α̂ of the probes, shape (M, K), from the estimated tilt and, where there is one, the estimated offset."""
    rays = records.calibration.intrinsics.rays(records.probe_pixels) @ mount_from_camera(records.calibration).T
    down = gravity(estimates.beta, estimates.tilt_azimuth)
    if estimates.offset is None:
        return _between(rays, down[:, None])
    rays = np.ascontiguousarray(rays.swapaxes(1, 2))
    with np.errstate(invalid="ignore"):
        x, y = swings(rays, 1 / records.probe_rope, down, estimates.offset).swapaxes(0, 1)
        return np.asarray(np.arcsin(np.minimum(np.hypot(x, y), 1.0)))


def _between(one: Array, other: Array) -> Array:
    """Angle between unit vectors (..., 3), rad."""
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(one, other), axis=-1), np.sum(one * other, axis=-1)))
