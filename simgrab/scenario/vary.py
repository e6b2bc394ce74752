"""Variants: the scenarios that the frames of one with varying factors are made of."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import msgspec
import numpy as np

from simgrab.errors import ScenarioError
from simgrab.rng import stream
from simgrab.scenario.factor import JOINT, Factor, OneOf, draw, trials
from simgrab.scenario.whole import Scenario, merged
from simgrab.utilities.strict import convert, of_another_kind

FIXED = ("name", "description", "seed", "frames", "image", "clip", "labels", "splits", "sensors", "vary")
_FIXED_WHY = "cannot vary: it must be the same for the whole dataset"


MOST_TRIALS = 20_000
"""Of values, each of which is tried when a scene is read."""


class Variant(msgspec.Struct, frozen=True):
    """The scenario of the frames of one clip.

    Attributes
    ----------
    number : int
        The clip's index, which also keys what is random about the place; 0 where nothing varies.
    scenario : Scenario
        With every factor at its drawn value, and nothing left that varies.
    drawn : dict
        By factor, what was drawn: a number, a value, or its name where the choice names its values.
    """

    number: int
    scenario: Scenario
    drawn: dict[str, Any]

    @property
    def varied(self) -> str:
        """``drawn`` as JSON, empty where nothing varies."""
        return json.dumps(self.drawn, sort_keys=True, ensure_ascii=False) if self.drawn else ""


def variant(
    scenario: Scenario, frame: int, randomiser: Callable[[Scenario], Mapping[str, Any]] | None = None
) -> Variant:
    """Draw the variant that a frame belongs to; every factor has its own stream, so a new one changes no other.

    Parameters
    ----------
    scenario : Scenario
    frame : int
    randomiser : callable, optional
        Takes the scenario as the factors drew it, and returns further keys, dotted, with their values.

    Raises
    ------
    ScenarioError
        If what was drawn cannot be together, naming the key.
    """
    if not scenario.vary and randomiser is None:
        return Variant(0, scenario, {})
    number = scenario.clip.of(frame)
    drawn: dict[str, Any] = {}
    change: dict[str, Any] = {}
    for key in sorted(scenario.vary):  # a table before the keys in it
        drawn[key], value = draw(scenario.vary[key], stream(scenario.seed, number, f"vary.{key}"))
        change |= _by_key(key, value)
    by = "vary"
    try:
        kept = _of_drawn_kinds(scenario, change)
        drawn = {key: value for key, value in drawn.items() if key in kept or JOINT in key}
        made = _changed(scenario, kept)
        if randomiser is not None:
            by, further = "the randomiser", _plain(randomiser(made))
            made = _changed(made, further)
            drawn = {key: value for key, value in drawn.items() if key not in further} | further
    except ScenarioError as problem:
        raise ScenarioError(problem.key, f"{problem.problem} (drawn for clip {number} by {by})") from None
    return Variant(number, made, drawn)


def _of_drawn_kinds(scenario: Scenario, change: dict[str, Any]) -> dict[str, Any]:
    """Leave out keys that belong to another kind of table than the one that was drawn."""
    tables = {key: value for key, value in change.items() if isinstance(value, Mapping)}
    if not tables:
        return change
    data = _laid(scenario, tables)
    return {key: value for key, value in change.items() if not of_another_kind(data, Scenario, key)}


def _laid(scenario: Scenario, change: Mapping[str, Any]) -> dict[str, Any]:
    data = msgspec.to_builtins(scenario)
    for key in sorted(change):
        data = merged(data, nested(key, change[key]))
    return data


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """Turn NumPy's numbers and arrays into Python's, as a file would have them."""

    def python(value: Any) -> Any:
        if hasattr(value, "tolist"):
            return value.tolist()
        raise ScenarioError("", f"{type(value).__name__} cannot be stored in a file")

    return dict(msgspec.to_builtins(dict(values), enc_hook=python))


def variants(scenario: Scenario) -> Iterator[tuple[Variant, range]]:
    """Give every variant with its frames, in order."""
    if not scenario.vary:
        yield variant(scenario, 0), range(scenario.frames)
        return
    for clip in range(scenario.clip.count(scenario.frames)):
        span = scenario.span(clip)
        yield variant(scenario, span.start), span


def check(scenario: Scenario) -> None:
    """Refuse factors whose key does not exist or may not vary, and values that can never be valid.

    Every value of a choice is tried, and both ends of a law, each with everything else as it is; a key that belongs to
    a kind of table which the scenario does not have itself, with the first drawn table of such a kind.
    """
    rng = np.random.default_rng(0)
    count = sum(len(trials(factor, rng)) for factor in scenario.vary.values())
    if count > MOST_TRIALS:
        raise ScenarioError("vary", f"the factors have {count} values in total; the limit is {MOST_TRIALS}")
    for key, factor in scenario.vary.items():
        around = _table_around(scenario, key)
        for value in trials(factor, rng):
            try:
                _changed(scenario, around | _by_key(key, value))
            except ScenarioError as problem:
                inner = "" if problem.key in ("", key) else f"{problem.key}: "
                raise ScenarioError(f"vary.{key}", f"{inner}{problem.problem} (trying {value!r})") from None


def _table_around(scenario: Scenario, key: str) -> dict[str, Any]:
    """Drawn table of a kind that has a key, where the scenario's own table is of another kind."""
    if JOINT in key or not of_another_kind(msgspec.to_builtins(scenario), Scenario, key):
        return {}
    for name, factor in scenario.vary.items():
        for value in factor.values if isinstance(factor, OneOf) else ():
            for part, table in _by_key(name, value).items():
                around = {part: table}
                if key.startswith(f"{part}.") and not of_another_kind(_laid(scenario, around), Scenario, key):
                    return around
    return {}


