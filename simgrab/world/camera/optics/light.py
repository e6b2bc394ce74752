"""Linear light and the 8-bit picture, by the transfer function of sRGB (IEC 61966-2-1)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.model.srgb import decoded, encoded

Light = NDArray[np.float32]  # linear, 0 or more, 1 = the picture's white
Picture = NDArray[np.uint8]

BT709 = np.array([0.2126, 0.7152, 0.0722], np.float32)  # luminance of linear red, green and blue
_LEVELS = 65535  # the darkest 8-bit step, 1/(255·12.92), is 20 of these


_TO_LINEAR = decoded(np.arange(256) / 255).astype(np.float32)
_TO_DISPLAY = (255 * encoded(np.arange(_LEVELS + 1) / _LEVELS)).round().astype(np.uint8)


def to_linear(rgb: Picture) -> Light:
    """Linear light, 0 … 1, of a picture's values; `to_display` gives back every one of them."""
    return np.asarray(cv2.LUT(rgb, _TO_LINEAR))


def to_display(light: Light) -> Picture:
    """Values of a picture that shows linear light of any shape; what is above 1 or below 0 is clipped."""
    levels = cv2.addWeighted(light, _LEVELS, light, 0, 0, dtype=cv2.CV_16U)
    return np.asarray(cv2.LUT(levels, _TO_DISPLAY))


def luminance(light: Light) -> Light:
    """Luminance, shape (height, width), of light of shape (height, width, 3)."""
    return np.asarray(cv2.transform(light, BT709[None]))
