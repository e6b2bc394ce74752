"""Measure simgrab on this machine. Ratios are taken pair by pair within one run, so that a noisy machine cancels.

python -m scripts.bench render [--pairs 30] [--memory-frames 2000]
python -m scripts.bench estimate
python -m scripts.bench motion
python -m scripts.bench stress
python -m scripts.bench world
python -m scripts.bench detect [--yolo FILE.onnx]
python -m scripts.bench run VIDEO [--detector bundled] [--frames 20000] [--live-frames 1000]
"""

from __future__ import annotations

import argparse
import itertools
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np

from simgrab import scenes
from simgrab.scenario import Scenario
from simgrab.world.extensions import Recipe
from simgrab.world.frames import FrameGenerator
from simgrab.world.output import stored
from simgrab.world.output.folder import Folder
from simgrab.world.output.manifest import identity
from simgrab.world.scenery.model import HIDDEN
from simgrab.world.trajectory.clip import ClipMotion


def render(pairs: int, memory_frames: int) -> None:
    """Print the time of a finished labelled frame over that of a bare ``mujoco.Renderer``, and how memory grows.

    The bare one renders rgb and segmentation of the same posed model, at the same size and through the same camera, and
    writes nothing; simgrab renders, labels, encodes and writes.
    """
    scenario = scenes.load("quay-day", {"camera.beta_deg": 5.0, "frames": max(pairs, memory_frames)})
    with tempfile.TemporaryDirectory() as temporary, FrameGenerator(scenario) as generator:
        folder = Folder(Path(temporary) / "bench")
        folder.open(identity(Recipe(scenario)), resume=False)
        k = scenario.camera.intrinsics
        name = generator.scene(0).renderer.fingerprint.renderer
        print(f"{name}, {k.width_px}x{k.height_px}, MSAA {scenario.image.samples}")
        competitor, ratios = _Bare(generator, k.width_px, k.height_px), []
        for frame in range(pairs + 2):
            start = time.perf_counter()
            folder.store(stored.make(generator, frame % scenario.frames))
            ours = time.perf_counter() - start
            bare = competitor.time()
            if frame >= 2:  # the first ones warm up
                ratios.append((ours / bare, ours, bare))
        ratio, ours, bare = np.median(ratios, axis=0)
        low, high = np.percentile([r[0] for r in ratios], [10, 90])
        print(f"finished labelled frame {ours * 1e3:.0f} ms, bare rgb + segmentation {bare * 1e3:.0f} ms")
        print(f"ratio {ratio:.2f} (median of {pairs} pairs; 10–90 %: {low:.2f}–{high:.2f})")
        competitor.close()
    if memory_frames:
        _memory(scenario, memory_frames)


class _Bare:
    """``mujoco.Renderer`` as its documentation uses it, looking at the same geoms from the same place."""

    def __init__(self, generator: FrameGenerator, width: int, height: int) -> None:
        import mujoco

        self._studio, self._camera, self._option = generator, mujoco.MjvCamera(), mujoco.MjvOption()
        self._option.geomgroup[:] = 1
        self._option.geomgroup[HIDDEN] = 0
        model = generator.scene(0).world.model
        self._renderer = mujoco.Renderer(model, height, width, max_geom=model.ngeom + 16)

    def time(self) -> float:
        """Seconds for rgb and segmentation."""
        start = time.perf_counter()
        self._renderer.disable_segmentation_rendering()
        self._look()
        self._renderer.render()
        self._renderer.enable_segmentation_rendering()
        self._look()
        self._renderer.render()
        return time.perf_counter() - start

    def _look(self) -> None:
        ours = self._studio.scene(0).renderer
        self._renderer.update_scene(ours.data, self._camera, self._option)
        ours.aim(ours.full, self._renderer.scene)

    def close(self) -> None:
        self._renderer.close()


def _memory(scenario: Scenario, frames: int) -> None:
    """Print resident memory after the first tenth and after all frames.

    Shadows and antialiasing are off, which saves time and leaves every buffer but the renderer's own as large.
    """
    quick = msgspec.structs.replace(scenario.image, samples=0, shadow_map_px=0)
    scenario = msgspec.structs.replace(scenario, image=quick)
    settled = max(frames // 10, 1)
    with tempfile.TemporaryDirectory() as temporary, FrameGenerator(scenario) as generator:
        folder = Folder(Path(temporary) / "bench")
        folder.open(identity(Recipe(scenario)), resume=False)
        for frame in range(frames):
            folder.store(stored.make(generator, frame))
            if frame + 1 == settled:
                before = _resident_mb()
    after = _resident_mb()
    print(f"memory after {settled} frames {before:.0f} MB, after {frames} {after:.0f} MB: {after - before:+.1f} MB")
    print(f"peak {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


def motion() -> None:
    """Print how much faster than the world the physics runs on one core, and how memory grows with a clip's length."""
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
        print(f"{name:18s} {speed:5.0f} × real time (CPU seconds, one core)")
    moments = iter(ClipMotion(scenes.load("work-cycles", {"frames": 10_000_000, "swing.wind.mean_m_s": 5.0}), 0))
    for hours in (0.25, 1.0, 4.0):
        for moment in moments:
            if moment.time is not None and moment.time >= 3600 * hours:
                break
        print(f"resident memory after {hours:g} h of a clip: {_resident_mb():.1f} MB", flush=True)


def world(repeats: int = 7) -> None:
    """Print what night, weather, optics and display cost a 1080p frame, once it is rendered."""
    print(f"milliseconds a frame, median of {repeats} frames after 2 that warm up")
    for name in ("calm-day", "windy-day", "night-light-snow", "heavy-snow", "rain", "fog", "dust", "glare"):
        with FrameGenerator(scenes.load(name)) as generator:
            times = []
            for frame in range(repeats + 2):
                scene = generator.scene(frame)
                buffers = scene.draw(generator.project(frame), labelled=False)
                began = time.perf_counter()
                scene.develop(buffers)
                times.append(time.perf_counter() - began)
        print(f"  {name:18s} {1e3 * float(np.median(times[2:])):6.1f} ms", flush=True)


def main() -> None:
    """Parse and run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(dest="verb", required=True)
    verb = verbs.add_parser("render")
    verb.add_argument("--pairs", type=int, default=30)
    verb.add_argument("--memory-frames", type=int, default=2000)
    verbs.add_parser("estimate")
    verbs.add_parser("motion")
    verbs.add_parser("stress")
    verbs.add_parser("world")
    verb = verbs.add_parser("detect")
    verb.add_argument("--yolo", type=Path, help="another detector beside the bundled one")
    verb = verbs.add_parser("run")
    verb.add_argument("video", type=Path)
    verb.add_argument("--detector", default="bundled")
    verb.add_argument("--frames", type=int, default=20_000)
    verb.add_argument("--live-frames", type=int, default=1000)
    chosen = parser.parse_args()
    sys.path.insert(0, str(Path(__file__).parents[1]))
    from scripts import bench_detect, bench_estimate, bench_run, bench_stress

    acts: dict[str, Callable[[], None]] = {
        "render": lambda: render(chosen.pairs, chosen.memory_frames),
        "estimate": bench_estimate.estimate,
        "motion": motion,
        "stress": bench_stress.stress,
        "world": world,
        "detect": lambda: bench_detect.detect(chosen.yolo),
        "run": lambda: bench_run.run(chosen.video, chosen.detector, chosen.frames, chosen.live_frames),
    }
    acts[chosen.verb]()


if __name__ == "__main__":
    main()
