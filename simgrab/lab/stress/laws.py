"""Distributions of α: heavier and lighter tails than the paper's half-normal."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from simgrab.model.distributions import AnyDistribution, Exponential, HalfNormal, Rayleigh
from simgrab.model.geometry import Array


@dataclass(frozen=True)
class Law:
    """A distribution of α, of which only the shape matters: σ scales it."""

    sample: Callable[[np.random.Generator, int], Array]  # generator and number of values → values, shape (n,)
    rms: float  # √E[α²]
    kurtosis: float = math.nan  # E[α⁴]/E[α²]², on which the paper's iteration depends


def of(distribution: AnyDistribution, kurtosis: float = math.nan) -> Law:
    """Make a law of a scenario's distribution."""
    return Law(distribution.sample, distribution.rms(), kurtosis)


def student(degrees: float = 5.0) -> Law:
    """Size of Student's t: tails so heavy that the fourth moment is infinite up to 4 degrees of freedom."""
    kurtosis = 3 * (degrees - 2) / (degrees - 4) if degrees > 4 else math.inf
    return Law(lambda rng, n: np.abs(rng.standard_t(degrees, n)), math.sqrt(degrees / (degrees - 2)), kurtosis)


def bursts(idle: float = 0.8) -> Law:
    """Swing half-normally in a share ``idle`` of the frames, and five times as far in the others."""
    square = idle + (1 - idle) * 5**2

    def sample(rng: np.random.Generator, n: int) -> Array:
        scale = np.where(rng.random(n) < idle, 1.0, 5.0)
        return np.asarray(np.abs(rng.normal(size=n)) * scale)

    return Law(sample, math.sqrt(square), 3 * (idle + (1 - idle) * 5**4) / square**2)


def harmonic() -> Law:
    """|sin φ|, φ uniform: a swing of constant amplitude through the vertical, seen at any time."""
    return Law(lambda rng, n: np.abs(np.sin(2 * np.pi * rng.random(n))), math.sqrt(0.5), 1.5)


LAWS = MappingProxyType(
    {
        "half-normal": of(HalfNormal(), 3.0),
        "rayleigh": of(Rayleigh(), 2.0),
        "exponential": of(Exponential(), 6.0),
        "student": student(),
        "bursts": bursts(),
        "harmonic": harmonic(),
    }
)
"""Law of α by name."""
