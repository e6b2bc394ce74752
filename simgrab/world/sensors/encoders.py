"""The crane's encoders of slewing angle, radius and rope length, and its controller, which knows more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from simgrab.model.geometry import Array
from simgrab.model.scenario import Controller, HoistEncoder, LuffEncoder, SlewEncoder
from simgrab.model.scenario.sensors import Encoder
from simgrab.world.scenery.grabs import design_of
from simgrab.world.sensors.device import Device, SensorRows, Setting
from simgrab.world.sensors.errors import Open, SensorClock, SensorErrors
from simgrab.world.sensors.motion import Motion

COLUMNS = {SlewEncoder: "slew [deg]", LuffEncoder: "radius [m]", HoistEncoder: "rope_length [m]"}
SETPOINTS = "slew_setpoint [deg/s]", "radius_setpoint [m/s]"
WIND, LOAD = "wind [m/s]", "load [t]"
SETPOINT_STEP = 0.001  # deg/s and m/s: a controller knows them exactly
SLACK = 0.3  # share of the mass that hangs on the ropes of a grab that digs


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


class ControllerDevice(Device):
    """Slewing angle, radius, rope length, wind, hoisted mass and setpoints, stamped late, with losses."""

    columns = (*COLUMNS.values(), WIND, LOAD, *SETPOINTS)
    truth_columns = ("time [s]", *columns)

    def __init__(self, sensor: Controller, setting: Setting) -> None:
        clock = SensorClock.draw(sensor.rate_hz, sensor, setting.opened)
        super().__init__(replace(clock, offset=clock.offset + sensor.lag_s))
        self._sensor, self._jitter, self._loss = sensor, setting.opened("jitter"), setting.opened("loss")
        self._lost: list[bool] = []
        self._grab = design_of(setting.scenario.grab)

        def of(part: str) -> Open:
            return lambda variable: setting.opened(f"{part}/{variable}")

        self._errors = (
            SensorErrors(1, of("slew"), bias=sensor.slew_zero_error_deg, resolution=sensor.slew_resolution_deg),
            SensorErrors(1, of("radius"), bias=sensor.radius_zero_error_m, resolution=sensor.radius_resolution_m),
            SensorErrors(
                1, of("rope"), bias=sensor.rope_zero_error_m, scale_error=sensor.rope_scale_error,
                resolution=sensor.rope_resolution_m,
            ),
            SensorErrors(1, of("wind"), scale_error=sensor.wind_scale_error, resolution=sensor.wind_resolution_m_s),
            SensorErrors(1, of("load"), scale_error=sensor.load_scale_error, resolution=sensor.load_resolution_t),
            *(SensorErrors(1, of(name), resolution=SETPOINT_STEP) for name in SETPOINTS),
        )  # fmt: skip

    def rows(self, motion: Motion) -> SensorRows:
        """Read the motion at the latest instants; the stamps keep their order."""
        found, most = super().rows(motion), 0.45 / self._sensor.rate_hz
        late = np.clip(self._sensor.jitter_s * self._jitter.standard_normal(len(found.stamp_ns)), -most, most)
        return replace(found, stamp_ns=found.stamp_ns + np.round(late * 1e9).astype(np.int64))

    def _read(self, motion: Motion) -> tuple[Array, Array]:
        mass = np.array([self._grab.mass_of(0.0, load).mass for load in motion.load.tolist()])
        tonnes = np.where(motion.held, SLACK, 1.0) * mass / 1000
        true = np.column_stack([
            np.degrees(motion.slew), motion.radius, motion.rope, np.hypot(*motion.wind.T), tonnes,
            np.degrees(motion.slew_setpoint), motion.luff_setpoint,
        ])  # fmt: skip
        values = np.column_stack([each.read(true[:, [k]])[0] for k, each in enumerate(self._errors)])
        piece = (motion.time / self._sensor.dropout_s).astype(np.int64)
        more = int(piece.max(initial=-1)) + 1 - len(self._lost)
        self._lost += (self._loss.random(max(more, 0)) < self._sensor.dropout).tolist()
        kept = ~np.array(self._lost, bool)[piece]
        self._counts = kept.astype(np.int64)
        return values[kept], true[kept]
