"""The grab in footage: how often the detector finds it, its size, and the colour of its paint."""

from __future__ import annotations

import colorsys
import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.instrument.detect import Detector
from simgrab.match.footage.footage import Footage
from simgrab.match.footage.quantity import Quantity, exact, unknown

LEAST_FOUND = 3
COLOURFUL = 0.25  # saturation from which a pixel is taken for paint
LEAST_SHARE = 0.04  # of the box that must be so
RUST_DEG = (-15.0, 42.0)  # hues of rust, and of most cargo that lies on a grab
LEAST_PAINTED = 0.1  # of all colour: so much of another hue is the paint, and the rest rust and cargo
HUE_BINS = 36
HUE_REACH_DEG = 20.0  # from the most frequent hue
_HUE_SD_DEG = 10.0  # of light that is not white, and of rust and cargo on the paint


@dataclass(frozen=True, eq=False)
class Grab:
    """What footage shows of the grab."""

    share: Quantity  # of the frames, in which the detector finds it
    size_px: Quantity  # longer side of its box
    hue_deg: Quantity  # of its paint; the interval may go beyond 0 and 360
    paint_rgb: tuple[float, float, float] | None  # as the picture shows it, 0 to 1
    boxes: NDArray[np.float64]  # (n, 4), boxes that were found, px


def grab(footage: Footage, detector: Detector) -> Grab:
    """Detect the grab in a few frames."""
    results = [(frame, detector(frame)) for frame in footage.rgb]
    pairs = [(frame, np.asarray(one.box, float)) for frame, one in results if one.found and one.box is not None]
    share = exact(len(pairs) / len(results))
    if len(pairs) < LEAST_FOUND:
        reason = f"the detector finds a grab in {len(pairs)} of {len(results)} frames"
        return Grab(share, unknown(reason, "px"), unknown(reason, "°"), None, np.zeros((0, 4)))
    boxes = np.array([box for _, box in pairs])
    sides = (boxes[:, 2:] - boxes[:, :2]).max(axis=1)
    low, high = np.quantile(sides, (0.025, 0.975))
    size = float(np.median(sides))
    hue, paint = _paint(footage, pairs)
    reach = 0.03 * size
    return Grab(share, Quantity(size, float(low) - reach, float(high) + reach, unit="px"), hue, paint, boxes)


def _paint(
    footage: Footage, pairs: list[tuple[NDArray[np.uint8], NDArray[np.float64]]]
) -> tuple[Quantity, tuple[float, float, float] | None]:
    if footage.grey:
        return unknown("the picture is grey", "°"), None
    shown = [rgb for frame, box in pairs if len(rgb := _colourful(frame, box))]
    if len(shown) < LEAST_FOUND:
        return unknown("little of the grab shows any colour", "°"), None
    most = _paint_hue(np.concatenate(shown))
    near = [rgb[np.abs(_turn(_hue(rgb) - most)) < HUE_REACH_DEG] for rgb in shown]
    painted = [part for part, whole in zip(near, shown, strict=True) if len(part) >= LEAST_PAINTED / 2 * len(whole)]
    if len(painted) < max(LEAST_FOUND, len(shown) / 2):
        return unknown("its colours differ too much from frame to frame", "°"), None
    colours = [np.median(rgb, axis=0) for rgb in painted]
    hues = np.array([360 * colorsys.rgb_to_hsv(*colour)[0] for colour in colours])
    centre = (most + float(_turn(hues - most).mean())) % 360
    sd = math.hypot(float(_turn(hues - centre).std()), _HUE_SD_DEG)
    r, g, b = (float(v) for v in np.median(colours, axis=0))
    return Quantity(centre, centre - 1.96 * sd, centre + 1.96 * sd, unit="°"), (r, g, b)


def _colourful(frame: NDArray[np.uint8], box: NDArray[np.float64]) -> NDArray[np.float64]:
    """Colourful pixels of a box's inner part, shape (n, 3), 0 to 1; none where they are few."""
    x0, y0, x1, y1 = box
    w, h = x1 - x0, y1 - y0
    part = frame[int(y0 + 0.15 * h) : int(y1 - 0.15 * h), int(x0 + 0.15 * w) : int(x1 - 0.15 * w)]
    rgb = part.reshape(-1, 3).astype(float) / 255
    most, least = rgb.max(axis=1, initial=0.0), rgb.min(axis=1, initial=1.0)
    colourful = (most - least > COLOURFUL * np.maximum(most, 0.05)) & (most > 0.12)
    return rgb[colourful] if colourful.sum() >= max(LEAST_SHARE * len(rgb), 1) else rgb[:0]


def _paint_hue(rgb: NDArray[np.float64]) -> float:
    """Degrees: the most frequent hue of colourful pixels, shape (n, 3), other than rust where enough is other."""
    hue, chroma = _hue(rgb), np.ptp(rgb, axis=1)
    low, high = RUST_DEG
    other = (hue - low) % 360 > high - low
    if chroma[other].sum() >= LEAST_PAINTED * chroma.sum():
        hue, chroma = hue[other], chroma[other]
    counts = np.histogram(hue, HUE_BINS, (0, 360), weights=chroma)[0]
    smooth = counts + (np.roll(counts, 1) + np.roll(counts, -1)) / 2
    return (float(smooth.argmax()) + 0.5) * 360 / HUE_BINS


def _hue(rgb: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(cv2.cvtColor(rgb[None].astype(np.float32), cv2.COLOR_RGB2HSV)[0, :, 0], float)


def _turn(degrees: NDArray[np.float64]) -> NDArray[np.float64]:
    """Differences of hues, in [-180, 180)."""
    return (degrees + 180) % 360 - 180
