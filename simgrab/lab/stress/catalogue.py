"""Find, read and check studies: bundled ones by name, or TOML files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from simgrab.errors import StressError
from simgrab.io import resources
from simgrab.io.parse import read_toml
from simgrab.io.resources import SCENES
from simgrab.io.strict import convert
from simgrab.lab.stress import estimators, fidelities
from simgrab.lab.stress.axes import AXES
from simgrab.lab.stress.study import Study

STUDIES = SCENES / "studies"
Fidelity = fidelities.Fidelity[Any]
MAP_AXES = ("alpha-law", "n", "beta", "sigma")
"""Axes of a map of convergence."""


def names() -> list[str]:
    """Names of the bundled studies."""
    return resources.names(STUDIES)


def of(fidelity: str) -> list[str]:
    """Names of the bundled studies of a fidelity; raises `StressError` naming the fidelities."""
    fidelities.find(fidelity)
    return [name for name in names() if _unchecked(STUDIES / f"{name}.toml").depth == fidelity]


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
    fidelity = fidelities.find(study.depth)
    most = 2 if study.kind == "estimators" else 4
    if not 1 <= len(study.axes) <= most:
        raise StressError(f"axes: takes 1 to {most} of them, got {len(study.axes)}; {_valid_axes(fidelity)}")
    if study.kind == "convergence" and tuple(s.axis for s in study.axes) != MAP_AXES:
        raise StressError(f"axes: a convergence map has these, in this order: {', '.join(MAP_AXES)}")
    for i, sweep in enumerate(study.axes):
        if not sweep.values:
            raise StressError(
                f"axes.{i}.values: {sweep.axis!r} has no values; give some, or take another axis, "
                f"{_valid_axes(fidelity)}"
            )
        if len(set(sweep.values)) < len(sweep.values):
            raise StressError(f"axes.{i}.values: {sweep.axis!r} has a value twice")
    for name in study.given:
        _check_axis(f"given.{name}", name, fidelity)
    for i, sweep in enumerate(study.axes):
        _check_axis(f"axes.{i}.axis", sweep.axis, fidelity)
    if not study.estimators:
        raise StressError("estimators: give at least one")
    for name in (*study.estimators, *study.fewer, *study.consistent):
        estimators.find(name)
    for name in (*study.consistent, *(accept.estimator for accept in study.accept)):
        if name not in study.estimators:
            raise StressError(f"{name!r} has limits but is not in estimators: {', '.join(study.estimators)}")
    for point in study.points:
        fidelity.settle(study, point)
    for key, points in (("holds", [study.holds] if study.holds else []), ("accept", [a.at for a in study.accept])):
        for point in points:
            if point not in study.points:
                raise StressError(f"{key}: {list(point)} is not a combination of axis values; one of: {_points(study)}")
    for accept in study.accept:
        valid = ("refused", *fidelities.columns(study.kind))
        if accept.quantity not in valid:
            raise StressError(f"accept: unknown quantity {accept.quantity!r}; one of: {', '.join(valid)}")


def _points(study: Study) -> str:
    return ", ".join(str(list(point)) for point in study.points)


def _valid_axes(fidelity: Fidelity) -> str:
    axes, keys = ", ".join(fidelity.axes()), ", ".join(fidelity.keys)
    return f"valid at depth {fidelity.name!r}: {axes}, or a key of the scene: {keys}"


def _check_axis(where: str, name: str, fidelity: Fidelity) -> None:
    known = name in fidelity.axes() if name in AXES else any(f"{name}.".startswith(f"{key}.") for key in fidelity.keys)
    if not known:
        hint = "" if name in AXES else resources.suggestion(name, [*AXES, *fidelity.keys])
        what = "is not available at this depth" if name in AXES or "." in name else "unknown axis"
        raise StressError(f"{where}: {name!r}: {what}{hint}; {_valid_axes(fidelity)}")
