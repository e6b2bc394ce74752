"""Recipes of the detector."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from simgrab.training.recipe import TrainingRecipe

Recipes = dict[str, TrainingRecipe]
"""By the nets' names."""

# Frames shown in all, however many there are to learn from.
SHOWN = {"coarse": 40_000, "pose": 120_000}
SHOWN_QUICK = {"coarse": 10_000, "pose": 24_000}
# Of nets that begin with trained weights: about 11 minutes on two cores.
SHOWN_AFTER = {"coarse": 8_000, "pose": 30_000}
SHOWN_AFTER_QUICK = {"coarse": 2_000, "pose": 6_000}
RATE_AFTER = 0.5  # of the usual one


def recipes(
    frames: int, *, quick: bool = False, started: bool = False, shown: Mapping[str, int] | None = None,
    epochs: int | None = None, batch: int | None = None, half: bool | None = None, **changes: object,
) -> Recipes:  # fmt: skip
    """Set the nets' recipes.

    Parameters
    ----------
    frames : int
        To learn from.
    quick : bool
        A quarter of the pictures and a fifth of the crops, in about a fifth of the time.
    started : bool
        Whether the nets begin with trained weights: fewer frames, at half the rate.
    shown : mapping of str to int, optional
        Frames shown in all, by net; else as in `SHOWN`, `SHOWN_QUICK`, `SHOWN_AFTER` or `SHOWN_AFTER_QUICK`.
    epochs : int, optional
        Of each; by default as many as show the usual number of frames.
    batch : int, optional
        Examples a step of each; by default 16 of the coarse net, 32 of the pose net.
    half : bool, optional
        Multiply in bfloat16; by default where this machine has units for it.
    **changes
        Other settings of all.
    """
    of_start = (SHOWN_AFTER, SHOWN_AFTER_QUICK) if started else (SHOWN, SHOWN_QUICK)
    shown = of_start[quick] | dict(shown or {})
    whether = has_half_units(str(changes.get("device", "cpu"))) if half is None else half
    common = replace(TrainingRecipe(half=whether), **changes)  # type: ignore[arg-type]

    def one(name: str, rate: float, usual: int) -> TrainingRecipe:
        wanted = max(round(shown[name] / max(frames, 1)), 1) if epochs is None else epochs
        rate *= RATE_AFTER if started else 1.0
        return replace(common, epochs=wanted, rate=rate, batch=min(usual if batch is None else batch, max(frames, 1)))

    return {"coarse": one("coarse", 1e-3, 16), "pose": one("pose", 1e-3, 32)}


def has_half_units(device: str) -> bool:
    """Whether a device has units for bfloat16: CPUs with AMX or AVX-512 BF16, and newer GPUs."""
    import torch

    if device.startswith("cuda"):
        return torch.cuda.is_available() and torch.cuda.is_bf16_supported()
    return bool(torch.cpu._is_amx_tile_supported() or torch.cpu._is_avx512_bf16_supported())
