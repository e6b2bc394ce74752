"""The command line that renders what a page shows: the scene that it began with, and what was changed."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Iterator, Mapping
from typing import Any

from simgrab.errors import SimgrabError
from simgrab.model import scenes
from simgrab.model.scenario import Scenario
from simgrab.model.scenario.whole import difference

_BARE = re.compile(r"[A-Za-z0-9_-]+")


def command(origin: str, scenario: Scenario) -> str | None:
    """Write the command that renders a scenario, from a scene and ``--set``; None where there is no such.

    That is so where a key or an entry was removed, since TOML has no null, and where a changed key also varies.

    Parameters
    ----------
    origin : str
        A bundled scene's name, or the path of a file.

    Examples
    --------
    >>> command("quay-day", scenes.load("quay-day", {"camera.beta_deg": 5.0, "weather.visibility_m": 80.0}))
    'simgrab render quay-day --set camera.beta_deg=5.0 --set weather.visibility_m=80.0'
    """
    try:
        old = scenes.load(origin)
        changes = _dotted(difference(old.to_dict(), scenario.to_dict()))
        assignments = [f"{key}={_toml(value)}" for key, value in changes]
        again = scenes.load(origin, scenes.parse_changes(assignments))
    except SimgrabError:
        return None
    if again.digest() != scenario.digest():
        return None
    return shlex.join(["simgrab", "render", origin, *(part for one in assignments for part in ("--set", one))])


def _dotted(change: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Give the dotted keys of a change with their values, which are tables where these are of another kind."""
    for key, value in change.items():
        whole = f"{above}{key}" == "vary" or not isinstance(value, Mapping) or bool({"model", "dist"} & set(value))
        yield from [(f"{above}{key}", value)] if whole else _dotted(value, f"{above}{key}.")


def _toml(value: Any) -> str:
    """Write a value in TOML on one line."""
    if isinstance(value, Mapping):
        pairs = (f"{_key(key)} = {_toml(inner)}" for key, inner in value.items() if inner is not None)
        return f"{{{', '.join(pairs)}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return json.dumps(value)


def _key(key: str) -> str:
    return key if _BARE.fullmatch(key) else json.dumps(key, ensure_ascii=False)
