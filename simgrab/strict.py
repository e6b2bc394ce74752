"""Strict conversion of parsed TOML into typed structs, with messages that name the key and list what is valid."""

from __future__ import annotations

import math
import re
import types
from collections.abc import Mapping
from typing import Any, Literal, TypeVar, Union, get_args, get_origin

import msgspec

from simgrab.errors import ScenarioError, SimgrabError
from simgrab.resources import suggestion

T = TypeVar("T", bound=msgspec.Struct)


def convert(data: Mapping[str, Any], kind: type[T], error: type[SimgrabError] = ScenarioError) -> T:
    """Turn plain data into a struct, refusing what does not fit.

    Parameters
    ----------
    data : mapping
        As parsed from TOML or JSON.
    kind : type
        A msgspec struct type.
    error : type
        Raised with one line: the dotted key, what is wrong, and the valid keys or values.
    """
    try:
        _refuse_unknown(data, kind, "")
        _refuse_nonfinite(data, "")
        return msgspec.convert(data, kind)
    except ScenarioError as problem:
        raise (problem if error is ScenarioError else error(str(problem))) from None
    except msgspec.ValidationError as problem:
        key, text = _read(str(problem), data)
        refusal = ScenarioError(key, text)
        raise (refusal if error is ScenarioError else error(str(refusal))) from None


def _structs_of(annotation: Any) -> list[type[msgspec.Struct]]:
    """Return the struct types that an annotation admits."""
    if get_origin(annotation) in (Union, types.UnionType):
        return [s for a in get_args(annotation) for s in _structs_of(a)]
    if isinstance(annotation, type) and issubclass(annotation, msgspec.Struct):
        return [annotation]
    return []


def _refuse_unknown(data: Mapping[str, Any], kind: type[msgspec.Struct], path: str) -> None:
    fields = {f.encode_name: f.type for f in msgspec.structs.fields(kind)}
    tag_field = kind.__struct_config__.tag_field
    valid = [*([tag_field] if tag_field else []), *fields]
    for key, value in data.items():
        dotted = f"{path}{key}"
        if key not in valid:
            raise ScenarioError(dotted, f"unknown key{suggestion(key, valid)}; valid here: {', '.join(valid)}")
        structs = _structs_of(fields.get(key))
        if get_origin(fields.get(key)) is Literal and value not in get_args(fields[key]):
            choices = [str(choice) for choice in get_args(fields[key])]
            hint = suggestion(str(value), choices)
            raise ScenarioError(dotted, f"must be one of: {', '.join(choices)}; got {value!r}{hint}")
        if get_origin(fields.get(key)) is dict and isinstance(value, Mapping):
            _refuse_bad_entries(value, get_args(fields[key])[1], dotted)
        if structs and isinstance(value, Mapping):
            _refuse_unknown(value, _choose(structs, value, dotted), f"{dotted}.")


def _refuse_bad_entries(table: Mapping[str, Any], kind: Any, path: str) -> None:
    """Convert the entries of a table with free keys one by one: msgspec does not say which of them it refuses."""
    for key, value in table.items():
        dotted = f"{path}.{key}"
        structs = _structs_of(kind)
        if structs and isinstance(value, Mapping):
            _refuse_unknown(value, _choose(structs, value, dotted), f"{dotted}.")
        try:
            msgspec.convert(value, kind)
        except msgspec.ValidationError as problem:
            inner, text = _read(str(problem), value)
            raise ScenarioError(f"{dotted}.{inner}" if inner else dotted, text) from None


def _choose(structs: list[type[msgspec.Struct]], value: Mapping[str, Any], path: str) -> type[msgspec.Struct]:
    """Pick the member of a union by its tag."""
    tag_field = structs[0].__struct_config__.tag_field
    if tag_field is None:
        return structs[0]
    by_tag = {str(s.__struct_config__.tag): s for s in structs}
    tag = value.get(tag_field)
    if tag is None:
        raise ScenarioError(f"{path}.{tag_field}", f"missing; one of: {', '.join(by_tag)}")
    if not isinstance(tag, str) or tag not in by_tag:
        hint = suggestion(str(tag), list(by_tag))
        raise ScenarioError(f"{path}.{tag_field}", f"unknown value {tag!r}{hint}; one of: {', '.join(by_tag)}")
    return by_tag[str(tag)]


def _refuse_nonfinite(value: Any, path: str) -> None:
    if isinstance(value, float) and not math.isfinite(value):
        raise ScenarioError(path, f"must be a finite number, got {value}")
    items = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list | tuple) else ()
    for key, inner in items:
        _refuse_nonfinite(inner, f"{path}.{key}" if path else str(key))


def _read(message: str, data: Mapping[str, Any]) -> tuple[str, str]:
    """Split msgspec's message into a dotted key and a sentence, with the value that was given."""
    text, _, path = message.partition(" - at `$")
    key = re.sub(r"\[(\d+)\]", r".\1", path.rstrip("`")).lstrip(".")
    missing = re.search(r"missing required field `(\w+)`", text)
    if missing:
        return f"{key}.{missing[1]}" if key else missing[1], "missing"
    given: Any = data
    for step in filter(None, key.split(".")):
        given = given[int(step)] if isinstance(given, list | tuple) else given.get(step)
    text = text[0].lower() + text[1:].replace("`", "")
    return key, text if isinstance(given, Mapping) or "got" in text else f"{text}, got {given!r}"
