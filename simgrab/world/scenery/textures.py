"""The bundled textures, loaded once."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.io import pictures
from simgrab.io.resources import ASSETS


@cache
def load(name: str, side: int | None = None) -> NDArray[np.uint8]:
    """Return a texture of the folder ``assets/textures`` as read-only RGB, shape (H, W, 3), uint8.

    With ``side``, it is scaled to a square of so many pixels a side.
    """
    if side is None:
        image = pictures.read(ASSETS / "textures" / f"{name}.jpg")
    else:
        image = np.asarray(cv2.resize(load(name), (side, side), interpolation=cv2.INTER_AREA), np.uint8)
    image.flags.writeable = False
    return image
