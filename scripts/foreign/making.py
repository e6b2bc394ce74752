"""Make the pictures of one world: truth and MuJoCo's picture by simgrab, the others by Blender and other cameras.

A file appears whole or not at all, so an interrupted world goes on where it was.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray
from pycocotools import mask as coco_mask
from scipy.ndimage import distance_transform_edt
from skimage import data as samples_of_skimage

from scripts.bench_renderers import exported, source_window
from scripts.foreign.camera import photographed
from scripts.foreign.worlds import CONDITIONS, Condition, Replacement, World, beside, sky_of
from simgrab.dataset import stored
from simgrab.dataset.stored import Record
from simgrab.errors import RendererError
from simgrab.io.files import write
from simgrab.model.rng import stream
from simgrab.world.camera.lens import Lens, PictureMap, Window
from simgrab.world.camera.renderer import LENS_SAMPLES
from simgrab.world.frames import FrameGenerator
from simgrab.world.scenery.model import GRAB, NOTHING

ROOT = Path(__file__).parents[2]
SUFFIXES = (".jpg", ".png")
BELOW_GRAB_M = 0.5
MARGIN_PX = 4
#: Photographs of surfaces that come with scikit-image, under CC0.
SURFACES = ("brick", "grass", "gravel")

Mask = NDArray[np.bool_]


class PathTracer(Protocol):
    """What renders jobs, as `scripts.foreign.blender.render` states them."""

    def __call__(self, jobs: Sequence[dict[str, Any]]) -> None:
        """Render all, or raise `RendererError`."""


@dataclass(frozen=True)
class Blender:
    """Path-traces in a process of its own, by an interpreter that can import bpy."""

    python: str

    def __call__(self, jobs: Sequence[dict[str, Any]]) -> None:
        """See `PathTracer`."""
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
class Agreement:
    """How simgrab's mask of the visible grab and the path tracer's object ids agree.

    Attributes
    ----------
    pixels : int
        Of simgrab's mask.
    iou : float
    farthest_px : float or None
        The farthest that a pixel of either is from the other; None where only one has any.
    beyond : int
        Pixels of either that are more than a pixel (or its diagonal) from the other; all where only one has any.
    """

    pixels: int
    iou: float
    farthest_px: float | None
    beyond: int

    @classmethod
    def of(cls, ours: Mask, theirs: Mask) -> Agreement:
        """Compare two masks of one size."""
        if not ours.any() and not theirs.any():
            return cls(0, 1.0, 0.0, 0)
        if not ours.any() or not theirs.any():
            return cls(int(ours.sum()), 0.0, None, int((ours | theirs).sum()))
        away = np.concatenate([distance_transform_edt(~b)[a & ~b] for a, b in ((ours, theirs), (theirs, ours))])
        iou = float((ours & theirs).sum() / (ours | theirs).sum())
        return cls(int(ours.sum()), iou, float(away.max(initial=0.0)), int((away > np.sqrt(2) + 1e-6).sum()))


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
                self._trace(world, replacement, missing, generator, made.record, folder)
        write(folder / f"truth-{replacement.name}.json", msgspec.json.encode(made.record))

    def _trace(
        self, world: World, replacement: Replacement, missing: Sequence[str], generator: FrameGenerator, record: Record,
        folder: Path,
    ) -> None:  # fmt: skip
        """Path-trace what some conditions need, and make their pictures."""
        scenario, scene, projection = generator.scenario, generator.scene(0), generator.project(0)
        lens = None if scenario.camera.intrinsics.distortion.is_null else Lens(scenario.camera.intrinsics)
        full = scene.renderer.full
        with tempfile.TemporaryDirectory() as temporary:
            place = Path(temporary)
            exported(generator, range(1)).save(place / "scene.npz")
            np.savez(place / "photographs.npz", **surface_photographs())
            lights = {CONDITIONS[name].light: CONDITIONS[name].render for name in missing}
            points = generator.scene(0).world.plan.grab_points(projection.moment.grab)
            pose = projection.moment.grab.jib_from_grab
            lowest = float((points @ pose[:3, :3].T + pose[:3, 3])[:, 2].min())
            jobs = [
                {
                    "scene": str(place / "scene.npz"), "photographs": str(place / "photographs.npz"),
                    "replaced": list(replaced or ()), "light": sky_of(scenario.light), "dusk": world.time == "dusk",
                    "jib_poses": [np.eye(4).tolist()],
                    "ground_m": -scenario.jib.head_height_m, "ceiling_m": lowest - BELOW_GRAB_M, "seed": world.seed,
                    "samples": self.samples, "threads": self.threads, "out": str(place / f"{light}.npy"), "ids": "",
                }
                for light, replaced in lights.items()
            ]  # fmt: skip
            window, agreement = IdWindow.of(generator), folder / f"ids-{replacement.name}.json"
            if window and not agreement.exists():
                jobs[0] |= {"ids": str(place / "ids.npy"), "ids_finer": window.finer, "ids_window": window.rendered}
            self.trace(jobs)
            if window and jobs[0]["ids"]:
                theirs = window.mask(np.load(place / "ids.npy"))
                write(agreement, msgspec.json.encode(Agreement.of(stored_mask(record), theirs)))
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


def stored_mask(record: Record) -> Mask:
    """Pixels of the visible grab, shape (height, width)."""
    return np.asarray(coco_mask.decode(record.mask), bool)


@dataclass(frozen=True, eq=False)
class IdWindow:
    """Where ids of the grab and some pixels around it are rendered.

    Attributes
    ----------
    full : tuple of 4 ints
        The whole picture.
    part : tuple of 4 ints
        Of the picture: the grab's box with a margin.
    lens : PictureMap or None
        Of that part, `finer` times as fine before the lens bends it.
    exported : tuple of 4 ints
        Window of the undistorted picture that is exported.
    """

    full: Window
    part: Window
    lens: PictureMap | None
    exported: Window

    @classmethod
    def of(cls, generator: FrameGenerator) -> IdWindow | None:
        """Make it for a generator's first frame; None where that shows no grab."""
        projection, renderer = generator.project(0), generator.scene(0).renderer
        k = generator.scenario.camera.intrinsics
        if not projection.moment.present or not projection.meets(k.width_px, k.height_px):
            return None
        x0, y0, x1, y1 = projection.window
        part = (
            max(x0 - MARGIN_PX, 0), max(y0 - MARGIN_PX, 0),
            min(x1 + MARGIN_PX, k.width_px), min(y1 + MARGIN_PX, k.height_px),
        )  # fmt: skip
        lens = None if k.distortion.is_null else Lens(k).map(part, LENS_SAMPLES)
        return cls(renderer.full, part, lens, source_window(generator))

    @property
    def finer(self) -> int:
        """Samples a pixel and direction."""
        return LENS_SAMPLES if self.lens else 1

    @property
    def source(self) -> Window:
        """Window of the finer undistorted picture that the part needs, counted from the corner of `exported`."""
        x0, y0, x1, y1 = self.lens.source if self.lens else self.part
        left, top = self.finer * self.exported[0], self.finer * self.exported[1]
        return x0 - left, y0 - top, x1 - left, y1 - top

    @property
    def rendered(self) -> Window:
        """What of `source` lies in the exported picture."""
        x0, y0, x1, y1 = self.source
        width, height = self.exported[2] - self.exported[0], self.exported[3] - self.exported[1]
        return max(x0, 0), max(y0, 0), min(x1, self.finer * width), min(y1, self.finer * height)

    def mask(self, ids: NDArray[np.uint8]) -> Mask:
        """Mask of the grab, shape of the picture, from ids of what was `rendered`."""
        (x0, y0, x1, y1), (left, top, right, bottom) = self.source, self.rendered
        part = np.full((y1 - y0, x1 - x0), NOTHING, np.uint8)
        part[top - y0 : bottom - y0, left - x0 : right - x0] = ids
        if self.lens:
            part = self.lens.resample(part, cv2.INTER_NEAREST, NOTHING)
        mask = np.zeros((self.full[3], self.full[2]), bool)
        mask[self.part[1] : self.part[3], self.part[0] : self.part[2]] = part == GRAB
        return mask


def surface_photographs() -> dict[str, Any]:
    """Photographs of surfaces, RGB."""
    grey = {name: getattr(samples_of_skimage, name)() for name in SURFACES}
    return {name: np.repeat(picture[..., None], 3, axis=2) for name, picture in grey.items()}


def picture(folder: Path, name: str) -> Path | None:
    """Path of a condition's picture, where it is made."""
    return next((path for suffix in SUFFIXES if (path := folder / f"{name}{suffix}").exists()), None)
