"""The paper's validation model: the swing from the apparent width of the grab."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from simgrab.model.geometry import Array


def swing_by_width(m_px: ArrayLike, width_px: ArrayLike, rope_length: ArrayLike, width_m: float = 2.9) -> Array:
    """α̃ = arcsin(m·b/(x·l)), which x·l·cosα = h·b and tanα = m/h give for β = 0 (section 4.6).

    It does not use the tilt. For a camera at the rope exit it is, up to the width's own error, the angle ψ of
    the ray from the optical axis, so that |ψ − α̂| ≤ β̂ holds by the triangle inequality for any β̂, right or wrong:
    this check cannot fail.

    Parameters
    ----------
    m_px : array_like, shape (n,)
        m, distance of the grab centre from the principal point, undistorted.
    width_px : array_like, shape (n,)
        x, the apparent width of the grab.
    rope_length : array_like, shape (n,)
        l, m.
    width_m : float
        b, the grab's width; the paper's by default.

    Returns
    -------
    ndarray, shape (n,)
        Radians; NaN where the arcsine has no value.
    """
    m, x, rope = (np.asarray(v, float) for v in (m_px, width_px, rope_length))
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = m * width_m / (x * rope)
        return np.asarray(np.arcsin(np.where(np.abs(ratio) <= 1, ratio, np.nan)))
