"""Time the physics of a clip, and watch its memory; see `scripts.bench`."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator

from scripts.bench_measure import resident_mb, single
from scripts.bench_results import Quantity
from simgrab.model import scenes
from simgrab.world.trajectory.clip import ClipMotion


def motion() -> Iterator[Quantity]:
    """Measure how much faster than real time the physics runs, and how memory grows with a clip's length."""
    for name in ("free-swing", "work-cycles", "wind-only", "isotropic-forcing"):
        scenario = scenes.load(name, {"frames": 10_000_000})
        moments = iter(ClipMotion(scenario, 0))
        for _ in itertools.islice(moments, 2000):  # the first blocks warm up
            pass
        began, clock, count = time.process_time(), next(moments).time, 2700
        last = next(itertools.islice(moments, count, None)).time
        assert clock is not None
        assert last is not None
        speed = (last - clock) / (time.process_time() - began)
        yield single(f"{name}: speed of the physics, one core", speed, "× real time")
    moments = iter(ClipMotion(scenes.load("work-cycles", {"frames": 10_000_000, "swing.wind.mean_m_s": 5.0}), 0))
    for hours in (0.25, 1.0, 4.0):
        for moment in moments:
            if moment.time is not None and moment.time >= 3600 * hours:
                break
        yield single(f"memory after {hours:g} h of a clip", resident_mb(), "MB")
