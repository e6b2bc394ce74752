"""The simulation study of Yu, Wang & Wang (2025), section 4.4, and what an honest version of it shows."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from simgrab.instrument.estimate import Estimator, GeometricMedian, MeanRay, PaperIteration
from simgrab.lab.paper.law import AXIS_DIRECTION, camera, draw
from simgrab.lab.stress.summary import MonteCarloFigure, figure
from simgrab.model.geometry import Array
from simgrab.model.records.estimates import Estimates

# Where the iteration would end if it went on. arccos resolves β to 2⁻⁵³/sin β, 1e-15 rad at 5°: an ε of that size is
# reached or never, by how the last bit is rounded. What is left after a step of 1e-12 is less than 1e-12 rad.
LIMIT = PaperIteration(axis="known", axis_direction=AXIS_DIRECTION, epsilon=1e-12)


@dataclass(frozen=True)
class PaperSettings:
    """Section 4.4's own, in radians and pixels; the text gives no grid of n."""

    h: float = 1600.0
    beta: float = float(np.deg2rad(5.0))
    sigma: float = float(np.deg2rad(2.0))
    replications: int = 1000  # M
    frames: tuple[int, ...] = (50, 100, 200, 500, 1000, 2000, 5000)  # n
    convergence_frames: int = 1000  # n of the studies of convergence, start values and time
    starts_deg: tuple[float, ...] = (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9.5, 10, 10.5, 11, 12)  # values of β⁽⁰⁾
    seed: int = 0


@dataclass(frozen=True)
class Spread:
    """Errors of one estimator at one n, shape (k,) each, of the k records that were not refused."""

    beta_error: Array  # β̂ − β, radians
    sigma2_error: Array  # σ̂²/σ² − 1
    azimuth_error: Array  # of the 0-degree line, radians
    refused: int
    cover_beta: float  # share of the i.i.d. 95 % intervals that hold the truth
    cover_sigma: float

    @property
    def beta(self) -> MonteCarloFigure:
        """Figures of the error of β̂, radians."""
        return figure(self.beta_error)

    @property
    def sigma2(self) -> MonteCarloFigure:
        """Figures of the relative error of σ̂²."""
        return figure(self.sigma2_error)

    @property
    def beta_deg(self) -> str:
        """Root mean square error of β̂ with its Monte Carlo standard error, degrees, as text."""
        return f"{np.rad2deg(self.beta.rms):.4f} ± {np.rad2deg(self.beta.rms_se):.4f}"


@dataclass(frozen=True)
class StartOutcome:
    """What came of one start value: refusals, their reason, and the largest distance from the end of start 0."""

    start_deg: float
    refused: int
    reason: str
    apart: float


@dataclass(frozen=True)
class PaperStudy:
    """Everything the study measured."""

    settings: PaperSettings
    # By n: the iteration with the axis known, with it estimated, and two rivals that need no axis.
    known: dict[int, Spread]
    estimated: dict[int, Spread]
    mean_ray: dict[int, Spread]
    median: dict[int, Spread]
    slope_beta: float  # of log RMSE against log n, axis known
    slope_sigma2: float
    # |β⁽ᵗ⁾ − β̂| and |σ²⁽ᵗ⁾/σ̂² − 1| from the limit β̂, σ̂², shape (M, T + 1); NaN beyond the last.
    beta_steps: Array
    sigma2_steps: Array
    iterations: dict[int, int]  # how many records took so many
    last_beta_step: float  # medians of the last steps, the second relative
    last_sigma2_step: float
    starts: tuple[StartOutcome, ...]
    single_s: float  # seconds a replication of 3,699 frames takes, by itself and in a batch
    batch_s: float
    mean_cos: float  # both sides of eq (3)
    expected_cos: float


