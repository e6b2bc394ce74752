"""Time the estimators: per replication in a batch, and over n."""

from __future__ import annotations

import os
import platform
import time
import tracemalloc

import numpy as np

from simgrab.instrument.estimate import ESTIMATORS, Estimator
from simgrab.judge.paper.law import camera, draw

FRAMES = 3699  # the paper's video
PAPER_MS = 28.0


def estimate() -> None:
    """Print milliseconds per replication at n = 3,699 and the cost up to 10⁶ frames."""
    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, numpy {np.__version__}")
    print(f"\nn = {FRAMES}, intervals included, both kinds; best of 5 batches. The paper: {PAPER_MS:g} ms (median)")
    for name, kind in ESTIMATORS.items():
        many = 1 if kind.needs_time else 100
        best = _batch_ms(kind(), many, 1 if kind.needs_time else 5)
        print(f"  {name:18s} {best:9.3f} ms" + ("" if best <= 1 else "   more than 1 ms"), flush=True)
    print("\nOne record of n frames: seconds, nanoseconds a frame, peak memory")
    for name, kind in ESTIMATORS.items():
        for n in (1_000, 10_000) if kind.needs_time else (10_000, 100_000, 1_000_000):
            seconds, peak = _one(kind(), n)
            print(
                f"  {name:18s} {n:9,d}  {seconds:8.3f} s {1e9 * seconds / n:12.0f} ns {peak / 1e6:7.0f} MB", flush=True
            )


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


def _batch_ms(estimator: Estimator, many: int, repeats: int) -> float:
    pixels, rope, time_s = _pendulum(FRAMES) if estimator.needs_time else _record(many, FRAMES)
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        estimator.batch(pixels, camera(1644.82), rope_length=rope, time=5 * time_s if many > 1 else time_s)
        times.append(time.perf_counter() - began)
    return 1e3 * min(times) / many


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


if __name__ == "__main__":
    estimate()
