"""The inertial measurement unit: gyroscope and accelerometer."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from simgrab.model.geometry import Array
from simgrab.model.scenario import Imu, Scenario
from simgrab.world.sensors.device import SWING, Device
from simgrab.world.sensors.errors import Clock, Open, Triad
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

    def __init__(self, sensor: Imu, scenario: Scenario, opened: Open) -> None:
        errors, rate = sensor.errors, sensor.rate_hz
        super().__init__(Clock.draw(rate, errors.clock_offset_ms, errors.clock_drift_ppm, opened))
        self._sensor, self._scenario = sensor, scenario
        self.body_from_sensor = body_from_sensor(sensor.mount, scenario)
        limit = errors.gyroscope_range_deg_s
        self._gyroscope = Triad(
            density=errors.gyroscope_noise_density, walk=errors.gyroscope_random_walk,
            bias=math.radians(errors.gyroscope_bias_deg_s), scale_error=errors.gyroscope_scale_error,
            misalignment=math.radians(errors.gyroscope_misalignment_deg),
            limit=None if limit is None else math.radians(limit),
            resolution=math.radians(errors.gyroscope_resolution_deg_s), rate_hz=rate,
            opened=lambda variable: opened(f"gyroscope.{variable}"),
        )  # fmt: skip
        self._accelerometer = Triad(
            density=errors.accelerometer_noise_density, walk=errors.accelerometer_random_walk,
            bias=errors.accelerometer_bias_m_s2, scale_error=errors.accelerometer_scale_error,
            misalignment=math.radians(errors.accelerometer_misalignment_deg), limit=errors.accelerometer_range_m_s2,
            resolution=errors.accelerometer_resolution_m_s2, rate_hz=rate,
            opened=lambda variable: opened(f"accelerometer.{variable}"),
        )  # fmt: skip

    def _read(self, motion: Motion, kept: NDArray[np.bool_]) -> tuple[Array, Array]:
        assert kept.all()
        true = kinematics(self._sensor.mount, motion, self._scenario)
        rate, rate_bias = self._gyroscope.read(true.rate)
        force, force_bias = self._accelerometer.read(true.force)
        swing = np.degrees(motion.swing).T
        return np.hstack([rate, force]), np.hstack([true.rate, true.force, rate_bias, force_bias, swing])
