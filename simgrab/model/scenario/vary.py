"""Variants: the scenarios drawn from one with varying factors, one for each clip."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

from simgrab.errors import ScenarioError
from simgrab.io.strict import convert, of_another_kind, without_numpy
from simgrab.model.rng import stream
from simgrab.model.scenario.factor import JOINT, OneOf, draw, trials
from simgrab.model.scenario.whole import Scenario, merged

FIXED = ("name", "description", "seed", "frames", "image", "clip", "labels", "splits", "sensors", "vary", "every")
_FIXED_WHY = "cannot vary: it must be the same for the whole dataset"


MOST_TRIALS = 20_000
"""Of values, each of which is tried when a scene is read."""


class Draws(msgspec.Struct, frozen=True):
    """Numbers of what is random about the place, parked grabs included, and about the grab, among those of one seed."""

    place: int = 0
    grab: int = 0


class Variant(msgspec.Struct, frozen=True):
    """The scenario of the frames of one clip.

    Attributes
    ----------
    number : int
        The clip's index; 0 where nothing varies.
    scenario : Scenario
        The scenario with every factor at its drawn value; nothing in it varies.
    drawn : dict
        By factor, what was drawn: a number, a value, or its name where the choice names its values.
    draws : Draws
        Keys of what is random beside the factors, such as stains.
    """

    number: int
    scenario: Scenario
    drawn: dict[str, Any]
    draws: Draws = Draws()

    @property
    def varied(self) -> str:
        """``drawn`` as JSON, empty where nothing varies."""
        return json.dumps(self.drawn, sort_keys=True, ensure_ascii=False) if self.drawn else ""


def variant(
    scenario: Scenario, frame: int, randomiser: Callable[[Scenario], Mapping[str, Any]] | None = None
) -> Variant:
    """Draw the variant that a frame belongs to; every factor has its own stream, so a new one changes no other.

    A ``randomiser`` takes the drawn scenario, and returns further dotted keys with their values.

    Raises `ScenarioError` if the drawn values do not fit together. The message names the key.
    """
    if not scenario.vary and randomiser is None:
        return Variant(0, scenario, {})
    number = scenario.clip.of(frame)
    drawn: dict[str, Any] = {}
    change: dict[str, Any] = {}
    for key in sorted(scenario.vary):  # a table before the keys in it
        shown = scenario.draw_of(number, *(part.partition(".")[0] for part in key.split(JOINT)))
        drawn[key], value = draw(scenario.vary[key], stream(scenario.seed, shown, f"vary.{key}"))
        change |= _by_key(key, value)
    by = "vary"
    try:
        kept = _of_drawn_kinds(scenario, change)
        drawn = {key: value for key, value in drawn.items() if key in kept or JOINT in key}
        made = _changed(scenario, kept)
        if randomiser is not None:
            by, further = "the randomiser", _storable(randomiser(made))
            made = _changed(made, further)
            drawn = {key: value for key, value in drawn.items() if key not in further} | further
    except ScenarioError as problem:
        raise ScenarioError(problem.key, f"{problem.problem} (drawn for clip {number} by {by})") from None
    return Variant(number, made, drawn, Draws(scenario.draw_of(number, "place"), scenario.draw_of(number, "grab")))


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


def _storable(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return a function's values in the form of a scene file."""
    try:
        return dict(msgspec.to_builtins(without_numpy(values)))
    except TypeError as problem:
        raise ScenarioError("", f"cannot be stored in a file: {problem}") from None


def variants(scenario: Scenario) -> Iterator[tuple[Variant, range]]:
    """Give every variant with its frames, in order."""
    if not scenario.vary:
        yield variant(scenario, 0), range(scenario.frames)
        return
    for clip in range(scenario.clip_count):
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
    parts = [part for name in scenario.vary for part in name.split(JOINT)]
    for part in parts:
        if parts.count(part) > 1:
            raise ScenarioError(f"vary.{part}", "varies twice, alone or joined with other keys; leave out one")
    for key, factor in scenario.vary.items():
        around = _table_around(scenario, key)
        for value in trials(factor, rng):
            try:
                _changed(scenario, around | _by_key(key, value))
            except ScenarioError as problem:
                inner = "" if problem.key in ("", key) else f"{problem.key}: "
                stated = at(_laid(scenario, around), key)
                law = not isinstance(factor, OneOf) and isinstance(stated, int | str | list)
                cure = '; dist = "one-of" keeps values as they are' if law else ""
                raise ScenarioError(f"vary.{key}", f"{inner}{problem.problem} (trying {value!r}){cure}") from None


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


