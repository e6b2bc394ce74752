"""A layer of weather before the picture: the share of light it keeps, and the light it adds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from simgrab.world.weather.sight import Picture, Vector

BAND_PX = 16


@dataclass(frozen=True, eq=False)
class Layer:
    """Turns light L into L · keep + glow · colour, for a colour that all layers joined by `behind` share.

    Attributes
    ----------
    keep, glow : ndarray of float32, shape (height, width)
    """

    keep: Picture
    glow: Picture

    def behind(self, front: Layer) -> Layer:
        """Join this layer and one before it, which dims what this one keeps and adds."""
        glow = cv2.multiply(self.glow, front.keep)
        return Layer(cv2.multiply(self.keep, front.keep), cv2.add(glow, front.glow, dst=glow))

    def over(self, light: Picture, colour: Vector) -> Picture:
        """Lay the layer over a picture (height, width, 3)."""
        result, colours = np.empty_like(light), np.tile(np.array(colour, np.float32), (BAND_PX, light.shape[1], 1))
        for rows in bands(len(light)):
            added = cv2.cvtColor(self.glow[rows], cv2.COLOR_GRAY2RGB)
            added *= colours[: len(added)]
            np.multiply(light[rows], cv2.cvtColor(self.keep[rows], cv2.COLOR_GRAY2RGB), out=result[rows])
            result[rows] += added
        return result


def bands(height: int) -> Iterator[slice]:
    """Cut a picture into bands of rows whose intermediate results stay in the processor's cache."""
    return (slice(y, min(y + BAND_PX, height)) for y in range(0, height, BAND_PX))


def matte(keep: Picture, brightness: float = 1.0) -> Layer:
    """Return a layer that is as bright as the colour, times ``brightness``, wherever it hides what lies behind."""
    return Layer(keep, cv2.addWeighted(keep, -brightness, keep, 0.0, brightness))


def clear(shape: tuple[int, int]) -> Layer:
    """Return a layer that changes nothing."""
    return Layer(np.ones(shape, np.float32), np.zeros(shape, np.float32))
