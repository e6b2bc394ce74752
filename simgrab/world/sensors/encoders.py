"""The crane's encoders of slewing angle, radius and rope length."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simgrab.geometry import Array
from simgrab.scenario import HoistEncoder, LuffEncoder, SlewEncoder
from simgrab.scenario.sensors import Encoder
from simgrab.world.sensors.device import Device
from simgrab.world.sensors.errors import Clock, Open, counted
from simgrab.world.sensors.motion import Motion


class EncoderDevice(Device):
    """The turn of the jib, its radius, or the rope's length."""

    def __init__(self, sensor: Encoder, opened: Open) -> None:
        super().__init__(Clock.draw(sensor.rate_hz, sensor.clock_offset_ms, sensor.clock_drift_ppm, opened))
        self._sensor = sensor
        zero, scale = (float(opened(name).standard_normal()) for name in ("zero", "scale"))
        if isinstance(sensor, SlewEncoder):
            self._zero, self._scale, self._resolution = zero * sensor.zero_error_deg, 1.0, sensor.resolution_deg
        else:
            self._zero, self._resolution = zero * sensor.zero_error_m, sensor.resolution_m
            self._scale = 1 + scale * sensor.scale_error

    def _read(self, motion: Motion, kept: NDArray[np.bool_]) -> tuple[Array, Array]:
        assert kept.all()
        match self._sensor:
            case SlewEncoder():
                true = np.degrees(motion.slew)
            case LuffEncoder():
                true = motion.radius
            case HoistEncoder():
                true = motion.rope
        return counted(self._scale * true + self._zero, self._resolution)[:, None], true[:, None]


class SlewDevice(EncoderDevice):
    """Encoder of the slewing angle."""

    columns, truth_columns = ("slew [deg]",), ("time [s]", "slew [deg]")


class LuffDevice(EncoderDevice):
    """Encoder of the radius."""

    columns, truth_columns = ("radius [m]",), ("time [s]", "radius [m]")


class HoistDevice(EncoderDevice):
    """Encoder of the rope length."""

    columns, truth_columns = ("rope_length [m]",), ("time [s]", "rope_length [m]")
