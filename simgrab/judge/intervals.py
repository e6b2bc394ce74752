"""Intervals of counted shares."""

from __future__ import annotations

from scipy import stats

LEVEL = 0.95


def clopper_pearson(count: int, of: int) -> tuple[float, float] | None:
    """Exact 95 % interval of a share (Clopper & Pearson 1934), of independent trials; None of nothing."""
    if not of:
        return None
    interval = stats.binomtest(count, of).proportion_ci(LEVEL, method="exact")
    return float(interval.low), float(interval.high)
