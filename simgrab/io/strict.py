"""Strict typed structs: checked from a file and in Python alike, with messages that name the key and what is valid."""

from __future__ import annotations

import functools
import math
import re
import types
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeVar, Union, get_args, get_origin

import msgspec

from simgrab.errors import InvalidError, ScenarioError, SimgrabError
from simgrab.io.parse import find_misfit, shown
from simgrab.io.resources import suggestion

T = TypeVar("T", bound=msgspec.Struct)


def about(description: str, **limits: Any) -> msgspec.Meta:
    """Describe a field, in its annotation, with the limits of its values as msgspec has them; the unit is its suffix.

    The JSON schema of scenes, the reference of keys and the controls of the studio show the description.
    """
    return msgspec.Meta(description=description, **limits)


class Checked(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base of structs whose values are checked wherever they come from: a file, a call in Python, or a replacement.

    Types and ranges are those of the annotations; a subclass checks in `check` what several values must keep to.
    Numbers and lists become what they are from a file: 3 is 3.0 where a float is wanted, and a list a tuple.
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
    """Turn plain data into a struct, refusing what does not fit.

    Parameters
    ----------
    data : mapping
        Anything else is refused; as parsed from TOML or JSON.
    kind : type
        A msgspec struct type.
    error : callable
        Makes what is raised, of one line: the dotted key, what is wrong, and the valid keys or values.
    file : str or path
        Where the data are from, with which the line begins.
    """
    try:
        if not isinstance(data, Mapping):
            raise ScenarioError("", f"must be a table of keys and values, got {shown(data)}")
        _refuse_misfits(data, kind)
        return msgspec.convert(_written_out(data, kind), kind)
    except ScenarioError as problem:
        key, text = problem.key, problem.problem
    except msgspec.ValidationError as problem:
        key, text = _read(problem, data, kind)
    raise _refusal(error, key, text, str(file)) from None


def _refusal(error: Callable[..., SimgrabError], key: str, text: str, file: str = "") -> SimgrabError:
    if error is ScenarioError:
        return ScenarioError(key, f"{file}: {text}" if file else text)
    return error(": ".join(filter(None, (file, key, text))))


def _fit(struct: Checked) -> None:
    """Refuse fields that do not fit their annotations, and make numbers and lists what they are from a file."""
    fields = _fields(type(struct))
    if not fields:
        return
    plain = {name: getattr(struct, name) for name in fields}
    try:
        _refuse_misfits(plain, type(struct))
        try:
            fitted = msgspec.convert(_written_out(plain, type(struct)), _shadow(type(struct)))
        except msgspec.ValidationError:  # NumPy's numbers and arrays are as good as Python's
            plain = without_numpy(plain)
            fitted = msgspec.convert(_written_out(plain, type(struct)), _shadow(type(struct)))
    except msgspec.ValidationError as problem:
        raise _refusal(struct.error, *_read(problem, plain, type(struct))) from None
    except ScenarioError as problem:
        raise _refusal(struct.error, problem.key, problem.problem) from None
    for name in fields:
        value = getattr(fitted, name)
        if value is not getattr(struct, name):
            msgspec.structs.force_setattr(struct, name, value)


def _refuse_misfits(data: Mapping[str, Any], kind: type[msgspec.Struct]) -> None:
    if misfit := find_misfit(data):
        raise ScenarioError(*misfit)
    _refuse_nonfinite(data, "")
    _refuse_unknown(data, kind, "")


@functools.cache
def _shadow(kind: type[msgspec.Struct]) -> type[msgspec.Struct]:
    """Make a type of the same fields which converts without calling ``__post_init__``."""
    return msgspec.defstruct(kind.__name__, [(field.name, field.type) for field in msgspec.structs.fields(kind)])


def without_numpy(value: Any) -> Any:
    """Turn NumPy's numbers and arrays into Python's, in tables and lists however deep."""
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


def _structs_of(annotation: Any) -> list[type[msgspec.Struct]]:
    """Return the struct types that an annotation admits."""
    if get_origin(annotation) in (Union, types.UnionType):
        return [s for a in get_args(annotation) for s in _structs_of(a)]
    if isinstance(annotation, type) and issubclass(annotation, msgspec.Struct):
        return [annotation]
    return []


def _words_of(annotation: Any) -> tuple[tuple[Any, ...], bool]:
    """Return the values of a Literal, or of the one in a union, and whether there is nothing else in it."""
    if get_origin(annotation) is Literal:
        return get_args(annotation), True
    if get_origin(annotation) in (Union, types.UnionType):
        return next((get_args(a) for a in get_args(annotation) if get_origin(a) is Literal), ()), False
    return (), False


def _choices(annotation: Any) -> tuple[Any, ...]:
    """Return the values of all Literals in an annotation."""
    if get_origin(annotation) is Literal:
        return get_args(annotation)
    return tuple(value for inner in get_args(annotation) for value in _choices(inner))


def _refuse_unknown(data: Mapping[str, Any], kind: type[msgspec.Struct], path: str) -> None:
    fields = _fields(kind)
    tag_field = kind.__struct_config__.tag_field
    valid = [*([tag_field] if tag_field else []), *fields]
    for key, value in data.items():
        dotted = f"{path}{key}"
        if key not in valid:
            raise ScenarioError(dotted, f"unknown key{suggestion(str(key), valid)}; valid here: {', '.join(valid)}")
        structs = _structs_of(fields.get(key))
        words, pure = _words_of(fields.get(key))
        if words and value not in words and (pure or isinstance(value, str)):
            choices = [str(choice) for choice in words]
            hint = suggestion(str(value), choices)
            either = f"{', '.join(choices)}{', or a table' if structs else ''}"
            raise ScenarioError(dotted, f"must be one of: {either}; got {shown(value)}{hint}")
        if get_origin(fields.get(key)) is dict and isinstance(value, Mapping):
            _refuse_bad_entries(value, get_args(fields[key])[1], dotted)
        if structs and isinstance(value, Mapping):
            _refuse_unknown(value, _choose(structs, value, dotted), f"{dotted}.")


def _refuse_bad_entries(table: Mapping[str, Any], kind: Any, path: str) -> None:
    """Convert the entries of a table with free keys one by one: msgspec does not report which of them it refuses."""
    for key, value in table.items():
        dotted = f"{path}.{key}"
        structs = _structs_of(kind)
        if structs and isinstance(value, Mapping):
            _refuse_unknown(value, _choose(structs, value, dotted), f"{dotted}.")
        try:
            msgspec.convert(_whole(value, kind), kind)
        except msgspec.ValidationError as problem:
            inner, text = _read(problem, value, kind)
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
        raise ScenarioError(f"{path}.{tag_field}", f"unknown value {shown(tag)}{hint}; one of: {', '.join(by_tag)}")
    return by_tag[str(tag)]


def of_another_kind(data: Mapping[str, Any], kind: type[msgspec.Struct], key: str) -> bool:
    """Whether a dotted key belongs to a table that comes in kinds, and to another kind than the data have."""
    kinds, (*tables, leaf) = [kind], key.split(".")
    for step in tables:
        kinds, data = _structs_of(_fields(kind).get(step)), data.get(step, {})
        if not kinds or not isinstance(data, Mapping):
            return False
        kind = _choose(kinds, data, step)
    return leaf not in _fields(kind) and any(leaf in _fields(other) for other in kinds)


def _refuse_nonfinite(value: Any, path: str) -> None:
    if isinstance(value, float) and not math.isfinite(value):
        raise ScenarioError(path, f"must be a finite number, got {value}")
    items: Iterable[tuple[Any, Any]] = ()
    if isinstance(value, Mapping):
        items = value.items()
    elif isinstance(value, list | tuple):
        items = enumerate(value)
    for key, inner in items:
        _refuse_nonfinite(inner, f"{path}.{key}" if path else str(key))


def _written_out(data: Mapping[str, Any], kind: type[msgspec.Struct]) -> dict[str, Any]:
    """Write out a number where a table is wanted that a number alone gives, such as a constant distribution."""
    fields = _fields(kind)
    return {key: _whole(value, fields.get(key)) for key, value in data.items()}


def _whole(value: Any, annotation: Any) -> Any:
    if isinstance(value, Mapping) and get_origin(annotation) is dict:
        return {key: _whole(inner, get_args(annotation)[1]) for key, inner in value.items()}
    if isinstance(value, Mapping) and (structs := _structs_of(annotation)):
        return _written_out(value, _choose(structs, value, ""))
    if isinstance(value, int | float) and not isinstance(value, bool):
        for struct in _structs_of(annotation):
            if field := getattr(struct, "of_number", ""):
                return {str(struct.__struct_config__.tag_field): struct.__struct_config__.tag, field: value}
    return value


def _read(problem: msgspec.ValidationError, data: Any, kind: Any) -> tuple[str, str]:
    """Split msgspec's message into a dotted key and a sentence, with the value that was given.

    ``kind`` is what the data were to become.
    """
    text, at, path = str(problem).rpartition(" - at `$")
    if not at:
        text, path = path, ""
    key = re.sub(r"\[(\d+)\]", r".\1", path.rstrip("`")).lstrip(".")
    if isinstance(cause := problem.__cause__, ScenarioError):  # of a struct within
        return ".".join(filter(None, (key, cause.key))), cause.problem
    missing = re.search(r"missing required field `(\w+)`", text)
    if missing:
        return f"{key}.{missing[1]}" if key else missing[1], "missing"
    given, choices = data, tuple[Any, ...]()
    for step in filter(None, key.split(".")):
        structs = _structs_of(kind)
        if len(structs) > 1 and isinstance(given, Mapping):
            structs = [_choose(structs, given, "")]
        kind = _fields(structs[0]).get(step) if structs else None
        choices = choices if kind is None else _choices(kind)  # an entry of a list has those of the list
        given = given[int(step)] if isinstance(given, list | tuple) else given.get(step)
    structs = _structs_of(kind)
    if choices:
        listed = ", ".join(map(repr, choices))
        wanted = "must be" if text.startswith("Invalid enum value") else f"{in_words(text)} of"
        return key, f"{wanted} {'one of ' if wanted == 'must be' else ''}{listed}; got {shown(given)}"
    return key, f"{in_words(text, _tables(structs))}{'; ' if structs else ', '}got {shown(given)}"


_WORDS = {
    "float": "a number", "int": "a whole number", "bool": "true or false", "str": "a text", "array": "a list",
    "object": "a table",
}  # fmt: skip


def in_words(text: str, table: str = _WORDS["object"]) -> str:
    """Say what msgspec's message wants in words of TOML, without what it got; ``table`` is how to call a table."""
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
    tag_field = structs[0].__struct_config__.tag_field
    if tag_field is None:
        return f"a table with keys among: {', '.join(_fields(structs[0]))}"
    tags = [str(struct.__struct_config__.tag) for struct in structs]
    number = "a number or " if any(getattr(struct, "of_number", "") for struct in structs) else ""
    return f'{number}a table such as {{ {tag_field} = "{tags[0]}" }}, with {tag_field} one of: {", ".join(tags)}'
