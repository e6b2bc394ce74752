"""A study: what is turned up, how far, who is tried, how often, and what is accepted."""

from __future__ import annotations

import functools
import hashlib
import itertools
import math
from typing import Annotated, Any, Literal

import msgspec

from simgrab.errors import SimgrabError, StressError
from simgrab.lab.stress import convergence, score
from simgrab.lab.stress import situation as situations
from simgrab.lab.stress.axes import AXES, EXCLUSIVE, Axis, Value
from simgrab.lab.stress.situation import Situation
from simgrab.model import scenes
from simgrab.model.scenario import Scenario
from simgrab.model.scenario.base import Meta, Strict

BASE = "base"
"""The key of a scene file that names the scene it departs from: as an axis, another scene in place of the study's."""

Statistic = Literal["mean", "rms", "z"]

QUICK_FRAMES, QUICK_REPLICATIONS, QUICK_PHYSICS, QUICK_MAP = 500, 30, 3, 4
QUICK_PICTURES, QUICK_RECORDS = 10, 2
MOST_POINTS, MOST_REPLICATIONS = 10_000, 10_000_000


class Sweep(Strict, frozen=True):
    """One axis and its values."""

    error = StressError

    axis: str
    values: Annotated[tuple[Value, ...], Meta(max_length=1000)]


class Accept(Strict, frozen=True):
    """A limit: the statistic of a column, at one point and of one estimator, lies in [low, high].

    It is met where the Monte Carlo interval, three standard errors to either side and more of few replications, meets
    the limits. ``z`` is the size
    of the mean in standard errors. Of ``refused`` the mean is the share of records refused.
    """

    error = StressError

    at: tuple[Value, ...]
    estimator: str
    quantity: str
    statistic: Statistic = "mean"
    low: float | None = None
    high: float | None = None
    says: str = ""


class Study(Strict, frozen=True):
    """A study, as its TOML file states it."""

    error = StressError

    name: Annotated[str, Meta(pattern=r"^[a-z0-9][a-z0-9-]*\Z", max_length=64)]
    title: Annotated[str, Meta(max_length=1000)]
    axes: Annotated[tuple[Sweep, ...], Meta(max_length=4)]  # one or two; up to four for convergence
    estimators: Annotated[tuple[str, ...], Meta(max_length=100)]  # names, or `package.module:Class`
    # `"estimators"`, or `"convergence"`: how the paper's iteration gets to its end
    kind: Literal["estimators", "convergence"] = "estimators"
    depth: str = "geometric"  # how far a record goes from truth to angles: `"geometric"` or `"rendered"`
    base: str = "paper-ideal"  # scene that it departs from
    given: dict[str, Value] = msgspec.field(default_factory=dict)  # axes, or keys of the scene, that hold throughout
    n: Annotated[int, Meta(ge=10, le=1_000_000)] = 3699
    replications: Annotated[int, Meta(ge=2, le=10_000_000)] = 1000
    seed: Annotated[int, Meta(ge=0, le=2**53)] = 0
    # replications of estimators that take too long for all
    fewer: dict[str, Annotated[int, Meta(ge=2, le=10_000_000)]] = msgspec.field(default_factory=dict)
    # point at which no assumption is violated; empty where there is none; there the estimators named in `consistent`
    # must show no bias of β̂ and σ̂ and intervals that cover 93 to 97 %
    holds: tuple[Value, ...] = ()
    consistent: tuple[str, ...] = ()
    accept: tuple[Accept, ...] = ()

    def check(self) -> None:  # noqa: D102
        points = math.prod(len(sweep.values) for sweep in self.axes)
        if points > MOST_POINTS:
            raise ValueError(f"axes: their values make {points} points; at most {MOST_POINTS} are studied")
        if points * self.replications > MOST_REPLICATIONS:
            raise ValueError(
                f"replications: {self.replications} of them at {points} points are {points * self.replications}; "
                f"at most {MOST_REPLICATIONS} are made"
            )

    @property
    def points(self) -> list[tuple[Value, ...]]:
        """Every combination of the axes' values, the last axis running fastest."""
        return list(itertools.product(*(sweep.values for sweep in self.axes)))

    @property
    def digest(self) -> str:
        """SHA-256 of everything in the study."""
        return hashlib.sha256(msgspec.json.encode(self, order="deterministic")).hexdigest()

    @property
    def columns(self) -> tuple[str, ...]:
        """Numbers of a row."""
        return tuple(score.COLUMNS if self.kind == "estimators" else convergence.COLUMNS)

    def trials_of(self, estimator: str) -> int:
        """How many replications an estimator gets."""
        return min(self.fewer.get(estimator, self.replications), self.replications)

    def settings(self, point: tuple[Value, ...]) -> dict[str, Value]:
        """Every axis or key with its value at a point."""
        return {"n": self.n, **self.given, **{s.axis: v for s, v in zip(self.axes, point, strict=True)}}


