"""Time the stress laboratory: many replications at one point, and its memory; see `scripts.bench`."""

from __future__ import annotations

import resource
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec

from scripts.bench_measure import peak_mb, single
from scripts.bench_results import Quantity
from simgrab.lab.stress import catalogue
from simgrab.lab.stress.laboratory import run
from simgrab.lab.stress.study import Study, Sweep

FRAMES, REPLICATIONS = 3699, 1000
MEMORYLESS = ("paper-iteration", "mean-ray", "geometric-median", "rope-aware", "zero-tilt")


def stress(workers: int = 2) -> Iterator[Quantity]:
    """Measure 200 and 1,000 replications of n = 3,699 at one point, report included, and the largest worker's memory.

    1,000 replications may take 20 s on two idle cores.
    """
    study = catalogue.load("focal")
    study = msgspec.structs.replace(
        study, axes=(Sweep("focal", (5.0,)),), holds=(), accept=(), n=FRAMES, estimators=MEMORYLESS
    )
    for replications in (REPLICATIONS // 5, REPLICATIONS):
        wall, cpu = _run(msgspec.structs.replace(study, replications=replications), workers)
        yield single(f"{replications} replications", wall, "s")
        yield single(f"{replications} replications: CPU time", cpu, "s")
        yield single(f"{replications} replications: largest worker", peak_mb(resource.RUSAGE_CHILDREN), "MB")


def _run(study: Study, workers: int) -> tuple[float, float]:
    """Seconds by the clock, and of the workers' processors."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as temporary:
        run([study], Path(temporary), workers=workers)
    wall = time.perf_counter() - began
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
