"""What a camera does with the signal after the sensor: white balance and sharpening."""

from __future__ import annotations

import cv2
import numpy as np

from simgrab.model.scenario.optics import Sharpening
from simgrab.world.camera.optics.light import Light, Picture

NEUTRAL = (1.0, 1.0, 1.0)


def balanced(level: Light, gains: tuple[float, float, float]) -> Light:
    """Multiply the colours of a signal (height, width, 3)."""
    return level if gains == NEUTRAL else level * np.array(gains, np.float32)


def sharpened(picture: Picture, by: Sharpening) -> Picture:
    """Sharpen a picture (height, width, 3) of 8-bit values by an unsharp mask."""
    if not by.amount:
        return picture
    blurred = cv2.GaussianBlur(picture, (0, 0), by.radius_px, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(cv2.addWeighted(picture, 1 + by.amount, blurred, -by.amount, 0))
