"""Cut the digits out of a picture: one crop for each cell, as input of the net."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.errors import ReaderError
from simgrab.model.layouts import Layout, Rectangle

INPUT_PX = 32  # LeNet-5's
MARGIN = 1 / 8  # of a cell's width and height, around it

Picture = NDArray[np.uint8]
Crops = NDArray[np.float32]


def fitted(picture: Picture, layout: Layout) -> Layout:
    """Check a picture and fit a layout to it.

    Parameters
    ----------
    picture : ndarray of uint8, shape (height, width, 3) or (height, width)
        RGB or grey.
    layout : Layout
        Layout with the picture's aspect ratio; its size may differ.

    Raises
    ------
    ReaderError
        If the array is not a picture, or its aspect ratio differs from the layout's.
    LayoutError
        If the digits would be too small.
    """
    if not isinstance(picture, np.ndarray) or picture.dtype != np.uint8:
        kind = getattr(picture, "dtype", type(picture).__name__)
        raise ReaderError(f"a picture must be an array of uint8, got {kind}")
    if not (picture.ndim == 2 or (picture.ndim == 3 and picture.shape[2] == 3)):
        raise ReaderError(f"a picture must have the shape (height, width, 3) or (height, width), got {picture.shape}")
    height, width = picture.shape[:2]
    if (width, height) == (layout.width_px, layout.height_px):
        return layout
    # A scaled stream is off by less than a pixel either way.
    if abs(width * layout.height_px - height * layout.width_px) >= max(layout.width_px, layout.height_px):
        raise ReaderError(
            f"a picture of {width} x {height} px does not have the aspect ratio of the layout, "
            f"{layout.width_px} x {layout.height_px} px"
        )
    return layout.scaled(width, height)


def crops(picture: Picture, layout: Layout) -> Crops:
    """Cut out the eight digits.

    Parameters
    ----------
    picture : ndarray of uint8, shape (height, width, 3) or (height, width)
    layout : Layout
        Fitted to the picture.

    Returns
    -------
    ndarray of float32, shape (8, 1, 32, 32)
        Grey in [−0.5, 0.5], cells and a `MARGIN` around them.
    """
    return np.stack([entered(cut(picture, around(cell))) for cell in layout.cells])[:, None]


def around(cell: Rectangle, more_px: int = 0) -> Rectangle:
    """Grow a cell by its margin, and by additional pixels."""
    x0, y0, x1, y1 = cell
    dx, dy = round(MARGIN * (x1 - x0)) + more_px, round(MARGIN * (y1 - y0)) + more_px
    return x0 - dx, y0 - dy, x1 + dx, y1 + dy


def cut(picture: Picture, box: Rectangle) -> Picture:
    """Cut a grey box out of a picture; border pixels are repeated outside of it."""
    x0, y0, x1, y1 = box
    height, width = picture.shape[:2]
    inside = picture[max(y0, 0) : min(y1, height), max(x0, 0) : min(x1, width)]
    grey = inside if inside.ndim == 2 else cv2.cvtColor(inside, cv2.COLOR_RGB2GRAY)
    beyond = max(-y0, 0), max(y1 - height, 0), max(-x0, 0), max(x1 - width, 0)
    return np.asarray(cv2.copyMakeBorder(grey, *beyond, cv2.BORDER_REPLICATE) if any(beyond) else grey)


def entered(grey: Picture) -> Crops:
    """Scale a grey box, (h, w), to the net's input, (32, 32)."""
    small = cv2.resize(grey, (INPUT_PX, INPUT_PX), interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.float32) / np.float32(255) - np.float32(0.5)
