"""How far counted shares and means of a sample are to be trusted."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np
from scipy import stats

from simgrab.model.geometry import Array

LEVEL = 0.95


def clopper_pearson(count: int, of: int) -> tuple[float, float] | None:
    """Exact 95 % interval of a share (Clopper & Pearson 1934), of independent trials; None of nothing."""
    if not of:
        return None
    interval = stats.binomtest(count, of).proportion_ci(LEVEL, method="exact")
    return float(interval.low), float(interval.high)


def standard_error(values: Array, groups: Sequence[Hashable]) -> float:
    """Tell the standard error of a mean of values alike within groups, by the groups' sums (Liang & Zeger 1986).

    Parameters
    ----------
    values : ndarray, shape (n,)
    groups : sequence of n hashables
        Where there is one group alone, its values are taken for independent.
    """
    number = {group: i for i, group in enumerate(dict.fromkeys(groups))}
    which = np.array([number[group] for group in groups]) if len(number) > 1 else np.arange(len(values))
    sums = np.bincount(which, values - values.mean())
    return float(np.sqrt(len(sums) / max(len(sums) - 1, 1) * (sums**2).sum()) / len(values))
