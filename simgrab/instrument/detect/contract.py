"""The contract of every detector."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from simgrab.errors import DetectorError
from simgrab.model.records.observations import Detection


class Detector(Protocol):
    """Finds the grab in a picture."""

    @property
    def name(self) -> str:
        """Name in reports."""

    def __call__(self, picture: NDArray[np.uint8]) -> Detection:
        """Detect the grab in a picture, RGB, (height, width, 3).

        Raises
        ------
        DetectorError
            If the array is not a picture. A picture without a grab returns a `Detection` with status ``"none"``.
        """


LEAST_PX = 32


def check(picture: NDArray[np.uint8]) -> None:
    """Refuse an array that is not an RGB picture.

    Raises
    ------
    DetectorError
    """
    kind: object = getattr(picture, "dtype", type(picture).__name__)
    shape: tuple[int, ...] = getattr(picture, "shape", ())
    if kind != np.uint8 or len(shape) != 3 or shape[2] != 3:
        raise DetectorError(f"a picture is uint8 of shape (height, width, 3), RGB; got {kind} of shape {shape}")
    if min(shape[:2]) < LEAST_PX:
        raise DetectorError(f"a picture of {shape[1]}x{shape[0]} is too small: {LEAST_PX} px a side at least")
