"""Time the stress laboratory: many replications at one point, and its memory."""

from __future__ import annotations

import os
import platform
import resource
import tempfile
import time
from pathlib import Path

import msgspec

from simgrab.judge.stress import catalogue
from simgrab.judge.stress.laboratory import run
from simgrab.judge.stress.study import Study, Sweep

FRAMES, REPLICATIONS, ALLOWED_S = 3699, 1000, 20.0
MEMORYLESS = ("paper-iteration", "mean-ray", "geometric-median", "rope-aware", "zero-tilt")


def stress(workers: int = 2) -> None:
    """Print the seconds of 1,000 replications of n = 3,699 at one point, and the workers' memory for two numbers."""
    study = catalogue.load("focal")
    study = msgspec.structs.replace(
        study, axes=(Sweep("focal", (5.0,)),), holds=(), accept=(), n=FRAMES, estimators=MEMORYLESS
    )
    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, {workers} workers")
    for replications in (REPLICATIONS // 5, REPLICATIONS):
        wall, cpu = _run(msgspec.structs.replace(study, replications=replications), workers)
        peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
        allowed = f" (allowed: {ALLOWED_S:g} s on two idle cores)" if replications == REPLICATIONS else ""
        print(f"{replications} replications of n = {FRAMES}, {len(MEMORYLESS)} estimators, report included: "
              f"{wall:.1f} s, {cpu:.1f} s of CPU{allowed}; largest worker {peak:.0f} MB", flush=True)  # fmt: skip


def _run(study: Study, workers: int) -> tuple[float, float]:
    """Seconds by the clock, and of the workers' processors."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as temporary:
        run([study], Path(temporary), workers=workers)
    wall = time.perf_counter() - began
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
