"""Make the pictures of one world: truth and MuJoCo's picture by simgrab, the others by Blender and other cameras.

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
from skimage import data as samples_of_skimage

from scripts.foreign.camera import photographed
from scripts.foreign.export import export
from scripts.foreign.worlds import CONDITIONS, Condition, Replacement, World, beside
from simgrab.dataset import stored
from simgrab.errors import RendererError
from simgrab.io.files import write
from simgrab.model.rng import stream
from simgrab.world.camera.lens import Lens
from simgrab.world.frames import FrameGenerator

ROOT = Path(__file__).parents[2]
SUFFIXES = (".jpg", ".png")
BELOW_GRAB_M = 0.5
#: Photographs of surfaces that come with scikit-image, under CC0.
SURFACES = ("brick", "grass", "gravel")


PathTracer = Callable[[Sequence[dict[str, Any]]], None]
"""What renders jobs, as `scripts.foreign.blender.render` states them, or raises `RendererError`."""


@dataclass(frozen=True)
class Blender:
    """Path-traces in a process of its own, by an interpreter that can import bpy."""

    python: str

    def __call__(self, jobs: Sequence[dict[str, Any]]) -> None:
        """Render jobs; see `PathTracer`."""
        with tempfile.NamedTemporaryFile("w", suffix=".json") as file:
            json.dump(list(jobs), file)
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
        replacements = dict.fromkeys(CONDITIONS[name].replacement for name in names)
        for replacement in replacements:
            wanted = [name for name in names if CONDITIONS[name].replacement == replacement]
            missing = [name for name in wanted if CONDITIONS[name].light and picture(folder, name) is None]
            if missing or not (folder / f"truth-{replacement.name}.json").exists():
                self._make_replaced(world, replacement, missing, folder)

    def _make_replaced(self, world: World, replacement: Replacement, missing: Sequence[str], folder: Path) -> None:
        scenario = world.replaced(world.scenario(self.size), replacement, folder)
        with FrameGenerator(scenario) as generator:
            made = stored.make(generator, 0)
            (data,) = made.files.values()
            write(folder / f"{beside(Condition(replacement))}{Path(made.record.truth.file).suffix}", data)
            if missing:
                self._trace(world, missing, generator, folder)
        write(folder / f"truth-{replacement.name}.json", msgspec.json.encode(made.record))

    def _trace(self, world: World, missing: Sequence[str], generator: FrameGenerator, folder: Path) -> None:
        """Path-trace what some conditions need, and make their pictures."""
        scenario, scene, projection = generator.scenario, generator.scene(0), generator.project(0)
        lens = None if scenario.camera.intrinsics.distortion.is_null else Lens(scenario.camera.intrinsics)
        full = scene.renderer.full
        with tempfile.TemporaryDirectory() as temporary:
            place = Path(temporary)
            np.savez(place / "scene.npz", **export(generator))
            np.savez(place / "photographs.npz", **surface_photographs())
            lights = {CONDITIONS[name].light: CONDITIONS[name].render for name in missing}
            points = generator.scene(0).world.plan.grab_points(projection.moment.grab)
            lowest = float(projection.moment.grab.jib_from_grab.apply(points)[:, 2].min())
            jobs = [
                {
                    "scene": str(place / "scene.npz"), "photographs": str(place / "photographs.npz"),
                    "replaced": list(replaced or ()), "dusk": world.time == "dusk",
                    "light": "lamps" if scenario.light.floodlights else "sun",
                    "ground_m": -scenario.jib.head_height_m, "ceiling_m": lowest - BELOW_GRAB_M, "seed": world.seed,
                    "samples": self.samples, "threads": self.threads, "out": str(place / f"{light}.npy"),
                }
                for light, replaced in lights.items()
            ]  # fmt: skip
            self.trace(jobs)
            buffers = scene.draw(projection)
            for name in missing:
                condition = CONDITIONS[name]
                light = np.load(place / f"{condition.light}.npy").astype(np.float32)
                bent = light if lens is None else np.asarray(lens.map(full).resample(light, cv2.INTER_CUBIC))
                replaced = (*(condition.render or ()), *condition.camera)
                file, suffix = photographed(
                    scenario, buffers, np.maximum(bent, 0), replaced, stream(world.seed, 0, "foreign.camera")
                )
                write(folder / f"{name}{suffix}", file)


def surface_photographs() -> dict[str, Any]:
    """Photographs of surfaces, RGB."""
    grey = {name: getattr(samples_of_skimage, name)() for name in SURFACES}
    return {name: np.repeat(picture[..., None], 3, axis=2) for name, picture in grey.items()}


def picture(folder: Path, name: str) -> Path | None:
    """Path of a condition's picture, where it is made."""
    return next((path for suffix in SUFFIXES if (path := folder / f"{name}{suffix}").exists()), None)
