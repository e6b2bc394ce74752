"""Checkpoints: written whole or not at all, and taken up only by the training that wrote them."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import torch

from simgrab.errors import TrainingError
from simgrab.training.folder import write


def save(path: Path, state: dict[str, Any]) -> None:
    """Write a checkpoint, replacing the one before only once the new one lies whole on the disk."""
    buffer = io.BytesIO()
    torch.save(state, buffer)
    write(path, buffer.getvalue())


def load(path: Path, identity: dict[str, Any]) -> dict[str, Any]:
    """Read a checkpoint.

    Parameters
    ----------
    path : Path
    identity : dict
        What makes the training what it is: recipe, data and versions.

    Raises
    ------
    TrainingError
        If it is none, or another training's; names the settings that differ.
    """
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
        known = state["identity"]
    except Exception as problem:
        raise TrainingError(f"{path} is no checkpoint of simgrab ({type(problem).__name__})") from None
    differing = [key for key in sorted(known.keys() | identity.keys()) if known.get(key) != identity.get(key)]
    if differing:
        changes = ", ".join(f"{key} {known.get(key)!r} became {identity.get(key)!r}" for key in differing[:3])
        raise TrainingError(
            f"{path} is of another training ({changes}): --resume needs the same, or choose another --out"
        )
    return dict(state)
