"""The paper's equations, and its camera."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from simgrab.model.geometry.rotations import Array

# The paper's camera (section 4.3). 2202.907 px / 6.43 mm is 342.60; the printed figure is kept.
PAPER_PIXELS_PER_MM = 342.67
PAPER_FOCAL_LENGTH_MM = 4.8


def image_radius(alpha: ArrayLike, gamma: ArrayLike, beta: ArrayLike, h: float) -> Array:
    """Solve eq. (1) for m: image radius, px, of a grab with swing (α, γ) seen by a camera at O tilted by β."""
    cos_psi = _cos_axis_angle(alpha, gamma, beta)
    return np.asarray(h * np.sqrt(np.maximum(1 / cos_psi**2 - 1, 0.0)))


def eq1_residual(m: ArrayLike, alpha: ArrayLike, gamma: ArrayLike, beta: ArrayLike, h: ArrayLike) -> Array:
    """Relative residual of eq. (1): (m² + h²)(cosα cosβ + sinα sinβ cosγ)²/h² − 1. Zero when camera and O coincide."""
    m_, h_ = np.asarray(m, float), np.asarray(h, float)
    return np.asarray((m_**2 + h_**2) * _cos_axis_angle(alpha, gamma, beta) ** 2 / h_**2 - 1)


def eq2_cos_alpha(m: ArrayLike, theta: ArrayLike, beta: ArrayLike, h: ArrayLike) -> Array:
    """Eq. (2): cosα = (m sinβ cosθ + h cosβ) / √(m² + h²). Holds when camera and O coincide."""
    m_, h_, b = np.asarray(m, float), np.asarray(h, float), np.asarray(beta, float)
    return np.asarray((m_ * np.sin(b) * np.cos(theta) + h_ * np.cos(b)) / np.hypot(m_, h_))


def _cos_axis_angle(alpha: ArrayLike, gamma: ArrayLike, beta: ArrayLike) -> Array:
    a, g, b = (np.asarray(v, float) for v in (alpha, gamma, beta))
    return np.asarray(np.cos(a) * np.cos(b) + np.sin(a) * np.sin(b) * np.cos(g))
