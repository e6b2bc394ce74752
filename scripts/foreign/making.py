"""Make the pictures of one world: truth and MuJoCo's picture by simgrab, the others by Blender.

An interrupted world goes on with the geometry at which it was.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from scripts.foreign.export import export
from scripts.foreign.worlds import PICTURES, World
from simgrab.dataset import stored
from simgrab.errors import RendererError
from simgrab.io.files import write
from simgrab.io.pictures import encode
from simgrab.world.camera.lens import Lens
from simgrab.world.camera.pipeline import Camera
from simgrab.world.frames import FrameGenerator

ROOT = Path(__file__).parents[2]

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
    """Makes worlds in a folder."""

    folder: Path
    size: tuple[int, int]
    # samples, threads: of the path tracer
    samples: int
    threads: int
    trace: PathTracer

    def make(self, world: World) -> None:
        """Make what is missing of a world."""
        folder = self.folder / world.name
        folder.mkdir(parents=True, exist_ok=True)
        for geometry, pictures in PICTURES.items():
            if not truth(folder, geometry).exists():
                with FrameGenerator(world.geometry(geometry, self.size, folder)) as generator:
                    made = stored.make(generator, 0)
                    (own,) = made.files.values()
                    traced = photographed(generator, self._light(generator))
                    for name, data in zip(pictures, (own, traced), strict=True):
                        write(folder / f"{name}.jpg", data)
                write(truth(folder, geometry), msgspec.json.encode(made.record))

    def _light(self, generator: FrameGenerator) -> NDArray[np.float32]:
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


def photographed(generator: FrameGenerator, light: NDArray[np.float32]) -> bytes:
    """Make simgrab's camera take frame 0 in linear light of shape (height, width, 3), which the lens has bent."""
    scenario, buffers = generator.scenario, generator.scene(0).draw(generator.project(0))
    rgb = Camera(scenario).develop(replace(buffers, rgb=light)).rgb
    return encode(cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), "jpeg", scenario.image.quality)


def truth(folder: Path, geometry: str) -> Path:
    """Path of a geometry's labels in a world's folder; they are written when its pictures are complete."""
    return folder / f"truth-{geometry}.json"
