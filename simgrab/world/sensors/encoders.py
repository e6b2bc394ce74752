"""The crane's encoders of slewing angle, radius and rope length."""

from __future__ import annotations

import numpy as np

from simgrab.model.geometry import Array
from simgrab.model.scenario import HoistEncoder, LuffEncoder, SlewEncoder
from simgrab.model.scenario.sensors import Encoder
from simgrab.world.sensors.device import Device, Setting
from simgrab.world.sensors.errors import SensorClock, SensorErrors
from simgrab.world.sensors.motion import Motion

COLUMNS = {SlewEncoder: "slew [deg]", LuffEncoder: "radius [m]", HoistEncoder: "rope_length [m]"}


class EncoderDevice(Device):
    """The turn of the jib, its radius, or the rope's length."""

    def __init__(self, sensor: Encoder, setting: Setting) -> None:
        super().__init__(SensorClock.draw(sensor.rate_hz, sensor, setting.opened))
        column = COLUMNS[type(sensor)]
        self.columns, self.truth_columns, self._sensor = (column,), ("time [s]", column), sensor
        if isinstance(sensor, SlewEncoder):
            zero, scale, resolution = sensor.zero_error_deg, 0.0, sensor.resolution_deg
        else:
            zero, scale, resolution = sensor.zero_error_m, sensor.scale_error, sensor.resolution_m
        self._errors = SensorErrors(1, setting.opened, bias=zero, scale_error=scale, resolution=resolution)

    def _read(self, motion: Motion) -> tuple[Array, Array]:
        match self._sensor:
            case SlewEncoder():
                true = np.degrees(motion.slew)
            case LuffEncoder():
                true = motion.radius
            case HoistEncoder():
                true = motion.rope
        return self._errors.read(true[:, None])[0], true[:, None]
