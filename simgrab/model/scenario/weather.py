"""The weather: what is in the air, on the ground and on the camera's cover glass."""

from __future__ import annotations

from typing import Annotated

from simgrab.model.scenario.base import Meta, Share, Strict, about

Visibility = Annotated[float, Meta(ge=1, le=1e6)]


class Weather(Strict, frozen=True):
    """Fog, dust, rain, snow, a wet or white ground, and a dirty glass. Everything is off unless set.

    At ``visibility_m`` a black thing keeps 2 % of its contrast. ``drift_thickness`` is of dust that the wind drives
    along the ground in streamers. Physics has a wind of its own.
    """

    visibility_m: Annotated[Visibility | None, about("Meteorological visibility in fog. Absent: clear air.")] = None
    rain_mm_h: Annotated[float, about("Rate of rain.", ge=0, le=150)] = 0.0
    snow_mm_h: Annotated[float, about("Rate of snow as melted water; heavy above 2.5.", ge=0, le=20)] = 0.0
    wind_m_s: Annotated[float, about("Wind that carries drops, flakes and dust.", ge=0, le=40)] = 0.0
    wind_azimuth_deg: Annotated[float, about("Azimuth that this wind blows towards.", ge=-360, le=360)] = 90.0
    dust_thickness: Annotated[float, about("Optical thickness through a fresh cloud's middle.", ge=0, le=10)] = 0.0
    dust_radius_m: Annotated[float, about("Standard deviation of the fresh cloud.", ge=0.2, le=10)] = 1.5
    drift_thickness: Annotated[float, about("Mean optical thickness of drifting dust, from above.", ge=0, le=3)] = 0.0
    wetness: Annotated[Share, about("0 is dry; 0.5 wets every pore; up to 1 puddles spread.")] = 0.0
    snow_cover: Annotated[Share, about("Share of level surfaces under snow, the grab's too.")] = 0.0
    lens_drops: Annotated[int, about("Number of water drops on the cover glass.", ge=0, le=200)] = 0
    lens_drop_mm: Annotated[float, about("Median size of these drops.", ge=0.5, le=10)] = 3.5
    lens_dirt: Annotated[Share, about("Share of the glass under dirt.")] = 0.0
    lens_snow: Annotated[Share, about("Share of the glass under snow, which grows from its rim.")] = 0.0

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
