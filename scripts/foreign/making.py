"""Make the pictures of one world: truth and MuJoCo's picture by simgrab, the others by Blender and another camera.

A file appears whole or not at all, so an interrupted world goes on where it was.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np

from scripts.foreign.camera import Light, photographed
from scripts.foreign.export import export
from scripts.foreign.worlds import CONDITIONS, Condition, World
from simgrab.dataset import stored
from simgrab.errors import RendererError
from simgrab.io.files import write
from simgrab.model.rng import stream
from simgrab.world.camera.lens import Lens
from simgrab.world.frames import FrameGenerator

ROOT = Path(__file__).parents[2]
SUFFIXES = (".jpg", ".png")


PathTracer = Callable[[dict[str, Any]], None]
"""What renders a job, as `scripts.foreign.blender.render` states it, or raises `RendererError`."""


@dataclass(frozen=True)
class Blender:
    """Path-traces in a process of its own, by an interpreter that can import bpy."""

    python: str

    def __call__(self, job: dict[str, Any]) -> None:
        """Render a job; see `PathTracer`."""
        with tempfile.NamedTemporaryFile("w", suffix=".json") as file:
            json.dump(job, file)
            file.flush()
            command = [self.python, "-m", "scripts.foreign.blender", file.name]
            try:
                subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True)
            except OSError as problem:
                raise RendererError(f"cannot run {self.python}: {problem.strerror}") from None
            except subprocess.CalledProcessError as problem:
                last = problem.stderr.strip().rpartition("\n")[2]
                raise RendererError(f"Blender ended: {last or problem.returncode}") from None


@dataclass(frozen=True)
class Maker:
    """Makes worlds in a folder.

    Attributes
    ----------
    folder : Path
    size : tuple of 2 ints
    samples, threads : int
        Of the path tracer.
    trace : PathTracer
    """

    folder: Path
    size: tuple[int, int]
    samples: int
    threads: int
    trace: PathTracer

    def make(self, world: World, names: Iterable[str]) -> None:
        """Make what is missing of some conditions of a world."""
        folder = self.folder / "worlds" / world.name
        folder.mkdir(parents=True, exist_ok=True)
        geometries = dict[str, list[str]]()
        for name in names:
            geometries.setdefault(CONDITIONS[name].geometry, []).append(name)
        for geometry, wanted in geometries.items():
            missing = [name for name in wanted if CONDITIONS[name].traced and picture(folder, name) is None]
            if missing or not (folder / f"truth-{geometry}.json").exists():
                self._make(world, geometry, missing, folder)

    def _make(self, world: World, geometry: str, missing: Sequence[str], folder: Path) -> None:
        """Make truth and MuJoCo's picture of a geometry, and the missing pictures of the path tracer's light."""
        scenario = world.scenario(self.size)
        if geometry == "grab":
            scenario = world.with_other_grab(scenario, folder)
        with FrameGenerator(scenario) as generator:
            made = stored.make(generator, 0)
            (data,) = made.files.values()
            beside = Condition(grab=geometry == "grab").beside
            write(folder / f"{beside}{Path(made.record.truth.file).suffix}", data)
            if missing:
                light = self._light(generator)
                buffers = generator.scene(0).draw(generator.project(0))
                for name in missing:
                    rng = stream(world.seed, 0, "foreign.camera")
                    write(folder / f"{name}.jpg", photographed(scenario, buffers, light, CONDITIONS[name].camera, rng))
        write(folder / f"truth-{geometry}.json", msgspec.json.encode(made.record))

    def _light(self, generator: FrameGenerator) -> Light:
        """Path-trace a frame, and bend it as its lens does."""
        with tempfile.TemporaryDirectory() as temporary:
            scene, out = Path(temporary) / "scene.npz", Path(temporary) / "light.npy"
            np.savez(scene, **export(generator))
            self.trace({"scene": str(scene), "samples": self.samples, "threads": self.threads, "out": str(out)})
            light = np.load(out).astype(np.float32)
        intrinsics = generator.scenario.camera.intrinsics
        if not intrinsics.distortion.is_null:
            light = Lens(intrinsics).map(generator.scene(0).renderer.full).resample(light, cv2.INTER_CUBIC)
        return np.maximum(np.asarray(light), 0)


def picture(folder: Path, name: str) -> Path | None:
    """Path of a condition's picture, where it is made."""
    return next((path for suffix in SUFFIXES if (path := folder / f"{name}{suffix}").exists()), None)
