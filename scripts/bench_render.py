"""Time a finished labelled frame beside a bare ``mujoco.Renderer``, and watch memory; see `scripts.bench`."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from scripts.bench_measure import in_turns, milliseconds, peak_mb, ratios, resident_mb, single
from scripts.bench_results import Quantity
from simgrab.dataset import stored
from simgrab.dataset.folder import Folder
from simgrab.dataset.manifest import identity
from simgrab.model import scenes
from simgrab.model.scenario import Scenario
from simgrab.world.extensions import Recipe
from simgrab.world.frames import FrameGenerator
from simgrab.world.scenery.model import HIDDEN

FINISHED, BARE = "simgrab: finished labelled frame", "mujoco.Renderer: rgb and segmentation"
SCENE = {"camera.beta_deg": 5.0}  # of quay-day
WARM_UP = 2


def render(pairs: int, memory_frames: int) -> Iterator[Quantity]:
    """Measure the time of a finished labelled frame over that of a bare ``mujoco.Renderer``, and how memory grows.

    The bare one renders rgb and segmentation of the same posed model, at the same size and through the same camera, and
    writes nothing; simgrab renders, labels, encodes and writes.
    """
    scenario = scenes.load("quay-day", SCENE | {"frames": max(pairs + WARM_UP, memory_frames)})
    with Finished(scenario) as finished, Bare(finished.generator) as bare:
        took = in_turns({FINISHED: finished.store, BARE: bare.render}, range(pairs + WARM_UP), WARM_UP)
    yield from (milliseconds(name, seconds) for name, seconds in took.items())
    yield ratios("finished frame over bare renderer", took[FINISHED], took[BARE])
    if memory_frames:
        yield from _memory(scenario, memory_frames)


class Finished:
    """Makes frames and writes them into a folder that is removed at the end."""

    def __init__(self, scenario: Scenario) -> None:
        self.generator = FrameGenerator(scenario)
        self._temporary = tempfile.TemporaryDirectory()
        self._folder = Folder(Path(self._temporary.name) / "bench")
        self._folder.open(identity(Recipe(scenario)), resume=False)

    def __enter__(self) -> Finished:
        return self

    def __exit__(self, *_: object) -> None:
        self.generator.close()
        self._temporary.cleanup()

    def store(self, frame: int) -> None:
        """Render, label, encode and write a frame."""
        self._folder.store(stored.make(self.generator, frame))


def textured(generator: FrameGenerator) -> Any:
    """Build the model of frame 0's world with its textures, for other renderers; simgrab's own uploads them itself."""
    from simgrab.world.scenery.model import build

    scene = generator.scene(0)
    return build(scene.scenario, scene.world.plan, textured=True).model


class Bare:
    """``mujoco.Renderer`` as its documentation uses it, with the same geoms and camera as the frame made last."""

    def __init__(self, generator: FrameGenerator) -> None:
        import mujoco

        self._generator, self._camera, self._option = generator, mujoco.MjvCamera(), mujoco.MjvOption()
        self._option.geomgroup[:] = 1
        self._option.geomgroup[HIDDEN] = 0
        self._model, k = textured(generator), generator.scenario.camera.intrinsics
        model = self._model
        self._renderer = mujoco.Renderer(model, k.height_px, k.width_px, max_geom=model.ngeom + 16)

    def __enter__(self) -> Bare:
        return self

    def __exit__(self, *_: object) -> None:
        self._renderer.close()

    def render(self, _frame: int) -> NDArray[np.uint8]:
        """Render rgb, which is returned, and segmentation."""
        self._renderer.disable_segmentation_rendering()
        self._aim()
        rgb = self._renderer.render()
        self._renderer.enable_segmentation_rendering()
        self._aim()
        self._renderer.render()
        return rgb

    def _aim(self) -> None:
        ours = self._generator.scene(0).renderer
        self._model.geom_group[:] = self._generator.scene(0).world.model.geom_group
        self._renderer.update_scene(ours.data, self._camera, self._option)
        ours.aim(ours.full, self._renderer.scene)


def _memory(scenario: Scenario, frames: int) -> Iterator[Quantity]:
    """Measure resident memory after the first tenth and after all frames.

    Shadows and antialiasing are off, which saves time and leaves every buffer but the renderer's own as large.
    """
    quick = msgspec.structs.replace(scenario.image, samples=0, shadow_map_px=0)
    settled = max(frames // 10, 1)
    with Finished(msgspec.structs.replace(scenario, image=quick)) as finished:
        for frame in range(frames):
            finished.store(frame)
            if frame + 1 in (settled, frames):
                yield single(f"memory after {frame + 1} frames", resident_mb(), "MB")
    yield single("peak memory", peak_mb(), "MB")
