"""The bundled textures, loaded once."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
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


_painting = ContextVar("painting", default=True)


def painting() -> bool:
    """Whether textures are painted; see `unpainted`."""
    return _painting.get()


@contextmanager
def unpainted() -> Iterator[None]:
    """Make shapes without painting their textures, which takes most of the time; what they show then means nothing.

    Whoever paints draws the same random numbers as ever, so that the shapes are the same too.
    """
    token = _painting.set(False)
    try:
        yield
    finally:
        _painting.reset(token)
