"""The photograph that a frame shows in place of the ground, in the pixels that the renderer draws."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.errors import ScenarioError
from simgrab.io import models, photographs
from simgrab.model.rng import stream
from simgrab.model.scenario import Iid, Photo, Scenario
from simgrab.world.camera.lens import Window

_REFUSE = partial(ScenarioError, "place.file")


class Background:
    """The photographs of a scenario's place, which is a `Photo`, as its camera sees them.

    Frames of a ``split`` show photographs of theirs alone, where there are enough.
    """

    def __init__(self, scenario: Scenario, split: Callable[[int], str]) -> None:
        place = scenario.place
        assert isinstance(place, Photo)
        self._scenario = scenario
        self._pictures = photographs.Sequence(models.recall(place.sha256, place.file, _REFUSE), _REFUSE)
        self._split, self._shared_out = split, self._pictures.shared_out(scenario.splits.shares)

    def number(self, frame: int) -> int:
        """Choose the photograph that a frame shows: of a video in order, else random of those of the frame's split."""
        scenario = self._scenario
        clip = scenario.clip.of(frame)
        if self._pictures.is_video:
            return (frame - scenario.span(clip).start) % len(self._pictures)
        of = frame if isinstance(scenario.swing, Iid) else clip
        own = self._shared_out[self._split(frame)] if self._shared_out else range(len(self._pictures))
        return own[int(stream(scenario.seed, of, "place.photo").integers(len(own)))]

    def picture(self, number: int, drawn: Window) -> NDArray[np.uint8]:
        """Scale and cut a photograph to the picture, and take the lens' distortion out of it.

        Returns the window that is drawn of the undistorted picture, shape (h, w, 3): the lens then shows the photograph
        as it is.
        """
        k = self._scenario.camera.intrinsics
        fitted = _covering(self._pictures[number], k.width_px, k.height_px)
        if k.distortion.is_null:
            return fitted
        x0, y0, x1, y1 = drawn
        ideal = np.stack(np.meshgrid(np.arange(x0, x1) + 0.5, np.arange(y0, y1) + 0.5), axis=-1)
        at = (k.distort(ideal) - 0.5).astype(np.float32)
        return np.asarray(cv2.remap(fitted, at, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101))


def _covering(picture: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    """Scale a picture evenly until it covers a size, and cut its middle out."""
    rows, columns = picture.shape[:2]
    scale = max(width / columns, height / rows)
    cut_width, cut_height = min(round(width / scale), columns), min(round(height / scale), rows)
    x, y = (columns - cut_width) // 2, (rows - cut_height) // 2
    part = np.ascontiguousarray(picture[y : y + cut_height, x : x + cut_width])
    return np.asarray(cv2.resize(part, (width, height), interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC))
