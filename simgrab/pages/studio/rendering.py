"""Frames of scenes that change: of the full size as a dataset stores them, and small ones in between."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, TypeVar

import cv2
import msgspec
import numpy as np

from simgrab.dataset.stored import encoded
from simgrab.errors import ScenarioError, SimgrabError
from simgrab.io import pictures
from simgrab.model.label_arrays import vertical
from simgrab.model.scenario import Iid, Scenario, resized
from simgrab.model.truth import Truth
from simgrab.pages.outlines import marks, outline
from simgrab.pages.studio.turns import Turns
from simgrab.world.frames import Frame, FrameGenerator

PREVIEW_WIDTH_PX = 480
K = TypeVar("K")
V = TypeVar("V")
_LEAST_PX = 64
_PREVIEW_QUALITY = 80
_OUTLINE_WIDTH_PX = 960


@dataclass(frozen=True)
class Wish:
    """A frame that is wanted, small where that will do."""

    scenario: Scenario
    frame: int
    small: bool = False


def kept(known: list[tuple[K, V]], key: K, make: Callable[[], V], most: int = 4) -> V:
    """Give the value of a key, made where it is none of the few used last. Scenes have no hash: compare values."""
    found = [value for old, value in known if old == key] or [make()]
    known[:] = [(key, found[0]), *(one for one in known if one[0] != key)][:most]
    return found[0]


class Rendering:
    """Renders frames, each side's in a world of its own, which stays for as long as changes leave it the same.

    All OpenGL is done by one thread.
    """

    def __init__(self) -> None:
        self._generators: dict[str, FrameGenerator] = {}
        self._parts: dict[str, list[Any]] = {}
        self._small: list[tuple[Scenario, Scenario]] = []
        self._full: list[tuple[Wish, bytes]] = []
        self.turns = Turns(self._close)

    def picture(self, side: str, wish: Wish) -> Future[tuple[dict[str, Any], bytes]]:
        """Render a frame of a side, in place of one that waits for it.

        Returns
        -------
        about : dict
            For JSON: size, what is drawn on it, its truth, its clip.
        content : bytes
            A JPEG or PNG file: at full size, that of a dataset.

        Raises
        ------
        ScenarioError, RendererError
            By the future: if the frame cannot be. `SupersededError` if another one was wanted meanwhile.
        """
        return self.turns.ask(side, lambda: self._picture(side, wish))

    def stored(self, side: str, wish: Wish) -> Future[bytes]:
        """Give a frame's picture file at full size, after all that waits to be shown; see `picture`."""
        return self.turns.ask(f"stored {side}", lambda: self._stored(side, wish), rank=1)

    def end(self) -> None:
        """Free what was built."""
        self.turns.end()

    def _close(self) -> None:
        for generator in self._generators.values():
            generator.close()

    def _generator(self, side: str, scenario: Scenario) -> FrameGenerator:
        generator = self._generators.get(side)
        if generator is None:
            generator = self._generators[side] = FrameGenerator(scenario)
        elif generator.scenario != scenario:
            generator.revise(scenario)
        return generator

    def _build(self, side: str, wish: Wish) -> None:
        """Build another world where one is needed: for full frames, whose antialiasing small ones lack."""
        scenario = wish.scenario
        parts = [getattr(scenario, name) for name in ("seed", "grab", "jib", "place", "clutter", "vary", "image")]
        if scenario.vary:
            parts.append(scenario.clip.of(wish.frame))
        if wish.small and 0 <= wish.frame < scenario.frames and self._parts.get(side) != parts:
            self._generator(side, scenario).scene(wish.frame)
        self._parts[side] = parts

    def _frame(self, side: str, scenario: Scenario, number: int) -> Frame:
        if not 0 <= number < scenario.frames:
            raise ScenarioError("frames", f"there is no frame {number} of {scenario.frames}")
        generator = self._generator(side, scenario)
        try:
            return generator.frame(number, full=scenario.image.stores_buffers)
        except SimgrabError:
            raise
        except BaseException:  # of unknown cause: the world may be half made
            generator.close()
            raise

    def _picture(self, side: str, wish: Wish) -> tuple[dict[str, Any], bytes]:
        scenario = wish.scenario
        self._build(side, wish)
        if not wish.small:
            frame = self._frame(side, scenario, wish.frame)
            return _about(wish, frame), kept(self._full, wish, lambda: self._encoded(side, frame))
        frame = self._frame(side, kept(self._small, scenario, lambda: reduced(scenario)), wish.frame)
        content = pictures.encode(cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2BGR), "jpeg", _PREVIEW_QUALITY)
        return _about(wish, frame), content

    def _stored(self, side: str, wish: Wish) -> bytes:
        return kept(self._full, wish, lambda: self._encoded(side, self._frame(side, wish.scenario, wish.frame)))

    def _encoded(self, side: str, frame: Frame) -> bytes:
        return next(iter(encoded(self._generators[side], frame).files.values()))


def reduced(scenario: Scenario) -> Scenario:
    """Give the scenario that shows the same in small pictures without antialiasing, which take less time.

    Where no smaller picture is possible, since the display would not fit, the size stays.
    """
    image = msgspec.structs.replace(scenario.image, samples=0, ids=False, depth=False)
    plain = msgspec.structs.replace(scenario, image=image)
    width, height = scenario.camera.width_px, scenario.camera.height_px
    scale = min(PREVIEW_WIDTH_PX / width, 1.0)
    scale = max(scale, _LEAST_PX / min(width, height))
    if scale >= 1:
        return plain
    try:
        return resized(plain, round(width * scale), round(height * scale))
    except ScenarioError:
        return plain


def _about(wish: Wish, frame: Frame) -> dict[str, Any]:
    truth, scenario = frame.truth, wish.scenario
    return {
        "frame": wish.frame, "small": wish.small, "width": truth.width_px, "height": truth.height_px,
        "kind": f"image/{'jpeg' if wish.small else scenario.image.format}",
        "truth": marks(truth, outline(frame.mask, _OUTLINE_WIDTH_PX)) | _geometry(truth),
        "values": truth,
        "frames": scenario.frames, "clip": scenario.clip.of(wish.frame), "timed": not isinstance(scenario.swing, Iid),
    }  # fmt: skip


def _geometry(truth: Truth) -> dict[str, Any]:
    """Give C', G' and the image of the grab centre; None where the picture has none."""
    centre = (truth.grab_u_px, truth.grab_v_px)
    places = {"principal": (truth.cx_px, truth.cy_px), "vertical": vertical(truth), "centre": centre}
    points = {name: np.array(place, float) for name, place in places.items()}
    return {name: point.tolist() if np.isfinite(point).all() else None for name, point in points.items()}
