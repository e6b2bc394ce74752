"""Test one instrument on one dataset: its metrics, and the limits that a constant answer would meet."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from simgrab.dataset.datasets import Dataset
from simgrab.errors import InstrumentError
from simgrab.instrument.contract import Instrument
from simgrab.instrument.run.run import measure
from simgrab.instrument.run.subject import one_line
from simgrab.instrument.source import open_source
from simgrab.judge.check.suite import Limit
from simgrab.judge.evaluate import swings
from simgrab.judge.evaluate.evaluation import evaluate
from simgrab.judge.evaluate.truths import Truths
from simgrab.model import calibration

_ANSWERS = 101  # between the least and the largest true angle: the best is hardly better than the best of these
Metrics = Mapping[str, float | None]


@dataclass(frozen=True)
class Trial:
    """Result of one scene.

    Attributes
    ----------
    dataset : Dataset
    metrics : mapping of str to float or None
        Metrics by dotted name; None if there was nothing to count. Empty if the instrument failed.
    problem : str
        Why the instrument failed.
    """

    dataset: Dataset
    metrics: Metrics
    problem: str = ""


def trial(dataset: Dataset, instrument: Instrument) -> Trial:
    """Let an instrument measure a dataset, and evaluate; its failure is a result too."""
    try:
        return Trial(dataset, measured(dataset, instrument))
    except InstrumentError as problem:
        return Trial(dataset, {}, str(problem))


def measured(dataset: Dataset, instrument: Instrument) -> Metrics:
    """Let an instrument measure a dataset, and evaluate.

    Returns
    -------
    mapping of str to float or None
        Results of `simgrab.judge.evaluate.evaluation.evaluate`, by dotted name.

    Raises
    ------
    InstrumentError
        If the instrument fails, or breaks the contract.
    """
    camera = calibration.load(dataset.path / "camera.toml")
    source = open_source(dataset.path)
    with one_line(instrument.name):
        run = measure(source, camera, instrument, source=source.name)
    with one_line(f"{instrument.name}: cannot be evaluated"):
        return flat(evaluate(run, dataset.path).to_dict())


def flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, float | None]:
    """Name the numbers in nested tables by dotted keys; other values are left out.

    Examples
    --------
    >>> flat({"angle": {"rmse_deg": 0.2, "interval": (0.1, 0.3), "worst": None}})
    {'angle.rmse_deg': 0.2, 'angle.worst': None}
    """
    result: dict[str, float | None] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            result |= flat(value, f"{prefix}{key}.")
        elif value is None:
            result[f"{prefix}{key}"] = None
        elif isinstance(value, bool | int | float):
            result[f"{prefix}{key}"] = float(value) if math.isfinite(value) else None
    return result


def constant_answer(scene: str, dataset: Dataset, limits: Mapping[str, Limit]) -> str:
    """Return a note that a constant answer meets every limit on errors of the angle; empty if none does.

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
