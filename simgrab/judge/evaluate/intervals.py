"""Intervals of counted shares, and standard errors of means."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np
from scipy import stats

from simgrab.model.geometry import Array

LEVEL = 0.95


def clopper_pearson(count: int, of: int) -> tuple[float, float] | None:
    """Exact 95 % interval of a share (Clopper & Pearson 1934), for independent trials; None without trials."""
    if not of:
        return None
    interval = stats.binomtest(count, of).proportion_ci(LEVEL, method="exact")
    return float(interval.low), float(interval.high)


def standard_error(values: Array, groups: Sequence[Hashable]) -> float:
    """Compute a mean's standard error for values (n,) correlated within n groups, by their sums (Liang & Zeger 1986).

    Values of a single group are taken as independent.
    """
    number = {group: i for i, group in enumerate(dict.fromkeys(groups))}
    which = np.array([number[group] for group in groups]) if len(number) > 1 else np.arange(len(values))
    sums = np.bincount(which, values - values.mean())
    return float(np.sqrt(len(sums) / max(len(sums) - 1, 1) * (sums**2).sum()) / len(values))
