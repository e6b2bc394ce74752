"""Mirror crops, and average a net's outputs on them: their errors differ, so the mean has a smaller error."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simgrab.instrument.detect.patches import Picture
from simgrab.model.geometry import Array

#: Left to right, and upside down: a crop is seen in the first of these ways, as many as the settings say.
FLIPS = ((False, False), (True, False), (False, True), (True, True))
#: As many of them are seen by newly trained detectors; with all four, little more is gained.
WAYS = 2


def flipped(crops: Picture, ways: int) -> Picture:
    """Mirror crops (n, h, w, channels) in ``ways`` ways: shape (ways * n, h, w, channels)."""
    return np.concatenate([
        crops[:, :: -1 if down else 1, :: -1 if across else 1] for across, down in FLIPS[:ways]
    ])  # fmt: skip


def averaged(rows: NDArray[np.floating], ways: int) -> Array:
    """Mirror refine's or settle's output on `flipped` crops, (ways * n, 16), back, and average it; shape (n, 16).

    Log scales and logits are averaged as they are, and yaw as a direction.
    """
    each = rows.astype(float).reshape(ways, -1, rows.shape[-1])
    for part, way in zip(each, FLIPS[:ways], strict=True):
        for axis, mirrored in enumerate(way):
            if mirrored:
                low, high, centre = axis, 2 + axis, 4 + axis
                part[:, [low, high]] = 1 - part[:, [high, low]]
                part[:, centre] = 1 - part[:, centre]
                part[:, [6 + low, 6 + high]] = part[:, [6 + high, 6 + low]]
                part[:, 13] *= -1
    yaw = each[..., 12:14]
    each[..., 12:14] = yaw / np.maximum(np.linalg.norm(yaw, axis=-1, keepdims=True), 1e-6)
    return np.asarray(each.mean(axis=0))
