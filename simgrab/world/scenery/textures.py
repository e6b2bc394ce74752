"""The bundled textures, loaded once."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from simgrab.io import pictures
from simgrab.io.resources import ASSETS


@cache
def load(name: str) -> NDArray[np.uint8]:
    """Return the texture ``assets/textures/<name>.jpg`` or ``.png`` as read-only RGB, shape (H, W, 3), uint8."""
    for suffix in (".jpg", ".png"):
        path = ASSETS / "textures" / f"{name}{suffix}"
        if path.is_file():
            image = pictures.read(path)
            image.flags.writeable = False
            return image
    raise FileNotFoundError(f"no texture {name!r} in {ASSETS / 'textures'}")
