"""How a net is trained: every setting that can change its weights."""

from __future__ import annotations

import math
from dataclasses import dataclass

from simgrab.errors import TrainingError
from simgrab.io.parse import shown

RANGES = {
    "epochs": (1, 1_000_000), "batch": (1, 65_536), "threads": (1, 256), "patience": (0, 1_000_000), "seed": (0, 2**53),
}  # fmt: skip


@dataclass(frozen=True)
class TrainingRecipe:
    """Settings of one training.

    Attributes
    ----------
    seed : int
        Of the first weights, the order of the examples and every augmentation.
    epochs : int
        Passes over the examples.
    batch : int
        Examples a step.
    rate : float
        Largest learning rate; see `rate_at`.
    warm_up : float
        Share of the steps in which the rate rises.
    final : float
        The last rate, as a share of the largest one.
    weight_decay : float
        AdamW's, for weights of two dimensions and more.
    clip : float
        Largest norm of the gradient.
    average : float
        Decay a step of the moving average of the weights, which is what comes out.
    patience : int
        Stop after so many epochs without a better validation score; 0 never stops early.
    threads : int
        Of torch, each of which learns from its part of a batch (`simgrab.training.copies`): another number gives other
        weights. On cores that others use as well, choose fewer.
    device : str
        ``"cpu"``, ``"cuda"``, …
    half : bool
        Multiply in bfloat16 (worth it where the machine has units for it).
    """

    seed: int = 0
    epochs: int = 40
    batch: int = 32
    rate: float = 2e-3
    warm_up: float = 0.1
    final: float = 1e-3
    weight_decay: float = 0.02
    clip: float = 5.0
    average: float = 0.998
    patience: int = 0
    threads: int = 2
    device: str = "cpu"
    half: bool = False

    def __post_init__(self) -> None:
        for name, (least, most) in RANGES.items():
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int):
                raise TrainingError(f"{name}: must be a whole number, got {shown(value)}")
            if value < least:
                raise TrainingError(f"{name}: must be {least} or more, got {value}")
            if value > most:
                raise TrainingError(f"{name}: must be {most} or less, got {value}")

    def rate_at(self, done: float) -> float:
        """Learning rate when a share ``done`` of the steps is done: up on half a cosine, down on another."""
        if done < self.warm_up:
            return self.rate * (0.04 + 0.96 * (1 - math.cos(math.pi * done / self.warm_up)) / 2)
        left = (1 - done) / (1 - self.warm_up)
        return self.rate * (self.final + (1 - self.final) * (1 - math.cos(math.pi * left)) / 2)
