"""Textures of steel: paint wear, rust, worn edges, rope strands."""

from __future__ import annotations

import cv2
import numpy as np

from scripts.textures.noise import Image, fractal, ramp, stretch

SIZE = 512


def rank(picture: Image) -> Image:
    """Replace every value by its rank in [0, 1], so that a threshold t selects the share t of the picture."""
    order = np.empty(picture.size)
    order[np.argsort(picture, axis=None, kind="stable")] = np.linspace(0.0, 1.0, picture.size)
    return order.reshape(picture.shape)


def drips(size: int, rng: np.random.Generator, length: float) -> Image:
    """Return tileable vertical streaks, about ``length`` of a tile long."""
    white = rng.standard_normal((size, size))
    fy = np.fft.fftfreq(size, 1 / size)[:, None]
    fx = np.fft.rfftfreq(size, 1 / size)[None, :]
    shape = np.exp(-((fy * length) ** 2) * 4.0) / np.maximum(fx, 4.0) ** 0.6
    return stretch(np.fft.irfft2(np.fft.rfft2(white) * shape, s=(size, size)))


def wear() -> Image:
    """Return three masks: red = order in which paint is lost, green = tone of the rust, blue = where dust settles."""
    rng = np.random.default_rng(11)
    chips = fractal(SIZE, rng, slope=2.4, low=3) + 0.35 * fractal(SIZE, rng, slope=1.2, low=24)
    scratches = scratch_marks(SIZE, rng, 260)
    lost = rank(chips + 0.35 * drips(SIZE, rng, 0.25) - 0.45 * scratches)
    tone = 0.6 * fractal(SIZE, rng, slope=2.0, low=4) + 0.4 * drips(SIZE, rng, 0.3)
    dust = fractal(SIZE, rng, slope=2.2, low=2) * 0.7 + 0.3 * fractal(SIZE, rng, slope=1.0, low=20)
    return np.stack([lost, stretch(tone), rank(dust)], axis=-1) * 255.0


def scratch_marks(size: int, rng: np.random.Generator, count: int) -> Image:
    """Return thin bright lines that wrap round the tile's edges, in [0, 1]."""
    canvas = np.zeros((3 * size, 3 * size), np.uint8)
    for _ in range(count):
        start = rng.uniform(size, 2 * size, 2)
        angle = rng.normal(np.pi / 2, 0.5)
        span = rng.exponential(0.06) * size
        end = start + span * np.array([np.cos(angle), np.sin(angle)])
        a, b = tuple(int(v) for v in start), tuple(int(v) for v in end)
        cv2.line(canvas, a, b, int(rng.uniform(90, 255)), int(rng.integers(1, 3)), cv2.LINE_AA)
    tiles = canvas.reshape(3, size, 3, size).max(axis=(0, 2))
    return np.asarray(tiles, float) / 255.0


def rust() -> Image:
    """Return rusty bare steel."""
    rng = np.random.default_rng(12)
    value = stretch(
        fractal(SIZE, rng, slope=1.8, low=3) + 0.5 * fractal(SIZE, rng, slope=0.8, low=30) + 0.5 * drips(SIZE, rng, 0.2)
    )
    return ramp(
        value,
        [(0, (52, 36, 29)), (0.4, (92, 58, 40)), (0.7, (124, 78, 50)), (0.9, (146, 101, 70)), (1, (160, 128, 100))],
    )


def worn_steel() -> Image:
    """Return steel rubbed bright by cargo, with grey stains."""
    rng = np.random.default_rng(13)
    value = stretch(
        0.8 * drips(SIZE, rng, 0.35) + 0.7 * fractal(SIZE, rng, slope=1.8, low=2) + 0.9 * scratch_marks(SIZE, rng, 500)
    )
    return ramp(value, [(0, (78, 74, 70)), (0.5, (120, 117, 113)), (0.85, (160, 158, 155)), (1, (205, 204, 202))])


def grease() -> Image:
    """Return dark greasy steel: sheaves, pins, rollers."""
    rng = np.random.default_rng(14)
    value = stretch(fractal(256, rng, slope=1.8, low=3) + 0.4 * fractal(256, rng, slope=0.7, low=20))
    return ramp(value, [(0, (30, 29, 28)), (0.6, (56, 54, 51)), (1, (96, 92, 86))])


def rope() -> Image:
    """Return one lay length of a right-hand rope of six strands: across = once round, down = one lay."""
    rng = np.random.default_rng(15)
    height, width = 256, 128
    v, u = np.mgrid[0:height, 0:width]
    turn = u / width + v / height
    across = (6.0 * turn) % 1.0
    strand = np.sin(np.pi * across) ** 0.7
    # The wires run against the strands' lay (ordinary lay): nearly along the rope.
    wires = 0.5 + 0.5 * np.cos(2 * np.pi * (36 * u / width + 6.0 * v / height))
    stain = cv2.resize(fractal(256, rng, slope=2.0, low=2), (width, height))
    value = 0.72 * strand + 0.14 * wires * strand + 0.22 * stain
    return ramp(stretch(value), [(0, (22, 21, 20)), (0.35, (58, 56, 53)), (0.75, (104, 101, 96)), (1, (150, 147, 140))])


TEXTURES = (wear, rust, worn_steel, grease, rope)
