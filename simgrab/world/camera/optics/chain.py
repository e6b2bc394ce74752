"""From the light before the lens to the picture that the camera gives."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from simgrab.model.geometry import Intrinsics
from simgrab.model.rng import stream
from simgrab.model.scenario import Optics
from simgrab.model.scenario.optics import Sharpening
from simgrab.world.camera.optics.exposure import Exposure
from simgrab.world.camera.optics.focus import defocus
from simgrab.world.camera.optics.lens import chromatic, vignetting
from simgrab.world.camera.optics.light import Light, Picture, luminance, to_display
from simgrab.world.camera.optics.sensor import noisy, pattern
from simgrab.world.camera.row_blocks import each_block

NEUTRAL = (1.0, 1.0, 1.0)


def expose(
    optics: Optics, light: Light, *, intrinsics: Intrinsics, seed: int, frame: int, exposure: Exposure
) -> Picture:
    """Take a picture, uint8 of shape (height, width, 3). The display and `recompress` come after it.

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
        if not exposure.grey and optics.white_balance != NEUTRAL:
            level = level * np.array(optics.white_balance, np.float32)
        taken = to_display(level)
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


def sharpened(picture: Picture, by: Sharpening) -> Picture:
    """Sharpen a picture (height, width, 3) of 8-bit values by an unsharp mask."""
    if not by.amount:
        return picture
    blurred = cv2.GaussianBlur(picture, (0, 0), by.radius_px, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(cv2.addWeighted(picture, 1 + by.amount, blurred, -by.amount, 0))


def recompress(rgb: Picture, quality: int) -> Picture:
    """Code and decode a finished picture, display included: what a still taken out of a stream looks like.

    JPEG stands in for the stream's key frames. Both quantise a block transform, so blocks, ringing and coarse chroma
    look alike; H.264's deblocking and what it carries over from frame to frame are not here. A clip's are in its video.

    Parameters
    ----------
    rgb : ndarray of uint8, shape (height, width, 3)
    quality : int
        JPEG quality 1 … 100 with chroma at half the resolution; 0 leaves the picture alone.
    """
    if quality == 0:
        return rgb
    _, data = cv2.imencode(".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.cvtColor(cv2.imdecode(data, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB))
