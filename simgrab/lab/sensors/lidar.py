"""The LiDAR on the slewing platform: rays cast into the world that the pictures show."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simgrab.model.geometry import Array
from simgrab.model.scenario import Lidar, Weather
from simgrab.world.scenery import model
from simgrab.world.scenery.plan import draw_up
from simgrab.world.sensors.device import SWING, Device, Setting
from simgrab.world.sensors.errors import SensorClock, counted
from simgrab.world.sensors.motion import Motion

if TYPE_CHECKING:
    import mujoco

_DB_KM = math.log(10) / 10 / 1000  # 1/m
_SHOWN = np.array([1, 1, 1, 1, 0, 0], np.uint8)  # groups of geoms: place, jib, ropes, grab


def extinction(weather: Weather) -> float:
    """Share of a 905 nm beam's light that a metre of air takes, 1/m.

    Rain and dry snow as of ITU-R P.1814, 1.076·R^0.67 and 5.545·S^1.38 dB/km for R and S in mm/h; fog as of
    Koschmieder, 3.912 over the visibility. Dust is left out.
    """
    fallen = 1.076 * weather.rain_mm_h**0.67 + 5.545 * weather.snow_mm_h**1.38
    return fallen * _DB_KM + (3.912 / weather.visibility_m if weather.visibility_m else 0.0)


class LidarDevice(Device):
    """A scanner whose beams of one scan are all sent at once."""

    columns = ("x [m]", "y [m]", "z [m]", "ring")
    truth_columns = ("time [s]", "range [m]", "id", *SWING)

    def __init__(self, sensor: Lidar, setting: Setting) -> None:
        super().__init__(SensorClock.draw(sensor.rate_hz, sensor, setting.opened))
        self._sensor, self._setting, self._noise = sensor, setting, setting.opened("noise")
        self._extinction = extinction(setting.scenario.weather)
        self.body_from_sensor = np.eye(4)
        self.body_from_sensor[:3, 3] = sensor.position_m
        elevation = np.radians(np.linspace(*sensor.elevation_deg, sensor.rings))
        azimuth = np.radians(np.linspace(*sensor.azimuth_deg, sensor.columns))
        self._angles = np.stack(np.meshgrid(elevation, azimuth, indexing="ij"), axis=-1).reshape(-1, 2)
        self._ring = np.repeat(np.arange(sensor.rings), sensor.columns)
        self._world: tuple[model.World, mujoco.MjData] | None = None

    def _read(self, motion: Motion) -> tuple[Array, Array]:
        swing = np.degrees(motion.swing).T
        scans = [self._scan(motion, i) for i in range(len(motion.time))]
        self._counts = np.array([len(points) for points, _ in scans])
        values, truth = (np.concatenate(parts) for parts in zip(*scans, strict=True))
        return values, np.hstack([truth, np.repeat(swing, self._counts, axis=0)])

    def _scan(self, motion: Motion, i: int) -> tuple[Array, Array]:
        """Points of one scan with their rings (n, 4), and true range and id (n, 2)."""
        sensor, noise, count = self._sensor, self._noise, len(self._angles)
        # The same draws whatever is hit.
        off = noise.standard_normal((count, 2)) * math.radians(sensor.angle_noise_deg)
        spread = noise.standard_normal(count) * sensor.range_noise_m
        lost, caught, where, echoed = noise.random((4, count))
        true, ids = self.cast(motion, i, _directions(self._angles + off))
        most, gamma = sensor.range_m[1], self._extinction
        path = np.where(np.isfinite(true), true, most)
        intercepted = -np.expm1(-2 * gamma * path)  # probability
        air = caught < intercepted
        echo = air & (echoed < sensor.false_echo)
        if gamma > 0:
            true = np.where(air, -np.log1p(-where * intercepted) / (2 * gamma), true)
        ids = np.where(air, model.NOTHING, ids)
        with np.errstate(invalid="ignore", over="ignore"):
            bright = true * np.exp(gamma * true) <= most
        back = bright & (lost >= sensor.dropout) & (~air | echo) & (true >= sensor.range_m[0])
        measured = counted(true[back] + spread[back], sensor.resolution_m)
        points = measured[:, None] * _directions(self._angles[back])
        return np.column_stack([points, self._ring[back]]), np.column_stack([true[back], ids[back]])

    def cast(self, motion: Motion, i: int, directions: Array) -> tuple[Array, NDArray[np.int64]]:
        """Cast rays from the sensor at one of a motion's instants.

        Parameters
        ----------
        directions : ndarray, shape (n, 3)
            Unit vectors, sensor frame.

        Returns
        -------
        range : ndarray, shape (n,)
            To the first surface, m; infinite where there is none within the sensor's range.
        id : ndarray of int, shape (n,)
            0 place, 1 jib head, 2 ropes, 3 grab, 255 nothing.
        """
        import mujoco  # whose OpenGL `simgrab.world` chooses

        scenario = self._setting.scenario
        if self._world is None:
            world = model.build(draw_up(scenario, self._setting.world))
            self._world = world, mujoco.MjData(world.model)
        world, data = self._world
        world.pose(data, motion.moment(i))
        # The platform's frame is that of the jib, moved to the slewing axis at the height of the quay.
        centre = np.array(self._sensor.position_m) - (float(motion.radius[i]), 0.0, scenario.jib.head_height_m)
        geom, far = np.empty(len(directions), np.int32), np.empty(len(directions))
        mujoco.mj_multiRay(
            world.model, data, centre, directions.ravel(), _SHOWN, 1, -1, geom, far, None, len(directions),
            self._sensor.range_m[1],
        )  # fmt: skip
        hit = (geom >= 0) & (far <= self._sensor.range_m[1])
        return np.where(hit, far, np.inf), np.where(hit, world.model.geom_group[geom], model.NOTHING).astype(int)


def _directions(angles: Array) -> Array:
    """Give unit vectors (n, 3) of elevation above the horizontal, and azimuth from x counter-clockwise."""
    elevation, azimuth = angles.T
    flat = np.cos(elevation)
    return np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
