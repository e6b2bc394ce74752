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

_BARE = re.compile(r"[A-Za-z0-9_-]+")


class _InexpressibleError(Exception):
    """A change that ``--set`` cannot make."""


def command(origin: str, scenario: Scenario) -> str | None:
    """Write the command that renders a scenario, from a scene and ``--set``; None where there is no such.

    That is so where a key or an entry was removed, since TOML has no null, and where a changed key also varies.

    Parameters
    ----------
    origin : str
        A bundled scene's name, or the path of a file.
    scenario : Scenario

    Examples
    --------
    >>> command("quay-day", scenes.load("quay-day", {"camera.beta_deg": 5.0, "weather.visibility_m": 80.0}))
    'simgrab render quay-day --set camera.beta_deg=5.0 --set weather.visibility_m=80.0'
    """
    try:
        old = scenes.load(origin)
        assignments = [f"{key}={_toml(value)}" for key, value in _changes(old.to_dict(), scenario.to_dict())]
        again = scenes.load(origin, scenes.parse_changes(assignments))
    except (_InexpressibleError, SimgrabError):
        return None
    if again.digest() != scenario.digest():
        return None
    return shlex.join(["simgrab", "render", origin, *(part for one in assignments for part in ("--set", one))])


def _changes(old: Mapping[str, Any], new: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Give the dotted keys that differ, with their new values."""
    if any(key not in new or new[key] is None for key in old if old[key] is not None):
        raise _InexpressibleError
    for key, value in new.items():
        before = old.get(key)
        if value == before:
            continue
        if not _BARE.fullmatch(key):
            raise _InexpressibleError
        tables = isinstance(value, Mapping) and isinstance(before, Mapping)
        if above == "" and key == "vary":  # its keys have dots
            yield key, {name: one for name, one in value.items() if one != (before or {}).get(name)}
        elif tables and all(value.get(tag) == before.get(tag) for tag in ("model", "dist")):  # type: ignore[union-attr]
            yield from _changes(before, value, f"{above}{key}.")  # type: ignore[arg-type]
        else:
            yield f"{above}{key}", value


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
