"""Limits on the angle that would be met without measuring it, by the same answer for every frame."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from simgrab.dataset.datasets import Dataset
from simgrab.judge.check.suite import Limit
from simgrab.judge.check.trial import flat
from simgrab.judge.evaluate import swings
from simgrab.judge.evaluate.truths import Truths

_ANSWERS = 101  # between the least and the largest true angle: the best is hardly better than the best of these


def warning(scene: str, dataset: Dataset, limits: Mapping[str, Limit]) -> str:
    """Say that a constant answer meets every limit on errors of the angle; empty where none does.

    Parameters
    ----------
    scene : str
        Its name in the suite.
    dataset : Dataset
        Its frames.
    limits : mapping of str to Limit
        By metric; those on other figures are left out.
    """
    limits = {name: limit for name, limit in limits.items() if name.startswith("angle.") and name.endswith("_deg")}
    known = Truths(dataset.rows, tuple(map(dataset.weather, dataset.rows)), dataset.least_visible_fraction)
    true = known.alpha
    if not limits or not np.isfinite(true).any():
        return ""
    for answer in np.linspace(np.nanmin(true), np.nanmax(true), _ANSWERS):
        errors = swings.angles(np.full(len(true), answer), true, known.rope_length, known.weather)
        values = flat({"angle": errors})
        if all((value := values.get(name)) is not None and limit.holds(value) for name, limit in limits.items()):
            accepted = ", ".join(f"{name} {limit}" for name, limit in limits.items())
            return f"{scene}: an instrument that always answers {np.rad2deg(answer):.1f}° would pass {accepted}"
    return ""
