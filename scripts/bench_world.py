"""Time night, weather, optics and display; see `scripts.bench`."""

from __future__ import annotations

import time
from collections.abc import Iterator

from scripts.bench_measure import milliseconds
from scripts.bench_results import Quantity
from simgrab.model import scenes
from simgrab.world.frames import FrameGenerator

WARM_UP = 2


def world(repeats: int = 7) -> Iterator[Quantity]:
    """Measure what night, weather, optics and display cost a 1080p frame, once it is rendered."""
    for name in ("calm-day", "windy-day", "night-light-snow", "heavy-snow", "rain", "fog", "dust", "glare"):
        with FrameGenerator(scenes.load(name)) as generator:
            seconds = []
            for frame in range(repeats + WARM_UP):
                scene = generator.scene(frame)
                buffers = scene.draw(generator.project(frame), labelled=False)
                began = time.perf_counter()
                scene.develop(buffers)
                seconds.append(time.perf_counter() - began)
        yield milliseconds(f"{name}: developing a frame", seconds[WARM_UP:])
