"""Apply weather between a rendered scene and the camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import groupby
from operator import attrgetter
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.model.geometry import Array
from simgrab.model.rng import stream
from simgrab.model.scenario import Cargo, Weather
from simgrab.world.camera.row_blocks import each_block
from simgrab.world.camera.weather import precipitation
from simgrab.world.camera.weather.air import haze
from simgrab.world.camera.weather.drift import TINT as DRIFT_TINT
from simgrab.world.camera.weather.drift import drift
from simgrab.world.camera.weather.dust import TINT, cloud_of_frame, dust
from simgrab.world.camera.weather.glass import DIRT, SNOW_LIGHT, glass, lying
from simgrab.world.camera.weather.ground import Lamp, ground
from simgrab.world.camera.weather.layer import Layer, Maker
from simgrab.world.camera.weather.precipitation import Particles, Precipitation, scatter
from simgrab.world.camera.weather.render_pass import Picture, RenderPass, Vector
from simgrab.world.camera.weather.streaks import draw, expose
from simgrab.world.camera.weather.surface import surface

MEAN_ALBEDO = 0.2  # of what ports show: turns the picture's mean light into that of a white surface
SKY: Vector = (0.96, 1.0, 1.03)
BRIGHTEST = 6.0  # of particles next to a lamp, in units of white


@dataclass(frozen=True, eq=False)
class Weathered:
    """A frame in its weather.

    Attributes
    ----------
    light : ndarray of float32, shape (height, width, 3)
        Linear radiance.
    attenuation : ndarray of float32, shape (height, width)
        Share of the scene's light that air, particles and glass keep from the camera.
    """

    light: Picture
    attenuation: Picture


def apply(
    weather: Weather,
    rendered: RenderPass,
    *,
    seed: int,
    frame: int,
    clip: int = 0,
    time_s: float = 0.0,
    wind_m_s: Vector | None = None,
    airlight: Vector | None = None,
    lamps: Sequence[Lamp] = (),
    cargo: Cargo = "coal",
) -> Weathered:
    """Put weather between a scene and the camera.

    Parameters
    ----------
    weather : Weather
    rendered : RenderPass
        The rendered scene. Nothing is written into it.
    seed, frame : int
        Key the random streams of what changes from frame to frame.
    clip : int
        Keys those of what stays on the glass. What lies on the ground is the scene's, for all clips.
    time_s : float
        Since the clip began: what the wind drives along the ground has come so far.
    wind_m_s : tuple of 3 floats, optional
        Velocity of the air, jib frame; the weather's own unless given.
    airlight : tuple of 3 floats, optional
        Linear radiance (r, g, b) of a white matte surface in the open: what dense fog, flakes and snow look like.
        Estimated from the picture's mean unless given.
    lamps : sequence of Lamp
        The sun and floodlights, for glints and for the particles near them.
    cargo : str
        What the dust is of.
    """
    if weather.off:
        return Weathered(rendered.light, np.zeros(rendered.depth.shape, np.float32))
    white = airlight or _airlight(rendered)
    wind = np.array(_wind(weather) if wind_m_s is None else wind_m_s)
    sheets = list[_Sheet]()
    if weather.wetness or weather.snow_cover:
        sheets.append(_Sheet(ground(weather, rendered, lamps, _mean(white), seed=seed), white, attenuates=False))
    if weather.drift_thickness:
        streamers = drift(rendered, surface(rendered), weather.drift_thickness, wind, time_s, seed=seed)
        sheets.append(_Sheet(streamers.block, _times(white, DRIFT_TINT)))
    if weather.dust_thickness:
        thickness, radius = weather.dust_thickness, weather.dust_radius_m
        cloud = cloud_of_frame(rendered, thickness, radius, wind, seed=seed, frame=frame)
        sheets.append(_Sheet(dust(cloud, rendered, seed=seed), _times(white, TINT[cargo])))
    if weather.visibility_m or weather.rain_mm_h or weather.snow_mm_h:
        sheets += (_Sheet(part, white) for part in _air(weather, rendered, lamps, white, wind, seed, frame))
    light, keep = rendered.light, np.ones(rendered.depth.shape, np.float32)
    if weather.lens_drops or weather.lens_dirt or weather.lens_snow:
        pane = glass(weather, rendered.intrinsics, seed=seed, clip=clip)
        if weather.lens_drops:  # they show what lies behind from elsewhere, so that must be there
            light, keep = _laid(light, keep, sheets) if sheets else (light.copy(), keep)
            pane.put_drops(light, keep, white)
            sheets = []
        if weather.lens_dirt:
            sheets.append(_Sheet(lying(pane.dirt, 1.0), _times(white, DIRT)))
        if weather.lens_snow:
            sheets.append(_Sheet(lying(pane.snow, SNOW_LIGHT), white))
    light, keep = _laid(light, keep, sheets) if sheets else (light, keep)
    return Weathered(light, np.subtract(1, keep, out=keep))


def hidden_fraction(attenuation: Picture, mask: NDArray[np.bool_]) -> float:
    """Mean attenuation over the pixels of a mask, both (height, width); 0 where the mask is empty."""
    return float(attenuation[mask].mean(dtype=np.float64)) if mask.any() else 0.0


def _airlight(rendered: RenderPass) -> Vector:
    """Estimate a white surface's light from a sixteenth of the picture's pixels."""
    white = min(1.0, float(rendered.light[::4, ::4].mean(dtype=np.float64)) / MEAN_ALBEDO)
    return SKY[0] * white, SKY[1] * white, SKY[2] * white


def _wind(weather: Weather) -> Vector:
    azimuth = np.radians(weather.wind_azimuth_deg)
    return weather.wind_m_s * np.cos(azimuth), weather.wind_m_s * np.sin(azimuth), 0.0


class _Sheet(NamedTuple):
    """A layer and its colour, and whether what it hides counts as hidden by weather."""

    layer: Maker
    colour: Vector
    attenuates: bool = True


def _laid(light: Picture, keep: Picture, sheets: Sequence[_Sheet]) -> tuple[Picture, Picture]:
    """Lay sheets over a picture, from the back to the front, and over the share of light that was kept before them."""
    seen, kept = np.empty_like(light), np.empty_like(keep)

    def lay(rows: slice) -> None:
        block, through = light[rows], keep[rows]
        for colour, some in groupby(sheets, attrgetter("colour")):
            layers = []
            for sheet in some:
                if layer := sheet.layer(rows):
                    layers.append(layer)
                    through = cv2.multiply(through, layer.keep) if sheet.attenuates else through
            block = reduce(Layer.behind, layers).over(block, colour) if layers else block
        seen[rows], kept[rows] = block, through

    each_block(len(light), lay)
    return seen, kept


def _times(colour: Vector, tint: Vector) -> Vector:
    return colour[0] * tint[0], colour[1] * tint[1], colour[2] * tint[2]


def _air(
    weather: Weather, rendered: RenderPass, lamps: Sequence[Lamp], white: Vector, wind: Array, seed: int, frame: int
) -> list[Maker]:
    """Fog, rain and snow: haze, and before it what falls near the camera."""
    falling = {}
    if weather.rain_mm_h:
        falling["rain"] = precipitation.rain(weather.rain_mm_h)
    if weather.snow_mm_h:
        falling["snow"] = precipitation.snow(weather.snow_mm_h)
    layers = [haze(rendered, weather.visibility_m, list(falling.values()))]
    for name, of in falling.items():
        rng = stream(seed, frame, f"weather.{name}")
        near = scatter(of, rendered.intrinsics, rendered.jib_from_camera, wind, rng)
        brightness = _brightness(of, near, rendered, lamps, _mean(white))
        layers.append(draw(expose(near, brightness, rendered.intrinsics, rendered.shutter_s), rendered))
    return layers


def _mean(white: Vector) -> float:
    return max(sum(white) / 3, 1e-6)


def _brightness(of: Precipitation, near: Particles, rendered: RenderPass, lamps: Sequence[Lamp], white: float) -> Array:
    """Brightness of particles in units of white, which holds the lamps' light as it is at the ground."""
    result = np.ones(len(near.diameter_m))
    at = near.position_m @ rendered.jib_from_camera.T + rendered.centre_m
    ground_z = rendered.centre_m[2] - rendered.height_m
    for lamp in lamps:
        fall = lamp.position_m[2] - ground_z
        squared = ((at - lamp.position_m) ** 2).sum(axis=1)
        result += lamp.light / white * (fall**2 / np.maximum(squared, 0.25) - 1)
    return np.asarray(of.brightness * np.clip(result, 0.0, BRIGHTEST))
