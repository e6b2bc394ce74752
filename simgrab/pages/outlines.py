"""Outlines of masks, as pages draw them."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

_SMOOTH_PX = 0.6  # by which an outline may leave out points


def outline(mask: NDArray[np.bool_], width_px: int) -> list[list[float]]:
    """Trace the outline of a mask.

    Parameters
    ----------
    mask : ndarray of bool, shape (height, width)
    width_px : int
        Of the picture on which it is shown, for which it is made coarser.

    Returns
    -------
    list of polygons u0, v0, u1, v1 …
        In px of the mask.
    """
    scale = min(width_px / mask.shape[1], 1.0)
    size = (max(round(mask.shape[1] * scale), 1), max(round(mask.shape[0] * scale), 1))
    small = cv2.resize(mask.astype(np.uint8) * 255, size, interpolation=cv2.INTER_AREA)
    found, _ = cv2.findContours((small >= 128).astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    factors = np.array([mask.shape[1] / size[0], mask.shape[0] / size[1]])
    lines = [cv2.approxPolyDP(one, _SMOOTH_PX, True)[:, 0] for one in found]
    return [np.round((line + 0.5) * factors, 1).ravel().tolist() for line in lines if len(line) > 2]
