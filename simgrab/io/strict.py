"""Strict typed structs, checked both from files and from Python. Messages name the key and the valid values."""

from __future__ import annotations

import contextlib
import functools
import re
import types
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeVar, Union, get_args, get_origin

import msgspec

from simgrab.errors import InvalidError, ScenarioError, SimgrabError
from simgrab.io.parse import find_misfit, shown
from simgrab.io.resources import suggestion

T = TypeVar("T", bound=msgspec.Struct)


def about(description: str, **limits: Any) -> msgspec.Meta:
    """Describe a field in its annotation, with msgspec's limits of its values. The unit is the suffix of its name.

    The JSON schema of scenes, the reference of keys and the controls of the studio show the description.
    """
    return msgspec.Meta(description=description, **limits)


class Checked(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base of structs whose values are checked wherever they come from: a file, a call in Python, or a replacement.

    Annotations give types and ranges; a subclass checks in `check` conditions on several values. Values are converted
    as from a file: 3 becomes 3.0 where a float is required, and a list becomes a tuple.
    """

    error: ClassVar[type[SimgrabError]] = ScenarioError
    """Raised in one line: the dotted key, what is wrong, and the valid values."""
    of_number: ClassVar[str] = ""
    """Field that a number alone gives where the table is wanted; of one kind of table at most."""

    def __post_init__(self) -> None:
        """Refuse what does not fit."""
        try:
            _fit(self)
            self.check()
        except InvalidError:
            raise
        except ValueError as problem:
            raise _refusal(self.error, "", str(problem)) from None

    def check(self) -> None:
        """Refuse values that do not fit together: raises ValueError, or an error with the dotted key."""


def convert(data: Any, kind: type[T], error: Callable[..., SimgrabError] = ScenarioError, file: str | Path = "") -> T:
    """Turn plain data into a struct; refuse data that do not fit.

    Parameters
    ----------
    data : mapping
        Plain data as parsed from TOML or JSON; anything else is refused.
    kind : type
        A msgspec struct type.
    error : callable
        Makes the error to raise from one line: the dotted key, the problem, and the valid keys or values.
    file : str or path
        File of the data, with which the line begins.
    """
    if not isinstance(data, Mapping):
        raise _refusal(error, "", f"must be a table of keys and values, got {shown(data)}", str(file))
    return _converted(data, kind, kind, error, str(file))


def _converted(
    data: Mapping[str, Any], kind: type[msgspec.Struct], to: type[T], error: Callable[..., SimgrabError], file: str = ""
) -> T:
    """Turn data of the fields of ``kind`` into ``to``, which has the same fields; see `convert`."""
    try:
        if misfit := find_misfit(data, finite=True):
            raise ScenarioError(*misfit)
        return msgspec.convert(_written_out(data, kind), to)
    except ScenarioError as problem:
        key, text = problem.key, problem.problem
    except msgspec.ValidationError as problem:
        key, text = _read(problem, data, kind)
    raise _refusal(error, key, text, file) from None


def _refusal(error: Callable[..., SimgrabError], key: str, text: str, file: str = "") -> SimgrabError:
    if error is ScenarioError:
        return ScenarioError(key, f"{file}: {text}" if file else text)
    return error(": ".join(filter(None, (file, key, text))))


def _fit(struct: Checked) -> None:
    """Refuse fields that do not fit their annotations, and convert numbers and lists as from a file."""
    fields = _fields(type(struct))
    if not fields:
        return
    plain = {name: getattr(struct, name) for name in fields}
    if misfit := find_misfit(plain):  # before `without_numpy`, whose depth has no limit
        raise _refusal(struct.error, *misfit)
    fitted = _converted(without_numpy(plain), type(struct), _shadow(type(struct)), struct.error)
    for name in fields:
        value = getattr(fitted, name)
        if value is not getattr(struct, name):
            msgspec.structs.force_setattr(struct, name, value)


@functools.cache
def _shadow(kind: type[msgspec.Struct]) -> type[msgspec.Struct]:
    """Make a type of the same fields which converts without calling ``__post_init__``."""
    return msgspec.defstruct(kind.__name__, [(field.name, field.type) for field in msgspec.structs.fields(kind)])


def without_numpy(value: Any) -> Any:
    """Turn NumPy's numbers and arrays into Python's, in tables and lists at any depth."""
    if isinstance(value, Mapping):
        return {key: without_numpy(inner) for key, inner in value.items()}
    if isinstance(value, tuple | list):
        return [without_numpy(inner) for inner in value]
    return value.tolist() if hasattr(value, "tolist") else value


@functools.cache
def _fields(kind: type[msgspec.Struct]) -> dict[str, Any]:
    """Types of a struct's fields by name, without what `Annotated` adds to them."""
    types = {field.name: field.type for field in msgspec.structs.fields(kind)}
    return {name: get_args(t)[0] if get_origin(t) is Annotated else t for name, t in types.items()}


def _members(annotation: Any) -> list[Any]:
    """Return the types that an annotation admits."""
    if get_origin(annotation) in (Union, types.UnionType):
        return [member for inner in get_args(annotation) for member in _members(inner)]
    return _members(get_args(annotation)[0]) if get_origin(annotation) is Annotated else [annotation]


def _choices(annotation: Any) -> list[str]:
    """Return the values of all Literals in an annotation, also within lists."""
    if get_origin(annotation) is Literal:
        return [str(value) for value in get_args(annotation)]
    return [value for inner in get_args(annotation) for value in _choices(inner)]


@functools.cache
def _structs_of(annotation: Any) -> list[type[msgspec.Struct]]:
    """Return the struct types that an annotation admits."""
    return [kind for kind in _members(annotation) if isinstance(kind, type) and issubclass(kind, msgspec.Struct)]


def _by_tag(structs: list[type[msgspec.Struct]]) -> tuple[str, dict[str, type[msgspec.Struct]]]:
    """Return the key by which a union's members are distinguished, and the members by its values."""
    return structs[0].__struct_config__.tag_field or "", {str(s.__struct_config__.tag): s for s in structs}


def _choose(structs: list[type[msgspec.Struct]], value: Mapping[str, Any]) -> type[msgspec.Struct] | None:
    """Pick the member of a union by its tag; None if the tag is missing or wrong."""
    tag_field, by_tag = _by_tag(structs)
    return structs[0] if len(structs) == 1 else by_tag.get(str(value.get(tag_field)))


def of_another_kind(data: Mapping[str, Any], kind: type[msgspec.Struct], key: str) -> bool:
    """Whether a dotted key belongs to a table that comes in kinds, and to another kind than the data have."""
    kinds, (*tables, leaf) = [kind], key.split(".")
    for step in tables:
        kinds, data = _structs_of(_fields(kind).get(step)), data.get(step, {})
        if not kinds or not isinstance(data, Mapping):
            return False
        chosen = _choose(kinds, data)
        if chosen is None:
            return False
        kind = chosen
    return leaf not in _fields(kind) and any(leaf in _fields(other) for other in kinds)


def _written_out(data: Mapping[str, Any], kind: type[msgspec.Struct]) -> dict[str, Any]:
    """Write out the table that a number abbreviates, such as a constant distribution."""
    fields = _fields(kind)
    return {key: _whole(value, fields.get(key)) for key, value in data.items()}


def _whole(value: Any, annotation: Any) -> Any:
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        for struct in _structs_of(annotation):
            if field := getattr(struct, "of_number", ""):
                return {str(struct.__struct_config__.tag_field): struct.__struct_config__.tag, field: value}
    elif isinstance(value, Mapping):
        if get_origin(annotation) is dict:
            return {key: _whole(inner, get_args(annotation)[1]) for key, inner in value.items()}
        if (structs := _structs_of(annotation)) and (chosen := _choose(structs, value)):
            return _written_out(value, chosen)
    return value


def _read(problem: msgspec.ValidationError, data: Any, kind: Any) -> tuple[str, str]:
    """Split msgspec's message into a dotted key and a sentence, with the value that was given.

    ``kind`` is the expected type.
    """
    text, at, path = str(problem).rpartition(" - at `$")
    text, steps = (text, re.findall(r"\.\.\.|[^.\[\]`]+", path)) if at else (path, [])
    for i, step in enumerate(steps):
        if step == "..." and get_origin(kind) is dict:  # an entry of free keys, of which msgspec does not say which
            return _of_entries(".".join(steps[:i]), data, get_args(kind)[1])
        try:
            kind, data = _inner(kind, data, step), data[int(step)] if isinstance(data, list | tuple) else data[step]
        except (LookupError, TypeError, ValueError):  # a number in place of a table, or a key that looks like a path
            steps = steps[:i]
            break
    key, structs = ".".join(steps), _structs_of(kind)
    if isinstance(cause := problem.__cause__, ScenarioError):  # of a struct within
        return ".".join(filter(None, (key, cause.key))), cause.problem
    if isinstance(cause, InvalidError):
        return key, str(cause)
    named = re.search(r"(missing required|contains unknown) field `(.*)`", text, re.DOTALL)
    if named and structs:
        dotted = f"{key}.{named[2]}" if key else named[2]
        tag_field, tags = _by_tag(structs)
        if named[1] == "missing required":
            return dotted, f"missing; one of: {', '.join(tags)}" if named[2] == tag_field else "missing"
        valid = [*filter(None, [tag_field]), *_fields(_choose(structs, data) or structs[0])]
        return dotted, f"unknown key{suggestion(named[2], valid)}; valid here: {', '.join(valid)}"
    words = in_words(text, _tables(structs))
    if (choices := _choices(kind)) and (text.startswith("Invalid") or get_origin(kind) is Literal):
        either = f"{', '.join(choices)}{', or a table' if structs else ''}"
        return key, f"must be one of: {either}; got {shown(data)}{suggestion(str(data), choices)}"
    if choices:
        return key, f"{words} of: {', '.join(choices)}; got {shown(data)}"
    return key, f"{words}{'; ' if structs else ', '}got {shown(data)}"


def _inner(kind: Any, data: Any, step: str) -> Any:
    """Return the expected type of a key of a table, or of an entry of a list."""
    if isinstance(data, Mapping):
        tag_field, tags = _by_tag(structs) if (structs := _structs_of(kind)) else ("", {})
        if step == tag_field:
            return Literal[tuple(tags)]
        chosen = _choose(structs, data) if structs else None
        return _fields(chosen).get(step) if chosen else None
    of_list = next((get_args(one) for one in _members(kind) if get_origin(one) in (list, tuple)), (None,))
    return of_list[int(step)] if int(step) < len(of_list) and ... not in of_list else of_list[0]


def _of_entries(key: str, table: Mapping[str, Any], kind: Any) -> tuple[str, str]:
    for name, value in table.items():
        try:
            msgspec.convert(_whole(value, kind), kind)
        except msgspec.ValidationError as problem:
            inner, text = _read(problem, value, kind)
            return ".".join(filter(None, (key, name, inner))), text + _fitting(value, kind)
    return key, "has a key that is no text"


def _fitting(value: Any, kind: Any) -> str:
    """Name another kind of table that the keys of a refused one fit; empty if there is none."""
    if not isinstance(value, Mapping) or not (structs := _structs_of(kind)):
        return ""
    tag_field, by_tag = _by_tag(structs)
    fits = dict[str, int]()  # by the number of keys that are not stated
    for tag, one in by_tag.items() if str(value.get(tag_field)) in by_tag else ():
        with contextlib.suppress(msgspec.ValidationError):
            msgspec.convert({**value, tag_field: tag}, kind)
            fits[tag] = len(_fields(one).keys() - value.keys())
    return f'; it fits {tag_field} = "{min(fits, key=lambda tag: fits[tag])}"' if fits else ""


_WORDS = {
    "float": "a number", "int": "a whole number", "bool": "true or false", "str": "a text", "array": "a list",
    "object": "a table",
}  # fmt: skip


def in_words(text: str, table: str = _WORDS["object"]) -> str:
    """State what msgspec's message requires, in TOML's terms, without the value given; ``table`` replaces "object"."""
    matched = re.match(r"Expected `([^`]+)`(.*?)(?:, got .*)?$", text, re.DOTALL)
    if not matched:
        return text[0].lower() + text[1:].replace("`", "")
    kinds = [kind for kind in matched[1].split(" | ") if kind != "null"]
    words = [table if kind == "object" else _WORDS.get(kind, kind) for kind in kinds]
    return f"must be {' or '.join(words)}{matched[2]}"


def _tables(structs: list[type[msgspec.Struct]]) -> str:
    """Say which tables are valid."""
    if not structs:
        return _WORDS["object"]
    tag_field, tags = _by_tag(structs)
    if not tag_field:
        return f"a table with keys among: {', '.join(_fields(structs[0]))}"
    number = "a number or " if any(getattr(struct, "of_number", "") for struct in structs) else ""
    return (
        f'{number}a table such as {{ {tag_field} = "{next(iter(tags))}" }}, with {tag_field} one of: {", ".join(tags)}'
    )
