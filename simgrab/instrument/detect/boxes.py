"""Boxes x0, y0, x1, y1."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from simgrab.model.geometry import Array


def iou(a: ArrayLike, b: ArrayLike) -> Array:
    """Intersection over union of boxes (..., 4), by pairs; 0 where both are empty."""
    common = overlap(a, b)
    return _share(common, area(a) + area(b) - common)


def covered(a: ArrayLike, b: ArrayLike) -> Array:
    """Share of the smaller box that the larger box covers, for pairs of boxes (..., 4): 1 if one contains the other."""
    return _share(overlap(a, b), np.minimum(area(a), area(b)))


def overlap(a: ArrayLike, b: ArrayLike) -> Array:
    """Area that boxes (..., 4) have in common, by pairs."""
    p, q = np.asarray(a, float), np.asarray(b, float)
    return area(np.concatenate([np.maximum(p[..., :2], q[..., :2]), np.minimum(p[..., 2:], q[..., 2:])], axis=-1))


def area(box: ArrayLike) -> Array:
    """Area of boxes (..., 4); 0 for inverted boxes."""
    p = np.asarray(box, float)
    return np.asarray(np.prod(np.maximum(p[..., 2:] - p[..., :2], 0), axis=-1))


def about(middle: Array, half: float | Array) -> Array:
    """Box (4,) about its middle (2,), given half its width and height, or half its side."""
    return np.concatenate([middle - half, middle + half])


def _share(part: Array, whole: Array) -> Array:
    return np.asarray(np.divide(part, whole, out=np.zeros_like(whole), where=whole > 0))
