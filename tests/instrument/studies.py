"""Monte Carlo studies of the estimators, which the tests run at a part of the recorded size."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from simgrab.instrument.estimate import (
    ESTIMATORS,
    Estimator,
    GeometricMedian,
    MeanRay,
    PaperIteration,
    PendulumSmoother,
    RopeAware,
)
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import camera_rotation, grab_centre, to_camera
from simgrab.model.records.estimates import Estimates, Intervals
from simgrab.model.rng import stream
from tests.instrument import pendulum_simulator as pendulum

H = 1644.82
AZIMUTH = 0.7
SIGMA_DEG = 2.0
LAWS = ("half-normal", "rayleigh", "exponential")


def camera(offset: tuple[float, float, float] = (0.0, 0.0, 0.0), sd: float = 0.5) -> Calibration:
    return Calibration(
        width_px=1920, height_px=1080, focal_length_px=H, cx_px=960.0, cy_px=540.0, offset_m=offset, offset_sd_m=sd
    )


@dataclass(frozen=True)
class Draws:
    pixels: np.ndarray  # (M, n, 2)
    alpha: np.ndarray  # (M, n)
    rope: np.ndarray  # (M, n)


def draw(
    law: str, records: int, frames: int, *, beta_deg: float = 5.0, rope: tuple[float, float] = (20.0, 20.0),
    offset: np.ndarray | None = None,
) -> Draws:  # fmt: skip
    """Independent frames whose α has the given law and a root mean square of `SIGMA_DEG`; offset (3,) or (M, 3)."""
    shape = (records, frames)
    rng = stream(0, frames, f"study.{law}")
    unit = {
        "half-normal": lambda: np.abs(rng.normal(size=shape)),
        "rayleigh": lambda: rng.rayleigh(size=shape) / np.sqrt(2),
        "exponential": lambda: rng.exponential(size=shape) / np.sqrt(2),
    }[law]()
    alpha = unit * np.deg2rad(SIGMA_DEG)
    lengths = rng.uniform(*rope, shape)
    grab = grab_centre(alpha, rng.uniform(0, 2 * np.pi, shape), lengths)
    place = np.zeros(3) if offset is None else np.asarray(offset)
    rotation = camera_rotation(np.deg2rad(beta_deg), AZIMUTH, 0.0)
    pixels = camera().intrinsics.project(to_camera(grab, rotation, place if place.ndim == 1 else place[:, None]))
    return Draws(pixels, alpha, lengths)


@dataclass(frozen=True)
class Score:
    """Of one estimator: RMSE of β̂ and α̂, degrees, over the records not refused."""

    rmse: float
    alpha: float
    refused: float
    squares: np.ndarray  # (M,), deg²; NaN where refused

    @staticmethod
    def of(found: Estimates, beta_deg: float, alpha: np.ndarray) -> Score:
        squares = (np.rad2deg(found.beta) - beta_deg) ** 2
        good = squares[found.ok]
        if not good.size:
            return Score(np.nan, np.nan, 1.0, squares)
        swing = np.rad2deg(found.alpha[found.ok] - alpha[found.ok])
        alpha_rmse = float(np.sqrt(np.nanmean(swing**2)))
        return Score(float(np.sqrt(good.mean())), alpha_rmse, float(np.mean(~found.ok)), squares)


@cache
def rivals(law: str, records: int, frames: int, beta_deg: float) -> dict[str, Score]:
    """Every memoryless estimator on the same draws."""
    d = draw(law, records, frames, beta_deg=beta_deg)
    known = np.pi / 2 - AZIMUTH
    estimators: dict[str, Estimator] = {
        "paper, axis known": PaperIteration(axis="known", axis_direction=known),
        "paper": PaperIteration(),
        "paper, from mean ray": PaperIteration(start="mean-ray"),
        **{name: ESTIMATORS[name]() for name in ("mean-ray", "geometric-median", "zero-tilt")},
    }
    return {name: Score.of(e.batch(d.pixels, camera()), beta_deg, d.alpha) for name, e in estimators.items()}


def beats(one: Score, other: Score) -> float:
    """By how many standard errors the first has the smaller mean square error, on the records that both solved."""
    gain = other.squares - one.squares
    gain = gain[np.isfinite(gain)]
    return float(gain.mean() / max(gain.std() / np.sqrt(gain.size), 1e-300)) if gain.size > 1 else np.nan


@cache
def offsets(law: str, offset_m: float, records: int) -> dict[str, Score]:
    """Camera behind the rope exit, as seen along the tilt; ropes of 8 to 35 m, an offset prior of 0 ± 0.5 m."""
    place = offset_m * np.array([-np.cos(AZIMUTH), -np.sin(AZIMUTH), 0.0])
    d = draw(law, records, 3699, rope=(8.0, 35.0), offset=place)
    return {
        e.name: Score.of(e.batch(d.pixels, camera(), rope_length=d.rope), 5.0, d.alpha)
        for e in (PaperIteration(), MeanRay(), GeometricMedian(), RopeAware())
    }


def drawn_offsets(
    law: str, rope: tuple[float, float], records: int, frames: int = 3699
) -> tuple[Score, Score, tuple[float, float, float]]:
    """Score mean ray and rope-aware on offsets drawn from the prior, and the latter's coverage of β, σ and α."""
    offset = stream(1, frames, "study.offset").normal(size=(records, 3)) * 0.5
    d = draw(law, records, frames, rope=rope, offset=offset)
    mean = MeanRay().batch(d.pixels, camera())
    found = RopeAware().batch(d.pixels, camera(), rope_length=d.rope)
    return Score.of(mean, 5.0, d.alpha), Score.of(found, 5.0, d.alpha), coverage(found.interval("iid"), d.alpha)


