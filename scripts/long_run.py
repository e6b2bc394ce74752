"""Render many small frames of many worlds in one process, and show that memory, handles and rate stay as they are.

python -m scripts.long_run [--frames 20000] [--worlds 500] [--size 480x270] [--json FILE]

The rate is that of the process's CPU time, which other programs of the machine disturb less than the clock's.
"""

from __future__ import annotations

import argparse
import gc
import json
import tempfile
import time
from pathlib import Path

import numpy as np
import psutil

from simgrab import scenes
from simgrab.world.camera.renderer import Renderer
from simgrab.world.output.dataset import render

TENTHS = 10


def main() -> None:
    """Parse, run and print a line for each tenth of the frames."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=20_000)
    parser.add_argument("--worlds", type=int, default=500)
    parser.add_argument("--size", type=scenes.parse_size, default=(480, 270))
    parser.add_argument("--json", type=Path)
    chosen = parser.parse_args()
    changes = {"frames": chosen.frames, "clip.clip_frames": -(-chosen.frames // chosen.worlds)}
    scene = scenes.load("training", changes, size=chosen.size)
    process, rows = psutil.Process(), list[tuple[int, float, float, float, int, int]]()
    edges = set(np.linspace(0, chosen.frames, TENTHS + 1).astype(int).tolist())

    def progress(done: int, _total: int) -> None:
        if done in edges:
            memory, contexts = process.memory_info().rss / 1e6, _contexts()
            rows.append((done, time.perf_counter(), time.process_time(), memory, process.num_fds(), contexts))
            _show(rows)

    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        render(scene, Path(folder) / "run", progress=progress)
        end, cpu = time.perf_counter(), time.process_time()
    print(f"{end - start:.0f} s in all, the last {end - rows[-1][1]:.0f} s of them for tables; {cpu:.0f} s of CPU")
    print(f"memory at the end {process.memory_info().rss / 1e6:.0f} MB")
    if chosen.json:
        chosen.json.write_text(json.dumps(rows))


def _contexts() -> int:
    """Count the renderers that exist, each of which has an OpenGL context."""
    return sum(isinstance(one, Renderer) for one in gc.get_objects())


def _show(rows: list[tuple[int, float, float, float, int, int]]) -> None:
    if len(rows) > 1:
        (before, wall, cpu, *_), (done, wall_now, cpu_now, memory, handles, contexts) = rows[-2:]
        each = (cpu_now - cpu) / (done - before) * 1e3
        print(
            f"to frame {done:6d}: {each:6.1f} ms of CPU a frame, {(done - before) / (wall_now - wall):5.1f} frames/s, "
            f"{memory:5.0f} MB, {handles} file handles, {contexts} contexts",
            flush=True,
        )


if __name__ == "__main__":
    main()
