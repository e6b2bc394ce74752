"""From linear light to a stored picture: simgrab's camera, or another sensor, other digits and another coder."""

from __future__ import annotations

import io
from collections.abc import Collection, Iterable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any, BinaryIO

import av
import cv2
import matplotlib
import numpy as np
from msgspec import structs
from numpy.random import Generator
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from simgrab.io.pictures import encode
from simgrab.model.layouts import Layout
from simgrab.model.scenario import FixedExposure, Scenario
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
VIDEO_CODERS = ("hevc", "vp9", "mpeg4")
CODERS = ("webp", "avif", "4:1:1 JPEG", *VIDEO_CODERS)


def photographed(
    scenario: Scenario, buffers: Buffers, light: Light, replaced: Collection[str], rng: Generator
) -> tuple[bytes, str]:
    """Take a picture of linear light before the lens' shading, bent by the lens already.

    Parameters
    ----------
    scenario : Scenario
    buffers : Buffers
        Of the moment.
    light : ndarray of float32, shape (height, width, 3)
    replaced : collection of str
        Of "light", whose tone is final, "sensor", "digits" and "coder".
    rng : Generator

    Returns
    -------
    tuple of bytes and str
        The file and its suffix: JPEG as simgrab stores it, or PNG of what another coder left.
    """
    own = structs.replace(
        scenario,
        display=structs.replace(scenario.display, layout="none"),
        optics=structs.replace(scenario.optics, recompress_quality=0),
    )
    if "light" in replaced:
        own = structs.replace(
            own,
            light=structs.replace(own.light, floodlights=0.0, sky=1.0),
            optics=structs.replace(own.optics, exposure=FixedExposure()),
        )
    if "sensor" in replaced:
        rgb = foreign_sensor(_lit(own, buffers, light), rng)
    else:
        rgb = Camera(own).develop(replace(buffers, rgb=light)).rgb
    layout, shown = scenario.display_layout, buffers.projection.nominal.shown
    if layout and shown:
        rgb = foreign_digits(rgb, layout, shown, rng) if "digits" in replaced else Overlay(layout).blend(rgb, shown)
    if "coder" in replaced:
        return encode(cv2.cvtColor(foreign_coder(rgb, rng), cv2.COLOR_RGB2BGR), "png", 0), ".png"
    rgb = recompress(rgb, scenario.optics.recompress_quality)
    return encode(cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), "jpeg", scenario.image.quality), ".jpg"


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


def foreign_coder(rgb: Picture, rng: Generator) -> Picture:
    """Code and decode a picture by another coder than simgrab's JPEG."""
    return coded(rgb, CODERS[int(rng.integers(len(CODERS)))], float(rng.uniform()))


def coded(rgb: Picture, coder: str, quality: float) -> Picture:
    """Code and decode a picture; ``quality`` goes from 0, poor, to 1."""
    bgr = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)
    still = {
        "webp": (".webp", [cv2.IMWRITE_WEBP_QUALITY, round(15 + 55 * quality)]),
        "avif": (".avif", [cv2.IMWRITE_AVIF_QUALITY, round(20 + 40 * quality), cv2.IMWRITE_AVIF_SPEED, 9]),
        "4:1:1 JPEG": (
            ".jpg",
            [
                cv2.IMWRITE_JPEG_QUALITY,
                round(18 + 50 * quality),
                cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
                cv2.IMWRITE_JPEG_SAMPLING_FACTOR_411,
            ],
        ),
    }
    if coder in still:
        suffix, options = still[coder]
        _, data = cv2.imencode(suffix, bgr, options)
        return np.asarray(cv2.cvtColor(cv2.imdecode(data, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB))
    file = io.BytesIO()
    film(file, "matroska", [rgb], 25, coder, quality)
    file.seek(0)
    with av.open(file, "r") as coded_file:
        frame = next(coded_file.decode(video=0))
        return np.ascontiguousarray(frame.to_ndarray(format="rgb24")[: rgb.shape[0], : rgb.shape[1]])


def film(
    file: BinaryIO | str, container: str, frames: Iterable[Picture], rate_hz: float, coder: str, quality: float
) -> None:
    """Code pictures of one size as a video by one of `VIDEO_CODERS` or h264; an odd side gets a pixel more."""
    names = {
        "h264": ("libx264", {"crf": str(round(34 - 14 * quality)), "preset": "fast"}),
        "hevc": (
            "libx265",
            {"crf": str(round(40 - 14 * quality)), "preset": "veryfast", "x265-params": "log-level=none:pools=1"},
        ),
        "vp9": ("libvpx-vp9", {"crf": str(round(56 - 22 * quality)), "b": "0", "cpu-used": "6"}),
        "mpeg4": ("mpeg4", {"qmin": str(round(18 - 13 * quality)), "qmax": str(round(18 - 13 * quality))}),
    }
    name, options = names[coder]
    with av.open(file, "w", format=container) as opened:
        stream: Any = opened.add_stream(name, rate=Fraction(rate_hz).limit_denominator(1001), options=options)
        stream.pix_fmt, stream.thread_count = "yuv420p", 1
        for number, rgb in enumerate(frames):
            height, width = rgb.shape[:2]
            even = np.pad(rgb, ((0, height % 2), (0, width % 2), (0, 0)), "edge")
            if not number:
                stream.width, stream.height = even.shape[1], even.shape[0]
            opened.mux(stream.encode(av.VideoFrame.from_ndarray(even, format="rgb24")))
        opened.mux(stream.encode(None))
