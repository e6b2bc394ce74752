"""Where the grab is in a picture: a detector of our nets, or a user's own YOLO, by one protocol."""

from __future__ import annotations

import os
from pathlib import Path

from simgrab.errors import DetectorError
from simgrab.instrument.detect.bundled import FIND, FOUR_ROPE, GENERIC, REFINE, SETTLE, SHIPPED, WEIGHTS, GrabDetector
from simgrab.instrument.detect.contract import Detector
from simgrab.instrument.detect.yolo import Yolo
from simgrab.instrument.net import open_net


def detector(name: str | Path = FOUR_ROPE) -> Detector:
    """Open a detector.

    Parameters
    ----------
    name : str or path
        ``"bundled"`` for the default four-rope grab, ``"any-grab"`` for grabs of all kinds, a folder with nets as
        `simgrab train` writes them, or a YOLO's ``.onnx`` file.

    Raises
    ------
    DetectorError
        If it is not a detector; states what was expected and what was found.

    Examples
    --------
    >>> import numpy as np
    >>> detector()(np.zeros((1080, 1920, 3), np.uint8)).status
    'none'
    """
    path = located(name)
    if path in SHIPPED.values() and not (path / "find.onnx").exists():
        raise DetectorError(
            f"no weights are bundled for {name!r}: name a folder that `simgrab train detector` wrote, or a YOLO's .onnx"
        )
    if os.path.isdir(path):  # noqa: PTH112  # unlike Path.is_dir answers no where a name is too long
        return GrabDetector(path)
    net = open_net(path)
    if net.facts.get("task") in (FIND, REFINE, SETTLE):
        return GrabDetector(path.parent)
    return Yolo(net)


def located(name: str | Path) -> Path:
    """Return the folder of a bundled detector, by its name; any other path is returned unchanged."""
    return SHIPPED[name] if isinstance(name, str) and name in SHIPPED else Path(name)


__all__ = ["FOUR_ROPE", "GENERIC", "SHIPPED", "WEIGHTS", "Detector", "GrabDetector", "Yolo", "detector", "located"]
