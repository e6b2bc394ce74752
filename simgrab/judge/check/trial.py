"""One instrument before one dataset: what it measured, as figures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from simgrab.dataset.datasets import Dataset
from simgrab.errors import InstrumentError
from simgrab.instrument.contract import Instrument
from simgrab.instrument.run.run import measure
from simgrab.instrument.run.subject import one_line
from simgrab.instrument.source import open_source
from simgrab.judge.evaluate.evaluation import evaluate
from simgrab.model import calibration

Metrics = Mapping[str, float | None]


@dataclass(frozen=True)
class Trial:
    """What came of one scene.

    Attributes
    ----------
    dataset : Dataset
    metrics : mapping of str to float or None
        By dotted name; None where there was nothing to count. Empty where the instrument failed.
    problem : str
        Why it did.
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
        If the instrument fails, or does not keep to the contract.
    """
    camera = calibration.load(dataset.path / "camera.toml")
    source = open_source(dataset.path)
    with one_line(instrument.name):
        run = measure(source, camera, instrument, source=source.name)
    with one_line(f"{instrument.name}: cannot be evaluated"):
        return flat(evaluate(run, dataset.path).to_dict())


def flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, float | None]:
    """Name the numbers in nested tables by dotted keys; what is no number is left out.

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
