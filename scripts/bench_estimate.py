"""Time the estimators: per replication in a batch, and over n; see `scripts.bench`."""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Iterator

import numpy as np

from scripts.bench_measure import milliseconds, single
from scripts.bench_results import Quantity
from simgrab.instrument.estimate import ESTIMATORS, Estimator
from simgrab.lab.paper.law import camera, draw

FRAMES = 3699  # the paper's video


def estimate() -> Iterator[Quantity]:
    """Measure milliseconds per replication at n = 3,699 (the paper: 28 ms), and the cost up to 10⁶ frames.

    Intervals are included, and both kinds of tilt. A sample is a batch of replications divided by their number.
    """
    for name, kind in ESTIMATORS.items():
        many = 1 if kind.needs_time else 100
        yield milliseconds(f"{name}: n = {FRAMES}", _batch(kind(), many, 1 if kind.needs_time else 5))
    for name, kind in ESTIMATORS.items():
        for n in (1_000, 10_000) if kind.needs_time else (10_000, 100_000, 1_000_000):
            seconds, peak = _one(kind(), n)
            yield single(f"{name}: one record of {n}", seconds, "s")
            yield single(f"{name}: memory for {n}", peak / 1e6, "MB")


def _record(records: int, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels (M, n, 2), rope (n,) and time (n,): a tenth of a degree of slow swing, or the paper's distribution."""
    time_s = np.arange(n) / 9.0
    rope = 20 + 4 * np.cos(2 * np.pi * time_s / 75)
    pixels, _ = draw(0, "bench", records, n, beta=np.deg2rad(5), sigma=np.deg2rad(2), h=1644.82)
    return pixels, rope, time_s


def _pendulum(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Swing at the pendulum's own frequency, for the smoother: (1, n, 2), (n,), (n,)."""
    rng = np.random.default_rng(0)
    time_s = np.arange(n) / 9.0
    phase = np.sqrt(9.81 / 20) * time_s
    swing = 1644.82 * np.deg2rad(2) * np.stack([np.cos(phase), 0.5 * np.sin(phase)], axis=-1)
    pixels = swing + (1000.0, 580.0) + rng.normal(size=(n, 2))
    return pixels[None], np.full(n, 20.0), time_s


def _batch(estimator: Estimator, many: int, repeats: int) -> list[float]:
    """Seconds per replication, batch by batch."""
    pixels, rope, time_s = _pendulum(FRAMES) if estimator.needs_time else _record(many, FRAMES)
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        estimator.batch(pixels, camera(1644.82), rope_length=rope, time=5 * time_s if many > 1 else time_s)
        times.append((time.perf_counter() - began) / many)
    return times


def _one(estimator: Estimator, n: int) -> tuple[float, int]:
    pixels, rope, time_s = _pendulum(n) if estimator.needs_time else _record(1, n)
    began = time.perf_counter()
    estimator.batch(pixels, camera(1644.82), rope_length=rope, time=time_s)
    seconds = time.perf_counter() - began
    tracemalloc.start()
    estimator.batch(pixels, camera(1644.82), rope_length=rope, time=time_s)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return seconds, peak
