"""Where the grab is in a picture: a detector of our nets, or a user's own YOLO, by one protocol."""

from __future__ import annotations

import os
from pathlib import Path

from simgrab.instrument.detect.contract import Detector
from simgrab.instrument.detect.grab import BUNDLED, COARSE, POSE, WEIGHTS, GrabDetector
from simgrab.instrument.detect.yolo import Yolo
from simgrab.instrument.net import open_net

_NAMES = (BUNDLED, "any-grab")  # the latter as commands call it that were written for two detectors


def detector(name: str | Path = BUNDLED) -> Detector:
    """Open a detector.

    Parameters
    ----------
    name : str or path
        ``"bundled"`` for the one that simgrab comes with, a folder with nets as `simgrab train` writes them, or a
        YOLO's ``.onnx`` file.

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
    if os.path.isdir(path):  # noqa: PTH112  # unlike Path.is_dir answers no where a name is too long
        return GrabDetector(path)
    net = open_net(path)
    if net.facts.get("task") in (COARSE, POSE):
        return GrabDetector(path.parent)
    return Yolo(net)


def located(name: str | Path) -> Path:
    """Return the folder of the bundled detector, by its names; any other path is returned unchanged."""
    return WEIGHTS if isinstance(name, str) and name in _NAMES else Path(name)


__all__ = ["BUNDLED", "WEIGHTS", "Detector", "GrabDetector", "Yolo", "detector", "located"]
