"""Find, read and check studies: bundled ones by name, or TOML files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from simgrab.errors import StressError
from simgrab.io import resources
from simgrab.io.parse import read_toml
from simgrab.io.resources import SCENES
from simgrab.io.strict import convert
from simgrab.lab.stress import estimators, geometric, rendered
from simgrab.lab.stress.axes import AXES
from simgrab.lab.stress.study import Study, axis_of

STUDIES = SCENES / "studies"
MAP_AXES = ("alpha-law", "n", "beta", "sigma")
"""Axes of a map of convergence."""


DEPTHS: Mapping[str, Any] = MappingProxyType({"geometric": geometric, "rendered": rendered})
"""How far a replication goes from truth to angles, by name: modules with the same functions.

``prepare(study, point)`` makes what every replication at a point is drawn from, or raises `StressError`; ``draw(that,
seed, trials)`` gives `Records`, each replication by its number alone; ``together(that)`` says how many may be drawn at
once; ``show(that, seed, trial)`` gives one and its picture, if any; ``made_with()`` names what else numbers depend on.
``KEYS`` are the scene's keys that reach it. Axes that are no key reach the geometric depth alone.
"""


def depth_of(name: str) -> Any:
    """Find a depth; raises `StressError` naming what there is."""
    if name not in DEPTHS:
        raise StressError(f"unknown depth {name!r}; one of: {', '.join(DEPTHS)}")
    return DEPTHS[name]


def names() -> list[str]:
    """Names of the bundled studies."""
    return resources.names(STUDIES)


def titles() -> dict[str, str]:
    """Titles of the bundled studies by name, which are not checked."""
    return {name: _unchecked(STUDIES / f"{name}.toml").title for name in names()}


def of(depth: str) -> list[str]:
    """Names of the bundled studies of a depth; raises `StressError` naming the depths."""
    depth_of(depth)
    return [name for name in names() if _unchecked(STUDIES / f"{name}.toml").depth == depth]


def load(study: str | Path) -> Study:
    """Read a bundled study by name, or a TOML file, and check all of it.

    Raises `StressError` with one line that names the key and what is valid there.
    """
    path = resources.find(study, STUDIES, "study", "studies", StressError)
    found = _unchecked(path)
    try:
        check(found)
    except StressError as problem:
        raise StressError(f"{path}: {problem}") from None
    return found


def _unchecked(path: Path) -> Study:
    return convert(read_toml(path, StressError, "study"), Study, StressError, path)


def read(data: Mapping[str, object]) -> Study:
    """Turn plain data into a checked study; raises `StressError`."""
    study = convert(data, Study, StressError)
    check(study)
    return study


def check(study: Study) -> None:
    """Refuse a study that cannot be, before anything is drawn; raises `StressError`."""
    depth = depth_of(study.depth)
    axes = ", ".join(_reaching(study.depth))
    valid = f"valid at depth {study.depth!r}: {axes}, or a key of the scene: {', '.join(depth.KEYS)}"
    most = 2 if study.kind == "estimators" else 4
    if not 1 <= len(study.axes) <= most:
        raise StressError(f"axes: takes 1 to {most} of them, got {len(study.axes)}; {valid}")
    if study.kind == "convergence" and tuple(s.axis for s in study.axes) != MAP_AXES:
        raise StressError(f"axes: a convergence map has these, in this order: {', '.join(MAP_AXES)}")
    for i, sweep in enumerate(study.axes):
        if not sweep.values:
            raise StressError(
                f"axes.{i}.values: {sweep.axis!r} has no values; give some, or take another axis, {valid}"
            )
        if len(set(sweep.values)) < len(sweep.values):
            raise StressError(f"axes.{i}.values: {sweep.axis!r} has a value twice")
    swept = [axis_of(sweep.axis).key or sweep.axis for sweep in study.axes]
    for name in study.given:
        if (axis_of(name).key or name) in swept:
            raise StressError(f"given.{name}: is an axis of this study too; leave it out of one of them")
    used = {f"given.{name}": name for name in study.given}
    for where, name in (used | {f"axes.{i}.axis": s.axis for i, s in enumerate(study.axes)}).items():
        if name in AXES and name not in _reaching(study.depth):
            raise StressError(f"{where}: {name!r}: is not available at this depth; {valid}")
        if name not in AXES and not any(f"{name}.".startswith(f"{key}.") for key in depth.KEYS):
            what = "is not available at this depth" if "." in name else "unknown axis"
            hint = resources.suggestion(name, [*AXES, *depth.KEYS])
            raise StressError(f"{where}: {name!r}: {what}{hint}; {valid}")
    if not study.estimators:
        raise StressError("estimators: give at least one")
    for name in (*study.estimators, *study.fewer, *study.consistent):
        estimators.find(name)
    for name in (*study.consistent, *(accept.estimator for accept in study.accept)):
        if name not in study.estimators:
            raise StressError(f"{name!r} has limits but is not in estimators: {', '.join(study.estimators)}")
    for point in study.points:
        depth.prepare(study, point)
    for key, points in (("holds", [study.holds] if study.holds else []), ("accept", [a.at for a in study.accept])):
        for point in points:
            if point not in study.points:
                there = ", ".join(str(list(point)) for point in study.points)
                raise StressError(f"{key}: {list(point)} is not a combination of axis values; one of: {there}")
    quantities = ("refused", *study.columns)
    for accept in study.accept:
        if accept.quantity not in quantities:
            raise StressError(f"accept: unknown quantity {accept.quantity!r}; one of: {', '.join(quantities)}")


def _reaching(depth: str) -> list[str]:
    """Names of the axes that reach a depth."""
    return [axis.name for axis in AXES.values() if axis.key or depth == "geometric"]
