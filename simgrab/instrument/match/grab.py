"""The grab in footage: how often the detector finds it, its size, and the colour of its paint."""

from __future__ import annotations

import colorsys
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgrab.instrument.detect import Detector
from simgrab.instrument.match.footage import Footage
from simgrab.instrument.match.quantity import Quantity, exact, unknown

LEAST_FOUND = 3
COLOURFUL = 0.25  # saturation from which a pixel is taken for paint
LEAST_SHARE = 0.04  # of the box that must be so
_HUE_SD_DEG = 10.0  # of light that is not white, and of rust and cargo on the paint


@dataclass(frozen=True, eq=False)
class Grab:
    """What footage shows of the grab.

    Attributes
    ----------
    found : Quantity
        Share of the frames that were looked at in which the detector finds it.
    size_px : Quantity
        Longer side of its box.
    hue_deg : Quantity
        Of its paint; the interval may go beyond 0 and 360.
    paint_rgb : tuple of 3 floats, or None
        As the picture shows it, 0 to 1.
    boxes : ndarray, shape (n, 4)
        Boxes that were found, px.
    """

    found: Quantity
    size_px: Quantity
    hue_deg: Quantity
    paint_rgb: tuple[float, float, float] | None
    boxes: NDArray[np.float64]


def grab(footage: Footage, detector: Detector) -> Grab:
    """Look for the grab in a few frames."""
    results = [(frame, detector(frame)) for frame in footage.rgb]
    pairs = [(frame, one.box) for frame, one in results if one.found and one.box is not None]
    share = exact(len(pairs) / len(results))
    if len(pairs) < LEAST_FOUND:
        reason = f"the detector finds a grab in {len(pairs)} of {len(results)} frames"
        return Grab(share, unknown(reason, "px"), unknown(reason, "°"), None, np.zeros((0, 4)))
    boxes = np.array([box for _, box in pairs], float)
    sides = (boxes[:, 2:] - boxes[:, :2]).max(axis=1)
    low, high = np.quantile(sides, (0.025, 0.975))
    size = float(np.median(sides))
    hue, paint = _paint(footage, [(frame, np.asarray(box, float)) for frame, box in pairs])
    reach = 0.03 * size
    return Grab(share, Quantity(size, float(low) - reach, float(high) + reach, unit="px"), hue, paint, boxes)


def _paint(
    footage: Footage, pairs: list[tuple[NDArray[np.uint8], NDArray[np.float64]]]
) -> tuple[Quantity, tuple[float, float, float] | None]:
    if footage.grey:
        return unknown("the picture is grey", "°"), None
    hues, colours = list[float](), list[NDArray[np.float64]]()
    for frame, (x0, y0, x1, y1) in pairs:
        w, h = x1 - x0, y1 - y0
        part = frame[int(y0 + 0.15 * h) : int(y1 - 0.15 * h), int(x0 + 0.15 * w) : int(x1 - 0.15 * w)]
        rgb = part.reshape(-1, 3).astype(float) / 255
        if not len(rgb):
            continue
        most, least = rgb.max(axis=1), rgb.min(axis=1)
        colourful = (most - least > COLOURFUL * np.maximum(most, 0.05)) & (most > 0.12)
        if colourful.mean() < LEAST_SHARE:
            continue
        middle = np.median(rgb[colourful], axis=0)
        colours.append(middle)
        hues.append(360 * colorsys.rgb_to_hsv(*middle)[0])
    if len(hues) < LEAST_FOUND:
        return unknown("little of the grab shows any colour", "°"), None
    angles = np.radians(hues)
    centre = math.degrees(math.atan2(np.sin(angles).mean(), np.cos(angles).mean())) % 360
    away = (np.array(hues) - centre + 180) % 360 - 180
    sd = math.hypot(float(away.std()), _HUE_SD_DEG)
    if sd > 40:
        return unknown("its colours differ too much from frame to frame", "°"), None
    r, g, b = (float(v) for v in np.median(colours, axis=0))
    return Quantity(centre, centre - 1.96 * sd, centre + 1.96 * sd, unit="°"), (r, g, b)
