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
from scipy.ndimage import distance_transform_edt
from skimage import data as samples_of_skimage

from scripts.bench_renderers import exported, seen_by
from scripts.foreign.camera import photographed
from scripts.foreign.worlds import CONDITIONS, Condition, Look, World, beside, sky_of
from simgrab.errors import RendererError
from simgrab.rng import stream
from simgrab.utilities.files import write
from simgrab.world.camera.lens import Lens
from simgrab.world.camera.renderer import LENS_SAMPLES
from simgrab.world.frames import FrameGenerator
from simgrab.world.output import stored
from simgrab.world.output.stored import Record
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
    farthest_px : float
        The farthest that a pixel of either is from the other; infinite where only one has any.
    beyond : int
        Pixels of either that are more than a pixel (or its diagonal) from the other.
    """

    pixels: int
    iou: float
    farthest_px: float
    beyond: int

    @classmethod
    def of(cls, ours: Mask, theirs: Mask) -> Agreement:
        """Compare two masks of one size."""
        if not ours.any() and not theirs.any():
            return cls(0, 1.0, 0.0, 0)
        if not ours.any() or not theirs.any():
            return cls(int(ours.sum()), 0.0, float("inf"), int((ours | theirs).sum()))
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
        looks = dict.fromkeys(CONDITIONS[name].look for name in names)
        for look in looks:
            wanted = [name for name in names if CONDITIONS[name].look == look]
            missing = [name for name in wanted if CONDITIONS[name].light and picture(folder, name) is None]
            if missing or not (folder / f"truth-{look.name}.json").exists():
                self._make_look(world, look, missing, folder)

    def _make_look(self, world: World, look: Look, missing: Sequence[str], folder: Path) -> None:
        scenario = world.looking(world.scenario(self.size), look, folder)
        with FrameGenerator(scenario) as generator:
            made = stored.make(generator, 0)
            (data,) = made.files.values()
            write(folder / f"{beside(Condition(look))}{Path(made.record.truth.file).suffix}", data)
            if missing:
                self._trace(world, look, missing, generator, made.record, folder)
        write(folder / f"truth-{look.name}.json", msgspec.json.encode(made.record))

    def _trace(
        self, world: World, look: Look, missing: Sequence[str], generator: FrameGenerator, record: Record, folder: Path
    ) -> None:
        """Path-trace what some conditions need, and make their pictures."""
        scenario, scene, projection = generator.scenario, generator.scene(0), generator.project(0)
        lens = None if scenario.camera.intrinsics.distortion.is_null else Lens(scenario.camera.intrinsics)
        full = scene.renderer.full
        with tempfile.TemporaryDirectory() as temporary:
            place = Path(temporary)
            exported(generator, range(1)).save(place / "scene.npz")
            np.savez(place / "photographs.npz", **_surfaces())
            lights = {CONDITIONS[name].light: CONDITIONS[name].render for name in missing}
            points = generator.scene(0).world.plan.grab_points(projection.moment.grab)
            pose = projection.moment.grab.jib_from_grab
            lowest = float((points @ pose[:3, :3].T + pose[:3, 3])[:, 2].min())
            jobs = [
                {
                    "scene": str(place / "scene.npz"), "photographs": str(place / "photographs.npz"),
                    "replaced": list(replaced or ()), "light": sky_of(scenario.light), "dusk": world.time == "dusk",
                    "ground_m": -scenario.jib.head_height_m, "ceiling_m": lowest - BELOW_GRAB_M, "seed": world.seed,
                    "samples": self.samples, "threads": self.threads, "out": str(place / f"{light}.npy"), "ids": "",
                }
                for light, replaced in lights.items()
            ]  # fmt: skip
            window = _id_window(projection.window, full, lens)
            agreement = folder / f"ids-{look.name}.json"
            if window and projection.moment.present and not agreement.exists():
                finer, source, _ = window
                jobs[0] |= {"ids": str(place / "ids.npy"), "ids_finer": finer,
                            "ids_window": _within(source, seen_by(generator), finer)}  # fmt: skip
            self.trace(jobs)
            if jobs[0]["ids"] and window:
                ours = stored_mask(record)
                theirs = _bent_ids(np.load(place / "ids.npy"), jobs[0]["ids_window"], window, seen_by(generator), full)
                write(agreement, msgspec.json.encode(Agreement.of(ours, theirs)))
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
    from pycocotools import mask as coco_mask

    return np.asarray(coco_mask.decode(record.mask), bool)


_IdWindow = tuple[int, tuple[int, int, int, int], Any]


def _id_window(window: Any, full: Any, lens: Lens | None) -> _IdWindow | None:
    """Samples a pixel, window of the finer undistorted picture, and map, of the ids of a part of the picture.

    The part is the grab's box within the picture, with a margin.
    """
    x0, y0 = (max(int(v) - MARGIN_PX, 0) for v in window[:2])
    x1, y1 = (min(int(v) + MARGIN_PX, int(f)) for v, f in zip(window[2:], full[2:], strict=True))
    if x0 >= x1 or y0 >= y1:
        return None
    if lens is None:
        return 1, (x0, y0, x1, y1), (x0, y0, x1, y1)
    bent = lens.map((x0, y0, x1, y1), LENS_SAMPLES)
    return LENS_SAMPLES, bent.source, ((x0, y0, x1, y1), bent)


def _within(source: Sequence[int], seen: Sequence[int], finer: int) -> list[int]:
    """Cut a window of the finer undistorted picture to what is rendered of it, counted from its corner."""
    left, top, right, bottom = (finer * v for v in seen)
    x0, y0, x1, y1 = source
    return [max(x0, left) - left, max(y0, top) - top, min(x1, right) - left, min(y1, bottom) - top]


def _bent_ids(ids: NDArray[np.uint8], rendered: Sequence[int], window: _IdWindow, seen: Any, full: Any) -> Mask:
    """Mask of the grab in the whole picture, from ids of a part of the undistorted one."""
    finer, (sx0, sy0, sx1, sy1), how = window
    part = np.full((sy1 - sy0, sx1 - sx0), NOTHING, np.uint8)
    x0, y0 = rendered[0] + finer * seen[0] - sx0, rendered[1] + finer * seen[1] - sy0
    part[y0 : y0 + ids.shape[0], x0 : x0 + ids.shape[1]] = ids
    mask = np.zeros((full[3], full[2]), bool)
    at = how
    if finer > 1:
        at, bent = how
        part = bent.resample(part, cv2.INTER_NEAREST, NOTHING)
    mask[at[1] : at[3], at[0] : at[2]] = part == GRAB
    return mask


def _surfaces() -> dict[str, Any]:
    """Photographs of surfaces, RGB."""
    grey = {name: getattr(samples_of_skimage, name)() for name in SURFACES}
    return {name: np.repeat(picture[..., None], 3, axis=2) for name, picture in grey.items()}


def picture(folder: Path, name: str) -> Path | None:
    """Path of a condition's picture, where it is made."""
    return next((path for suffix in SUFFIXES if (path := folder / f"{name}{suffix}").exists()), None)

