"""What pages draw of a frame's truth on its picture: outlines of masks, boxes, keypoints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.model.truth import KEYPOINT_NAMES, Truth

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


def marks(truth: Truth, mask: Sequence[Sequence[float]] | None) -> dict[str, Any]:
    """Return box and keypoints, px, beside the `outline` of the mask, as plain data."""
    points = np.reshape(truth.keypoints, (-1, 3)).tolist()
    box = (truth.box_x0_px, truth.box_y0_px, truth.box_x1_px, truth.box_y1_px)
    return {
        "box": None if None in box else box,
        "keypoints": [[name, *point] for name, point in zip(KEYPOINT_NAMES, points, strict=True) if point[2]],
        "mask": mask,
    }
