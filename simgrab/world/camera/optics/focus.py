"""Defocus: every point becomes a disc, the circle of confusion.

Its diameter is the same all over the picture. A lens of aperture D and focal length f, focused at s, images a point at
distance z as a disc of D·f·|1/s − 1/z|. For the paper's 4.8 mm at f/1.6 and 342.67 px/mm that is 4.93 px·m times the
difference: over the 6 … 45 m at which a grab can hang it varies by 0.71 px whatever the focus, and a lens focused
anywhere beyond 5 m blurs none of them by more than a pixel. A camera that is seen to be out of focus is so everywhere.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from simgrab.world.camera.optics.light import Light

WHOLE = slice(None)
LARGE = 50  # OpenCV sums smaller ones
_FINE = 16  # samples a pixel and axis


def defocus(light: Light, diameter_px: float, rows: slice = WHOLE) -> Light:
    """Spread every point over a disc.

    Parameters
    ----------
    light : ndarray of float32, shape (height, width, 3)
        Taken to go on beyond the border as it is there.
    diameter_px : float
        Of the circle of confusion. Up to a pixel it makes no difference.
    rows : slice
        Of the picture, which to return.
    """
    if diameter_px <= 1:
        return light[rows]
    kernel = disc(diameter_px)
    top, bottom, _ = rows.indices(len(light))
    first = max(top - len(kernel) // 2, 0)
    seen = light[first : bottom + len(kernel) // 2]
    spread = cv2.filter2D(seen, -1, kernel, borderType=cv2.BORDER_REPLICATE)[top - first : bottom - first]
    # Large kernels go through a DFT, which may end below 0.
    return np.asarray(cv2.max(spread, 0.0) if kernel.size >= LARGE else spread)


@lru_cache(maxsize=2)
def disc(diameter_px: float) -> Light:
    """Share of a centred disc that falls into each pixel, shape (n, n), n odd; the sum is 1."""
    half = int(np.ceil(diameter_px / 2 - 0.5))
    n = 2 * half + 1
    at = (np.arange(n * _FINE) + 0.5) / _FINE - n / 2
    inside = np.hypot(at, at[:, None]) <= diameter_px / 2
    share = inside.reshape(n, _FINE, n, _FINE).sum(axis=(1, 3))
    result: Light = (share / share.sum()).astype(np.float32)
    result.setflags(write=False)
    return result
