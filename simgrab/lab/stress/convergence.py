"""Where the paper's iteration goes, how fast, and what its linearisation predicts; see docs/convergence.md."""

from __future__ import annotations

import math
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgrab.instrument.estimate import PaperIteration
from simgrab.instrument.estimate.frames import groups, tangent_basis
from simgrab.lab.stress.records import Records
from simgrab.model.geometry import Array
from simgrab.model.records.estimates import Estimates

COLUMNS = MappingProxyType(
    {
        "iterations": "steps from start 0 to the end by the paper's rule",
        "beta_error_deg": "β̂ − β from start 0",
        "converges": "whether start 0 converges",
        "domain": "whether start 0 stays where (est-3) has a solution",
        "foretold": "whether the kurtosis of the ray angles is below 3, the same condition for the first step",
        "repaired": "whether the start at the mean ray converges",
        "apart_deg": "largest distance between the ends of both starts",
        "fixed_deg": "β*, the fixed point found from the mean ray",
        "fixed_error_deg": "β* − β",
        "rate": "T′(β*), contraction measured by one step from 1 % above and below β*",
        "rate_linear": "cotβ*·mean(x·α/sinα), the linearised contraction",
    }
)
"""Numbers of a row and what they are. NaN where there is none."""

_FINE = PaperIteration(start="mean-ray", epsilon=1e-12, max_iterations=200)
_STEP = 0.01  # relative
_NO_TILT = 1e-6  # rad


def trace(records: Records) -> dict[str, NDArray[Any]]:
    """Follow the iteration through M records.

    Returns
    -------
    dict of str to ndarray, shape (M,)
        `COLUMNS`, ``status`` and ``reason``, both of start 0.
    """
    first = PaperIteration().batch(records.pixels, records.calibration)
    fixed = _FINE.batch(records.pixels, records.calibration)
    kurtosis = np.asarray(first.diagnostics["kurtosis"], float)
    left = np.char.find(first.reason, "arccos") >= 0
    numbers = {
        "iterations": np.where(first.ok, first.diagnostics["iterations"], np.nan),
        "beta_error_deg": np.rad2deg(first.beta - records.beta),
        "converges": first.ok.astype(float),
        "domain": (~left).astype(float),
        "foretold": (kurtosis < 3).astype(float),
        "repaired": fixed.ok.astype(float),
        "apart_deg": np.rad2deg(np.abs(first.beta - fixed.beta)),
        "fixed_deg": np.rad2deg(fixed.beta),
        "fixed_error_deg": np.rad2deg(fixed.beta - records.beta),
        "rate": _measured(fixed, records),
        "rate_linear": linearised(fixed, records),
    }
    return {"status": np.where(first.ok, "ok", "refused"), "reason": first.reason, **numbers}


def _measured(fixed: Estimates, records: Records) -> Array:
    """(T(β* + h) − T(β* − h)) / 2h of each record, by the iteration itself."""
    rate = np.full(len(fixed), np.nan)
    for i in np.flatnonzero(fixed.ok & (fixed.beta > _NO_TILT)):
        h = _STEP * fixed.beta[i]
        ends = []
        for start in (fixed.beta[i] + h, fixed.beta[i] - h):
            once = replace(_FINE, start=float(start), max_iterations=1)
            ends.append(once.batch(records.pixels[i : i + 1], records.calibration).diagnostics["beta_history"][0, 1])
        rate[i] = (ends[0] - ends[1]) / (2 * h)
    return rate


def linearised(fixed: Estimates, records: Records) -> Array:
    """T′(β*) = cotβ*·mean(x·α/sinα), shape (M,); x is the swing along the line, away from the axis."""
    parts, done = [], 0
    for frames in groups(records.pixels, None, None, records.calibration):
        some = slice(done, done := done + len(frames.count))
        beta, azimuth = fixed.beta[some], fixed.tilt_azimuth[some]
        with np.errstate(invalid="ignore"):
            x, y, z = np.moveaxis(tangent_basis(beta, azimuth) @ frames.rays, 1, 0)
            sine = np.hypot(x, y)
            ratio = np.where(sine > 1e-12, np.arctan2(sine, z) / np.maximum(sine, 1e-12), 1.0)
            parts.append(np.where(beta > _NO_TILT, frames.mean(ratio * x) / np.tan(beta), np.nan))
    return np.concatenate(parts)


def population(beta: float, sigma: float, kurtosis: float) -> tuple[float, float]:
    """Give the fixed point (rad) and the contraction there for n → ∞, to fourth order; NaN where there is none.

    Tilt and σ are in radians, and the kurtosis is E[α⁴]/E[α²]² of the distribution.
    """
    q = (kurtosis - 3) * sigma**4 / 12
    if beta**2 < 2 * q:
        return math.nan, math.nan
    fixed = (beta + math.sqrt(beta**2 - 2 * q)) / 2
    return fixed, (beta / fixed - 1 if fixed > 0 else math.nan)


def starts_at_zero(beta: float, sigma: float, kurtosis: float) -> bool:
    """Tell whether start 0 stays in its domain for n → ∞: the kurtosis of the ray angles is below 3."""
    return (kurtosis - 3) * sigma**4 < 2 * beta**2 * (beta**2 + sigma**2)
