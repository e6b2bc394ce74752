"""Draws from the model of Yu, Wang & Wang (2025), section 4.3, made as their section 4.4 makes them."""

from __future__ import annotations

import numpy as np

from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array, image_radius
from simgrab.model.rng import stream

AXIS_DIRECTION = 0.0  # of C'G' in the picture, where it is known


def camera(h: float) -> Calibration:
    """Build a 1920 × 1080 camera without distortion and of focal length h, pixels, at the rope exit."""
    return Calibration(width_px=1920, height_px=1080, focal_length_px=h, cx_px=960.0, cy_px=540.0)


def draw(
    seed: int, name: str, records: int, frames: int, *, beta: float, sigma: float, h: float
) -> tuple[Array, Array]:
    """Draw γ ~ U[0, 2π) and α = |Z|, Z ~ N(0, σ²); m from eq (1), cosθ from eq (2) with the true α and β.

    Parameters
    ----------
    name : str
        Of the study, which keys the streams together with the number of frames.
    records, frames : int
        M and n.
    beta, sigma : float
        Radians.
    h : float
        Pixels.

    Returns
    -------
    pixels : ndarray, shape (M, n, 2)
    alpha : ndarray, shape (M, n)
        Radians.
    """
    alpha = np.abs(stream(seed, frames, f"paper.{name}.alpha").normal(size=(records, frames))) * sigma
    gamma = stream(seed, frames, f"paper.{name}.gamma").uniform(0, 2 * np.pi, (records, frames))
    m = image_radius(alpha, gamma, beta, h)
    with np.errstate(invalid="ignore", divide="ignore"):
        cos_theta = (np.cos(alpha) * np.hypot(m, h) - h * np.cos(beta)) / (m * np.sin(beta))
    theta = np.copysign(np.arccos(np.clip(cos_theta, -1, 1)), np.sin(gamma))
    return camera(h).intrinsics.from_polar(m, np.where(m > 0, theta, 0.0), AXIS_DIRECTION), alpha
