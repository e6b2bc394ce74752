"""Render many small frames of many worlds in one process, and show that memory, handles and rate stay as they are.

python -m scripts.long_run [--frames 20000] [--worlds 500] [--size 480x270] [--pairs 60] [--json FILE]

The rate is that of the process's CPU time, which other programs of the machine disturb less than the clock's. Pairs are
more reliable still: after the run, this process and a new one make the frames of the last worlds in turns, frame by
frame, and their CPU times are compared world by world.
"""

from __future__ import annotations

import argparse
import gc
import json
import multiprocessing
import tempfile
import time
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import psutil

from simgrab.dataset import stored
from simgrab.dataset.render import render
from simgrab.model import scenes
from simgrab.model.scenario import Scenario
from simgrab.world.camera.renderer import Renderer
from simgrab.world.frames import FrameGenerator

TENTHS = 10
WARM_WORLDS = 10
"""Worlds that both processes make before they are compared: the new one has imports and caches to fill."""


def main() -> None:
    """Parse, run and print a line for each tenth of the frames."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=20_000)
    parser.add_argument("--worlds", type=int, default=500)
    parser.add_argument("--size", type=scenes.parse_size, default=(480, 270))
    parser.add_argument("--pairs", type=int, default=60, help="worlds that an aged and a new process both make; or 0")
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
    ratios = _compare(scene, chosen.pairs) if chosen.pairs else []
    if ratios:
        low, middle, high = _median(np.array(ratios))
        print(f"CPU time of this process over that of a new one, {len(ratios)} worlds in turns: median {middle:.3f}")
        print(f"95 % interval {low:.3f} to {high:.3f}")
    if chosen.json:
        chosen.json.write_text(json.dumps({"tenths": rows, "aged over new": ratios}))


def _compare(scene: Scenario, worlds: int) -> list[float]:
    """Make the last worlds' frames here and in a new process, in turns; returns the ratio of CPU times for each."""
    clips = range(scene.clip.count(scene.frames))[-worlds - WARM_WORLDS :]
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    ratios = []
    process = context.Process(target=_serve, args=(scene, there), daemon=True)
    process.start()
    with FrameGenerator(scene) as generator:
        for clip in clips:
            spent = np.zeros(2)
            for frame in scene.span(clip):
                for aged in (True, False) if frame % 2 else (False, True):
                    if aged:
                        spent[0] += _cost(generator, frame)
                    else:
                        here.send(frame)
                        spent[1] += here.recv()
            ratios.append(float(spent[0] / spent[1]))
    here.send(None)
    process.join()
    return ratios[WARM_WORLDS:]


def _serve(scene: Scenario, orders: Connection) -> None:
    """Make frames by number and answer with the CPU time of each, until there is no number."""
    with FrameGenerator(scene) as generator:
        while (frame := orders.recv()) is not None:
            orders.send(_cost(generator, frame))


def _cost(generator: FrameGenerator, frame: int) -> float:
    """CPU time of a finished frame, s, and of its world where it is the first."""
    start = time.process_time()
    stored.make(generator, frame)
    return time.process_time() - start


def _median(values: np.ndarray, draws: int = 4000) -> tuple[float, float, float]:
    """Median with its bootstrapped 95 % interval: lower end, median, upper end."""
    picks = np.random.default_rng(0).choice(values, (draws, len(values)))
    low, high = np.quantile(np.median(picks, axis=1), [0.025, 0.975])
    return float(low), float(np.median(values)), float(high)


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