def laid_over(base: Mapping[str, Any], layer: Mapping[str, Any], tables: Iterable[str] = ()) -> dict[str, Any]:
    """Merge plain data of a scene over those of its base: what the layer states no longer varies as in the base.

    A stated key leaves the factors of the base, and so does a table of which the layer states the kind. What the layer
    itself varies replaces the base's factors of the same keys.

    Parameters
    ----------
    base, layer : mapping
        As a scene file holds them.
    tables : iterable of str
        Dotted keys of tables that the layer states as a whole, as ``--set light={sun=0}`` does.

    Raises
    ------
    ScenarioError
        If a table that varies as a whole would overwrite a stated key in it.
    """
    data, factors, own = merged(base, layer), base.get("vary"), layer.get("vary", {})
    if not isinstance(factors, Mapping) or not isinstance(own, Mapping):
        return data
    stated = dict(_leaves({key: value for key, value in layer.items() if key != "vary"}))
    parts = [part for name in factors for part in name.split(JOINT)]
    for key in (key for key, value in stated.items() if isinstance(value, Mapping)):
        if below := next((part for part in parts if f"{part}.".startswith(f"{key}.")), None):
            raise ScenarioError(key, f"an empty table states nothing, and {below} varies; leave it out, or fill it")
    kinds = {key.rpartition(".")[0] for key in stated if key.endswith((".model", ".dist"))}
    fixed = {*stated, *kinds, *tables, *(part for name in own for part in name.split(JOINT))}
    left = dict[str, Any]()
    for name, factor in factors.items():
        parts = name.split(JOINT)
        free = [part for part in parts if part not in fixed and not any(part.startswith(f"{key}.") for key in stated)]
        kept = [part for part in free if _fits(part, fixed, data, own)]
        if kept:
            left[JOINT.join(kept)] = factor if kept == parts else _only(kept, factor)
            _refuse_overwriting(stated, JOINT.join(kept), left[JOINT.join(kept)], data, name)
    return data | {"vary": left | dict(own)}


def _leaves(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Give the dotted keys that a table states, with their values; of an empty table its own."""
    for key, value in table.items():
        if isinstance(value, Mapping) and value:
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _fits(part: str, fixed: Collection[str], data: Mapping[str, Any], own: Mapping[str, Any]) -> bool:
    """Whether a part of the base's factors belongs to any kind that a table above it, now fixed, is or is drawn as."""
    above = [table for table in fixed if part.startswith(f"{table}.")]
    if not above or not of_another_kind(data, Scenario, part):
        return True
    drawn = ((table, value) for name, factor in own.items() for table, value in _tables(name, factor))
    return any(
        table in above and not of_another_kind(merged(data, nested(table, value)), Scenario, part)
        for table, value in drawn
    )


def _tables(name: str, factor: Any) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Give the tables among a factor's values, plain data, each with the part that it is a value of."""
    values = factor.get("values") if isinstance(factor, Mapping) else None
    for value in values if isinstance(values, list | tuple) else ():
        by_part = value if JOINT in name else {name: value}
        for part, table in by_part.items() if isinstance(by_part, Mapping) else ():
            if isinstance(table, Mapping):
                yield part, table


def _only(parts: Sequence[str], factor: Any) -> Any:
    """Leave only some parts of a joint factor, plain data, whose names would describe values that are gone."""
    try:
        values = [{part: value[part] for part in parts} for value in factor["values"]]
        rest = {key: value for key, value in factor.items() if key not in ("names", "values")}
    except (AttributeError, KeyError, TypeError):
        return factor  # refused later
    return rest | {"values": values if len(parts) > 1 else [value[parts[0]] for value in values]}


def _refuse_overwriting(stated: Mapping[str, Any], name: str, factor: Any, data: Mapping[str, Any], whole: str) -> None:
    """Refuse keys that a factor, of which the base has ``whole``, would overwrite."""
    for part, table in _tables(name, factor):
        laid = merged(data, nested(part, table))
        below = {key.removeprefix(f"{part}."): value for key, value in stated.items() if key.startswith(f"{part}.")}
        for key, value in below.items():
            if at(laid, f"{part}.{key}") == value:
                continue
            if key in ("file", "sha256"):
                cure = f"state {part}.model too"
            elif "model" in table:
                cure = (
                    f'state {part}.model too, or set it in every draw: [vary] "{part}.{key}" = {_one_of(_toml(value))}'
                )
            else:
                inner = ", ".join(f"{inner} = {_toml(value)}" for inner, value in below.items())
                cure = f'replace that factor: [vary] "{part}" = {_one_of(f"{{ {inner} }}")}'
            raise ScenarioError(
                f"{part}.{key}", f"would be overwritten, because {part} varies as a whole (vary.{whole}); {cure}"
            )


def _one_of(value: str) -> str:
    return f'{{ dist = "one-of", values = [{value}] }}'


def _toml(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, default=str)


def check_stated(data: Mapping[str, Any]) -> None:
    """Refuse plain data of a file that state a number which the file's own factors, drawn in its place, cannot be.

    They are what the file lays over its base: a file without one states every key, also those that its factors replace.

    Raises `ScenarioError`.
    """
    own = data.get("vary")
    for key, factor in own.items() if isinstance(own, Mapping) else ():
        ends = [factor.get(end) for end in ("low", "high")] if isinstance(factor, Mapping) else []
        numbers = [value for value in (at(data, key), *ends) if type(value) in (int, float)]
        if len(numbers) == 3 and numbers[1] <= numbers[2] and not numbers[1] <= numbers[0] <= numbers[2]:
            stated, low, high = numbers
            raise ScenarioError(key, f"states {stated:g}, and [vary] draws {low:g} to {high:g} instead: change both")


def at(data: Any, key: str) -> Any:
    """Look up a dotted key in plain data; None where there is none."""
    for step in key.split("."):
        data = data.get(step) if isinstance(data, Mapping) else None
    return data


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
    data = msgspec.structs.asdict(scenario) | {"vary": {}, "every": {}}
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
