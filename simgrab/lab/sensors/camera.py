"""A further camera on the slewing platform or at the jib head, which renders the world as the main one does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from simgrab.io import pictures
from simgrab.model.geometry import Array, Intrinsics
from simgrab.model.scenario import Camera, FixedMount, PixelFocal, SideCamera
from simgrab.world.scenery import model
from simgrab.world.scenery.plan import draw_up
from simgrab.world.sensors.device import SWING, Device, Setting
from simgrab.world.sensors.errors import SensorClock
from simgrab.world.sensors.motion import Motion
from simgrab.world.trajectory.moment import Moment

QUALITY = 95
ROUNDING = 1e-6  # frames
SKY_RGB = (176, 190, 205)


class CameraDevice(Device):
    """Pictures without weather, optics, lens or display; a photograph is that of the latest frame."""

    columns = ("picture",)
    truth_columns = ("time [s]", "radius [m]", "u [px]", "v [px]", *SWING)

    def __init__(self, sensor: SideCamera, setting: Setting) -> None:
        super().__init__(SensorClock(sensor.rate_hz))
        self._sensor, self._setting = sensor, setting
        camera = Camera(
            width_px=sensor.width_px, height_px=sensor.height_px, focal=PixelFocal(sensor.focal_length_px),
            mount=FixedMount(),
        )  # fmt: skip
        self.intrinsics: Intrinsics = camera.intrinsics
        self._camera, self._taken = camera, 0
        self.body_from_sensor = np.eye(4)
        self.body_from_sensor[:3, :3] = looking(sensor.azimuth_deg, sensor.elevation_deg)
        self.body_from_sensor[:3, 3] = sensor.position_m

    def station(self, moment: Moment) -> tuple[Array, Array]:
        """Give rotation (3, 3) and centre (3,) of the camera in the jib frame, m."""
        assert self.body_from_sensor is not None
        assert moment.jib is not None
        rotation, centre = self.body_from_sensor[:3, :3], self.body_from_sensor[:3, 3]
        if self._sensor.mount == "platform":
            centre = centre - (moment.jib.radius, 0.0, self._setting.scenario.jib.head_height_m)
        return rotation, centre

    def _read(self, motion: Motion) -> tuple[Array, Array]:
        frames, rate = self._setting.frames, self._setting.scenario.clip.frame_rate_hz
        latest = np.minimum(motion.time * rate + ROUNDING, len(frames) - 1).astype(int)
        moments = [replace(motion.moment(i), frame=frames[latest[i]]) for i in range(len(motion.time))]
        pixels = np.array([self._pixel(moment) for moment in moments]).reshape(-1, 2)
        number = np.arange(self._taken, self._taken + len(moments), dtype=float)
        self._taken += len(moments)
        if self._setting.renders:
            self.pictures = [pictures.encode(self._picture(moment)[..., ::-1], "jpeg", QUALITY) for moment in moments]
        return number[:, None], np.column_stack([motion.radius, pixels, np.degrees(motion.swing).T])

    def _pixel(self, moment: Moment) -> Array:
        """Pixel of the grab centre A; NaN behind the camera."""
        rotation, centre = self.station(moment)
        return self.intrinsics.project((moment.grab.jib_from_grab.translation - centre) @ rotation)

    def _picture(self, moment: Moment) -> NDArray[np.uint8]:
        if self._close is None:
            from simgrab.world.camera.renderer import Renderer  # with OpenGL

            scenario = self._setting.scenario
            world = model.build(draw_up(scenario, self._setting.world))
            self._renderer = Renderer(world, scenario.with_camera(self._camera), self._setting.split, self.station)
            self._close = self._renderer.close
        picture = np.array(self._renderer.rgb(moment))
        picture[self._renderer.view(moment).ids == model.NOTHING] = SKY_RGB
        return picture


def looking(azimuth_deg: float, elevation_deg: float) -> Array:
    """Rotation ``body_from_camera``, shape (3, 3), of a camera whose picture has the vertical upright.

    The azimuth of the optical axis is from x counter-clockwise seen from above, the elevation less than 90 either way.
    """
    azimuth, elevation = np.radians((azimuth_deg, elevation_deg))
    ahead = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    return np.column_stack([right, np.cross(ahead, right), ahead])