def fixed(factors: Mapping[str, Factor], key: str) -> dict[str, Factor]:
    """Drop from factors what would overwrite ``key``, which somebody set by hand."""
    left: dict[str, Factor] = {}
    for name, factor in factors.items():
        parts = name.split(JOINT)
        kept = [part for part in parts if not f"{part}.".startswith(f"{key}.")]
        if any(key.startswith(f"{part}.") for part in kept):
            raise ScenarioError(key, f"varies as a part of {name!r}; change that factor under vary")
        if kept == parts:
            left[name] = factor
        elif kept and isinstance(factor, OneOf):
            tables = [{part: value[part] for part in kept} for value in factor.values]
            values = tuple(tables if len(kept) > 1 else (table[kept[0]] for table in tables))
            left[JOINT.join(kept)] = msgspec.structs.replace(factor, values=values)
    return left


def _by_key(name: str, value: Any) -> dict[str, Any]:
    """Split a drawn value into dotted keys."""
    parts = name.split(JOINT)
    if len(parts) == 1:
        return {name: value}
    if not isinstance(value, Mapping) or set(value) != set(parts):
        raise ScenarioError(name, f"each value must be a table with the keys {', '.join(parts)}")
    return {part: value[part] for part in parts}


def _changed(scenario: Scenario, change: Mapping[str, Any]) -> Scenario:
    """Lay dotted keys over a scenario, which varies no more."""
    sections = {key.split(".")[0] for key in change}
    # Sections that do not change stay structs, which are not checked again: this is done for thousands of values.
    data = msgspec.structs.asdict(scenario) | {"vary": {}}
    data |= {name: plain for name, plain in msgspec.to_builtins(scenario).items() if name in sections}
    for key in sorted(change):
        if key.split(".")[0] in FIXED:
            raise ScenarioError(key, _FIXED_WHY)
        data = merged(data, nested(key, change[key]))
    result = convert(data, Scenario)
    for key in ("width_px", "height_px"):
        if getattr(result.camera, key) != getattr(scenario.camera, key):
            raise ScenarioError(f"camera.{key}", _FIXED_WHY)
    if type(result.swing) is not type(scenario.swing):
        raise ScenarioError("swing.model", _FIXED_WHY)
    return result


def nested(dotted: str, value: Any) -> dict[str, Any]:
    """Turn a dotted key into tables within tables."""
    for step in reversed(dotted.split(".")):
        value = {step: value}
    return dict(value)
