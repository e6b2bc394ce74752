"""From what is rendered to the picture that the camera gives: night, weather, lens, sensor, display, coding."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from simgrab.model.layouts import Layout
from simgrab.model.rng import stream
from simgrab.model.scenario import AutoExposure, Dynamic, Font, GeneratedFont, Iid, Scenario, Water
from simgrab.world.camera import faces, lamps, shutter, weather
from simgrab.world.camera.buffers import Buffers
from simgrab.world.camera.optics import Exposure, Light, Picture, expose, metered, recompress, to_display, to_linear
from simgrab.world.camera.overlay import Overlay
from simgrab.world.camera.renderer import Renderer
from simgrab.world.camera.row_blocks import each_block
from simgrab.world.camera.weather import Lamp, RenderPass, Weathered
from simgrab.world.scenery.meshes.jib_access import FLOODLIGHTS
from simgrab.world.trajectory.moment import Moment

SUN_M = 1e4  # far enough for its light to be parallel
SUN_SHARE = 0.6  # of a clear day's light that comes from the sun


@dataclass(frozen=True, eq=False)
class Developed:
    """What the camera makes of one frame.

    Attributes
    ----------
    rgb : ndarray of uint8, shape (height, width, 3)
    attenuation : ndarray of float32, shape (height, width), or None
        Share of the scene's light that weather keeps from the camera; None in clear air.
    exposure : Exposure or None
        That it was taken with; None where the scenario has no optics.
    """

    rgb: Picture
    attenuation: NDArray[np.float32] | None
    exposure: Exposure | None


class Camera:
    """The camera of a scenario: a pure function from buffers to a picture."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        exposure = scenario.optics.exposure
        self.has_memory = isinstance(exposure, AutoExposure) and exposure.lag_s > 0
        """Whether the exposure of a frame that has a time depends on the frames before it in its clip."""

    @property
    def wants_view(self) -> bool:
        """Whether depth and ids of the whole picture are needed."""
        return self._scenario.light.floodlights > 0 or not self._scenario.weather.off

    def develop(self, buffers: Buffers, before: Exposure | None = None) -> Developed:
        """Make a frame's picture.

        Parameters
        ----------
        buffers : Buffers
            With a ``view`` where `wants_view`.
        before : Exposure, optional
            Of the clip's frame before, where the camera `has_memory`.
        """
        if self._scenario.optics.off and not self.wants_view:
            rgb = buffers.rgb if buffers.rgb.dtype == np.uint8 else to_display(buffers.rgb)
            return Developed(self._finished(buffers, rgb), None, None)
        scenario, weathered = self._scenario, self._weathered(buffers)
        exposure = self._metered(weathered.light, before)
        rgb = expose(
            scenario.optics, weathered.light, intrinsics=scenario.camera.intrinsics,
            seed=scenario.seed, frame=buffers.projection.nominal.frame, exposure=exposure,
        )  # fmt: skip
        return Developed(self._finished(buffers, rgb), weathered.attenuation, exposure)

    def meter(self, buffers: Buffers, before: Exposure | None) -> Exposure:
        """Exposure of a frame whose picture is not wanted."""
        return self._metered(self._weathered(buffers).light, before)

    def _metered(self, light: Light, before: Exposure | None) -> Exposure:
        return metered(self._scenario.optics, light, before, period_s=1 / self._scenario.clip.frame_rate_hz)

    def _finished(self, buffers: Buffers, rgb: Picture) -> Picture:
        """Put the display into a picture and code it."""
        shown = buffers.projection.nominal.shown
        layout = self._scenario.display_layout
        if shown and layout:
            rgb = _overlay(layout, self._font(buffers.projection.nominal.frame)).blend(rgb, shown)
        return recompress(rgb, self._scenario.optics.recompress_quality)

    def _font(self, frame: int) -> Font:
        """Font of a frame's display; a generated one without a shape is random by frame or clip."""
        scenario, font = self._scenario, self._scenario.display.font
        if not isinstance(font, GeneratedFont) or font.shape is not None:
            return font
        of = frame if isinstance(scenario.swing, Iid) else scenario.clip.of(frame)
        shape = stream(scenario.seed, of, "display.font").random()
        return msgspec.structs.replace(font, shape=shape)

    def _weathered(self, buffers: Buffers) -> Weathered:
        """Light before the lens."""
        view = buffers.view
        light = to_linear(np.ascontiguousarray(buffers.rgb)) if buffers.rgb.dtype == np.uint8 else buffers.rgb
        if view is None:
            return Weathered(light, np.zeros(light.shape[:2], np.float32))
        scenario, moment = self._scenario, buffers.projection.moment
        frame = moment.frame
        k, rotation = scenario.camera.intrinsics, moment.tilt.jib_from_camera
        offset = np.array(scenario.camera.offset_m)
        if scenario.light.floodlights:
            by = lamps.illumination(scenario.light, view.depth, intrinsics=k, jib_from_camera=rotation, offset=offset)
            light = lamps.lit(light, by)
        place = scenario.place
        rendered = RenderPass(
            light, view.depth, view.ids, k, rotation,
            centre_m=offset,
            height_m=scenario.jib.head_height_m + float(offset[2]),
            shutter_s=scenario.shutter.exposure_s,
            grab_m=moment.grab.jib_from_grab.translation,
            jib_from_place=moment.jib.jib_from_place if moment.jib else None,
            water_m=-place.quay_height_m if isinstance(place, Water) else None,
        )  # fmt: skip
        return weather.apply(
            scenario.weather, rendered, seed=scenario.seed, frame=frame, clip=scenario.clip.of(frame),
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
            return [Lamp(position, each) for position in FLOODLIGHTS]
        if not light.sun:
            return []
        elevation = math.radians(light.sun_elevation_deg)
        azimuth = math.radians(light.sun_azimuth_deg) - (moment.jib.slew if moment.jib else 0.0)
        level = math.cos(elevation)
        towards = np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)])
        return [Lamp(SUN_M * towards, SUN_SHARE * light.sun)]


@lru_cache(maxsize=4)  # worlds in turn have one of a few layouts
def _overlay(layout: Layout, font: Font) -> Overlay:
    return Overlay(layout, faces.face(font), faces.ink(font))


def exposed_rgb(scenario: Scenario, renderer: Renderer, moment: Moment) -> NDArray[Any]:
    """Render the scene as the picture's rows see it, one after another and each for a while.

    Returns
    -------
    ndarray, shape (height, width, 3)
        uint8, sRGB, where one instant is enough; else float32, linear light averaged over each row's exposure.
    """
    times = scenario.shutter
    at = shutter.instants(times.exposure_s, times.rolling_s, shutter.speed_px_s(scenario, moment))
    weights = shutter.row_weights(scenario.camera.height_px, times.exposure_s, times.rolling_s, at)
    result = np.zeros((0, 0, 3), np.float32)
    for seconds, share in zip(at.tolist(), weights.T.astype(np.float32), strict=True):
        rgb = renderer.rgb(moment.shifted(seconds))
        if len(at) == 1:
            return rgb
        result = result if result.size else np.zeros(rgb.shape, np.float32)
        each_block(len(rgb), partial(_accumulate, result, rgb, share))
    return result


def _accumulate(total: Light, rgb: Picture, share: NDArray[np.float32], rows: slice) -> None:
    """Add the light of some rows, each by its share."""
    if share[rows].any():
        light = to_linear(np.ascontiguousarray(rgb[rows])).reshape(len(share[rows]), -1)
        light *= share[rows, None]
        total[rows] += light.reshape(total[rows].shape)
