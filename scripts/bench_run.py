"""Time the instrument on a video, looped: frames a second, latency, memory; see `scripts.bench`."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from scripts.bench_measure import milliseconds, peak_mb, resident_mb, single
from scripts.bench_results import Quantity
from simgrab.instrument.contract import Frame
from simgrab.instrument.pipeline import Pipeline, assemble
from simgrab.instrument.source import camera_beside, fitting, open_source
from simgrab.model import calibration as camera_file
from simgrab.model.calibration import Calibration

SETTLED = 2000  # frames after which memory is compared


class Loop:
    """A source over and over, its time going on, and how long each frame took to decode."""

    def __init__(self, path: Path, camera: Calibration, frames: int) -> None:
        self._source, self._camera, self._frames = open_source(path), camera, frames
        self.decoding: list[float] = []
        self.memory: list[float] = []

    def __iter__(self) -> Iterator[Frame]:
        """Give so many frames."""
        last, step = 0.0, 1 / 9
        while True:
            shift = last + step
            began = time.perf_counter()
            for frame in fitting(iter(self._source), self._camera):
                assert frame.time_s is not None
                last = shift + frame.time_s
                self.decoding.append(time.perf_counter() - began)
                if len(self.decoding) in (SETTLED, self._frames):
                    self.memory.append(resident_mb())
                yield Frame(frame.picture, last, frame.reason)
                if len(self.decoding) >= self._frames:
                    return
                began = time.perf_counter()


def run(video: Path, detector: str, frames: int, live_frames: int) -> Iterator[Quantity]:
    """Measure speed and memory of a whole record, and the latency of a live one."""
    camera = camera_file.load(camera_beside(video))
    pipeline = assemble(detector=detector)
    first = next(iter(open_source(video))).picture
    assert first is not None
    pipeline.detector(first)  # the first detection warms up
    loop, began, cpu = Loop(video, camera, frames), time.perf_counter(), time.process_time()
    record = pipeline.record(loop, camera)
    seconds, cpu = time.perf_counter() - began, time.process_time() - cpu
    yield single("whole record: frames with an angle", sum(m.status == "ok" for m in record.measurements), "frames")
    yield single("whole record: speed", frames / seconds, "frames/s")
    yield single("whole record: CPU time of a frame", 1e3 * cpu / frames, "ms")
    for at, memory in zip(sorted({min(SETTLED, frames), frames}), loop.memory, strict=True):
        yield single(f"memory after {at} frames", memory, "MB")
    yield single("peak memory", peak_mb(), "MB")
    yield from _live(pipeline, Loop(video, camera, live_frames), camera)


def _live(pipeline: Pipeline, loop: Loop, camera: Calibration) -> Iterator[Quantity]:
    seconds = [one.seconds for one in pipeline.live(loop, camera)]
    decoding = loop.decoding[: len(seconds)]
    yield milliseconds("live: latency, decoding included", np.array(seconds) + decoding)
    yield milliseconds("live: decoding", decoding)
