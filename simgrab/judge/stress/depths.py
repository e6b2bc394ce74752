"""How far a replication goes from truth to angles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from simgrab.errors import StressError
from simgrab.judge.stress import convergence, geometric, score
from simgrab.judge.stress.axes import AXES
from simgrab.judge.stress.geometric import Records
from simgrab.judge.stress.situation import KEYS, Situation


@dataclass(frozen=True)
class Depth:
    """One depth.

    Attributes
    ----------
    name : str
    draw : callable
        Situation, seed and numbers of the replications → what the estimators get.
    keys : tuple of str
        Keys of a scene, or tables of them, that reach it.
    whole : bool
        Whether axes that are no scene's key reach it.
    """

    name: str
    draw: Callable[[Situation, int, Sequence[int]], Records]
    keys: tuple[str, ...]
    whole: bool

    def axes(self) -> list[str]:
        """Names of the axes that reach it."""
        return [axis.name for axis in AXES.values() if axis.key or self.whole]


DEPTHS = MappingProxyType({depth.name: depth for depth in (Depth("geometric", geometric.draw, KEYS, whole=True),)})
"""Depth by name. One through pictures needs a pipeline from video to angles."""


def find(name: str) -> Depth:
    """Find a depth; raises `StressError` naming what there is."""
    if name not in DEPTHS:
        raise StressError(f"depth: {name!r} is not to be had; one of: {', '.join(DEPTHS)}")
    return DEPTHS[name]


def columns(kind: str) -> tuple[str, ...]:
    """Numbers of a row of a study of this kind."""
    return tuple(score.COLUMNS if kind == "estimators" else convergence.COLUMNS)
