"""Time the instrument on a video, looped: frames a second, latency, memory."""

from __future__ import annotations

import resource
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from simgrab import calibration as camera_file
from simgrab.calibration import Calibration
from simgrab.instrument.contract import Frame
from simgrab.instrument.pipeline import Pipeline, assemble
from simgrab.instrument.source import camera_beside, fitting, open_source

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
                    self.memory.append(_resident_mb())
                yield Frame(frame.picture, last, frame.reason)
                if len(self.decoding) >= self._frames:
                    return
                began = time.perf_counter()


def run(video: Path, detector: str, frames: int, live_frames: int) -> None:
    """Print speed and memory of a whole record, and the latency of a live one."""
    camera = camera_file.load(camera_beside(video))
    pipeline = assemble(detector=detector)
    first = next(iter(open_source(video))).picture
    assert first is not None
    pipeline.detector(first)  # the first detection warms up
    print(f"{video.name}, {camera.width_px}x{camera.height_px} px, detector {detector}")
    loop, began, cpu = Loop(video, camera, frames), time.perf_counter(), time.process_time()
    record = pipeline.record(loop, camera)
    seconds, cpu = time.perf_counter() - began, time.process_time() - cpu
    ok = sum(m.status == "ok" for m in record.measurements)
    print(f"whole record of {frames} frames, {ok} with an angle: {frames / seconds:.1f} frames/s, "
          f"{1e3 * cpu / frames:.1f} ms of CPU a frame")  # fmt: skip
    if len(loop.memory) == 2:
        before, after = loop.memory
        print(f"memory after {SETTLED} frames {before:.0f} MB, after {frames} {after:.0f} MB: "
              f"{1e3 * (after - before) / (frames - SETTLED):.1f} kB a frame")  # fmt: skip
    print(f"peak {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1.024e-3:.0f} MB")
    _live(pipeline, Loop(video, camera, live_frames), camera)


def _live(pipeline: Pipeline, loop: Loop, camera: Calibration) -> None:
    seconds = [one.seconds for one in pipeline.live(loop, camera)]
    latency = np.array(seconds) + loop.decoding[: len(seconds)]
    median, high = 1e3 * np.quantile(latency, (0.5, 0.99))
    decoding = 1e3 * np.median(loop.decoding)
    print(f"live, {len(seconds)} frames: latency, decoding included, median {median:.0f} ms, 99 % {high:.0f} ms "
          f"(decoding: median {decoding:.0f} ms); the camera gives a frame each 111 ms")  # fmt: skip


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6
