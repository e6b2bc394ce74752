"""Checkpoints: written whole or not at all, and taken up only by the training that wrote them.

They hold tensors and plain values, and are read as such: nothing in one is executed.
"""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import torch

from simgrab.errors import TrainingError, one_line
from simgrab.io.parse import shown
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
    identity : dict
        What makes the training what it is: recipe, data and versions.

    Raises
    ------
    TrainingError
        If it is none, or another training's; names the settings that differ.
    """
    try:
        with zipfile.ZipFile(path) as archive:  # torch compresses nothing; what is may be larger than memory
            if any(entry.compress_type != zipfile.ZIP_STORED for entry in archive.infolist()):
                raise ValueError("compressed")
        state: dict[str, Any] = dict(torch.load(path, map_location="cpu", weights_only=True))
        known = dict(state["identity"])
    except Exception as problem:
        raise TrainingError(f"{path} is not a simgrab checkpoint ({type(problem).__name__})") from None
    differing = [key for key in sorted(known.keys() | identity.keys(), key=str) if known.get(key) != identity.get(key)]
    if differing:
        changes = ", ".join(
            f"{one_line(key, 40)} {shown(known.get(key))} became {shown(identity.get(key))}" for key in differing[:3]
        )
        raise TrainingError(
            f"{path} belongs to another training ({changes}): --resume needs the same settings, or choose another --out"
        )
    return state
