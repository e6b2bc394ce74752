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
    """Settings of one training."""

    seed: int = 0  # of the first weights, the order of the examples and every augmentation
    epochs: int = 40  # passes over the examples
    batch: int = 32  # examples a step
    rate: float = 2e-3  # largest learning rate; see `rate_at`
    warm_up: float = 0.1  # share of the steps in which the rate rises
    final: float = 1e-3  # the last rate, as a share of the largest one
    weight_decay: float = 0.02  # AdamW's, for weights of two dimensions and more
    clip: float = 5.0  # largest norm of the gradient
    average: float = 0.998  # decay a step of the moving average of the weights, which is what comes out
    patience: int = 0  # stop after so many epochs without a better validation score; 0 never stops early
    # of torch, each of which learns from its part of a batch (`simgrab.training.copies`): another number gives other
    # weights; on cores that others use as well, choose fewer
    threads: int = 2
    device: str = "cpu"  # `"cpu"`, `"cuda"`, …
    half: bool = False  # multiply in bfloat16 (worth it where the machine has units for it)

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
