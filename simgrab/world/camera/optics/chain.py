"""From the light before the lens to the picture that the camera gives."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from simgrab.model.geometry import Intrinsics
from simgrab.model.rng import stream
from simgrab.model.scenario import Optics
from simgrab.world.camera.optics.exposure import Exposure
from simgrab.world.camera.optics.focus import defocus
from simgrab.world.camera.optics.lens import chromatic, vignetting
from simgrab.world.camera.optics.light import Light, Picture, luminance, to_display
from simgrab.world.camera.optics.processing import balanced, sharpened
from simgrab.world.camera.optics.sensor import noisy, pattern
from simgrab.world.camera.row_blocks import each_block


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
        See `metered`.

    Returns
    -------
    ndarray of uint8, shape (height, width, 3)
    """
    sharp = chromatic(light, intrinsics, optics.chromatic_px)
    axes = 2 if exposure.grey else 3
    response = _response(intrinsics, axes, optics.vignetting_stops, optics.sensor.fixed_pattern_percent, seed)
    picture = np.empty(light.shape, np.uint8)

    def take(rows: slice) -> None:
        seen = defocus(sharp, optics.defocus_px, rows)
        if exposure.grey:  # without its infrared filter the sensor sees much the same through all three colours
            seen = luminance(seen)
        level = cv2.multiply(seen, response[rows], scale=exposure.gain)
        rng = stream(seed, frame, f"optics.noise.{rows.start}")
        level = noisy(level, optics.sensor, exposure.gain, rng)
        taken = to_display(level if exposure.grey else balanced(level, optics.white_balance))
        picture[rows] = cv2.cvtColor(taken, cv2.COLOR_GRAY2RGB) if exposure.grey else taken

    each_block(len(light), take)
    return sharpened(picture, optics.sharpening)


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
