"""The bundled textures, loaded once."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from simgrab.io import pictures
from simgrab.io.resources import ASSETS


@cache
def load(name: str) -> NDArray[np.uint8]:
    """Return a texture of the folder ``assets/textures`` as read-only RGB, shape (H, W, 3), uint8."""
    image = pictures.read(ASSETS / "textures" / f"{name}.jpg")
    image.flags.writeable = False
    return image
