"""Distributions of α besides the scenario's own: heavier and lighter tails than the paper's half-normal."""

from __future__ import annotations

import math
from types import MappingProxyType
from typing import Annotated

import numpy as np

from simgrab.model.distributions import Distribution, Exponential, HalfNormal, Rayleigh
from simgrab.model.geometry import Array
from simgrab.model.scenario.base import Meta


class Student(Distribution, frozen=True, tag="student"):
    """Size of Student's t: tails so heavy that the fourth moment is infinite up to 4 degrees of freedom."""

    degrees: Annotated[float, Meta(gt=2)] = 5.0

    def sample(self, rng: np.random.Generator, size: int | None = None) -> Array:  # noqa: D102
        return np.abs(rng.standard_t(self.degrees, size))

    def rms(self) -> float:  # noqa: D102
        return math.sqrt(self.degrees / (self.degrees - 2))

    def support(self) -> tuple[float, float]:  # noqa: D102
        return 0.0, math.inf


class Bursts(Distribution, frozen=True, tag="bursts"):
    """A share ``idle`` of the frames swings half-normally, the others ``ratio`` times as far."""

    idle: Annotated[float, Meta(ge=0, lt=1)] = 0.8
    ratio: Annotated[float, Meta(ge=1)] = 5.0

    def sample(self, rng: np.random.Generator, size: int | None = None) -> Array:  # noqa: D102
        scale = np.where(rng.random(size) < self.idle, 1.0, self.ratio)
        return np.asarray(np.abs(rng.normal(size=size)) * scale)

    def rms(self) -> float:  # noqa: D102
        return math.sqrt(self.idle + (1 - self.idle) * self.ratio**2)

    def support(self) -> tuple[float, float]:  # noqa: D102
        return 0.0, math.inf


class Harmonic(Distribution, frozen=True, tag="harmonic"):
    """|sin φ|, φ uniform: a swing of constant amplitude through the vertical, seen at any time."""

    def sample(self, rng: np.random.Generator, size: int | None = None) -> Array:  # noqa: D102
        return np.abs(np.sin(2 * np.pi * rng.random(size)))

    def rms(self) -> float:  # noqa: D102
        return math.sqrt(0.5)

    def support(self) -> tuple[float, float]:  # noqa: D102
        return 0.0, 1.0


LAWS = MappingProxyType(
    {
        "half-normal": HalfNormal(),
        "rayleigh": Rayleigh(),
        "exponential": Exponential(),
        "student": Student(),
        "bursts": Bursts(),
        "harmonic": Harmonic(),
    }
)
"""Distribution of α by name; only its shape matters, σ scales it."""

KURTOSIS = MappingProxyType(
    {
        "half-normal": 3.0,
        "rayleigh": 2.0,
        "exponential": 6.0,
        "student": 9.0,
        "bursts": 3 * (0.8 + 0.2 * 5.0**4) / (0.8 + 0.2 * 5.0**2) ** 2,
        "harmonic": 1.5,
    }
)
"""E[α⁴]/E[α²]² of each, on which the paper's iteration depends."""
