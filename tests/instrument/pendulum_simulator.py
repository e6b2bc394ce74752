"""A spherical pendulum of changing length, written for these tests alone and in other variables than the package's own.

State: the unit vector n from O to A and its rate, so that the length's rate appears:
n̈ = (g⃗ + a⃗)ₜ/l − 2(l̇/l + ζω) ṅ − |ṅ|² n, with the subscript for the part across the rope.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

GRAVITY = 9.81


@dataclass(frozen=True)
class Record:
    time: np.ndarray  # (n,), s
    rope: np.ndarray  # (n,), m, as a display in centimetres has it
    direction: np.ndarray  # (M, n, 3), unit, jib frame

    @property
    def alpha(self) -> np.ndarray:
        return np.arctan2(np.hypot(self.direction[..., 0], self.direction[..., 1]), -self.direction[..., 2])


@dataclass(frozen=True)
class Hoist:
    """Rope from one length to another at constant speed, with a smooth start and end."""

    start: float
    end: float
    begin_s: float
    duration_s: float

    def length(self, t: np.ndarray | float) -> np.ndarray:
        x = np.clip((np.asarray(t) - self.begin_s) / self.duration_s, 0, 1)
        return self.start + (self.end - self.start) * (x - np.sin(2 * np.pi * x) / (2 * np.pi))

    def rate(self, t: np.ndarray | float) -> np.ndarray:
        x = (np.asarray(t) - self.begin_s) / self.duration_s
        inside = (x > 0) & (x < 1)
        return (self.end - self.start) / self.duration_s * np.where(inside, 1 - np.cos(2 * np.pi * x), 0.0)


@dataclass(frozen=True)
class Cycles:
    """A rope that goes up and down for as long as the record lasts."""

    low: float
    high: float
    period_s: float

    def length(self, t: np.ndarray | float) -> np.ndarray:
        return (self.low + self.high) / 2 + (self.high - self.low) / 2 * np.cos(
            2 * np.pi * np.asarray(t) / self.period_s
        )

    def rate(self, t: np.ndarray | float) -> np.ndarray:
        w = 2 * np.pi / self.period_s
        return -(self.high - self.low) / 2 * w * np.sin(w * np.asarray(t))


Rope = Hoist | Cycles


def _acceleration(t: float, n: np.ndarray, v: np.ndarray, rope: Rope, damping: float, push: np.ndarray) -> np.ndarray:
    length, rate = rope.length(t), rope.rate(t)
    force = np.array([0.0, 0.0, -GRAVITY]) + push
    across = force - np.sum(force * n, axis=-1, keepdims=True) * n
    drag = 2 * (rate / length + damping * np.sqrt(GRAVITY / length))
    return across / length - drag * v - np.sum(v * v, axis=-1, keepdims=True) * n


def _start(rng: np.random.Generator, m: int, size: float, rope: Rope) -> tuple[np.ndarray, np.ndarray]:
    """Gaussian in position and velocity, the size (rad) being the root mean square of α over time."""
    s = rng.normal(size=(m, 2)) * size / np.sqrt(2)
    n = np.concatenate([s, -np.sqrt(1 - np.sum(s**2, -1, keepdims=True))], -1)
    v = np.pad(rng.normal(size=(m, 2)) * size / np.sqrt(2) * np.sqrt(GRAVITY / rope.length(0.0)), ((0, 0), (0, 1)))
    return n, v - np.sum(v * n, -1, keepdims=True) * n


def free(
    rng: np.random.Generator, m: int, duration_s: float, rope: Rope, size: float, damping: float, fps: float = 9.0
) -> Record:
    """Free swing, each record solved by itself to 1e-10."""
    time = np.arange(int(duration_s * fps)) / fps
    n0, v0 = _start(rng, m, size, rope)

    def slope(t: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate([y[3:], _acceleration(t, y[:3], y[3:], rope, damping, np.zeros(3))])

    paths = [
        solve_ivp(
            slope, (0, time[-1] + 1e-9), np.concatenate([n, v]), t_eval=time, method="DOP853", rtol=1e-10, atol=1e-12
        )
        .y[:3]
        .T
        for n, v in zip(n0, v0, strict=True)
    ]
    direction = np.stack(paths)
    return Record(time, np.round(rope.length(time), 2), direction / np.linalg.norm(direction, axis=-1, keepdims=True))


def forced(
    rng: np.random.Generator, m: int, duration_s: float, rope: Rope, size: float, damping: float,
    fps: float = 9.0, substeps: int = 4, slow: float = 0.0,
) -> Record:  # fmt: skip
    """Swing under white horizontal acceleration that keeps its size, by Runge and Kutta, all records at once.

    ``slow`` adds an acceleration that wanders (an Ornstein–Uhlenbeck process of 15 s) with this size in rad of lean.
    """
    frames = int(duration_s * fps)
    h = 1 / (fps * substeps)
    mean_length = float(np.mean(rope.length(np.arange(frames) / fps)))
    omega = np.sqrt(GRAVITY / mean_length)
    density = 4 * damping * omega * (mean_length * size / np.sqrt(2) * omega) ** 2  # m²/s³ per axis
    n, v = _start(rng, m, size, rope)
    wander = rng.normal(size=(m, 2)) * slow * GRAVITY
    keep = np.exp(-h / 15.0)
    direction = np.empty((m, frames, 3))
    for k in range(frames * substeps):
        if k % substeps == 0:
            direction[:, k // substeps] = n
        t = k * h
        wander = keep * wander + np.sqrt(1 - keep**2) * slow * GRAVITY * rng.normal(size=(m, 2))
        push = np.pad(rng.normal(size=(m, 2)) * np.sqrt(density / h) + wander, ((0, 0), (0, 1)))

        def slope(t: float, n: np.ndarray, v: np.ndarray, push: np.ndarray = push) -> tuple[np.ndarray, np.ndarray]:
            return v, _acceleration(t, n, v, rope, damping, push)

        a1, b1 = slope(t, n, v)
        a2, b2 = slope(t + h / 2, n + h / 2 * a1, v + h / 2 * b1)
        a3, b3 = slope(t + h / 2, n + h / 2 * a2, v + h / 2 * b2)
        a4, b4 = slope(t + h, n + h * a3, v + h * b3)
        n = n + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        v = v + h / 6 * (b1 + 2 * b2 + 2 * b3 + b4)
        n /= np.linalg.norm(n, axis=-1, keepdims=True)
        v -= np.sum(v * n, -1, keepdims=True) * n
    time = np.arange(frames) / fps
    return Record(time, np.round(rope.length(time), 2), direction)


def seen(
    rng: np.random.Generator, record: Record, project: Callable[[np.ndarray], np.ndarray], *,
    rotation: np.ndarray, offset: np.ndarray, missing: float = 0.0, outliers: float = 0.0,
) -> np.ndarray:  # fmt: skip
    """Pixels (M, n, 2) of the grab, with 1 px of noise; ``missing`` and ``outliers`` are shares of the frames.

    ``rotation`` is jib_from_camera and ``offset`` (M, 3) the camera's place.
    """
    grab = record.direction * record.rope[:, None]
    pixels = project((grab - offset[:, None]) @ rotation)
    pixels = pixels + rng.normal(size=pixels.shape)
    wild = rng.random(pixels.shape[:2]) < outliers
    pixels = np.where(wild[..., None], rng.random(pixels.shape) * (1920, 1080), pixels)
    return np.where((rng.random(pixels.shape[:2]) < missing)[..., None], np.nan, pixels)
