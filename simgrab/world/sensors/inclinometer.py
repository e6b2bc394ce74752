"""The inclinometer: slow, and level by apparent gravity."""

from __future__ import annotations

import math

import numpy as np
from scipy import signal

from simgrab.model.geometry import Array
from simgrab.model.scenario import Inclinometer
from simgrab.world.sensors.device import SWING, Device, Setting
from simgrab.world.sensors.errors import SensorClock, SensorErrors
from simgrab.world.sensors.motion import Motion
from simgrab.world.sensors.mounts import Kinematics, body_from_sensor, kinematics

FILTER_HZ = 200.0
"""How often, at least, its filter takes a value."""


class InclinometerDevice(Device):
    """Two angles of apparent gravity behind a low-pass filter."""

    columns = ("tilt_x [deg]", "tilt_y [deg]")
    truth_columns = (
        "time [s]", "apparent_tilt_x [deg]", "apparent_tilt_y [deg]", "tilt_x [deg]", "tilt_y [deg]", *SWING,
    )  # fmt: skip

    def __init__(self, sensor: Inclinometer, setting: Setting) -> None:
        each = math.ceil(FILTER_HZ / sensor.rate_hz)
        clock = SensorClock.draw(each * sensor.rate_hz, sensor, setting.opened)
        super().__init__(clock, each)
        self._sensor, self._scenario = sensor, setting.scenario
        self.body_from_sensor = body_from_sensor(sensor.mount, setting.scenario)
        self._errors = SensorErrors(
            2, setting.opened, density=sensor.noise_deg, bias=sensor.zero_error_deg, resolution=sensor.resolution_deg
        )
        # Exact for a force that goes straight from sample to sample.
        step = 2 * math.pi * sensor.bandwidth_hz / clock.rate_hz
        self._pole = math.exp(-step)
        share = -math.expm1(-step) / step
        self._taps = 1 - share, share - self._pole
        self._state: Array | None = None

    def _read(self, motion: Motion) -> tuple[Array, Array]:
        true = kinematics(self._sensor.mount, motion, self._scenario)
        if self._state is None:  # begins at the first value, without a transient
            self._state = (1 - self._taps[0]) * true.force[:1]
        slow, self._state = signal.lfilter(self._taps, (1, -self._pole), true.force, axis=0, zi=self._state)
        truth = np.hstack([_above_level(true.force), _true_tilt(true), np.degrees(motion.swing).T])
        return self._errors.read(_above_level(slow[self._kept]))[0], truth[self._kept]


def _above_level(force: Array) -> Array:
    """Angles of x and y axes above the plane across a specific force (n, 3), degrees, shape (n, 2)."""
    return np.degrees(np.arcsin(force[:, :2] / np.linalg.norm(force, axis=1, keepdims=True)))


def _true_tilt(true: Kinematics) -> Array:
    """Angles of x and y axes above the horizontal, degrees, shape (n, 2)."""
    return np.degrees(np.arcsin(np.clip(true.attitude[:, 2, :2], -1.0, 1.0)))
