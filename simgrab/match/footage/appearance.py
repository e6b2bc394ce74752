"""The whole of what footage shows of a camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simgrab.instrument.detect import Detector
from simgrab.match.footage.blur import blur
from simgrab.match.footage.display import DisplayMatch, display
from simgrab.match.footage.footage import Footage, to_linear
from simgrab.match.footage.grab import Grab, grab
from simgrab.match.footage.noise import Noise, noise
from simgrab.match.footage.quantity import Quantity, exact, positive, unknown
from simgrab.match.footage.shading import vignetting
from simgrab.match.footage.sharpness import Sharpness, sharpness
from simgrab.match.footage.still import still

DARK = 4.0  # levels: a picture whose brightest parts are below shows nothing
_FLOODLIGHTS = "at night floodlights make the same falloff"
_BLACK = "the picture is black"
_NEVER = (  # fixed pattern, tone curve, and share of the picture that weather hides
    "the scene's own texture looks the same while the camera stands still",
    "nothing of known brightness is in it",
    "haze and rain look like pale surroundings without a clear view to compare",
)


@dataclass(frozen=True, eq=False)
class Appearance:
    """What footage shows of a camera."""

    footage: Footage
    dark: bool  # whether it is black
    noise: Noise
    blur: Quantity  # diameter of the circle of confusion
    sharpness: Sharpness
    vignetting: Quantity
    level: Quantity  # mean luminance in linear light, white being 1
    # red over green and blue over green of the mean, linear: the colour of light and surroundings together
    cast: tuple[Quantity, Quantity]
    display: DisplayMatch
    grab: Grab

    def rows(self) -> list[tuple[str, str]]:
        """Names and texts of all quantities, as reports list them."""
        footage = self.footage
        width, height = footage.size
        stated = {
            "frame rate": _stated(footage.frame_rate_hz, "Hz", "the file has no time stamps"),
            "bit rate": _stated(footage.bit_rate_mbit_s, "Mbit/s", "the file has no time stamps"),
            "distance of key frames": _stated(footage.gop_frames, "frames", "only one key frame was read"),
            "quantiser step": _stated(footage.quantiser, "levels", f"{footage.codec} states none"),
        }
        never = [unknown(_BLACK if self.dark else why).text() for why in _NEVER]
        layout = self.display.layout
        digits = f"not determined by this footage: {self.display.reason}"
        if layout:
            places = ", ".join(f"({x}, {y})" for x, y in (layout.hoist_px[0], layout.closing_px[0]))
            digits = f"{layout.digit_width_px}x{layout.digit_height_px} px, numbers begin at {places}"
        return [
            ("size", f"{width}x{height} px" + (f": {footage.note}" if footage.note else "")), ("coder", footage.codec),
            *((name, quantity.text()) for name, quantity in stated.items()),
            ("grey picture", "yes" if footage.grey else "no"),
            ("shot noise, variance per light", self.noise.gain.text()),
            ("read noise, of white", self.noise.read.text()),
            ("fixed pattern", never[0]),
            ("blur, circle of confusion", self.blur.text()),
            ("overshoot at edges", self.sharpness.overshoot.text()),
            ("vignetting at the corner", self.vignetting.text()),
            ("mean luminance, linear", self.level.text()),
            ("red over green", self.cast[0].text()), ("blue over green", self.cast[1].text()),
            ("tone curve", never[1]),
            ("share hidden by weather", never[2]),
            ("display's digits", digits),
            ("share of frames with a grab", self.grab.share.text()),
            ("longer side of the grab", self.grab.size_px.text()),
            ("hue of its paint", self.grab.hue_deg.text()),
        ]  # fmt: skip


def measure(footage: Footage, detector: Detector, *, night: bool = False) -> Appearance:
    """Measure all that pixels show.

    Parameters
    ----------
    detector : Detector
        That detects the grab.
    night : bool
        Whether it was recorded by floodlights, which pixels do not show: their falloff is like that of a lens.
    """
    dark = float(np.quantile(footage.luma, 0.999)) < DARK
    if dark:
        none, px = unknown(_BLACK), unknown(_BLACK, "px")
        return Appearance(
            footage, True, Noise(none, none, None), px, Sharpness(unknown(_BLACK, "%")),
            unknown(_BLACK, "stops"), none, (none, none), DisplayMatch(None, _BLACK, 0.0),
            Grab(exact(0.0), px, unknown(_BLACK, "°"), None, np.zeros((0, 4))),
        )  # fmt: skip
    standing = still(footage)
    shown = display(footage)
    found = grab(footage, detector)
    overlay = shown.mask(*footage.luma.shape[1:])
    covered = overlay.copy()
    for x0, y0, x1, y1 in found.boxes.astype(int).tolist():
        covered[max(y0, 0) : y1 + 1, max(x0, 0) : x1 + 1] = True
    return Appearance(
        footage, False, noise(footage, standing, overlay), blur(footage, overlay), sharpness(footage, overlay),
        unknown(_FLOODLIGHTS, "stops")
        if night
        else vignetting(footage, standing.pixels(*footage.luma.shape[1:]) if standing else None, covered),
        *_means(footage), shown, found,
    )  # fmt: skip


def _means(footage: Footage) -> tuple[Quantity, tuple[Quantity, Quantity]]:
    """Mean luminance, and red and blue over green, with their spread from frame to frame."""
    means = np.array([to_linear(frame[::2, ::2]).mean(axis=(0, 1)) for frame in footage.rgb])
    level = _spread(means @ (0.2126, 0.7152, 0.0722))
    red, green, blue = means.T
    why = "the picture is grey" if footage.grey else "" if green.all() else "a frame shows no green"
    return level, (unknown(why), unknown(why)) if why else (_spread(red / green), _spread(blue / green))


def _spread(values: np.ndarray) -> Quantity:
    mean = float(values.mean())
    return positive(mean, 1.96 * float(values.std()) + 0.01 * mean)


def _stated(value: float | None, unit: str, reason: str) -> Quantity:
    return unknown(reason, unit) if value is None else exact(value, unit)
