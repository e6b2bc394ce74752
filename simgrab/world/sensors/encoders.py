"""The crane's encoders of slewing angle, radius and rope length."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simgrab.model.geometry import Array
from simgrab.model.scenario import HoistEncoder, LuffEncoder, SlewEncoder
from simgrab.model.scenario.sensors import Encoder
from simgrab.world.sensors.device import Device
from simgrab.world.sensors.errors import Clock, Open, counted
from simgrab.world.sensors.motion import Motion


class EncoderDevice(Device):
    """The turn of the jib, its radius, or the rope's length."""

    def __init__(self, sensor: Encoder, opened: Open) -> None:
        super().__init__(Clock.draw(sensor.rate_hz, sensor.clock_offset_ms, sensor.clock_drift_ppm, opened))
        self._sensor = sensor
        zero, scale = (float(opened(name).standard_normal()) for name in ("zero", "scale"))
        match sensor:
            case SlewEncoder():
                column, self._scale = "slew [deg]", 1.0
                self._zero, self._resolution = zero * sensor.zero_error_deg, sensor.resolution_deg
            case LuffEncoder() | HoistEncoder():
                column = "radius [m]" if isinstance(sensor, LuffEncoder) else "rope_length [m]"
                self._scale = 1 + scale * sensor.scale_error
                self._zero, self._resolution = zero * sensor.zero_error_m, sensor.resolution_m
        self.columns, self.truth_columns = (column,), ("time [s]", column)

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
