"""Find, read and check studies: bundled ones by name, or TOML files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from simgrab.errors import StressError
from simgrab.judge.stress import depths, estimators
from simgrab.judge.stress.axes import AXES
from simgrab.judge.stress.study import Study
from simgrab.utilities import resources
from simgrab.utilities.parse import read_toml
from simgrab.utilities.resources import SCENES
from simgrab.utilities.strict import convert

STUDIES = SCENES / "studies"
Depth = depths.Depth[Any]
MAP_AXES = ("alpha-law", "n", "beta", "sigma")
"""Axes of a map of convergence."""


def names() -> list[str]:
    """Names of the bundled studies."""
    return resources.names(STUDIES)


def of(depth: str) -> list[str]:
    """Names of the bundled studies of a depth; raises `StressError` naming the depths."""
    depths.find(depth)
    return [name for name in names() if _unchecked(STUDIES / f"{name}.toml").depth == depth]


def load(study: str | Path) -> Study:
    """Read a bundled study by name, or a TOML file, and check all of it.

    Raises
    ------
    StressError
        With one line that names the key and what is valid there.
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
    depth = depths.find(study.depth)
    most = 2 if study.kind == "estimators" else 4
    if not 1 <= len(study.axes) <= most:
        raise StressError(f"axes: takes 1 to {most} of them, got {len(study.axes)}; {_valid_axes(depth)}")
    if study.kind == "convergence" and tuple(s.axis for s in study.axes) != MAP_AXES:
        raise StressError(f"axes: a convergence map has these, in this order: {', '.join(MAP_AXES)}")
    for i, sweep in enumerate(study.axes):
        if not sweep.values:
            raise StressError(
                f"axes.{i}.values: {sweep.axis!r} has no values; give some, or take another axis, {_valid_axes(depth)}"
            )
        if len(set(sweep.values)) < len(sweep.values):
            raise StressError(f"axes.{i}.values: {sweep.axis!r} has a value twice")
    for name in study.given:
        _check_axis(f"given.{name}", name, depth)
    for i, sweep in enumerate(study.axes):
        _check_axis(f"axes.{i}.axis", sweep.axis, depth)
    if not study.estimators:
        raise StressError("estimators: give at least one")
    for name in (*study.estimators, *study.fewer, *study.consistent):
        estimators.find(name)
    for name in (*study.consistent, *(accept.estimator for accept in study.accept)):
        if name not in study.estimators:
            raise StressError(f"{name!r} has limits but is not in estimators: {', '.join(study.estimators)}")
    for point in study.points:
        depth.settle(study, point)
    for key, points in (("holds", [study.holds] if study.holds else []), ("accept", [a.at for a in study.accept])):
        for point in points:
            if point not in study.points:
                raise StressError(f"{key}: {list(point)} is not a combination of axis values; one of: {_points(study)}")
    for accept in study.accept:
        valid = ("refused", *depths.columns(study.kind))
        if accept.quantity not in valid:
            raise StressError(f"accept: unknown quantity {accept.quantity!r}; one of: {', '.join(valid)}")


def _points(study: Study) -> str:
    return ", ".join(str(list(point)) for point in study.points)


def _valid_axes(depth: Depth) -> str:
    return f"valid at depth {depth.name!r}: {', '.join(depth.axes())}, or a key of the scene: {', '.join(depth.keys)}"


def _check_axis(where: str, name: str, depth: Depth) -> None:
    known = name in depth.axes() if name in AXES else any(f"{name}.".startswith(f"{key}.") for key in depth.keys)
    if not known:
        hint = "" if name in AXES else resources.suggestion(name, [*AXES, *depth.keys])
        what = "is not available at this depth" if name in AXES or "." in name else "unknown axis"
        raise StressError(f"{where}: {name!r}: {what}{hint}; {_valid_axes(depth)}")
