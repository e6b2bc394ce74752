"""Clips of the foreign exam: one world in motion, filmed by simgrab and by Blender with the same truth.

A frame's file appears whole or not at all, so an interrupted clip goes on where it was.
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from scripts.bench_renderers import RenderProcess, exported
from scripts.bench_scene import ExportedScene
from scripts.foreign.camera import VIDEO_CODERS, Light, before_coding, film
from scripts.foreign.making import BELOW_GRAB_M, surface_photographs
from scripts.foreign.worlds import CLIP_SEEDS, CONDITIONS, DEFAULT_FAMILY, at_time, foreign_grab, levelled, sky_of
from simgrab.dataset.video.coder import Coder
from simgrab.dataset.video.render import render_video
from simgrab.io import pictures
from simgrab.io.files import drafted, write
from simgrab.model import scenes
from simgrab.model.rng import stream
from simgrab.model.scenario import AutoExposure, Cycles, Dynamic, FixedMount, Scenario, Wind
from simgrab.world.camera.buffers import Buffers
from simgrab.world.camera.lens import Lens
from simgrab.world.extensions import Recipe
from simgrab.world.frames import FrameGenerator

MUJOCO, FOREIGN = "mujoco", "foreign"
#: What may be replaced: all that the exam's condition "all" does. The grab alone stays simgrab's own by default.
REPLACEABLE = (
    *("grab", "ground"), *(part for part in CONDITIONS["all"].render or () if part != "ground"),
    *CONDITIONS["all"].camera,
)  # fmt: skip
BY_BLENDER = CONDITIONS["all"].render or ()
DEFAULT = tuple(part for part in REPLACEABLE if part != "grab")
CALM = {"dig_slew_deg": 15.0, "slew_deg": -32.0}
HARD = {
    "dig_slew_deg": 15.0, "slew_deg": -47.4, "operator": 0.81, "slew_rpm": 0.75, "abrupt_every": 1, "abrupt_s": 2.25,
}  # fmt: skip
WIND_M_S = 4.0
CARRY_ROPE_M, DIG_ROPE_M = 10.0, 22.5
LEAST_BELOW_M = 8.0  # from the end of the rope to the ground: the grab, and room for what stands there
MBIT_PER_FRAME = 4.0 / 9.0  # of simgrab's own coder at its default rate


class Tracer(Protocol):
    """What path-traces the frames of one clip, as `scripts.foreign.blender` does."""

    def render(self, frame: int) -> None:
        """Render a frame."""

    def save(self, path: Path) -> None:
        """Write linear light of the frame rendered last as an array."""


Opener = Callable[[dict[str, Any]], AbstractContextManager[Tracer]]


def blender(python: str) -> Opener:
    """Path-trace in a process of its own, by an interpreter that can import bpy; it stays alive over a clip."""

    def opened(table: dict[str, Any]) -> RenderProcess:
        path = Path(table["scene"]).with_name("table.json")
        path.write_text(json.dumps(table), encoding="utf-8")
        return RenderProcess([python, "-m", "scripts.foreign.blender", str(path)])

    return opened


@dataclass(frozen=True)
class Clip:
    """One clip.

    Attributes
    ----------
    time : str
        Time of day, by which it is named.
    number : int
        Of its seed and its coder.
    hard : bool
        Whether the crane brakes its slewing hard.
    """

    time: str
    number: int
    hard: bool

    @property
    def seed(self) -> int:
        """Seed of its scenario."""
        return CLIP_SEEDS + self.number

    @property
    def coder(self) -> str:
        """Coder of the foreign video."""
        return VIDEO_CODERS[self.number % len(VIDEO_CODERS)]

    @property
    def motion(self) -> str:
        """What the crane does."""
        return "brakes hard" if self.hard else "works calmly"


CLIPS = (Clip("day", 0, hard=True), Clip("dusk", 1, hard=False), Clip("night", 2, hard=True))


@dataclass(frozen=True)
class Setting:
    """How clips are made.

    Attributes
    ----------
    size : tuple of 2 ints
        Width and height, px.
    seconds, rate_hz : float
        Duration of a clip, and its frame rate.
    samples : int
        Of the path tracer, a pixel.
    replaced : tuple of str
        Of `REPLACEABLE`.
    """

    size: tuple[int, int]
    seconds: float
    rate_hz: float
    samples: int
    replaced: tuple[str, ...]

    @property
    def frames(self) -> int:
        """Frames of a clip."""
        return max(round(self.seconds * self.rate_hz), 1)


def scenario_of(clip: Clip, setting: Setting, folder: Path) -> Scenario:
    """Draw a clip's scenario: working cycles over a level yard, seen by a fixed camera with a display.

    It has no weather and no motion blur. The file of a foreign grab goes into the folder.
    """
    keys = {
        "seed": clip.seed, "frames": setting.frames, "clip.clip_frames": setting.frames,
        "clip.frame_rate_hz": setting.rate_hz, "clip.bit_rate_mbit_s": MBIT_PER_FRAME * setting.rate_hz,
        "shutter.exposure_s": 0.0, "shutter.rolling_s": 0.0,
    }  # fmt: skip
    drawn = levelled(Recipe(scenes.load("exam-calm", keys, size=setting.size)).variant(0).scenario)
    drawn = at_time(drawn, clip.time, stream(clip.seed, 0, "foreign.time"))
    deepest = min(DIG_ROPE_M, drawn.jib.head_height_m - LEAST_BELOW_M)
    work = Cycles(dig_rope_m=deepest, carry_rope_m=CARRY_ROPE_M, **(HARD if clip.hard else CALM))  # type: ignore[arg-type]
    exposure = drawn.optics.exposure
    assert isinstance(exposure, AutoExposure)
    grab = drawn.grab
    if "grab" in setting.replaced:
        grab = foreign_grab(DEFAULT_FAMILY, folder, stream(clip.seed, 0, "foreign.grab"))
    return structs.replace(
        drawn,
        name=f"foreign-{clip.time}",
        grab=grab,
        swing=Dynamic(work=work, wind=Wind(mean_m_s=WIND_M_S)),
        camera=structs.replace(drawn.camera, mount=FixedMount()),
        display=structs.replace(drawn.display, layout="two-by-four"),
        optics=structs.replace(drawn.optics, exposure=structs.replace(exposure, lag_s=0.0)),
    )


@dataclass(frozen=True)
class Filmer:
    """Films clips in a folder.

    Attributes
    ----------
    folder : Path
    setting : Setting
    threads : int
        Of the path tracer.
    open_tracer : callable
        Opens a `Tracer` for a job of `scripts.foreign.blender` with several frames.
    report : callable
        Called with a line about each frame.
    """

    folder: Path
    setting: Setting
    threads: int
    open_tracer: Opener
    report: Callable[[str], None] = print

    def film(self, clip: Clip) -> None:
        """Make what is missing of a clip."""
        folder = self.folder / clip.time
        folder.mkdir(parents=True, exist_ok=True)
        scenario = scenario_of(clip, self.setting, folder)
        render_video(scenario, video(folder, MUJOCO), resume=True)
        missing = missing_frames(folder, scenario.frames)
        if missing:
            self._trace(clip, scenario, missing, folder)
        if not video(folder, FOREIGN).exists():
            camera = video(folder, MUJOCO).with_suffix(".camera.toml").read_bytes()
            write(video(folder, FOREIGN).with_suffix(".camera.toml"), camera)
            with drafted(video(folder, FOREIGN)) as draft:
                encode(draft, clip, scenario, folder, self.setting.replaced)

    def _trace(self, clip: Clip, scenario: Scenario, missing: list[int], folder: Path) -> None:
        """Path-trace missing frames, and take their pictures by one camera."""
        job = {
            "replaced": [part for part in BY_BLENDER if part in self.setting.replaced], "dusk": clip.time == "dusk",
            "seed": clip.seed, "samples": self.setting.samples, "threads": self.threads, "grain": True,
        }  # fmt: skip
        start = time.monotonic()
        for frame, buffers, light in traced(scenario, missing, job, self.open_tracer):
            rgb = before_coding(
                scenario, buffers, light, self.setting.replaced, stream(clip.seed, 0, "foreign.camera"),
                stream(clip.seed, frame, "foreign.noise"),
            )  # fmt: skip
            write(frame_file(folder, frame), pictures.encode(cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), "png"))
            self.report(f"{clip.time}, frame {frame} of {scenario.frames}: {time.monotonic() - start:.1f} s")
            start = time.monotonic()


def traced(
    scenario: Scenario, frames: Iterable[int], job: dict[str, Any], open_tracer: Opener
) -> Iterator[tuple[int, Buffers, Light]]:
    """Path-trace frames of a scenario in motion.

    Parameters
    ----------
    scenario : Scenario
    frames : iterable of int
    job : dict
        ``replaced``, ``dusk``, ``seed``, ``samples``, ``threads`` and ``grain`` of `scripts.foreign.blender.render`.
    open_tracer : callable
        See `Filmer`.

    Yields
    ------
    frame : int
    buffers : Buffers
        MuJoCo's of the frame.
    light : ndarray of float32, shape (height, width, 3)
        Path-traced linear light, bent by the lens.
    """
    lens = None if scenario.camera.intrinsics.distortion.is_null else Lens(scenario.camera.intrinsics)
    with FrameGenerator(scenario) as generator, tempfile.TemporaryDirectory() as temporary:
        place, full = Path(temporary), generator.scene(0).renderer.full
        poses = jib_poses(generator)
        standing(exported(generator, range(scenario.frames)), poses).save(place / "scene.npz")
        np.savez(place / "photographs.npz", **surface_photographs())
        table = job | {
            "scene": str(place / "scene.npz"), "photographs": str(place / "photographs.npz"),
            "light": sky_of(scenario.light), "jib_poses": poses.tolist(),
            "ground_m": -scenario.jib.head_height_m, "ceiling_m": lowest(generator) - BELOW_GRAB_M,
        }  # fmt: skip
        with open_tracer(table) as tracer:
            for frame in frames:
                tracer.render(frame)
                tracer.save(place / "light.npy")
                light = np.load(place / "light.npy").astype(np.float32)
                bent = light if lens is None else np.asarray(lens.map(full).resample(light, cv2.INTER_CUBIC))
                scene = generator.scene(frame)
                yield frame, scene.draw(scene.project(frame), labelled=False), np.maximum(bent, 0)


def encode(path: Path, clip: Clip, scenario: Scenario, folder: Path, replaced: Collection[str]) -> None:
    """Encode a clip's foreign frames as a video, by another coder or by simgrab's own."""

    def frames() -> Iterator[NDArray[np.uint8]]:
        for frame in range(scenario.frames):
            yield pictures.read(frame_file(folder, frame))

    if "coder" in replaced:
        quality = float(stream(clip.seed, 0, "foreign.coder").uniform())
        film(str(path), "mp4", frames(), scenario.clip.frame_rate_hz, clip.coder, quality)
        return
    ticks_per_s = 90_000
    with Coder(path, "mp4", ticks_per_s, scenario.camera, scenario.clip) as coder:
        for frame, rgb in enumerate(frames()):
            coder.send(rgb, round(frame * ticks_per_s / scenario.clip.frame_rate_hz))


def jib_poses(generator: FrameGenerator) -> NDArray[np.float64]:
    """Pose of each frame's jib frame in that of the first frame, shape (frames, 4, 4)."""
    states = [generator.project(frame).moment.jib for frame in range(generator.scenario.frames)]
    places = [np.eye(4) if state is None else state.jib_from_place for state in states]
    return np.array([places[0] @ np.linalg.inv(place) for place in places])


