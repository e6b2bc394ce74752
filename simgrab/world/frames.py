"""Make the frames of a scenario: each alone, in any order, on any worker, always the same."""

from __future__ import annotations

import ctypes
import hashlib
import itertools
import multiprocessing
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from types import TracebackType
from typing import Any

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray
from pycocotools import mask as coco_mask

from simgrab.errors import DatasetError, ScenarioError
from simgrab.records import Truth
from simgrab.scenario import Scenario
from simgrab.world import model, truth
from simgrab.world.gl import Fingerprint
from simgrab.world.model import World
from simgrab.world.osd.draw import Overlay
from simgrab.world.render import Renderer, View
from simgrab.world.story import Story
from simgrab.world.swing import split

PR_SET_PDEATHSIG = 1
DEPTH_MM = 1000.0  # depth pictures hold millimetres in 16 bits


class Record(msgspec.Struct, frozen=True):
    """What is known of a finished frame.

    Attributes
    ----------
    truth : Truth
    mask : dict
        The visible grab in the whole picture, as COCO's compressed run lengths.
    drawn_by : Fingerprint
    """

    truth: Truth
    mask: dict[str, Any]
    drawn_by: Fingerprint


@dataclass(frozen=True, eq=False)
class Frame:
    """A finished frame: its record, and its picture files by name."""

    record: Record
    files: dict[str, bytes]


class Studio:
    """The built world of a scenario with a renderer before it. Use as a context manager.

    Parameters
    ----------
    scenario : Scenario
    world : World, optional
        Of the same scenario, where it was built already.

    Examples
    --------
    >>> from simgrab import scenes
    >>> with Studio(scenes.load("quay-day")) as studio:  # doctest: +SKIP
    ...     frame = studio.make(812)
    """

    def __init__(self, scenario: Scenario, world: World | None = None) -> None:
        self.scenario = scenario
        self.world = world or model.build(scenario)
        self.renderer = Renderer(self.world, scenario)
        self._story = Story(scenario)
        layout = scenario.display.layout_in(scenario.camera.width_px, scenario.camera.height_px)
        self._overlay = Overlay(layout) if layout else None

    def __enter__(self) -> Studio:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.renderer.close()

    def aim(self, frame: int) -> truth.Aim:
        """Pose the world and the camera as in one frame."""
        aimed = truth.aim(self.scenario, self.world, self._story.at(frame))
        self.renderer.pose(aimed.moment)
        return aimed

    def make(self, frame: int) -> Frame:
        """Draw, label and encode one frame."""
        scenario, image = self.scenario, self.scenario.image
        aimed = self.aim(frame)
        rgb = self.renderer.rgb()
        if self._overlay and aimed.moment.shown:
            rgb = self._overlay.blend(rgb, aimed.moment.shown)
        full = self.renderer.look() if image.ids or image.depth else None
        sight = truth.see(self.renderer, aimed, full)
        stem = f"{split(scenario, frame)}/{frame:06d}"
        name = f"images/{stem}.{'jpg' if image.format == 'jpeg' else 'png'}"
        files = {name: encode(rgb[..., ::-1], image.format, image.quality)}
        if full and image.ids:
            files[f"ids/{stem}.png"] = encode(full.ids, "png")
        if full and image.depth:
            files[f"depth/{stem}.png"] = encode(_millimetres(full), "png")
        digest = hashlib.sha256(files[name]).hexdigest()
        row = truth.label(scenario, aimed, sight, file=name, image_sha256=digest)
        return Frame(Record(row, run_length_mask(sight, row), self.renderer.fingerprint), files)


def _millimetres(view: View) -> NDArray[np.uint16]:
    return np.minimum(view.depth * DEPTH_MM, 65535).round().astype(np.uint16)


def encode(picture: NDArray[np.generic], kind: str, quality: int = 95) -> bytes:
    """Encode a BGR or single-channel picture as ``jpeg`` or ``png``."""
    if kind == "jpeg":
        ok, data = cv2.imencode(".jpg", np.ascontiguousarray(picture), [cv2.IMWRITE_JPEG_QUALITY, quality])
    else:
        ok, data = cv2.imencode(".png", np.ascontiguousarray(picture), [cv2.IMWRITE_PNG_COMPRESSION, 3])
    if not ok:
        raise DatasetError(f"cannot encode a picture as {kind}")
    return data.tobytes()


def run_length_mask(sight: truth.Sight, row: Truth) -> dict[str, Any]:
    """COCO's compressed run lengths of the visible grab in the whole picture."""
    mask = np.zeros((row.height_px, row.width_px), np.uint8, order="F")
    x0, y0, x1, y1 = sight.visible.window
    mask[y0:y1, x0:x1] = sight.mask
    coded = coco_mask.encode(mask)
    return {"size": list(coded["size"]), "counts": coded["counts"].decode("ascii")}


def check(scenario: Scenario, world: World) -> None:
    """Refuse, before anything is drawn, a scenario with an impossible frame or whose camera never sees the grab."""
    k = scenario.camera.intrinsics
    story = Story(scenario)
    aims = (truth.aim(scenario, world, story.at(frame)) for frame in range(scenario.frames))
    if not sum(aimed.meets(k.width_px, k.height_px) for aimed in aims):  # all of them: each may be impossible
        raise ScenarioError(
            "camera",
            f"it never sees the grab in any of the {scenario.frames} frames; "
            "lower camera.beta_deg or the focal length, or set offset and azimuth so that it looks at the rope",
        )


_studio: Studio | None = None


def _make_and_store(scenario: Scenario, frame: int, store: Callable[[Frame], None]) -> Fingerprint:
    """Work for a process that serves one scenario all its life."""
    global _studio
    if _studio is None:  # not in the pool's initializer, whose errors reach nobody
        _die_with_parent()
        _studio = Studio(scenario)
    made = _studio.make(frame)
    store(made)
    return made.record.drawn_by


def _die_with_parent() -> None:
    """Ask Linux to end this process when the one that feeds it is killed; else it would draw on, unseen."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


def make_all(
    scenario: Scenario, world: World, frames: Iterable[int], workers: int, store: Callable[[Frame], None]
) -> Iterator[Fingerprint]:
    """Make frames and store each where it was made; yields what drew each as they come, in no set order.

    Parameters
    ----------
    scenario : Scenario
    world : World
        Of the same scenario.
    frames : iterable of int
    workers : int
        Processes. The software renderer uses every core already, so more than one gains little there.
    store : callable
        Takes each finished frame, in the process that made it; must be picklable when there are several.
    """
    if workers == 1:
        with Studio(scenario, world) as studio:
            for index in frames:
                frame = studio.make(index)
                store(frame)
                yield frame.record.drawn_by
        return
    spawn = multiprocessing.get_context("spawn")  # OpenGL contexts do not survive a fork
    with ProcessPoolExecutor(workers, mp_context=spawn) as pool:
        jobs = (pool.submit(_make_and_store, scenario, frame, store) for frame in frames)
        try:
            running = set(itertools.islice(jobs, 3 * workers))
            while running:
                done, running = wait(running, return_when=FIRST_COMPLETED)
                running |= set(itertools.islice(jobs, len(done)))
                for future in done:
                    yield future.result()
        except BrokenProcessPool:
            raise DatasetError(
                "a worker process died (out of memory?); go on with --resume and fewer --workers"
            ) from None
        finally:
            pool.shutdown(cancel_futures=True)
