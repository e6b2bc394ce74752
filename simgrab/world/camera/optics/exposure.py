"""Exposure: how much the picture is amplified, and whether it is grey."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from simgrab.model.scenario import AutoExposure, Optics
from simgrab.world.camera.optics.light import BT709, Light

HYSTERESIS_DB = 6.0  # colour comes back so far below the gain at which it went
_EVERY = 8  # the meter reads every so many pixels of every so many rows
_DARKEST = 1e-6  # mean level at which the meter ends


class Exposure(NamedTuple):
    """What the camera has set for a frame.

    Attributes
    ----------
    stops : float
        Binary logarithm of the gain: of the level in the picture over the scene's light. What is below 0 the iris keeps
        out; above 0 it is amplification.
    grey : bool
        Whether the picture shows luminance alone.
    """

    stops: float
    grey: bool

    @property
    def gain(self) -> float:
        """Level in the picture over the scene's light."""
        return float(2.0**self.stops)


def metered(optics: Optics, light: Light, before: Exposure | None = None, *, period_s: float = 1.0) -> Exposure:
    """Exposure of a frame by its own light and by the exposure of the frame before.

    Parameters
    ----------
    optics : Optics
    light : ndarray of float32, shape (height, width, 3)
        Before the lens.
    before : Exposure, optional
        Of the clip's frame before: the gain in stops goes from there towards what this light asks for,
        1 − exp(−period/lag) of the way. Without one the camera has settled.
    period_s : float
        From frame to frame.

    Examples
    --------
    >>> from simgrab.model.scenario import FixedExposure
    >>> metered(Optics(exposure=FixedExposure(exposure_ev=1.0)), np.ones((64, 64, 3), np.float32))
    Exposure(stops=1.0, grey=False)
    """
    auto, grey = optics.exposure, before.grey if before else optics.night_mode == "on"
    if not isinstance(auto, AutoExposure):
        return Exposure(auto.exposure_ev, grey)
    stops = _wanted_stops(auto, light)
    if before and auto.lag_s > 0:
        stops = before.stops - math.expm1(-period_s / auto.lag_s) * (stops - before.stops)
    if optics.night_mode == "auto":
        threshold_db = auto.night_gain_db - (HYSTERESIS_DB if grey else 0.0)
        grey = 20 * math.log10(2.0**stops) >= threshold_db
    return Exposure(stops, grey)


def _wanted_stops(auto: AutoExposure, light: Light) -> float:
    mean = float(light[_EVERY // 2 :: _EVERY, _EVERY // 2 :: _EVERY].mean(axis=(0, 1), dtype=np.float64) @ BT709)
    wanted = math.log2(auto.target_level / max(mean, _DARKEST)) + auto.exposure_ev
    return min(wanted, auto.max_gain_db / (20 * math.log10(2)))
