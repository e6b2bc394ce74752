"""What the lens, the exposure and the sensor do to the picture. Every effect is off at zero."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from simgrab.model.scenario.base import Meta, Strict, Tagged

Stops = Annotated[float, Meta(ge=-8, le=8)]


class FixedExposure(Tagged, frozen=True, tag="fixed"):
    """The same exposure in every frame, ``exposure_ev`` stops above what the scene's light is drawn for."""

    exposure_ev: Stops = 0.0


class AutoExposure(Tagged, frozen=True, tag="auto"):
    """Exposure that follows the light.

    It brings the mean linear luminance (1 = white) to ``target_level``, made ``exposure_ev`` stops brighter. In a clip
    it gets there with a first-order lag of time constant ``lag_s``. A bright scene closes the iris; a dark one is
    amplified, by ``max_gain_db`` at most. From ``night_gain_db`` on, ``night_mode = "auto"`` turns grey.
    """

    exposure_ev: Stops = 0.0
    target_level: Annotated[float, Meta(ge=0.01, le=0.9)] = 0.18
    lag_s: Annotated[float, Meta(ge=0, le=60)] = 1.0
    max_gain_db: Annotated[float, Meta(ge=0, le=60)] = 36.0
    night_gain_db: Annotated[float, Meta(gt=0, le=60)] = 18.0


class Sensor(Strict, frozen=True):
    """The sensor's noise. White is ``full_well_e`` electrons at 0 dB; with 0 light comes without shot noise.

    ``fixed_pattern_percent`` is the standard deviation of the pixels' response, the same in every frame.
    """

    full_well_e: Annotated[float, Meta(ge=0, le=1e6)] = 0.0
    read_noise_e: Annotated[float, Meta(ge=0, le=1000)] = 0.0
    fixed_pattern_percent: Annotated[float, Meta(ge=0, le=20)] = 0.0

    def check(self) -> None:  # noqa: D102
        if self.read_noise_e > 0 and self.full_well_e == 0:
            raise ValueError("read_noise_e is in electrons and needs full_well_e, the electron count of white")
        if 0 < self.full_well_e < 100:
            raise ValueError(f"full_well_e must be 0 (no shot noise) or at least 100, got {self.full_well_e:g}")


class Sharpening(Strict, frozen=True):
    """The camera's sharpening, an unsharp mask over the finished picture, noise and all; the display is not sharpened.

    To each value it adds ``amount`` times what a Gaussian of standard deviation ``radius_px`` would take away.
    """

    amount: Annotated[float, Meta(ge=0, le=5)] = 0.0
    radius_px: Annotated[float, Meta(gt=0, le=50)] = 1.0


ColourGain = Annotated[float, Meta(ge=0.1, le=10)]


class Optics(Strict, frozen=True):
    """Lens, exposure, sensor and processing; geometric distortion is ``camera.distortion``.

    ``vignetting_stops`` is the loss at the corner farthest from the axis, ``defocus_px`` the diameter of the circle of
    confusion, ``chromatic_px`` how far red moves outwards and blue inwards at that corner. A grey picture shows
    luminance alone, as does a camera at night that has moved its infrared filter aside. ``white_balance`` is what red,
    green and blue are multiplied by after the sensor: off neutral it casts a colour. ``recompress_quality`` is the
    JPEG quality at which the finished picture has once been coded, 0 for never: artefacts within a frame.
    """

    vignetting_stops: Annotated[float, Meta(ge=0, le=8)] = 0.0
    defocus_px: Annotated[float, Meta(ge=0, le=50)] = 0.0
    chromatic_px: Annotated[float, Meta(ge=-10, le=10)] = 0.0
    exposure: FixedExposure | AutoExposure = FixedExposure()
    sensor: Sensor = Sensor()
    night_mode: Literal["off", "on", "auto"] = "off"
    white_balance: tuple[ColourGain, ColourGain, ColourGain] = (1.0, 1.0, 1.0)
    sharpening: Sharpening = Sharpening()
    recompress_quality: Annotated[int, Meta(ge=0, le=100)] = 0

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
