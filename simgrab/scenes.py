"""Find, read and change scenarios: bundled scenes by name, TOML files, a finished dataset's manifest."""

from __future__ import annotations

import functools
import json
import tomllib
from collections.abc import Iterable, Mapping
from datetime import date
from pathlib import Path
from typing import Any

import msgspec

from simgrab import resources
from simgrab.errors import ScenarioError
from simgrab.resources import SCENES
from simgrab.scenario import Scenario, merged, vary
from simgrab.strict import convert


def names() -> list[str]:
    """Names of the bundled scenes."""
    return resources.names(SCENES)


def load(scene: str | Path = "quay-day", changes: Mapping[str, Any] | None = None) -> Scenario:
    """Read a scenario and apply changes to it.

    Parameters
    ----------
    scene : str or Path
        A bundled scene's name (see `names`), a TOML file, or the ``manifest.json`` of a dataset.
    changes : mapping, optional
        Dotted keys to values, e.g. ``{"camera.beta_deg": 5.0}``. A key that is set so varies no more.

    Returns
    -------
    Scenario

    Raises
    ------
    ScenarioError
        With one line that names the key and what would be valid there.

    Examples
    --------
    >>> load("quay-day", {"camera.beta_deg": 5.0}).camera.beta_deg
    5.0
    """
    data = merged(Scenario().to_dict(), _read(scene))
    for key, value in (changes or {}).items():
        data = merged(data, vary.nested(key, value))
    scenario = convert(data, Scenario)
    for key in changes or {}:
        if not f"{key}.".startswith("vary."):
            scenario = msgspec.structs.replace(scenario, vary=vary.fixed(scenario.vary, key))
    vary.check(scenario)
    return scenario


def parse_changes(assignments: Iterable[str]) -> dict[str, Any]:
    """Parse ``a.b=value`` assignments; values are TOML, and dates and anything else are taken as strings."""
    changes: dict[str, Any] = {}
    for assignment in assignments:
        key, equals, text = (s.strip() for s in assignment.partition("="))
        if not equals or not key or not text:
            raise ScenarioError("", f"--set takes key=value, got {assignment!r}")
        try:
            value = tomllib.loads(f"v = {text}")["v"]
            changes[key] = text if isinstance(value, date) else value  # scenarios hold dates as ISO texts
        except tomllib.TOMLDecodeError:
            changes[key] = text
    return changes


def _read(scene: str | Path) -> dict[str, Any]:
    """Plain data of a scene, laid over its base where it names one."""
    path = resources.find(scene, SCENES, "scene", "scenes", functools.partial(ScenarioError, ""))
    if path.suffix == ".json":
        return _manifest_scenario(path)
    data = _toml(path)
    base = data.pop("base", None)
    if base is None:
        return data
    if base not in names():
        raise ScenarioError("base", f"{path}: no bundled scene {base!r}; one of: {', '.join(names())}")
    return merged(_read(base), data)


def _toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as problem:
        raise ScenarioError("", f"{path} is not valid TOML: {problem}") from None
    except (OSError, UnicodeDecodeError) as problem:
        raise ScenarioError("", f"cannot read {path}: {problem}") from None


def _manifest_scenario(path: Path) -> dict[str, Any]:
    try:
        return dict(json.loads(path.read_text(encoding="utf-8"))["scenario"])
    except (OSError, ValueError, KeyError, TypeError):
        raise ScenarioError("", f"{path} is not a simgrab manifest: it holds no scenario") from None