def axis_of(name: str) -> Axis:
    """Find an axis, or make one of a key of the scene."""
    return AXES.get(name) or Axis(name, "", f"the scene's {name}", None, key=name)


def stated(name: str, value: Value) -> str:
    """Name a value of an axis, with its unit."""
    return f"{name} = {value}" if isinstance(value, str) else f"{name} = {value:g} {axis_of(name).unit}".rstrip()


def place(study: Study, point: tuple[Value, ...]) -> str:
    """Name a point: its axes with values and units."""
    return ", ".join(stated(sweep.axis, value) for sweep, value in zip(study.axes, point, strict=True))


@functools.lru_cache(maxsize=256)
def _scenario(base: str, settings: tuple[tuple[str, Value], ...]) -> Scenario:
    changes = {axis.key: _whole(value) for axis, value in ((axis_of(n), v) for n, v in settings) if axis.key}
    try:
        return scenes.load(str(changes.pop(BASE, base)), changes)
    except SimgrabError as problem:
        raise StressError(str(problem)) from None


def _whole(value: Value) -> Value | int:
    """Give a count, which a study holds as a float like any number, as what a scene takes."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def scenario(study: Study, point: tuple[Value, ...]) -> Scenario:
    """Make the scene at a point of a study, of which axes that are no key of a scene change nothing."""
    return _scenario(study.base, tuple(study.settings(point).items()))


def situation(study: Study, point: tuple[Value, ...]) -> Situation:
    """Make the situation at a point of a study."""
    result, settings = situations.of(scenario(study, point)), study.settings(point)
    for name, value in settings.items():
        axis = axis_of(name)
        if not axis.key:
            result = axis.apply(result, value)
    turned_up = {name: value for name, value in settings.items() if value != axis_of(name).holds}
    for name, value in turned_up.items():
        if by := axis_of(name).overridden(result, value):
            raise StressError(f"{name}: has no effect, because {by}")
    for group in EXCLUSIVE:
        names = [name for name in settings if name in group]
        if len(names) > 1 and not group.isdisjoint(turned_up):
            raise StressError(f"{names[0]}: {' and '.join(names)} exclude each other: leave all but one out")
    return result


def resized(study: Study, frames: int | None, replications: int | None, seed: int | None) -> Study:
    """Take other sizes, where they are given; raises `StressError` where an axis sets the number of frames."""
    if frames is not None and any(s.axis == "n" for s in study.axes):
        raise StressError(f"{study.name}: its axis n sets the number of frames: leave frames out, or change the axis")
    sizes = {"n": frames, "replications": replications, "seed": seed}
    changes: dict[str, Any] = {key: value for key, value in sizes.items() if value is not None}
    if changes.get("n", study.n) < study.n:  # of fewer frames errors are larger
        changes["accept"] = tuple(accept for accept in study.accept if accept.statistic != "rms")
    return msgspec.structs.replace(study, **changes)


def quickened(study: Study) -> Study:
    """Make a study so small that it takes seconds. Its numbers are rough, and slow estimators are left out."""
    kept = tuple(name for name in study.estimators if name not in study.fewer) or study.estimators
    short = msgspec.structs.replace(study, axes=tuple(map(_shorter, study.axes)), estimators=kept, fewer={})
    if study.depth == "rendered":  # so few pictures keep to no limits
        few = {"n": QUICK_PICTURES, "replications": QUICK_RECORDS}
        return msgspec.structs.replace(short, **few, holds=(), consistent=(), accept=())
    slow = {"motion", "mount"} & {*study.given, *(s.axis for s in study.axes)}
    many = QUICK_MAP if study.kind == "convergence" else QUICK_PHYSICS if slow else QUICK_REPLICATIONS
    points = set(short.points)
    return msgspec.structs.replace(
        short,
        n=min(study.n, QUICK_FRAMES),
        replications=min(study.replications, many),
        holds=study.holds if study.holds in points else (),
        consistent=tuple(name for name in study.consistent if name in kept),
        accept=tuple(a for a in study.accept if a.at in points and a.estimator in kept and a.statistic != "rms"),
    )


def _shorter(sweep: Sweep) -> Sweep:
    """Leave out numbers of frames that take long."""
    if sweep.axis != "n":
        return sweep
    few = tuple(v for v in sweep.values if isinstance(v, float | int) and v <= 2 * QUICK_FRAMES)
    return msgspec.structs.replace(sweep, values=few or sweep.values[:1])
