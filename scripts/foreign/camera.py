"""From linear light to a stored picture: simgrab's camera, or another sensor and other digits."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import cv2
import matplotlib
import numpy as np
from msgspec import structs
from numpy.random import Generator
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from simgrab.io.pictures import encode
from simgrab.model.layouts import Layout
from simgrab.model.scenario import Scenario
from simgrab.model.srgb import encoded
from simgrab.world.camera import lamps
from simgrab.world.camera.buffers import Buffers
from simgrab.world.camera.optics import recompress
from simgrab.world.camera.overlay import Overlay
from simgrab.world.camera.pipeline import Camera
from simgrab.world.trajectory.display import Shown

Picture = NDArray[np.uint8]
Light = NDArray[np.float32]
FONTS = tuple(
    Path(matplotlib.get_data_path()) / "fonts" / "ttf" / f"{name}.ttf"
    for name in ("DejaVuSansMono", "DejaVuSans-Bold", "DejaVuSerif", "STIXGeneral")
)


def photographed(
    scenario: Scenario, buffers: Buffers, light: Light, replaced: Collection[str], rng: Generator
) -> bytes:
    """Take a picture of linear light before the lens' shading, bent by the lens already.

    Parameters
    ----------
    scenario : Scenario
    buffers : Buffers
        Of the moment.
    light : ndarray of float32, shape (height, width, 3)
    replaced : collection of str
        Of "sensor" and "digits".
    rng : Generator

    Returns
    -------
    bytes
        JPEG, as simgrab stores it.
    """
    own = structs.replace(
        scenario,
        display=structs.replace(scenario.display, layout="none"),
        optics=structs.replace(scenario.optics, recompress_quality=0),
    )
    if "sensor" in replaced:
        rgb = foreign_sensor(_lit(own, buffers, light), rng)
    else:
        rgb = Camera(own).develop(replace(buffers, rgb=light)).rgb
    layout, shown = scenario.display_layout, buffers.projection.nominal.shown
    if layout and shown:
        rgb = foreign_digits(rgb, layout, shown, rng) if "digits" in replaced else Overlay(layout).blend(rgb, shown)
    rgb = recompress(rgb, scenario.optics.recompress_quality)
    return encode(cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), "jpeg", scenario.image.quality)


def _lit(scenario: Scenario, buffers: Buffers, light: Light) -> Light:
    """Light with what the scenario's floodlights do at night."""
    if not scenario.light.floodlights:
        return light
    assert buffers.view is not None
    by = lamps.illumination(
        scenario.light,
        buffers.view.depth,
        intrinsics=scenario.camera.intrinsics,
        jib_from_camera=buffers.projection.moment.tilt.jib_from_camera,
        offset=np.array(scenario.camera.offset_m),
    )
    return lamps.lit(light, by)


def foreign_sensor(light: Light, rng: Generator) -> Picture:
    """Take a picture with a colour filter mosaic, Poisson and read noise, denoising, sharpening and tone curve."""
    height, width = light.shape[:2]
    y, x = np.mgrid[-1 : 1 : complex(height), -1 : 1 : complex(width)]
    x, y = x - rng.uniform(-0.1, 0.1), y - rng.uniform(-0.1, 0.1)
    falloff = 1 / (1 + rng.uniform(0.05, 0.45) * (x * x + (height / width) ** 2 * y * y)) ** 2
    lens = cv2.GaussianBlur(np.maximum(light, 0), (0, 0), rng.uniform(0.5, 0.9))  # with its optical low-pass filter
    level = np.asarray(lens, float) * falloff[..., None]
    middle = float(np.quantile(level[::8, ::8].mean(axis=-1), 0.5))
    level *= rng.uniform(0.07, 0.18) / max(middle, 1e-6)
    balance = np.array((rng.uniform(0.85, 1.15), 1.0, rng.uniform(0.85, 1.15)))
    well, read = rng.uniform(1500, 9000), rng.uniform(3, 12)
    mosaic = np.empty((height, width))
    for channel, (rows, columns) in ((0, (0, 0)), (1, (0, 1)), (1, (1, 0)), (2, (1, 1))):
        mosaic[rows::2, columns::2] = (level[..., channel] * balance[channel])[rows::2, columns::2]
    electrons = rng.poisson(np.minimum(mosaic, 4.0) * well) + rng.normal(0, read, mosaic.shape)
    raw = np.clip(electrons / well, 0, 1) * 65535
    rgb = cv2.demosaicing(raw.astype(np.uint16), cv2.COLOR_BayerBG2RGB).astype(np.float32) / 65535
    shoulder = rng.uniform(0.0, 0.6)
    toned = encoded((rgb * (1 + shoulder) / (1 + shoulder * rgb)).astype(float))
    contrast = rng.uniform(0.0, 0.5)
    toned = (1 - contrast) * toned + contrast * (3 * toned**2 - 2 * toned**3)
    grey = toned.mean(axis=-1, keepdims=True)
    toned = grey + rng.uniform(0.6, 1.3) * (toned - grey) + rng.normal(0, 0.012, 3)
    picture = np.asarray(np.clip(255 * toned, 0, 255), np.uint8)
    if rng.random() < 0.7:
        picture = np.asarray(cv2.bilateralFilter(picture, 5, rng.uniform(8, 30), 2.0), np.uint8)
    blurred = cv2.GaussianBlur(picture, (0, 0), rng.uniform(0.8, 1.8))
    amount = rng.uniform(0.2, 1.4)
    return np.asarray(cv2.addWeighted(picture, 1 + amount, blurred, -amount, 0), np.uint8)


def foreign_digits(rgb: Picture, layout: Layout, shown: Shown, rng: Generator) -> Picture:
    """Put the rope lengths and the clock where the layout has them, in another font, colour and outline."""
    picture = Image.fromarray(rgb)
    pen, path = ImageDraw.Draw(picture), FONTS[int(rng.integers(len(FONTS)))]
    colour = ((255, 255, 255), (255, 255, 255), (255, 240, 90), (150, 255, 150))[int(rng.integers(4))]
    stroke, share = int(rng.integers(0, 3)), rng.uniform(0.78, 0.95)
    font = _fitted(path, "0123456789", layout.digit_width_px * share, layout.digit_height_px * share)
    digits = [c for c in shown.rope_text if c.isdigit()]
    cells = [*zip(layout.cells, digits, strict=True), *((cell, ".") for cell in layout.points)]
    for (x0, y0, x1, y1), character in cells:
        bottom = y0 + (y1 - y0 + (y1 - y0) * share) / 2
        pen.text(((x0 + x1) / 2, bottom), character, colour, font, "ms", stroke_width=stroke, stroke_fill=(0, 0, 0))
    clock = layout.clock
    small = _fitted(path, "0123456789", clock.size_px * 0.55, clock.size_px * 0.8)
    text = "".join(c for c in shown.clock_text if c.isascii()).strip()
    pen.text((clock.x_px, clock.y_px), text, colour, small, "lt", stroke_width=stroke, stroke_fill=(0, 0, 0))
    return np.asarray(picture)


def _fitted(path: Path, characters: str, width: float, height: float) -> ImageFont.FreeTypeFont:
    boxes = [ImageFont.truetype(str(path), 1000).getbbox(c, anchor="ms") for c in characters]
    widest, tallest = max(box[2] - box[0] for box in boxes), max(box[3] - box[1] for box in boxes)
    return ImageFont.truetype(str(path), max(int(1000 * min(width / widest, height / tallest)), 6))
