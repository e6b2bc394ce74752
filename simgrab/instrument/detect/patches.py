"""Parts of a picture as input of nets, and the mapping back to the picture's pixels.

A patch is a rectangle of whole pixels, which may reach beyond the picture, shrunk to a net's size by area. Shares of a
patch run from 0 at its first corner to 1 at its last, so that both ends and everything between map exactly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from simgrab.model.geometry import Array

Picture = NDArray[np.uint8]

COARSE_WIDTH, COARSE_HEIGHT = 384, 224
POSE_SIZE, POSE_CHANNELS = 192, 6
GREY = 114  # of what lies beyond the picture; the colour YOLO letterboxes with


@dataclass(frozen=True)
class Patch:
    """A rectangle of whole pixels, half open; it may reach beyond the picture."""

    x0: int
    y0: int
    x1: int
    y1: int

    @property
    def corner(self) -> Array:
        """Its first corner, px."""
        return np.array([self.x0, self.y0], float)

    @property
    def size(self) -> Array:
        """Width and height, px."""
        return np.array([self.x1 - self.x0, self.y1 - self.y0], float)

    @property
    def box(self) -> Array:
        """First and last corner, px: (4,)."""
        return np.array([self.x0, self.y0, self.x1, self.y1], float)

    def to_picture(self, shares: ArrayLike) -> Array:
        """Convert points (..., 2) from shares of the patch to the picture's pixels."""
        return np.asarray(self.corner + np.asarray(shares, float) * self.size)

    def to_shares(self, points: ArrayLike) -> Array:
        """Convert points (..., 2) from the picture's pixels to shares of the patch."""
        return np.asarray((np.asarray(points, float) - self.corner) / self.size)


def whole(width: int, height: int, aspect: float = COARSE_WIDTH / COARSE_HEIGHT, *, centred: bool = True) -> Patch:
    """Smallest patch of an aspect (width over height) that holds a whole picture, in its middle or at its top left."""
    wide = max(width, round(height * aspect))
    high = max(height, round(wide / aspect))
    x0, y0 = ((width - wide) // 2, (height - high) // 2) if centred else (0, 0)
    return Patch(x0, y0, x0 + wide, y0 + high)


def around(box: ArrayLike, factor: float) -> Patch:
    """Square patch around a box x0, y0, x1, y1; its side is ``factor`` times the longer side, even, at least 16 px."""
    x0, y0, x1, y1 = np.asarray(box, float)
    side = max(2 * math.ceil(factor * max(x1 - x0, y1 - y0) / 2), 16)
    left, top = round((x0 + x1 - side) / 2), round((y0 + y1 - side) / 2)
    return Patch(left, top, left + side, top + side)


def cut(picture: Picture, patch: Patch, width: int, height: int) -> Picture:
    """Cut a patch out of a picture and resize it, by area.

    Parameters
    ----------
    picture : ndarray of uint8, shape (h, w, channels)
    width, height : int
        Size of the result.

    Returns
    -------
    ndarray of uint8, shape (height, width, channels)
        Grey beyond the picture.
    """
    content = _content(picture, patch)
    h, w = content.shape[:2]
    if h >= 2 * height and w >= 2 * width and h % 2 == w % 2 == 0:  # a whole number of pixels to one: far faster
        content = cv2.resize(content, (w // 2, h // 2), interpolation=cv2.INTER_AREA)
    return cv2.resize(content, (width, height), interpolation=cv2.INTER_AREA)


def cut_crop(picture: Picture, patch: Patch, size: int) -> Picture:
    """Cut a square patch for the pose net.

    Returns
    -------
    ndarray of uint8, shape (size, size, 6)
        Red, green and blue; the share of each pixel inside the picture; and `places`.
    """
    h, w = picture.shape[:2]
    inside = mask(w, h, patch.corner, patch.size, size)
    where = as_bytes(places(w, h, patch.corner, patch.size, size))
    return np.concatenate([cut(picture, patch, size, size), inside[..., None], where], axis=-1)


def mirror(crop: Picture) -> Picture:
    """Mirror a crop of `cut_crop` left to right, as if the whole picture were mirrored."""
    result = crop[:, ::-1].copy()
    result[..., 4] = np.minimum(256 - result[..., 4].astype(int), 255)  # `as_bytes` of the opposite place
    return result


def places(width: int, height: int, corner: Array, extent: Array, size: int) -> Array:
    """Where each pixel of a part, as of `mask`, lies: from the middle, in the picture's widths, (size, size, 2)."""
    steps = (np.arange(size) + 0.5) / size
    x, y = (corner[:, None] + steps * extent[:, None] - np.array([[width], [height]]) / 2) / width
    return np.stack(np.meshgrid(x, y), axis=-1)


def as_bytes(where: Array) -> Picture:
    """Quantise `places`: 128 is the picture's middle, 0 and 255 lie a width from it or farther."""
    return np.clip(np.rint(128 + 127 * where), 0, 255).astype(np.uint8)


def mask(width: int, height: int, corner: Array, extent: Array, size: int) -> Picture:
    """Share of each pixel of a part that lies inside the picture, 0 to 255.

    Parameters
    ----------
    width, height : int
        Size of the picture.
    corner, extent : ndarray, shape (2,)
        First corner, and width and height of the part, px of the picture.
    size : int
        Side of the result, (size, size).
    """
    edges = np.linspace(0, 1, size + 1)
    columns, rows = (
        np.diff(np.clip(corner[axis] + edges * extent[axis], 0, limit)) * size / extent[axis]
        for axis, limit in ((0, width), (1, height))
    )
    return np.round(255 * np.outer(rows, columns)).astype(np.uint8)


def _content(picture: Picture, patch: Patch) -> Picture:
    h, w = picture.shape[:2]
    x0, x1 = (min(max(x, 0), w) for x in (patch.x0, patch.x1))
    y0, y1 = (min(max(y, 0), h) for y in (patch.y0, patch.y1))
    inside = picture[y0:y1, x0:x1]
    wide, high = patch.x1 - patch.x0, patch.y1 - patch.y0
    if inside.shape[:2] == (high, wide):
        return inside
    result = np.full((high, wide, picture.shape[2]), GREY, np.uint8)
    result[y0 - patch.y0 : y1 - patch.y0, x0 - patch.x0 : x1 - patch.x0] = inside
    return result
