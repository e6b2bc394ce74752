"""From what is drawn to the picture that the camera gives: shutter, night, weather, lens, sensor, display, coding."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from simgrab.geometry import Array
from simgrab.scenario import AutoExposure, Dynamic, Scenario, Water
from simgrab.world.camera import lamps, shutter, weather
from simgrab.world.camera.bands import each_band
from simgrab.world.camera.optics import (
    Exposure,
    ExposureControl,
    Light,
    expose,
    recompress,
    settled,
    to_display,
    to_linear,
)
from simgrab.world.camera.overlay import Overlay
from simgrab.world.camera.renderer import Renderer, View
from simgrab.world.camera.weather import Lamp, Sight, Weathered
from simgrab.world.scenery.meshes.jib_access import FLOODLIGHTS
from simgrab.world.trajectory.moment import Moment

SUN_M = 1e4  # far enough for its light to be parallel
SUN_SHARE = 0.6  # of a clear day's light that comes from the sun

Picture = NDArray[np.uint8]


class Chain:
    """What happens to a picture from the scene to the stream.

    Parameters
    ----------
    scenario : Scenario
    renderer : Renderer
    moment_at : callable
        Gives the moment of a frame.
    """

    def __init__(self, scenario: Scenario, renderer: Renderer, moment_at: Callable[[int], Moment]) -> None:
        self._scenario, self._renderer, self._moment_at = scenario, renderer, moment_at
        layout = scenario.display_layout
        self._overlay = Overlay(layout) if layout else None
        exposure = scenario.optics.exposure
        self._lags = isinstance(exposure, AutoExposure) and exposure.lag_s > 0 and isinstance(scenario.swing, Dynamic)
        self._next, self._control = 0, ExposureControl(scenario.optics, scenario.clip.frame_rate_hz)

    @property
    def plain(self) -> bool:
        """Whether the picture is what was drawn, but for shutter and display."""
        return self._scenario.optics.off and not self.wants_view

    @property
    def wants_view(self) -> bool:
        """Whether depth and ids of the whole picture are needed."""
        return self._scenario.light.floodlights > 0 or not self._scenario.weather.off

    def picture(self, frame: int, view: View | None) -> tuple[Picture, NDArray[np.float32] | None]:
        """Make a frame's picture.

        Parameters
        ----------
        frame : int
        view : View or None
            Of the whole picture at the instant of the labels, where `wants_view`.

        Returns
        -------
        rgb : ndarray of uint8, shape (height, width, 3)
        veil : ndarray of float32, shape (height, width), or None
            Share of the scene's light that weather keeps from the camera.
        """
        moment = self._moment_at(frame)
        at = self._instants(moment)
        if self.plain and len(at) == 1:
            self._renderer.pose(moment)
            return self._finished(moment, self._renderer.rgb()), None
        return self.develop(frame, self._light(moment, at), view)

    def develop(self, frame: int, light: Light, view: View | None) -> tuple[Picture, NDArray[np.float32] | None]:
        """Make a frame's picture of the scene's linear light, shape (height, width, 3); see `picture`."""
        if self.plain:
            return self._finished(self._moment_at(frame), to_display(light)), None
        weathered = self._weathered(frame, light, view)
        rgb = self._exposed(frame, weathered.light)
        return self._finished(self._moment_at(frame), rgb), weathered.veil

    def _finished(self, moment: Moment, rgb: Picture) -> Picture:
        """Put the display into a picture and code it."""
        if self._overlay and moment.shown:
            rgb = self._overlay.blend(rgb, moment.shown)
        return recompress(rgb, self._scenario.optics.recompress_quality)

    def _instants(self, moment: Moment) -> Array:
        times = self._scenario.shutter
        return shutter.instants(times.exposure_s, times.rolling_s, shutter.speed_px_s(self._scenario, moment))

    def _light(self, moment: Moment, at: Array) -> Light:
        """Draw the scene as its rows see it, one after another and each for a while: linear light."""
        times = self._scenario.shutter
        weights = shutter.row_weights(self._scenario.camera.height_px, times.exposure_s, times.rolling_s, at)
        result = None
        for seconds, share in zip(at.tolist(), weights.T.astype(np.float32), strict=True):
            self._renderer.pose(moment.shifted(seconds))
            rgb = self._renderer.rgb()
            if len(at) == 1:
                return to_linear(np.ascontiguousarray(rgb))
            result = np.zeros(rgb.shape, np.float32) if result is None else result
            each_band(len(rgb), partial(_accumulate, result, rgb, share))
        assert result is not None
        return result

    def _weathered(self, frame: int, light: Light, view: View | None) -> Weathered:
        """Light before the lens."""
        if view is None:
            return Weathered(light, np.zeros(light.shape[:2], np.float32))
        scenario, moment = self._scenario, shutter.exposed(self._scenario, self._moment_at(frame))
        k, rotation = scenario.camera.intrinsics, moment.tilt.jib_from_camera
        offset = np.array(scenario.camera.offset_m)
        if scenario.light.floodlights:
            by = lamps.illumination(scenario.light, view.depth, intrinsics=k, jib_from_camera=rotation, offset=offset)
            light = lamps.lit(light, by)
        place = scenario.place
        sight = Sight(
            light, view.depth, view.ids, k, rotation,
            centre_m=(float(offset[0]), float(offset[1]), float(offset[2])),
            height_m=scenario.jib.head_height_m + float(offset[2]),
            shutter_s=scenario.shutter.exposure_s,
            grab_m=_vector(moment.grab.jib_from_grab[:3, 3]),
            jib_from_place=moment.jib.jib_from_place if moment.jib else None,
            water_m=-place.quay_height_m if isinstance(place, Water) else None,
        )  # fmt: skip
        return weather.apply(
            scenario.weather, sight, seed=scenario.seed, frame=frame, clip=scenario.clip.of(frame),
            time_s=frame / scenario.clip.frame_rate_hz if moment.time is None else moment.time,
            wind_m_s=self._wind(moment), lamps=self._lamps(moment), cargo=scenario.grab.cargo,
        )  # fmt: skip

    def _wind(self, moment: Moment) -> tuple[float, float, float] | None:
        """Mean wind of the physics, jib frame; None lets the weather have its own."""
        swing = self._scenario.swing
        if not isinstance(swing, Dynamic) or not moment.jib:
            return None
        azimuth = math.radians(swing.wind.azimuth_deg) - moment.jib.slew
        return swing.wind.mean_m_s * math.cos(azimuth), swing.wind.mean_m_s * math.sin(azimuth), 0.0

    def _lamps(self, moment: Moment) -> list[Lamp]:
        light = self._scenario.light
        if light.floodlights:
            each = light.floodlights / len(FLOODLIGHTS)
            return [Lamp(_vector(position), each) for position in FLOODLIGHTS]
        if not light.sun:
            return []
        elevation = math.radians(light.sun_elevation_deg)
        azimuth = math.radians(light.sun_azimuth_deg) - (moment.jib.slew if moment.jib else 0.0)
        level = math.cos(elevation)
        towards = np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)])
        return [Lamp(_vector(SUN_M * towards), SUN_SHARE * light.sun)]

    def _exposed(self, frame: int, light: Light) -> Picture:
        scenario = self._scenario
        return expose(
            scenario.optics, light, intrinsics=scenario.camera.intrinsics, seed=scenario.seed, frame=frame,
            exposure=self._exposure(frame, light),
        )  # fmt: skip

    def _exposure(self, frame: int, light: Light) -> Exposure:
        """Exposure of a frame; where it lags, what the clip showed before is metered first."""
        if not self._lags:
            return settled(self._scenario.optics, light)
        clip = self._scenario.clip
        first = clip.span(clip.of(frame), self._scenario.frames).start
        if not first < self._next <= frame:
            self._next = first
            self._control = ExposureControl(self._scenario.optics, clip.frame_rate_hz)
        while self._next < frame:
            self._control.next(self._meter(self._next))
            self._next += 1
        self._next = frame + 1
        return self._control.next(light)

    def _meter(self, frame: int) -> Light:
        """Light of a frame that is not shown, or that another worker makes."""
        moment = self._moment_at(frame)
        self._renderer.pose(shutter.exposed(self._scenario, moment))
        view = self._renderer.glance() if self.wants_view else None
        return self._weathered(frame, self._light(moment, self._instants(moment)), view).light


def _accumulate(total: Light, rgb: Picture, share: NDArray[np.float32], rows: slice) -> None:
    """Add the light of some rows, each by its share."""
    if share[rows].any():
        light = to_linear(np.ascontiguousarray(rgb[rows])).reshape(len(share[rows]), -1)
        light *= share[rows, None]
        total[rows] += light.reshape(total[rows].shape)


def _vector(values: Array) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z
