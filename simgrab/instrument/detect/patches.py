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

from simgrab.instrument.detect.boxes import about
from simgrab.model.geometry import Array

Picture = NDArray[np.uint8]

FIND_WIDTH, FIND_HEIGHT = 512, 288
REFINE_SIZE = 160
LEVEL_ROOM = 1.1  # side of a level part over the longer side of the grab's box
VERIFY_SIZE = 224
VERIFY_ROOM = 1.9  # side of verify's crop over the longer side of the grab's box
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


@dataclass(frozen=True, eq=False)
class Level:
    """A square part of a picture, turned so that a direction of the picture becomes its own x axis.

    Attributes
    ----------
    middle : ndarray, shape (2,)
        Middle, px of the picture.
    side : float
        Side, px of the picture.
    angle : float
        Angle of that direction, clockwise from the picture's x axis, rad.
    """

    middle: Array
    side: float
    angle: float

    @property
    def axes(self) -> Array:
        """Its x and y axis in the picture, unit columns, shape (2, 2)."""
        c, s = math.cos(self.angle), math.sin(self.angle)
        return np.array([[c, -s], [s, c]])

    def to_picture(self, shares: ArrayLike) -> Array:
        """Convert points (..., 2) from shares of the part to the picture's pixels."""
        return np.asarray(self.middle + self.side * (np.asarray(shares, float) - 0.5) @ self.axes.T)

    def to_shares(self, points: ArrayLike) -> Array:
        """Convert points (..., 2) from the picture's pixels to shares of the part."""
        return np.asarray((np.asarray(points, float) - self.middle) @ self.axes / self.side + 0.5)


def whole(width: int, height: int, aspect: float = FIND_WIDTH / FIND_HEIGHT, *, centred: bool = True) -> Patch:
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
    patch : Patch
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


def cut_with_mask(picture: Picture, patch: Patch, size: int) -> Picture:
    """Cut a square patch; its fourth channel is the share of each pixel inside the picture, 0 to 255."""
    h, w = picture.shape[:2]
    inside = mask(w, h, patch.corner, patch.size, size)
    return np.concatenate([cut(picture, patch, size, size), inside[..., None]], axis=-1)


def cut_level(picture: Picture, level: Level, size: int) -> Picture:
    """Cut a level part of a picture; its fourth channel is the share of each pixel inside the picture."""
    half = level.side / 2
    upright = around(about(level.middle, half), math.sqrt(2))
    return turned(cut_with_mask(picture, upright, round(math.sqrt(2) * size)), upright, level, size)


def turned(crop: Picture, patch: Patch, level: Level, size: int) -> Picture:
    """Rotate an upright crop to a level part of the same picture.

    Parameters
    ----------
    crop : ndarray of uint8, shape (n, n, 4)
        Crop of ``patch``, with what lies in the picture; as fine as the result, or nearly so.
    patch : Patch
    level : Level
        The level part to cut.
    size : int
        Side of the result, (size, size, 4).
    """
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])  # of the crop
    origin, *ends = level.to_shares(patch.to_picture(corners)) * size
    matrix = np.stack([end - origin for end in ends], axis=1) / crop.shape[0]
    shift = origin + matrix @ [0.5, 0.5] - 0.5  # OpenCV counts from the middle of the first pixel
    return np.asarray(
        cv2.warpAffine(
            crop, np.column_stack([matrix, shift]), (size, size), flags=cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT, borderValue=(GREY, GREY, GREY, 0),
        ),
        np.uint8,
    )  # fmt: skip


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
