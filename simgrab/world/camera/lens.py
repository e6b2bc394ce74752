"""A lens as a map: where each pixel of its picture comes from in the undistorted one."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.model.geometry import Array, Intrinsics

Window = tuple[int, int, int, int]  # x0, y0, x1, y1 in pixels of the picture, half open; may reach beyond it


class PictureMap:
    """Where each pixel of a window of the lens' picture comes from in the undistorted one.

    Parameters
    ----------
    ideal : ndarray, shape (h, w, 2)
        Undistorted pixels, of a picture that may be rendered finer.
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
        source = np.ascontiguousarray(picture)
        return cv2.remap(source, self._map, None, interpolation, borderMode=cv2.BORDER_CONSTANT, borderValue=outside)


class Lens:
    """The maps of one lens, worked out once for the whole picture."""

    def __init__(self, intrinsics: Intrinsics) -> None:
        self._intrinsics = intrinsics
        self._full: Window = (0, 0, intrinsics.width_px, intrinsics.height_px)
        self._ideal = intrinsics.undistorted_centres()
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
