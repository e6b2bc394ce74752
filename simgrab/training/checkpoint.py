"""Checkpoints: written whole or not at all, and taken up only by the training that wrote them."""

from __future__ import annotations

import contextlib
import io
import os
from pathlib import Path
from typing import Any

import torch

from simgrab.errors import TrainingError


def save(path: Path, state: dict[str, Any]) -> None:
    """Write a checkpoint, replacing the one before only once the new one lies whole on the disk."""
    buffer = io.BytesIO()
    torch.save(state, buffer)
    write_whole(path, buffer.getvalue())


def write_whole(path: Path, data: bytes) -> None:
    """Write a file whole or not at all, whenever the process or the machine stops."""
    draft = path.with_name(f"{path.name}.draft")
    try:
        with draft.open("wb") as handle:
            handle.write(data)
            handle.flush()
            os.fsync(handle.fileno())
        draft.replace(path)
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    except OSError as problem:
        with contextlib.suppress(OSError):
            draft.unlink()
        raise TrainingError(f"cannot write {path}: {problem.strerror or problem}") from None


def claim(out: Path, *, resume: bool) -> None:
    """Make the folder of a training, or refuse one that is in use.

    Raises
    ------
    TrainingError
    """
    try:
        if out.exists() and not out.is_dir():
            raise TrainingError(f"{out} is not a folder; choose another --out")
        if out.is_dir() and any(out.iterdir()) and not resume:
            raise TrainingError(f"{out} is not empty; go on with --resume, or choose another --out")
        out.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise TrainingError(f"cannot write to {out}: {problem.strerror or problem}") from None


def load(path: Path, identity: dict[str, Any]) -> dict[str, Any]:
    """Read a checkpoint.

    Parameters
    ----------
    path : Path
    identity : dict
        What makes the training what it is: recipe and data.

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
