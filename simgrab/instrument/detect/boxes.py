"""Boxes x0, y0, x1, y1."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from simgrab.geometry import Array


def iou(a: ArrayLike, b: ArrayLike) -> Array:
    """Intersection over union of boxes (..., 4), by pairs; 0 where both are empty."""
    p, q = np.asarray(a, float), np.asarray(b, float)
    sides = np.minimum(p[..., 2:], q[..., 2:]) - np.maximum(p[..., :2], q[..., :2])
    overlap = np.prod(np.maximum(sides, 0), axis=-1)
    both = area(p) + area(q) - overlap
    return np.asarray(np.divide(overlap, both, out=np.zeros_like(both), where=both > 0))


def area(box: ArrayLike) -> Array:
    """Area of boxes (..., 4); 0 of those that end before they begin."""
    p = np.asarray(box, float)
    return np.asarray(np.prod(np.maximum(p[..., 2:] - p[..., :2], 0), axis=-1))
