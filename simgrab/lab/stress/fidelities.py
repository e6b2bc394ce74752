"""How far a replication goes from truth to angles."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Generic, TypeVar

from simgrab.errors import StressError
from simgrab.lab.stress import convergence, geometric, rendered, score, situation, study
from simgrab.lab.stress.axes import AXES
from simgrab.lab.stress.parameters import Value
from simgrab.lab.stress.records import Picture, Records
from simgrab.lab.stress.situation import Situation
from simgrab.lab.stress.study import Study
from simgrab.model.scenario import Scenario

Here = TypeVar("Here")


@dataclass(frozen=True)
class Fidelity(Generic[Here]):
    """One fidelity.

    Attributes
    ----------
    name : str
    settle : callable
        Study and point → what every replication there is drawn from; raises `StressError` where that cannot be.
    draw : callable
        That, seed and numbers of the replications → what the estimators get. A replication depends on its number alone.
    together : callable
        That → how many replications may be drawn together.
    show : callable
        That, seed and number → what the estimators get of one replication, and its pictures, where there are any.
    made_with : callable
        Gives what else than study and package the numbers depend on; empty where nothing.
    keys : tuple of str
        Keys of a scene, or tables of them, that reach it.
    whole : bool
        Whether axes that are no scene's key reach it.
    """

    name: str
    settle: Callable[[Study, tuple[Value, ...]], Here]
    draw: Callable[[Here, int, Sequence[int]], Records]
    together: Callable[[Here], int]
    show: Callable[[Here, int, int], tuple[Records, Picture | None]]
    made_with: Callable[[], str]
    keys: tuple[str, ...]
    whole: bool

    def axes(self) -> list[str]:
        """Names of the axes that reach it."""
        return [axis.name for axis in AXES.values() if axis.key or self.whole]


GEOMETRIC = Fidelity[Situation](
    "geometric", study.situation, geometric.draw, geometric.together, geometric.show, str, situation.KEYS, whole=True
)
RENDERED = Fidelity[Scenario](
    "rendered", rendered.settle, rendered.draw, rendered.together, rendered.show, rendered.made_with, rendered.KEYS,
    whole=False,
)  # fmt: skip
FIDELITIES: Mapping[str, Fidelity[Any]] = MappingProxyType(
    {fidelity.name: fidelity for fidelity in (GEOMETRIC, RENDERED)}
)
"""Fidelity by name."""


def find(name: str) -> Fidelity[Any]:
    """Find a fidelity; raises `StressError` naming what there is."""
    if name not in FIDELITIES:
        raise StressError(f"unknown depth {name!r}; one of: {', '.join(FIDELITIES)}")
    return FIDELITIES[name]


def columns(kind: str) -> tuple[str, ...]:
    """Numbers of a row of a study of this kind."""
    return tuple(score.COLUMNS if kind == "estimators" else convergence.COLUMNS)
