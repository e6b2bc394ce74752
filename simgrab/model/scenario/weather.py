"""The weather: what is in the air, on the ground and on the camera's cover glass."""

from __future__ import annotations

from typing import Annotated

from simgrab.model.scenario.base import Meta, Share, Strict


class Weather(Strict, frozen=True):
    """Fog, dust, rain, snow, a wet or white ground, and a dirty glass. Everything is off unless set.

    Attributes
    ----------
    visibility_m : float or None
        Meteorological visibility in fog: a black thing keeps 2 % of its contrast there. None is clear air.
    rain_mm_h : float
        Rate of rain.
    snow_mm_h : float
        Rate of snow as melted water: light below 1, heavy above 2.5.
    wind_m_s, wind_azimuth_deg : float
        Wind that carries drops, flakes and dust, and the azimuth it blows towards; physics has a wind of its own.
    dust_thickness : float
        Optical thickness through the middle of a fresh cloud of dust.
    dust_radius_m : float
        Standard deviation of the fresh cloud.
    drift_thickness : float
        Mean optical thickness, from above, of the dust that the wind drives along the ground in streamers.
    wetness : float
        0 is dry; 0.5 wets every pore; up to 1 puddles spread.
    snow_cover : float
        Share of level surfaces under snow, the grab's too.
    lens_drops : int
        Water drops on the cover glass, of ``lens_drop_mm`` in the median.
    lens_dirt, lens_snow : float
        Share of the glass under dirt, and under snow that grows from its rim.
    """

    visibility_m: Annotated[float, Meta(ge=1, le=1e6)] | None = None
    rain_mm_h: Annotated[float, Meta(ge=0, le=150)] = 0.0
    snow_mm_h: Annotated[float, Meta(ge=0, le=20)] = 0.0
    wind_m_s: Annotated[float, Meta(ge=0, le=40)] = 0.0
    wind_azimuth_deg: Annotated[float, Meta(ge=-360, le=360)] = 90.0
    dust_thickness: Annotated[float, Meta(ge=0, le=10)] = 0.0
    dust_radius_m: Annotated[float, Meta(ge=0.2, le=10)] = 1.5
    drift_thickness: Annotated[float, Meta(ge=0, le=3)] = 0.0
    wetness: Share = 0.0
    snow_cover: Share = 0.0
    lens_drops: Annotated[int, Meta(ge=0, le=200)] = 0
    lens_drop_mm: Annotated[float, Meta(ge=0.5, le=10)] = 3.5
    lens_dirt: Share = 0.0
    lens_snow: Share = 0.0

    def check(self) -> None:  # noqa: D102
        if self.rain_mm_h and self.snow_mm_h > 2.5:
            raise ValueError(
                f"snow_mm_h ({self.snow_mm_h:g}) must not be above 2.5 while it rains: heavy snow falls without rain"
            )
        if self.lens_dirt + self.lens_snow > 1:
            raise ValueError("lens_dirt + lens_snow must not be above 1: both cover the same glass")

    @property
    def off(self) -> bool:
        """Whether pictures stay as they are."""
        air = (self.rain_mm_h, self.snow_mm_h, self.dust_thickness, self.drift_thickness)
        rest = (self.wetness, self.snow_cover, self.lens_drops, self.lens_dirt, self.lens_snow)
        return self.visibility_m is None and not any((*air, *rest))
