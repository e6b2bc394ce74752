"""Where a net is trained: the device, what is moved there, and what it cannot hold."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import Tensor

from simgrab.errors import TrainingError, first_line
from simgrab.training.recipe import TrainingRecipe


def named(name: str) -> torch.device:
    """Open a device; raises `TrainingError` if this machine has none of the name."""
    try:
        device = torch.device(name)
        torch.empty(1, device=device)
    except (RuntimeError, AssertionError) as problem:
        raise TrainingError(f"device {name!r} cannot be used: {first_line(problem)}") from None
    return device


def to_device(batch: dict[str, Tensor], device: torch.device) -> dict[str, Tensor]:
    """Move a batch; pictures of floats, (n, channels, height, width), become channels-last."""
    plain, last = torch.preserve_format, torch.channels_last
    return {
        name: value.to(device, memory_format=last if value.ndim == 4 and value.is_floating_point() else plain)
        for name, value in batch.items()
    }


@contextmanager
def out_of_memory(recipe: TrainingRecipe) -> Iterator[None]:
    """Turn a lack of memory into one line."""
    line = f"out of memory with batches of {recipe.batch} on {recipe.device}: choose a smaller --batch"
    try:
        yield
    except (MemoryError, RuntimeError) as problem:  # the latter is what torch's allocators raise
        text = str(problem).lower()
        if isinstance(problem, MemoryError) or "not enough memory" in text or "alloc" in text:
            raise TrainingError(line) from None
        raise
