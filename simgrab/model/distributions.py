"""Distributions that a scenario draws from: one small struct each, with one `sample`.

Values carry the unit of the key that holds the distribution, e.g. metres under ``rope_length_m``.
"""

from __future__ import annotations

import math
from typing import Annotated

import msgspec
import numpy as np
import scipy

from simgrab.io.strict import Checked, about
from simgrab.model.geometry import Array

MOST = 1e9
"""Largest magnitude of a value or a weight."""
MOST_VALUES = 10_000
"""Of a choice."""
Value = Annotated[float, msgspec.Meta(ge=-MOST, le=MOST)]
NonNegative = Annotated[float, msgspec.Meta(ge=0, le=MOST)]
Weights = Annotated[tuple[NonNegative, ...], msgspec.Meta(max_length=MOST_VALUES)]


class Distribution(Checked, frozen=True, tag_field="dist"):
    """A one-dimensional probability distribution: one of `AnyDistribution`.

    Each draws by ``sample(rng, size)`` so many values, shape (size,), or one, shape (). ``rms()`` is √E[X²], and
    ``support()`` are the lowest and the highest value that can be drawn.
    """


class HalfNormal(Distribution, frozen=True, tag="half-normal"):
    """|N(0, scale²)|: the paper's distribution of α (section 4.3)."""

    scale: Annotated[NonNegative, about("Standard deviation of the normal distribution.")] = 1.0

    def sample(self, rng: np.random.Generator, size: int | None = None) -> Array:  # noqa: D102
        return np.abs(rng.normal(0.0, self.scale, size))

    def rms(self) -> float:  # noqa: D102
        return self.scale

    def support(self) -> tuple[float, float]:  # noqa: D102
        return 0.0, math.inf


class Rayleigh(Distribution, frozen=True, tag="rayleigh"):
    """Length of a two-dimensional normal vector: what isotropic forcing of a pendulum gives.

    It is truncated to [0, high] where that is given.
    """

    scale: Annotated[NonNegative, about("Standard deviation of each of the two components.")] = 1.0
    high: Annotated[NonNegative | None, about("Upper end, where it is truncated.")] = None

    def check(self) -> None:  # noqa: D102
        if self.high is not None and self.high < 1e-3 * self.scale:
            raise ValueError(f"the distribution has almost no probability in [0, {self.high:g}]")

    def _beyond(self, high: float) -> float:
        """P(X > high) without truncation."""
        return math.exp(-((high / self.scale) ** 2) / 2) if high < 40 * self.scale else 0.0

    def sample(self, rng: np.random.Generator, size: int | None = None) -> Array:  # noqa: D102
        if self.high is None:
            return np.asarray(rng.rayleigh(self.scale, size))
        within = 1 - self._beyond(self.high)
        return np.asarray(self.scale * np.sqrt(-2 * np.log1p(-within * rng.random(size))))

    def rms(self) -> float:  # noqa: D102
        if self.high is None:
            return math.sqrt(2) * self.scale
        beyond = self._beyond(self.high)
        return math.sqrt(2 * self.scale**2 - self.high**2 * beyond / (1 - beyond))

    def support(self) -> tuple[float, float]:  # noqa: D102
        return 0.0, math.inf if self.high is None else self.high


class Exponential(Distribution, frozen=True, tag="exponential"):
    """Exponential distribution of the given mean: a heavy tail."""

    mean: Annotated[NonNegative, about("Mean.")] = 1.0

    def sample(self, rng: np.random.Generator, size: int | None = None) -> Array:  # noqa: D102
        return np.asarray(rng.exponential(self.mean, size))

    def rms(self) -> float:  # noqa: D102
        return math.sqrt(2) * self.mean

    def support(self) -> tuple[float, float]:  # noqa: D102
        return 0.0, math.inf


