"""Exposure: how much the picture is amplified, and whether it is grey."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from simgrab.scenario import AutoExposure, Optics
from simgrab.world.camera.optics.light import BT709, Light

HYSTERESIS_DB = 6.0  # colour comes back so far below the gain at which it went
_EVERY = 8  # the meter reads every so many pixels of every so many rows
_DARKEST = 1e-6  # mean level at which the meter ends


class Exposure(NamedTuple):
    """What the camera has set for a frame.

    Attributes
    ----------
    gain : float
        Level in the picture over the scene's light. What is below 1 the iris keeps out; above 1 it is amplification.
    grey : bool
        Whether the picture shows luminance alone.
    """

    gain: float
    grey: bool


def settled(optics: Optics, light: Light) -> Exposure:
    """Exposure of a frame on its own: of a camera that has long looked at this light."""
    return ExposureControl(optics, 1.0).next(light)


class ExposureControl:
    """The exposure of a clip's frames, which are to be given in order.

    Parameters
    ----------
    optics : Optics
    frame_rate_hz : float

    Examples
    --------
    >>> from simgrab.scenario import FixedExposure
    >>> control = ExposureControl(Optics(exposure=FixedExposure(exposure_ev=1.0)), 25.0)
    >>> control.next(np.ones((64, 64, 3), np.float32))
    Exposure(gain=2.0, grey=False)
    """

    def __init__(self, optics: Optics, frame_rate_hz: float) -> None:
        self._optics = optics
        self._period_s = 1 / frame_rate_hz
        self._stops: float | None = None
        self._grey = optics.night_mode == "on"

    def next(self, light: Light) -> Exposure:
        """Exposure of the next frame, whose light before the lens has shape (height, width, 3).

        The first one finds the camera settled. Afterwards the gain in stops goes towards what the metered frame asks
        for, 1 − exp(−period/lag) of the way each frame.
        """
        auto = self._optics.exposure
        if not isinstance(auto, AutoExposure):
            return Exposure(2.0**auto.exposure_ev, self._grey)
        wanted = _wanted_stops(auto, light)
        if self._stops is None or auto.lag_s == 0:
            self._stops = wanted
        else:
            self._stops -= math.expm1(-self._period_s / auto.lag_s) * (wanted - self._stops)
        gain = 2.0**self._stops
        if self._optics.night_mode == "auto":
            threshold_db = auto.night_gain_db - (HYSTERESIS_DB if self._grey else 0.0)
            self._grey = 20 * math.log10(gain) >= threshold_db
        return Exposure(gain, self._grey)


def _wanted_stops(auto: AutoExposure, light: Light) -> float:
    mean = float(light[_EVERY // 2 :: _EVERY, _EVERY // 2 :: _EVERY].mean(axis=(0, 1), dtype=np.float64) @ BT709)
    wanted = math.log2(auto.target_level / max(mean, _DARKEST)) + auto.exposure_ev
    return min(wanted, auto.max_gain_db / (20 * math.log10(2)))
