"""A baseline: metrics of an instrument, recorded over several seeds, and how much later metrics may differ.

The spread over seeds is measured: the suite is run with R seeds. A value under another seed lies within t s √(1 + 1/R)
of their mean, where s is their standard deviation and t Student's quantile with R − 1 degrees of freedom (a prediction
interval, exact for normal metrics). The probability of a value beyond its limit is divided evenly among all limits of a
suite (Bonferroni), so that an unchanged instrument fails with a probability of at most `FALSE_FAILURES`. On the
recorded frames themselves there is no chance: a metric may be worse by its slack only.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from scipy import stats

from simgrab._version import __version__
from simgrab.errors import SuiteError
from simgrab.io.journal import differences
from simgrab.io.parse import read_json
from simgrab.io.strict import convert
from simgrab.judge.check.suite import Limit, Suite
from simgrab.judge.check.trial import Trial
from simgrab.model.scenario import Scenario
from simgrab.model.scenario.whole import difference

FILE = "baseline.json"
FALSE_FAILURES = 1e-3  # of a whole check, for an instrument that is what it was

ROUNDING = 1e-9  # more than that of the very same work by another build of a library


class Recorded(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Record of one scene over R seeds.

    Attributes
    ----------
    digest : str
        Digest of the scenario, under the suite's own seed.
    labels : tuple of R str
        Digests of the datasets' labels, and through them of their pictures.
    metrics : dict of str to tuple of R floats or None
    scenario : dict
        The keys that are not as by default, to name those that differ later.
    """

    digest: str
    labels: tuple[str, ...]
    metrics: dict[str, tuple[float | None, ...]]
    scenario: dict[str, Any]


class Baseline(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Record of a suite.

    Attributes
    ----------
    suite, instrument : str
        Their names.
    simgrab : str
        Version that rendered and evaluated, without its last part, which changes no pixel of a bundled scene.
    seeds : tuple of R int
    scenes : dict of str to Recorded
    """

    suite: str
    instrument: str
    simgrab: str
    seeds: Annotated[tuple[int, ...], msgspec.Meta(min_length=1)]
    scenes: dict[str, Recorded]


def version() -> str:
    """Return the part of simgrab's version with which pixels and metrics may change."""
    return ".".join(__version__.split(".")[:2])


def compose(suite: Suite, instrument: str, seeds: tuple[int, ...], trials: Mapping[str, list[Trial]]) -> Baseline:
    """Compose a baseline from the measurements of each scene under each seed."""
    scenes = {}
    for name, of_scene in trials.items():
        metrics = {key: tuple(one.metrics.get(key) for one in of_scene) for key in suite.limits_of(name)}
        labels = tuple(one.dataset.data.labels_sha256 for one in of_scene)
        scenario = suite.scenario(name)
        scenes[name] = Recorded(scenario.digest(), labels, metrics, _stated(scenario))
    return Baseline(suite.name, instrument, version(), seeds, scenes)


def _stated(scenario: Scenario) -> dict[str, Any]:
    return difference(Scenario().to_dict(), scenario.to_dict())


def load(folder: Path) -> Baseline | None:
    """Read a baseline, None if nothing is recorded yet; raises `SuiteError` for another file."""
    path = folder / FILE
    if not os.path.lexists(path):
        return None
    return convert(read_json(path, refusal, "baseline"), Baseline, refusal, path)


def refusal(problem: str) -> SuiteError:
    """Make the error of a recorded file that cannot be used."""
    return SuiteError(f"{problem}; record it again with --update-baseline")


def stale(baseline: Baseline, suite: Suite, instrument: str) -> list[str]:
    """Return why a baseline cannot be used: one reason for each property that differs from the recorded one."""
    reasons = []
    for what, then, now in (
        ("suite", baseline.suite, suite.name),
        ("instrument", baseline.instrument, instrument),
        ("simgrab", baseline.simgrab, version()),
    ):
        if then != now:
            reasons.append(f"recorded for the {what} {then!r}, and this is {now!r}")
    for name in suite.scenes:
        recorded, scenario, place = baseline.scenes.get(name), suite.scenario(name), f"scenes.{name}"
        if recorded is None:
            reasons.append(f"{place} was not recorded")
        elif recorded.digest != scenario.digest():
            keys = differences({place: recorded.scenario}, {place: _stated(scenario)})
            reasons.append(f"{keys or f'a default of {place}'} was recorded with another value")
        elif missing := [key for key in suite.limits_of(name) if key not in recorded.metrics]:
            reasons.append(f"{place}: {', '.join(missing)} was not recorded")
    return reasons


class Reference(msgspec.Struct, frozen=True):
    """Reference value of a metric.

    Attributes
    ----------
    value : float
        Value of the same frames, or else the mean over all seeds.
    allowed : float
        By how much a metric may be worse.
    same_frames : bool
    """

    value: float
    allowed: float
    same_frames: bool

    def holds(self, value: float, limit: Limit) -> bool:
        """Whether a value is no worse than allowed; ``limit`` determines which direction is worse."""
        return limit.excess(value) <= limit.excess(self.value) + self.allowed


def reference(recorded: Recorded, metric: str, limit: Limit, labels: str, comparisons: int) -> Reference | None:
    """Find the reference of a metric; None if nothing was recorded.

    ``labels`` is the digest of the labels of the dataset that was measured now, ``comparisons`` the number of limits'
    ends that share the probability of a false failure.
    """
    values = recorded.metrics[metric]
    if labels in recorded.labels:
        same = values[recorded.labels.index(labels)]
        return None if same is None else Reference(same, limit.allows(same) + ROUNDING, True)
    known = np.array([v for v in values if v is not None])
    if len(known) < 2:
        return None
    spread = deviations(len(known), comparisons) * float(known.std(ddof=1))
    mean = float(known.mean())
    return Reference(mean, limit.allows(mean) + ROUNDING + spread, False)


def deviations(seeds: int, comparisons: int) -> float:
    """How many standard deviations over so many seeds a metric of other frames may lie from their mean."""
    return float(stats.t.isf(FALSE_FAILURES / comparisons, seeds - 1)) * math.sqrt(1 + 1 / seeds)


def ends(suite: Suite) -> int:
    """Count the ends of all limits of a suite; each may fail falsely."""
    limits = [limit for name in suite.scenes for limit in suite.limits_of(name).values()]
    return sum((limit.lower is not None) + (limit.upper is not None) for limit in limits)