def standing(scene: ExportedScene, poses: NDArray[np.float64]) -> ExportedScene:
    """Express a scene in the jib frame of its first frame, so that place and lights stand still.

    Parameters
    ----------
    scene : ExportedScene
        Its lights are those of its last frame.
    poses : ndarray, shape (frames, 4, 4)
        As `jib_poses` gives.
    """
    return replace(
        scene,
        jib_from_camera=poses @ scene.jib_from_camera,
        jib_from_geom=poses[:, None] @ scene.jib_from_geom,
        light_directions=scene.light_directions @ poses[-1, :3, :3].T,
    )


def lowest(generator: FrameGenerator) -> float:
    """Lowest z of the grab in all frames, m."""
    found = []
    for frame in range(generator.scenario.frames):
        grab = generator.project(frame).moment.grab
        points, pose = generator.scene(frame).world.plan.grab_points(grab), grab.jib_from_grab
        found.append((points @ pose[:3, :3].T + pose[:3, 3])[:, 2].min())
    return float(min(found))


def video(folder: Path, by: str) -> Path:
    """Path of a clip's video."""
    return folder / f"{by}.mp4"


def frame_file(folder: Path, frame: int) -> Path:
    """Path of a foreign frame before it is coded."""
    return folder / "frames" / f"{frame:06d}.png"


def missing_frames(folder: Path, frames: int) -> list[int]:
    """Foreign frames that are not there."""
    return [frame for frame in range(frames) if not frame_file(folder, frame).exists()]
