"""A layer of weather before the picture: the share of light it keeps, and the light it adds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from simgrab.world.camera.weather.render_pass import Picture, Vector


@dataclass(frozen=True, eq=False)
class Layer:
    """Turns light L into L · keep + glow · colour, for a colour that all layers joined by `behind` share.

    Attributes
    ----------
    keep, glow : ndarray of float32, shape (height, width)
        Of the picture, or of a block of its rows.
    """

    keep: Picture
    glow: Picture

    def block(self, rows: slice) -> Layer:
        """Return some rows."""
        return Layer(self.keep[rows], self.glow[rows])

    def behind(self, front: Layer) -> Layer:
        """Join this layer and one before it, which dims what this one keeps and adds."""
        glow = cv2.multiply(self.glow, front.keep)
        return Layer(cv2.multiply(self.keep, front.keep), cv2.add(glow, front.glow, dst=glow))

    def over(self, light: Picture, colour: Vector) -> Picture:
        """Lay the layer over a picture (height, width, 3)."""
        added = cv2.cvtColor(self.glow, cv2.COLOR_GRAY2RGB)
        by_row = added.reshape(len(added), -1)
        by_row *= np.tile(np.array(colour, np.float32), added.shape[1])
        result = cv2.cvtColor(self.keep, cv2.COLOR_GRAY2RGB)
        cv2.multiply(result, light, dst=result)
        return np.asarray(cv2.add(result, added, dst=result))


Maker = Callable[[slice], Layer | None]  # makes a block of a layer; None where that changes nothing


def matte(keep: Picture, brightness: float = 1.0) -> Layer:
    """Return a layer that is as bright as the colour, times ``brightness``, wherever it hides what lies behind."""
    return Layer(keep, cv2.addWeighted(keep, -brightness, keep, 0.0, brightness))
