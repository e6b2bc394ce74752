"""Make the frames of a scenario: each alone, in any order, on any worker, always the same."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from types import TracebackType
from typing import Any

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray
from pycocotools import mask as coco_mask

from simgrab.errors import DatasetError, ScenarioError
from simgrab.labels.truth import Truth
from simgrab.scenario import Scenario, Variant, variant
from simgrab.world import label as truth
from simgrab.world.camera.renderer import Renderer, View
from simgrab.world.gl import Fingerprint
from simgrab.world.scenery.model import World
from simgrab.world.scenery.plan import Plan, draw_up
from simgrab.world.stage import Stage
from simgrab.world.trajectory.iid import split
from simgrab.world.trajectory.trajectory import Story

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


@dataclass(frozen=True, eq=False)
class Drawn:
    """A frame as it was drawn, neither labelled nor encoded.

    Attributes
    ----------
    variant : Variant
        The frame is of.
    aimed : Aim
    rgb : ndarray of uint8, shape (height, width, 3)
    full : View or None
        Ids and depth of the whole picture, where they are needed.
    sight : Sight
    veil : ndarray of float32, shape (height, width), or None
        Share of the scene's light that weather keeps from the camera; None in clear air.
    """

    variant: Variant
    aimed: truth.Aim
    rgb: NDArray[np.uint8]
    full: View | None
    sight: truth.Sight
    veil: NDArray[np.float32] | None


class Studio:
    """Makes the frames of a scenario. Use as a context manager.

    It keeps one variant's world built, with a renderer before it; where factors vary, go clip by clip.

    Parameters
    ----------
    scenario : Scenario
    plan : Plan, optional
        Of the scenario's first variant, where it was drawn up already.

    Examples
    --------
    >>> from simgrab import scenes
    >>> with Studio(scenes.load("quay-day")) as studio:  # doctest: +SKIP
    ...     frame = studio.make(812)
    """

    def __init__(self, scenario: Scenario, plan: Plan | None = None) -> None:
        self.scenario = scenario
        self._stage = Stage(variant(scenario, 0), plan) if plan else None

    def __enter__(self) -> Studio:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._stage:
            self._stage.close()

    @property
    def stage(self) -> Stage:
        """The stage of the frame last aimed at; at first that of frame 0."""
        return self._stage or self.at(0)

    @property
    def world(self) -> World:
        """The stage's world."""
        return self.stage.world

    @property
    def renderer(self) -> Renderer:
        """The stage's renderer."""
        return self.stage.renderer

    def at(self, frame: int) -> Stage:
        """Set the stage for a frame, built anew where another variant's stands."""
        number = self.scenario.variant_number(frame)
        if self._stage is None or self._stage.variant.number != number:
            if self._stage:
                self._stage.close()
                self._stage = None  # building may fail
            self._stage = Stage(variant(self.scenario, frame))
        return self._stage

    def aim(self, frame: int) -> truth.Aim:
        """Pose the world and the camera as in one frame, at the instant of its labels."""
        return self.at(frame).aim(frame)

    def make(self, frame: int) -> Frame:
        """Draw, label and encode one frame."""
        return self.finish(self.draw(frame))

    def draw(self, frame: int) -> Drawn:
        """Draw one frame."""
        image, stage = self.scenario.image, self.at(frame)
        aimed = stage.aim(frame)
        full = stage.renderer.look() if image.ids or image.depth else None
        glance = full or (stage.renderer.glance() if stage.chain.wants_view else None)
        sight = truth.see(stage.renderer, aimed, full if stage.renderer.bends else glance)
        rgb, veil = stage.chain.picture(frame, glance)
        return Drawn(stage.variant, aimed, rgb, full, sight, veil)

    def finish(self, drawn: Drawn) -> Frame:
        """Label and encode a drawn frame."""
        scenario, image, full = self.scenario, self.scenario.image, drawn.full
        stem = f"{split(scenario, drawn.aimed.moment.frame)}/{drawn.aimed.moment.frame:06d}"
        name = f"images/{stem}.{'jpg' if image.format == 'jpeg' else 'png'}"
        files = {name: encode(drawn.rgb[..., ::-1], image.format, image.quality)}
        if full and image.ids:
            files[f"ids/{stem}.png"] = encode(full.ids, "png")
        if full and image.depth:
            files[f"depth/{stem}.png"] = encode(_millimetres(full), "png")
        row = self.label(drawn, file=name, image=files[name])
        return Frame(Record(row, run_length_mask(drawn.sight, row), self.renderer.fingerprint), files)

    def label(self, drawn: Drawn, *, file: str, image: bytes | memoryview) -> Truth:
        """Compose the row of labels of a drawn frame, whose picture is kept as ``image`` in ``file``."""
        digest = hashlib.sha256(image).hexdigest()
        frame = drawn.aimed.moment.frame
        return truth.label(
            drawn.variant, drawn.aimed, drawn.sight, drawn.veil,
            split=split(self.scenario, frame), file=file, image_sha256=digest,
        )  # fmt: skip


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


def vet(scenario: Scenario, number: int = 0) -> tuple[int, Plan]:
    """Refuse a variant with an impossible frame; returns how many of its frames see the grab, and its world's plan.

    Parameters
    ----------
    scenario : Scenario
    number : int
        Of the variant: of its clip.
    """
    span = scenario.clip.span(number, scenario.frames) if scenario.vary else range(scenario.frames)
    one, k = variant(scenario, span.start), scenario.camera.intrinsics
    plan, story = draw_up(one.scenario, one.number), Story(one.scenario)
    aims = (truth.aim(one.scenario, plan, story.at(frame)) for frame in span)
    return sum(aimed.meets(k.width_px, k.height_px) for aimed in aims), plan  # all of them: each may be impossible


def refuse_unseen(scenario: Scenario, seen: int) -> None:
    """Refuse a scenario of whose frames none sees the grab."""
    if not seen:
        raise ScenarioError(
            "camera",
            f"it never sees the grab in any of the {scenario.frames} frames; "
            "lower camera.beta_deg or the focal length, or set offset and azimuth so that it looks at the rope",
        )