class Normal(Distribution, frozen=True, tag="normal"):
    """Normal distribution, truncated to [low, high] where these are given."""

    mean: Annotated[Value, about("Mean before truncation.")] = 0.0
    sd: Annotated[NonNegative, about("Standard deviation before truncation.")] = 1.0
    low: Annotated[Value | None, about("Lower end, where it is truncated.")] = None
    high: Annotated[Value | None, about("Upper end, where it is truncated.")] = None

    def check(self) -> None:  # noqa: D102
        low, high = self.support()
        if low >= high:
            raise ValueError(f"low must lie below high, got {low:g} and {high:g}")
        if self.sd == 0 and not low <= self.mean <= high:
            raise ValueError(f"with sd = 0 the mean must lie in [{low:g}, {high:g}], got {self.mean:g}")
        if self.sd > 0 and self._mass()[1] - self._mass()[0] < 1e-9:
            raise ValueError(f"the distribution has almost no probability in [{low:g}, {high:g}]")

    def _mass(self) -> tuple[float, float]:
        low, high = self.support()
        ndtr = scipy.special.ndtr
        return float(ndtr((low - self.mean) / self.sd)), float(ndtr((high - self.mean) / self.sd))

    def sample(self, rng: np.random.Generator, size: int | None = None) -> Array:  # noqa: D102
        if self.sd == 0:
            return np.full(() if size is None else size, self.mean)
        below, above = self._mass()
        quantile = scipy.special.ndtri(below + (above - below) * rng.random(size))
        return np.clip(self.mean + self.sd * quantile, *self.support())

    def rms(self) -> float:  # noqa: D102
        if self.sd == 0:
            return abs(self.mean)
        a, b = ((bound - self.mean) / self.sd for bound in self.support())
        if b - a < 1e-4:  # the density is even there, and the closed form would cancel
            return Uniform(*self.support()).rms()
        below, above = self._mass()
        density_a, density_b = (math.exp(-z * z / 2) / math.sqrt(2 * math.pi) for z in (a, b))
        tail_a, tail_b = (z * d if math.isfinite(z) else 0.0 for z, d in ((a, density_a), (b, density_b)))
        first = (density_a - density_b) / (above - below)
        second = 1 + (tail_a - tail_b) / (above - below)
        return math.sqrt(max(self.mean**2 + 2 * self.mean * self.sd * first + self.sd**2 * second, 0.0))

    def support(self) -> tuple[float, float]:  # noqa: D102
        low = -math.inf if self.low is None else self.low
        return low, math.inf if self.high is None else self.high


class Uniform(Distribution, frozen=True, tag="uniform"):
    """Uniform on [low, high)."""

    low: Annotated[Value, about("Lower end.")]
    high: Annotated[Value, about("Upper end.")]

    def check(self) -> None:  # noqa: D102
        if self.low > self.high:
            raise ValueError(f"low must not exceed high, got {self.low:g} and {self.high:g}")

    def sample(self, rng: np.random.Generator, size: int | None = None) -> Array:  # noqa: D102
        return np.asarray(rng.uniform(self.low, self.high, size))

    def rms(self) -> float:  # noqa: D102
        return math.sqrt((self.low**2 + self.low * self.high + self.high**2) / 3)

    def support(self) -> tuple[float, float]:  # noqa: D102
        return self.low, self.high


class Constant(Distribution, frozen=True, tag="constant"):
    """Always the same value. A number alone, without a table, means the same."""

    of_number = "value"

    value: Annotated[Value, about("The value.")]

    def sample(self, rng: np.random.Generator, size: int | None = None) -> Array:  # noqa: ARG002, D102
        return np.full(() if size is None else size, self.value)

    def rms(self) -> float:  # noqa: D102
        return abs(self.value)

    def support(self) -> tuple[float, float]:  # noqa: D102
        return self.value, self.value


class Choice(Distribution, frozen=True, tag="choice"):
    """One of several values, with weights that need not sum to 1 (equal unless given)."""

    values: Annotated[tuple[Value, ...], about("Values to choose from.", min_length=1, max_length=MOST_VALUES)]
    weights: Annotated[Weights, about("Weights, which need not sum to 1; equal unless given.")] = ()

    def check(self) -> None:  # noqa: D102
        if self.weights and len(self.weights) != len(self.values):
            raise ValueError(f"{len(self.values)} values need as many weights, got {len(self.weights)}")
        if self.weights and sum(self.weights) <= 0:
            raise ValueError("at least one weight must be above 0")

    def _probabilities(self) -> Array:
        weights = np.array(self.weights or [1.0] * len(self.values))
        return np.asarray(weights / weights.sum())

    def sample(self, rng: np.random.Generator, size: int | None = None) -> Array:  # noqa: D102
        return np.asarray(rng.choice(np.array(self.values), size, p=self._probabilities()))

    def rms(self) -> float:  # noqa: D102
        return math.sqrt(float(self._probabilities() @ np.square(self.values)))

    def support(self) -> tuple[float, float]:  # noqa: D102
        return min(self.values), max(self.values)


AnyDistribution = HalfNormal | Rayleigh | Exponential | Normal | Uniform | Constant | Choice
