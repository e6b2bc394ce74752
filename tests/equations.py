"""The paper's equations, which hold where camera and rope exit coincide."""

import numpy as np


def eq1_residual(m, alpha, gamma, beta, h):
    """(m² + h²)(cosα cosβ + sinα sinβ cosγ)²/h² − 1, zero by eq. (1)."""
    cos_psi = np.cos(alpha) * np.cos(beta) + np.sin(alpha) * np.sin(beta) * np.cos(gamma)
    return (m**2 + h**2) * cos_psi**2 / h**2 - 1


def eq2_cos_alpha(m, theta, beta, h):
    """Eq. (2): cosα = (m sinβ cosθ + h cosβ) / √(m² + h²)."""
    return (m * np.sin(beta) * np.cos(theta) + h * np.cos(beta)) / np.hypot(m, h)
