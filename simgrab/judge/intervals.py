"""Intervals of counted shares."""

from __future__ import annotations

from scipy import stats

LEVEL = 0.95


def clopper_pearson(count: int, of: int, level: float = LEVEL) -> tuple[float, float] | None:
    """Exact interval of a share (Clopper & Pearson 1934), for independent trials; None where nothing is counted."""
    if not of:
        return None
    interval = stats.binomtest(count, of).proportion_ci(level, method="exact")
    return float(interval.low), float(interval.high)