def coverage(interval: Intervals, alpha: np.ndarray, beta_deg: float = 5.0) -> tuple[float, float, float]:
    """Share of the intervals of β, σ and α that hold the truth."""

    def share(ends: np.ndarray | None, truth: np.ndarray | float) -> float:
        if ends is None:
            return float("nan")
        return float(np.mean((ends[..., 0] <= truth) & (truth <= ends[..., 1])))

    return (
        share(interval.beta, np.deg2rad(beta_deg)),
        share(interval.sigma, np.deg2rad(SIGMA_DEG)),
        share(interval.alpha, alpha),
    )


@cache
def independent(law: str, records: int, frames: int) -> dict[str, tuple[float, float, float]]:
    """Coverage of the i.i.d. intervals on independent frames."""
    d = draw(law, records, frames)
    return {
        e.name: coverage(e.batch(d.pixels, camera()).interval("iid"), d.alpha)
        for e in (PaperIteration(), MeanRay(), GeometricMedian())
    }


def long_records(records: int, minutes: float, damping: float) -> dict[str, dict[str, tuple[float, float, float]]]:
    """Coverage of both kinds of intervals on forced pendulum records, 20 m rope, 4.5 frames a second, σ = 2°."""
    rng = stream(0, int(minutes), "study.long")
    rope = pendulum.Cycles(20.0, 20.0, 60.0)
    record = pendulum.forced(rng, records, minutes * 60, rope, np.deg2rad(2.0), damping, fps=4.5, substeps=3)
    rotation = camera_rotation(np.deg2rad(5.0), AZIMUTH, 0.0)
    place = np.zeros((records, 3))
    pixels = pendulum.seen(rng, record, camera().intrinsics.project, rotation=rotation, offset=place)
    result = {}
    for e in (PaperIteration(), MeanRay(), GeometricMedian()):
        found = e.batch(pixels, camera(), time=record.time, pixel_sd=np.ones(len(record.time)))
        result[e.name] = {i.kind: coverage(i, record.alpha) for i in found.intervals}
    return result


@dataclass(frozen=True)
class Smoothed:
    """The smoother beside the memoryless: RMSE of β̂ (deg), coverage of β and α."""

    others: dict[str, float]
    rmse: float
    beta_cover: float
    alpha_cover: float
    refused: float


def swinging(kind: str, records: int, duration_s: float, *, damping: float = 0.01, size_deg: float = 2.0) -> Smoothed:
    """Pendulum records with a camera 0.6 m beside the rope, known to ± 5 cm; free ones hoist from 24 to 16 m."""
    rng = stream(0, int(duration_s), f"study.{kind}.0.0")
    size, nominal = np.deg2rad(size_deg), np.array([0.6 * np.cos(1.0), 0.6 * np.sin(1.0), 0.0])
    if kind == "free":
        record = pendulum.free(rng, records, duration_s, pendulum.Hoist(24.0, 16.0, 1.0, 13.0), size, damping)
    else:
        rope = pendulum.Cycles(16.0, 24.0, 75.0)
        record = pendulum.forced(rng, records, duration_s, rope, size, damping)
    cal = camera((float(nominal[0]), float(nominal[1]), 0.0), 0.05)
    pixels = pendulum.seen(
        rng, record, cal.intrinsics.project, rotation=camera_rotation(np.deg2rad(5.0), AZIMUTH, 0.0),
        offset=nominal + rng.normal(size=(records, 3)) * 0.05, missing=0.1, outliers=0.02,
    )  # fmt: skip
    others = {
        e.name: Score.of(e.batch(pixels, cal, rope_length=record.rope), 5.0, record.alpha).rmse
        for e in (PaperIteration(start="mean-ray"), MeanRay(), GeometricMedian(), RopeAware())
    }
    found = PendulumSmoother().batch(pixels, cal, rope_length=record.rope, time=record.time)
    score = Score.of(found, 5.0, record.alpha)
    beta_cover, _, alpha_cover = coverage(found.interval("posterior"), record.alpha)
    return Smoothed(others, score.rmse, beta_cover, alpha_cover, score.refused)
