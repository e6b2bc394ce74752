"""From the light before the lens to the picture that the camera gives."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from simgrab.geometry import Intrinsics
from simgrab.rng import stream
from simgrab.scenario import Optics
from simgrab.world.optics.exposure import Exposure
from simgrab.world.optics.focus import defocus
from simgrab.world.optics.lens import chromatic, vignetting
from simgrab.world.optics.light import Light, Picture, luminance, to_display
from simgrab.world.optics.sensor import noisy, pattern

STRIP_ROWS = 64  # what is done to so many rows stays in the cache: a third less time at 1080p


def expose(
    optics: Optics, light: Light, *, intrinsics: Intrinsics, seed: int, frame: int, exposure: Exposure
) -> Picture:
    """Take a picture. The display and `recompress` come after it.

    Parameters
    ----------
    optics : Optics
    light : ndarray of float32, shape (height, width, 3)
        Linear light before the lens as geometry has it, distortion and motion blur included; 0 or more.
    intrinsics : Intrinsics
        Of the light's size.
    seed, frame : int
        Key the noise.
    exposure : Exposure
        From `ExposureControl`, or `settled` for a frame on its own.

    Returns
    -------
    ndarray of uint8, shape (height, width, 3)
    """
    sharp = chromatic(light, intrinsics, optics.chromatic_px)
    seen = defocus(sharp, optics.defocus_px)
    if exposure.grey:  # without its infrared filter the sensor sees much the same through all three colours
        seen = luminance(seen)
    response = _response(intrinsics, seen.ndim, optics.vignetting_stops, optics.sensor.fixed_pattern_percent, seed)
    picture, rng = np.empty(seen.shape, np.uint8), stream(seed, frame, "optics.noise")
    for top in range(0, len(seen), STRIP_ROWS):
        rows = np.s_[top : top + STRIP_ROWS]
        level = cv2.multiply(seen[rows], response[rows], scale=exposure.gain)
        picture[rows] = to_display(noisy(level, optics.sensor, exposure.gain, rng))
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_GRAY2RGB)) if exposure.grey else picture


@lru_cache(maxsize=2)
def _response(intrinsics: Intrinsics, axes: int, stops: float, fixed_pattern_percent: float, seed: int) -> Light:
    """Signal of each pixel over the light before the lens, shape (height, width) or (height, width, 3)."""
    result = vignetting(intrinsics, stops)
    if axes == 3:
        result = np.asarray(cv2.merge([result] * 3))
    if fixed_pattern_percent:
        result = result * (1 + np.float32(fixed_pattern_percent / 100) * pattern(result.shape, seed))
    result.setflags(write=False)
    return result
