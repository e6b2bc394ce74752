"""The paper's camera, and its first equation."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from simgrab.model.geometry.rotations import Array

# The paper's camera (section 4.3). 2202.907 px / 6.43 mm is 342.60; the printed figure is kept.
PAPER_PIXELS_PER_MM = 342.67
PAPER_FOCAL_LENGTH_MM = 4.8


def image_radius(alpha: ArrayLike, gamma: ArrayLike, beta: ArrayLike, h: float) -> Array:
    """Solve eq. (1) for m: image radius, px, of a grab with swing (α, γ) seen by a camera at O tilted by β."""
    a, g, b = (np.asarray(v, float) for v in (alpha, gamma, beta))
    cos_psi = np.cos(a) * np.cos(b) + np.sin(a) * np.sin(b) * np.cos(g)
    return np.asarray(h * np.sqrt(np.maximum(1 / cos_psi**2 - 1, 0.0)))
