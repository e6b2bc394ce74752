"""Tilt and swing from pixels: estimators under one contract, each imported when it is first used."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from functools import cached_property
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Any

from simgrab.errors import RecordError, first_line

if TYPE_CHECKING:
    from simgrab.instrument.estimate.contract import Estimator as Estimator
    from simgrab.instrument.estimate.geometric_median import GeometricMedian as GeometricMedian
    from simgrab.instrument.estimate.intervals import IntervalSettings as IntervalSettings
    from simgrab.instrument.estimate.mean_ray import MeanRay as MeanRay
    from simgrab.instrument.estimate.paper_iteration import PaperIteration as PaperIteration
    from simgrab.instrument.estimate.pendulum_smoother import PendulumSmoother as PendulumSmoother
    from simgrab.instrument.estimate.rope_aware import RopeAware as RopeAware
    from simgrab.instrument.estimate.zero_tilt import ZeroTilt as ZeroTilt

GROUP = "simgrab.estimators"
DEFAULT = "mean-ray"
_OWN = {
    "paper-iteration": f"{__name__}.paper_iteration:PaperIteration",
    "mean-ray": f"{__name__}.mean_ray:MeanRay",
    "geometric-median": f"{__name__}.geometric_median:GeometricMedian",
    "rope-aware": f"{__name__}.rope_aware:RopeAware",
    "pendulum-smoother": f"{__name__}.pendulum_smoother:PendulumSmoother",
    "zero-tilt": f"{__name__}.zero_tilt:ZeroTilt",
}
_OTHERS = ("contract:Estimator", "intervals:IntervalSettings")


class EstimatorTable(Mapping[str, "type[Estimator]"]):
    """Maps names on the command line to classes. A class is imported on first use, and can be made without arguments.

    A name may be shortened to one of its words, or written as the class is: ``paper``, ``PaperIteration``.

    Parameters
    ----------
    own : mapping of str to str
        ``package.module:Class`` of each name. Installed packages add their own as entry points of the group
        ``simgrab.estimators``.

    Raises
    ------
    RecordError
        From ``[]``, in one line, for a class that cannot be imported or is not an `Estimator`.
    """

    def __init__(self, own: Mapping[str, str]) -> None:
        self._own = own

    @cached_property
    def _places(self) -> dict[str, str]:
        others = sorted(entry_points(group=GROUP), key=lambda point: point.name)
        return {**self._own, **{point.name: point.value for point in others if point.name not in self._own}}

    def full(self, name: str) -> str:
        """Complete a name; one that fits no estimator, or several, is returned as it is."""
        plain = name.lower().replace("_", "-")
        fits = [one for one in self._places if plain in (one, one.replace("-", ""), *one.split("-"))]
        return name if name in self._places or len(fits) != 1 else fits[0]

    def __getitem__(self, name: str) -> type[Estimator]:
        from simgrab.instrument.estimate.contract import Estimator

        place = self._places[self.full(name)]
        module, _, attribute = place.partition(":")
        try:
            kind = getattr(importlib.import_module(module), attribute)
        except (ImportError, AttributeError) as problem:
            raise RecordError(f"the estimator {name!r} ({place}) is not installed: {first_line(problem)}") from None
        if not (isinstance(kind, type) and issubclass(kind, Estimator)):
            raise RecordError(f"the estimator {name!r} ({place}) is not a subclass of {__name__}.Estimator")
        return kind

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and self.full(name) in self._places

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)


ESTIMATORS = EstimatorTable(_OWN)


def __getattr__(name: str) -> Any:
    for place in (*_OWN.values(), *(f"{__name__}.{other}" for other in _OTHERS)):
        module, _, attribute = place.partition(":")
        if attribute == name:
            return getattr(importlib.import_module(module), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
