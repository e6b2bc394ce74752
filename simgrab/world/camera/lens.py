"""A lens as a map: where each pixel of its picture comes from in the undistorted one."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.model.geometry import Array, Intrinsics
from simgrab.world.camera import changes

Window = changes.Window
KERNEL_PX = 3  # within which lie the pixels that resampling takes


class PictureMap:
    """Where each pixel of a window of the lens' picture comes from in the undistorted one, which may be rendered finer.

    It is made of those undistorted pixels, shape (h, w, 2).
    """

    def __init__(self, ideal: Array) -> None:
        # NumPy goes row by row many times faster than over both axes at once.
        low, high = (np.asarray(of.reduce(of.reduce(ideal))) for of in (np.fmin, np.fmax))
        # Two pixels of margin for the resampling kernel.
        self.source: Window = (*(int(v) - 2 for v in np.floor(low)), *(int(v) + 2 for v in np.ceil(high)))  # type: ignore[assignment]
        # OpenCV counts from the centre of the first pixel.
        at = ideal - self.source[:2]
        at -= 0.5
        self._map = at.astype(np.float32)
        np.copyto(self._map, -10.0, where=np.isnan(self._map))

    def resample(self, picture: NDArray[Any], interpolation: int, outside: float = 0) -> NDArray[Any]:
        """Bend a picture of ``source``; ``interpolation`` is OpenCV's."""
        return cv2.remap(np.ascontiguousarray(picture), self._map, None, interpolation, borderValue=outside)

    def resample_over(
        self, before: NDArray[Any], picture: NDArray[Any], windows: Sequence[Window], interpolation: int
    ) -> NDArray[Any]:
        """Bend a picture that differs in windows alone from one of which ``before`` was made."""
        result, source = before.copy(), np.ascontiguousarray(picture)
        (low, high), (height, width) = self._extents, self._map.shape[:2]
        grid = np.zeros(low.shape[:2], bool)
        for window in windows:
            start, end = np.array(window[:2]) - KERNEL_PX, np.array(window[2:]) + KERNEL_PX
            grid |= ((high > start) & (low < end)).all(axis=-1)
        for x0, y0, x1, y1 in changes.windows(grid, width, height, changes.COPY_PX):
            result[y0:y1, x0:x1] = cv2.remap(source, self._map[y0:y1, x0:x1], None, interpolation)
        return result

    @cached_property
    def _extents(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Least and greatest place, in the undistorted picture, of each tile's pixels: shapes (rows, columns, 2)."""
        low, high = (
            of.reduceat(of.reduceat(self._map, _tiled(self._map, 0), axis=0), _tiled(self._map, 1), axis=1)
            for of in (np.minimum, np.maximum)
        )
        return low, high


def _tiled(values: NDArray[Any], axis: int) -> NDArray[np.int64]:
    return np.arange(0, values.shape[axis], changes.TILE_PX)


class Lens:
    """The maps of one lens, worked out once for the whole picture."""

    def __init__(self, intrinsics: Intrinsics) -> None:
        self._intrinsics = intrinsics
        self._full: Window = (0, 0, intrinsics.width_px, intrinsics.height_px)
        self._ideal = intrinsics.f_px * intrinsics.normalised_centres() + (intrinsics.cx_px, intrinsics.cy_px)
        self._whole = PictureMap(self._ideal)
        self.map = lru_cache(maxsize=1)(self._map)  # where the grab is in the picture, two are the same

    def _map(self, window: Window, finer: int = 1, *, enlarged: bool = False) -> PictureMap:
        """Map a window, rendered ``finer`` or not, to the picture's pixels, or ``enlarged`` to as fine ones."""
        if window == self._full and finer == 1:
            return self._whole
        ideal = self._of(window)
        if enlarged:
            ideal = cv2.resize(ideal, None, fx=finer, fy=finer, interpolation=cv2.INTER_LINEAR)
        return PictureMap(ideal * finer)

    def _of(self, window: Window) -> Array:
        x0, y0, x1, y1 = window
        if x0 >= 0 and y0 >= 0 and x1 <= self._full[2] and y1 <= self._full[3]:
            return self._ideal[y0:y1, x0:x1]
        centres = np.stack(np.meshgrid(np.arange(x0, x1) + 0.5, np.arange(y0, y1) + 0.5), axis=-1)
        return self._intrinsics.undistort(centres)