def study(settings: PaperSettings, report: Callable[[str], None]) -> PaperStudy:
    """Run section 4.4; ``report`` is called with what is being done."""
    rivals: dict[str, Estimator] = {
        "known": PaperIteration(axis="known", axis_direction=AXIS_DIRECTION),
        "estimated": PaperIteration(),
        "mean_ray": MeanRay(),
        "median": GeometricMedian(),
    }
    spreads: dict[str, dict[int, Spread]] = {name: {} for name in rivals}
    for n in settings.frames:
        report(f"errors at n = {n}")
        pixels, _ = _draw(settings, "errors", n)
        for name, estimator in rivals.items():
            spreads[name][n] = _spread(estimator.batch(pixels, camera(settings.h)), settings)
    report("convergence and start values")
    pixels, alpha = _draw(settings, "convergence", settings.convergence_frames)
    run = rivals["known"].batch(pixels, camera(settings.h))
    beta_steps, sigma2_steps = _steps(run, LIMIT.batch(pixels, camera(settings.h)))
    rows, last = np.flatnonzero(run.ok), np.asarray(run.diagnostics["iterations"][run.ok], int)
    betas, sigma2s = run.diagnostics["beta_history"], run.diagnostics["sigma2_history"]
    report("time")
    single, batch = _times(settings)
    cos_psi = settings.h / np.hypot(settings.h, camera(settings.h).intrinsics.polar(pixels)[0])
    return PaperStudy(
        settings=settings,
        **spreads,
        slope_beta=_slope({n: s.beta.rms for n, s in spreads["known"].items()}),
        slope_sigma2=_slope({n: s.sigma2.rms for n, s in spreads["known"].items()}),
        beta_steps=beta_steps,
        sigma2_steps=sigma2_steps,
        iterations=dict(sorted(Counter(last.tolist()).items())),
        last_beta_step=float(np.median(np.abs(betas[rows, last] - betas[rows, last - 1]))),
        last_sigma2_step=float(np.median(np.abs(sigma2s[rows, last] / sigma2s[rows, last - 1] - 1))),
        starts=tuple(_start(settings, pixels, run, s) for s in settings.starts_deg),
        single_s=single,
        batch_s=batch,
        mean_cos=float(cos_psi.mean()),
        expected_cos=float(np.cos(settings.beta) * np.exp(-np.mean(alpha**2) / 2)),
    )


def _draw(settings: PaperSettings, name: str, frames: int) -> tuple[Array, Array]:
    return draw(
        settings.seed, name, settings.replications, frames, beta=settings.beta, sigma=settings.sigma, h=settings.h
    )


def _spread(found: Estimates, settings: PaperSettings) -> Spread:
    ok = found.ok
    interval = found.interval("iid")
    # The tilt azimuth of C'G' along the picture's x axis is −π/2 of the half turn less; see `vertical_direction`.
    direction = np.pi / 2 - found.tilt_azimuth[ok] - AXIS_DIRECTION

    def cover(ends: Array | None, truth: float) -> float:
        assert ends is not None
        return float(np.mean((ends[ok, 0] <= truth) & (truth <= ends[ok, 1])))

    return Spread(
        beta_error=found.beta[ok] - settings.beta,
        sigma2_error=found.sigma[ok] ** 2 / settings.sigma**2 - 1,
        azimuth_error=np.asarray((direction + np.pi) % (2 * np.pi) - np.pi),
        refused=int(np.sum(~ok)),
        cover_beta=cover(interval.beta, settings.beta),
        cover_sigma=cover(interval.sigma, settings.sigma),
    )


def _slope(rmse: dict[int, float]) -> float:
    return float(np.polyfit(np.log(list(rmse)), np.log(list(rmse.values())), 1)[0])


def _steps(found: Estimates, limit: Estimates) -> tuple[Array, Array]:
    """How far each iterate is from where the iteration would end if it went on."""
    beta, sigma2 = found.diagnostics["beta_history"], found.diagnostics["sigma2_history"]
    width = int(np.isfinite(beta).any(axis=0).sum())
    return (np.abs(beta[:, :width] - limit.beta[:, None]), np.abs(sigma2[:, :width] / limit.sigma[:, None] ** 2 - 1))


def _start(settings: PaperSettings, pixels: Array, reference: Estimates, start_deg: float) -> StartOutcome:
    estimator = PaperIteration(axis="known", axis_direction=AXIS_DIRECTION, start=float(np.deg2rad(start_deg)))
    found = estimator.batch(pixels, camera(settings.h))
    both = found.ok & reference.ok
    apart = float(np.abs(found.beta[both] - reference.beta[both]).max()) if both.any() else float("nan")
    reason = str(found.reason[~found.ok][0]) if not found.ok.all() else ""
    return StartOutcome(start_deg, int(np.sum(~found.ok)), reason, apart)


def _times(settings: PaperSettings) -> tuple[float, float]:
    """Median seconds for a record of 3,699 frames by itself, and its share of a batch."""
    many = min(settings.replications, 100)
    pixels, _ = draw(settings.seed, "time", many, 3699, beta=settings.beta, sigma=settings.sigma, h=settings.h)
    estimator = PaperIteration()
    alone = []
    for record in pixels[:30]:
        began = time.perf_counter()
        estimator.estimate(record, camera(settings.h))
        alone.append(time.perf_counter() - began)
    began = time.perf_counter()
    estimator.batch(pixels, camera(settings.h))
    return float(np.median(alone)), (time.perf_counter() - began) / many
