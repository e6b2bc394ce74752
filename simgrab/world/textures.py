"""The bundled textures, loaded once."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.resources import ASSETS


@cache
def load(name: str) -> NDArray[np.uint8]:
    """Return the texture ``assets/textures/<name>.jpg`` or ``.png`` as read-only RGB, shape (H, W, 3), uint8."""
    for suffix in (".jpg", ".png"):
        path = ASSETS / "textures" / f"{name}{suffix}"
        if path.is_file():
            image = cv2.cvtColor(cv2.imread(str(path), cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)
            image.flags.writeable = False
            return np.asarray(image, np.uint8)
    raise FileNotFoundError(f"no texture {name!r} in {ASSETS / 'textures'}")
