"""Linear light and the 8-bit picture, by the transfer function of sRGB (IEC 61966-2-1)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Light = NDArray[np.float32]  # linear, 0 or more, 1 = the picture's white
Picture = NDArray[np.uint8]

BT709 = np.array([0.2126, 0.7152, 0.0722], np.float32)  # luminance of linear red, green and blue
_LEVELS = 65535  # the darkest 8-bit step, 1/(255·12.92), is 20 of these


def _decode(value: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def _encode(light: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(light <= 0.0031308, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055)


_TO_LINEAR = _decode(np.arange(256) / 255).astype(np.float32)
_TO_DISPLAY = (255 * _encode(np.arange(_LEVELS + 1) / _LEVELS)).round().astype(np.uint8)


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
