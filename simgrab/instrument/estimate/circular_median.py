"""The circular median, by which the paper finds its 0-degree line."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from simgrab.model.geometry import Array


def circular_median(angles: ArrayLike) -> float:
    """Direction of least mean arc to the angles (Mardia & Jupp 2000, 2.2.2), exactly, in O(n log n).

    Parameters
    ----------
    angles : array_like, shape (n,)
        Radians, any winding.

    Returns
    -------
    float
        In [0, 2π). Half of the angles lie to either side of the line through it, and most on its own half of the
        circle. For an even number it is midway between the two middle angles. Over [0, 2π) as a mere interval a
        median would depend on where the circle is cut.
    """
    t = np.sort(np.asarray(angles, float) % (2 * np.pi))
    n = len(t)
    twice = np.concatenate([t, t + 2 * np.pi])
    total = np.concatenate([[0.0], np.cumsum(twice)])
    k = np.arange(n)
    half = np.searchsorted(twice, t + np.pi, side="right")  # first angle that is nearer going backwards
    ahead = total[half] - total[k + 1] - (half - k - 1) * t
    behind = (k + n - half) * (t + 2 * np.pi) - (total[k + n] - total[half])
    arc: Array = ahead + behind
    best = int(np.argmin(arc))
    if n % 2:
        return float(t[best])
    level = arc[best] + 1e-9 * n
    after, before = (best + 1) % n, best - 1
    other = after if arc[after] <= min(level, arc[before]) else before if arc[before] <= level else best
    gap = (t[other] - t[best] + np.pi) % (2 * np.pi) - np.pi
    return float((t[best] + gap / 2) % (2 * np.pi))
