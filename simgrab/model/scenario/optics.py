"""What the lens, the exposure and the sensor do to the picture. Every effect is off at zero."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from simgrab.model.scenario.base import Meta, Strict, Tagged, about

Stops = Annotated[float, Meta(ge=-8, le=8)]


class FixedExposure(Tagged, frozen=True, tag="fixed"):
    """The same exposure in every frame, ``exposure_ev`` stops above what the scene's light is drawn for."""

    exposure_ev: Annotated[Stops, about("Exposure, relative to that of the rendered scene.")] = 0.0


class AutoExposure(Tagged, frozen=True, tag="auto"):
    """Exposure that follows the light.

    It brings the mean linear luminance (1 = white) to ``target_level``, made ``exposure_ev`` stops brighter. In a clip
    it gets there with a first-order lag of time constant ``lag_s``. A bright scene closes the iris; a dark one is
    amplified, by ``max_gain_db`` at most. From ``night_gain_db`` on, ``night_mode = "auto"`` turns grey.
    """

    exposure_ev: Annotated[Stops, about("Brighter than the target by so many stops.")] = 0.0
    target_level: Annotated[float, about("Mean linear luminance of the image; 1 is white.", ge=0.01, le=0.9)] = 0.18
    lag_s: Annotated[float, about("Time constant of the exposure.", ge=0, le=60)] = 1.0
    max_gain_db: Annotated[float, about("Largest gain in the dark.", ge=0, le=60)] = 36.0
    night_gain_db: Annotated[float, about("Gain from which night mode auto turns the image grey.", gt=0, le=60)] = 18.0


class Sensor(Strict, frozen=True):
    """The sensor's noise; the pixels' response is the same in every frame."""

    full_well_e: Annotated[float, about("Electrons of white at 0 dB; 0: no shot noise.", ge=0, le=1e6)] = 0.0
    read_noise_e: Annotated[float, about("Standard deviation of read noise; needs full_well_e.", ge=0, le=1000)] = 0.0
    fixed_pattern_percent: Annotated[float, about("Standard deviation of the pixels' response.", ge=0, le=20)] = 0.0

    def check(self) -> None:  # noqa: D102
        if self.read_noise_e > 0 and self.full_well_e == 0:
            raise ValueError("read_noise_e is in electrons and needs full_well_e, the electron count of white")
        if 0 < self.full_well_e < 100:
            raise ValueError(f"full_well_e must be 0 (no shot noise) or at least 100, got {self.full_well_e:g}")


class Sharpening(Strict, frozen=True):
    """The camera's sharpening, an unsharp mask over the finished picture, noise and all; the display is not sharpened.

    To each value it adds ``amount`` times what a Gaussian of standard deviation ``radius_px`` would take away.
    """

    amount: Annotated[float, about("Added share of what a Gaussian blur takes away; 0 is off.", ge=0, le=5)] = 0.0
    radius_px: Annotated[float, about("Standard deviation of that Gaussian.", gt=0, le=50)] = 1.0


ColourGain = Annotated[float, Meta(ge=0.1, le=10)]
Gains = tuple[ColourGain, ColourGain, ColourGain]
NightMode = Literal["off", "on", "auto"]


class Optics(Strict, frozen=True):
    """Lens, exposure, sensor and processing; geometric distortion is ``camera.distortion``.

    A grey picture shows luminance alone, as does a camera at night that has moved its infrared filter aside; it has no
    ``white_balance``. With ``recompress_quality`` the finished picture has once been coded: artefacts within a frame.
    """

    vignetting_stops: Annotated[float, about("Loss of light at the corner farthest from the axis.", ge=0, le=8)] = 0.0
    defocus_px: Annotated[float, about("Diameter of the circle of confusion.", ge=0, le=50)] = 0.0
    chromatic_px: Annotated[float, about("Shift of red outwards and blue inwards at that corner.", ge=-10, le=10)] = 0.0
    exposure: Annotated[FixedExposure | AutoExposure, about("Fixed or automatic exposure.")] = FixedExposure()
    sensor: Annotated[Sensor, about("Noise of the sensor.")] = Sensor()
    night_mode: Annotated[NightMode, about("Grey image: off, on, or auto, which depends on the gain.")] = "off"
    white_balance: Annotated[Gains, about("Gains of red, green and blue after the sensor.")] = (1.0, 1.0, 1.0)
    sharpening: Annotated[Sharpening, about("Sharpening by the camera.")] = Sharpening()
    recompress_quality: Annotated[int, about("JPEG quality of an earlier compression; 0 is none.", ge=0, le=100)] = 0

    def check(self) -> None:  # noqa: D102
        if self.night_mode != "auto":
            return
        if isinstance(self.exposure, FixedExposure):
            raise ValueError('night_mode "auto" depends on the gain and needs exposure.model = "auto"')
        if self.exposure.night_gain_db > self.exposure.max_gain_db:
            raise ValueError(
                f"exposure.night_gain_db ({self.exposure.night_gain_db:g}) is never reached: "
                f"exposure.max_gain_db is {self.exposure.max_gain_db:g}"
            )

    @property
    def off(self) -> bool:
        """Whether the picture stays as it was drawn."""
        return not self.sharpening.amount and msgspec.structs.replace(self, sharpening=Sharpening()) == Optics()
