"""The inertial measurement unit: gyroscope and accelerometer."""

from __future__ import annotations

import math

import numpy as np

from simgrab.model.geometry import Array
from simgrab.model.scenario import Imu
from simgrab.world.sensors.device import SWING, Device, Setting
from simgrab.world.sensors.errors import SensorClock, SensorErrors
from simgrab.world.sensors.motion import Motion
from simgrab.world.sensors.mounts import body_from_sensor, kinematics


class ImuDevice(Device):
    """Gyroscope and accelerometer."""

    columns = (
        *(f"w_RS_S_{axis} [rad s^-1]" for axis in "xyz"),
        *(f"a_RS_S_{axis} [m s^-2]" for axis in "xyz"),
    )  # fmt: skip
    truth_columns = (
        "time [s]", *columns, *(f"b_w_RS_S_{axis} [rad s^-1]" for axis in "xyz"),
        *(f"b_a_RS_S_{axis} [m s^-2]" for axis in "xyz"), *SWING,
    )  # fmt: skip

    def __init__(self, sensor: Imu, setting: Setting) -> None:
        super().__init__(SensorClock.draw(sensor.rate_hz, sensor.errors, setting.opened))
        self._sensor, self._scenario = sensor, setting.scenario
        self.body_from_sensor = body_from_sensor(sensor.mount, setting.scenario)
        self._gyroscope = _errors(sensor, setting, "gyroscope", "deg_s", math.radians(1))
        self._accelerometer = _errors(sensor, setting, "accelerometer", "m_s2", 1.0)

    def _read(self, motion: Motion) -> tuple[Array, Array]:
        true = kinematics(self._sensor.mount, motion, self._scenario)
        rate, rate_bias = self._gyroscope.read(true.rate)
        force, force_bias = self._accelerometer.read(true.force)
        swing = np.degrees(motion.swing).T
        return np.hstack([rate, force]), np.hstack([true.rate, true.force, rate_bias, force_bias, swing])


def _errors(sensor: Imu, setting: Setting, kind: str, unit: str, scale: float) -> SensorErrors:
    """Errors of one of the two triads, whose keys end in a unit of this many SI units."""

    def of(name: str) -> float:
        return float(getattr(sensor.errors, f"{kind}_{name}"))

    limit = getattr(sensor.errors, f"{kind}_range_{unit}")
    drawn = {"scale": "matrix", "zero": "bias"}
    return SensorErrors(
        3, lambda variable: setting.opened(f"{kind}.{drawn.get(variable, variable)}"),
        density=of("noise_density"), walk=of("random_walk"), bias=scale * of(f"bias_{unit}"),
        scale_error=of("scale_error"), misalignment=math.radians(of("misalignment_deg")),
        limit=None if limit is None else scale * limit, resolution=scale * of(f"resolution_{unit}"),
        rate_hz=sensor.rate_hz,
    )  # fmt: skip
