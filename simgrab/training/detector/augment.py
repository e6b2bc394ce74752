"""Image augmentation: geometry, which moves the labels too, and light, colour, blur and dirt, which do not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.instrument.detect.patches import Picture
from simgrab.model.geometry import Array

_NOISE = 1 << 20  # bytes of noise made once; each picture takes a stretch of it
_BLUR = (0.4, 3.5)  # px, standard deviation


@dataclass(frozen=True)
class Orientation:
    """One of the eight ways to lay a picture: mirrored left to right or not, then turned clockwise by quarters."""

    mirror: bool
    quarters: int

    def picture(self, picture: NDArray[Any]) -> NDArray[Any]:
        """Lay a picture (h, w, channels)."""
        laid = picture[:, ::-1] if self.mirror else picture
        return np.rot90(laid, -self.quarters)

    def points(self, shares: Array) -> Array:
        """Lay points (..., 2) in shares of the picture."""
        x, y = shares[..., 0], shares[..., 1]
        x = 1 - x if self.mirror else x
        for _ in range(self.quarters):
            x, y = 1 - y, x
        return np.stack([x, y], -1)

    def box(self, shares: Array) -> Array:
        """Lay a box x0, y0, x1, y1 in shares of the picture."""
        corners = self.points(shares.reshape(2, 2))
        return np.concatenate([corners.min(0), corners.max(0)])

    def angle(self, angle: float) -> float:
        """Lay a direction, clockwise from the picture's x axis, rad."""
        return (np.pi - angle if self.mirror else angle) + self.quarters * np.pi / 2


def turn(rng: np.random.Generator, *, quarters: bool) -> Orientation:
    """Draw a turn; without quarters, upright and upside down only."""
    steps = int(rng.integers(4)) if quarters else 2 * int(rng.integers(2))
    return Orientation(bool(rng.integers(2)), steps)


class Dirt:
    """Draws how a picture is spoiled, by light and by what a camera does with it. Geometry stays."""

    def __init__(self) -> None:
        self._noise = np.random.default_rng(0).normal(0, 1, _NOISE).astype(np.float32)

    def __call__(self, picture: Picture, rng: np.random.Generator) -> Picture:
        """Spoil a picture (h, w, 3).

        Grey or turned hues, tone and cast, blur, noise, sharpening, fewer pixels, compression, and a patch cut out:
        each at times, in the order in which cameras have them.
        """
        result = np.ascontiguousarray(picture)
        if rng.random() < 0.2:
            result = cv2.cvtColor(cv2.cvtColor(result, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
        elif rng.random() < 0.25:
            result = cv2.transform(result, _hues(float(rng.uniform(-np.pi, np.pi))))
        result = cv2.LUT(result, _curves(rng))
        if rng.random() < 0.2:
            result = cv2.GaussianBlur(result, (0, 0), float(np.exp(rng.uniform(*np.log(_BLUR)))))
        if rng.random() < 0.3:
            result = self._noisy(result, float(rng.uniform(1, 10)), rng)
        if rng.random() < 0.25:
            result = _sharpened(result, float(rng.uniform(0.3, 2.5)), float(rng.uniform(0.5, 1.6)))
        if rng.random() < 0.15:
            result = _coarsened(result, float(rng.uniform(0.3, 0.8)))
        if rng.random() < 0.2:
            result = _coded(result, int(rng.integers(8, 60)))
        if rng.random() < 0.25:
            result = _cut_out(result, rng)
        return np.asarray(result, np.uint8)

    def _noisy(self, picture: Picture, sd: float, rng: np.random.Generator) -> Picture:
        """Add noise, white or as smooth as denoising leaves it."""
        start = int(rng.integers(_NOISE - picture.size))
        noise = (self._noise[start : start + picture.size] * sd).reshape(picture.shape)
        if rng.random() < 0.4:
            radius = float(rng.uniform(0.6, 1.3))
            noise = cv2.GaussianBlur(noise, (0, 0), radius) * np.float32(2 * np.sqrt(np.pi) * radius)
        return np.clip(picture + noise.astype(np.int16), 0, 255).astype(np.uint8)


def _sharpened(picture: Picture, amount: float, radius: float) -> Picture:
    """Mask a picture unsharp, by a radius in px."""
    blurred = cv2.GaussianBlur(picture, (0, 0), radius)
    return np.asarray(cv2.addWeighted(picture, 1 + amount, blurred, -amount, 0))


def _coarsened(picture: Picture, share: float) -> Picture:
    """Shrink a picture to a share of its size, and enlarge it again."""
    h, w = picture.shape[:2]
    small = cv2.resize(picture, (round(share * w), round(share * h)), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.resize(small, (w, h), interpolation=cv2.INTER_LINEAR))


def _coded(picture: Picture, quality: int) -> Picture:
    """Compress a picture by JPEG, whose colours are swapped on the way, which matters little."""
    coded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR))


def _hues(angle: float) -> Array:
    """Turn all hues by an angle, rad: colours about the grey axis, (3, 3)."""
    return np.asarray(cv2.Rodrigues(np.full(3, angle / np.sqrt(3.0)))[0])


def _curves(rng: np.random.Generator) -> Picture:
    """Draw a tone curve for each colour, (1, 256, 3): gamma, contrast of the middle tones, gains and lift."""
    x = np.arange(256, dtype=np.float64)[:, None] / 255
    toned = x ** np.exp(rng.normal(0, 0.25))
    if rng.random() < 0.3:
        toned = toned - rng.uniform(-0.7, 0.7) * np.sin(2 * np.pi * toned) / (2 * np.pi)
    cast = 0.2 if rng.random() < 0.2 else 0.06
    gain = np.exp(rng.normal(0, 0.2)) * np.exp(rng.normal(0, cast, 3))
    return np.clip(255 * (gain * toned + rng.normal(0, 0.04)), 0, 255).astype(np.uint8)[None]


def _cut_out(picture: Picture, rng: np.random.Generator) -> Picture:
    """Lay a rectangle of one colour over the picture."""
    h, w = picture.shape[:2]
    high, wide = (rng.uniform(0.05, 0.25, 2) * min(h, w)).astype(int)
    y, x = int(rng.integers(h - high)), int(rng.integers(w - wide))
    result = picture.copy()
    result[y : y + high, x : x + wide] = rng.integers(0, 256, 3)
    return result
