"""Seamless noise whose values are ranks, so that the part of it below p covers the share p."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from simgrab.model.geometry import Array
from simgrab.model.rng import stream
from simgrab.world.camera.weather.render_pass import Picture

SIDE = 1024


@lru_cache(maxsize=8)
def tile(seed: int, index: int, name: str, exponent: float) -> Picture:
    """Return noise of the spectrum f^−exponent, evenly distributed over [0, 1), periodic.

    Shape (1025, 1025): the first row and column come again, so that it can be sampled up to its end.
    """
    white = stream(seed, index, name).standard_normal((SIDE, SIDE))
    f = np.hypot(np.fft.fftfreq(SIDE)[:, None], np.fft.rfftfreq(SIDE)[None, :])
    f[0, 0] = np.inf
    field = np.fft.irfft2(np.fft.rfft2(white) * f**-exponent, (SIDE, SIDE))
    return np.pad(ranked(field), (0, 1), mode="wrap")


def ranked(field: Array | Picture, within: float = 0.0) -> Picture:
    """Ranks of a field's values, of its shape: that of the k-th least is (k + within) / size. Equal ones keep order."""
    ranks = np.empty(field.size, np.float32)
    ranks[np.argsort(field, axis=None, kind="stable")] = (np.arange(field.size) + within) / field.size
    return ranks.reshape(field.shape)


def look_up(noise: Picture, x: Picture, y: Picture, span: float) -> Picture:
    """Sample a tile that spans ``span`` and repeats, at places of any shape (height, width)."""
    return cv2.remap(noise, _wrapped(x, span), _wrapped(y, span), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _wrapped(at: Picture, span: float) -> Picture:
    """Texels of a tile, 0 … 1024."""
    turns = at * np.float32(1 / span)
    turns -= np.floor(turns)
    turns *= np.float32(SIDE)
    return turns


def covered(noise: Picture, share: float, softness: float) -> Picture:
    """Return how far each place is covered when ``share`` of all is: 0, 1, or between at edges ``softness`` wide."""
    softness = min(softness, 2 * share, 2 * (1 - share))
    if softness == 0:
        return np.full_like(noise, share)
    return np.clip((share - noise) / np.float32(softness) + np.float32(0.5), 0, 1)
