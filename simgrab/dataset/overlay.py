"""The marks of a frame's truth that are drawn on its picture, px, as plain data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from simgrab.model import geometry
from simgrab.model.geometry import Array, Intrinsics
from simgrab.model.truth import KEYPOINT_NAMES, Truth


def marks(truth: Truth, outline: Sequence[Sequence[float]] | None = None) -> dict[str, Any]:
    """Return box, keypoints and mask.

    Parameters
    ----------
    truth : Truth
    outline : sequence of polygons u0, v0, u1, v1 …, optional
        Outline of the mask.
    """
    points = np.reshape(truth.keypoints, (-1, 3)).tolist()
    box = (truth.box_x0_px, truth.box_y0_px, truth.box_x1_px, truth.box_y1_px)
    return {
        "box": None if None in box else box,
        "keypoints": [[name, *point] for name, point in zip(KEYPOINT_NAMES, points, strict=True) if point[2]],
        "mask": outline,
    }


def principal(truth: Truth) -> tuple[float, float]:
    """Return C', the point where the optical axis meets the picture."""
    return truth.cx_px, truth.cy_px


def vertical(truth: Truth) -> Array:
    """Return G', the image of the vertical, px as the picture has it, shape (2,); NaN beyond the fold of the lens."""
    k = Intrinsics(
        truth.width_px, truth.height_px, truth.fx_px, truth.cx_px, truth.cy_px,
        geometry.Distortion(truth.k1, truth.k2, truth.p1, truth.p2, truth.k3),
    )  # fmt: skip
    axis = geometry.vertical_direction(*np.radians((truth.tilt_azimuth_deg, truth.roll_deg)))
    return k.distort(k.from_polar(k.f_px * np.tan(np.radians(truth.beta_deg)), 0.0, axis))
