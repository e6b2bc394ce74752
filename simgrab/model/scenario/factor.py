"""What varies within a dataset: a factor is a law, or a choice among values of any kind."""

from __future__ import annotations

from typing import Annotated, Any

import msgspec
import numpy as np

from simgrab.io.parse import shown
from simgrab.io.strict import Checked
from simgrab.model.distributions import MOST_VALUES, AnyDistribution, Choice, Weights
from simgrab.model.scenario.base import about

JOINT = "+"  # between keys that are drawn together


class OneOf(Checked, frozen=True, tag_field="dist", tag="one-of"):
    """One of several values of any kind, with weights that need not sum to 1 (equal unless given).

    ``names`` are what labels call the values; without them labels hold the values themselves.
    """

    values: Annotated[tuple[Any, ...], about("Values of any kind.", min_length=1, max_length=MOST_VALUES)]
    weights: Annotated[Weights, about("Weights, which need not sum to 1; equal unless given.")] = ()
    names: Annotated[tuple[str, ...], about("What labels call the values.", max_length=MOST_VALUES)] = ()

    def check(self) -> None:  # noqa: D102
        for what, given in (("weights", self.weights), ("names", self.names)):
            if given and len(given) != len(self.values):
                raise ValueError(f"{len(self.values)} values need as many {what}, got {len(given)}")
        for i, value in enumerate(self.values):
            try:
                msgspec.json.encode(value)
            except TypeError:
                raise ValueError(f"values.{i}: {shown(value)} cannot be stored in a file") from None
        if len(set(self.names)) != len(self.names):
            raise ValueError("names must differ")
        if self.weights and sum(self.weights) <= 0:
            raise ValueError("at least one weight must be above 0")

    @property
    def probabilities(self) -> tuple[float, ...]:
        """Of each value; they sum to 1."""
        weights = self.weights or (1.0,) * len(self.values)
        total = sum(weights)
        return tuple(weight / total for weight in weights)

    def called(self, index: int) -> Any:
        """Give what labels hold of a value: its name, or itself."""
        return self.names[index] if self.names else self.values[index]


Factor = OneOf | AnyDistribution


def draw(factor: Factor, rng: np.random.Generator) -> tuple[Any, Any]:
    """Draw a factor once: what labels call the value, and the value."""
    if isinstance(factor, OneOf):
        index = int(rng.choice(len(factor.values), p=factor.probabilities))
        return factor.called(index), factor.values[index]
    value = float(factor.sample(rng))
    return value, value


def trials(factor: Factor, rng: np.random.Generator) -> list[Any]:
    """Values that show whether a factor fits its key: every one of a choice; of a law its ends and one from within."""
    if isinstance(factor, OneOf | Choice):
        return list(factor.values)
    return [*(end for end in factor.support() if np.isfinite(end)), float(factor.sample(rng))]
