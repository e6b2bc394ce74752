"""Hostile TOML and JSON: valid documents of which some keys and values are replaced."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hypothesis import strategies as st

CHANGES = (1, 1, 1, 2, 3)  # at a time: one is the most likely to get past the first check


@dataclass(frozen=True)
class Raw:
    """Text that stands in the document as it is."""

    text: str


DEEP = 3000
RAW = (
    Raw("9" * 6000), Raw("-" + "1" * 400), Raw("0x" + "f" * 6000), Raw("1e999999"), Raw("1e-999999"),
    Raw("0." + "1" * 5000),
    Raw("[" * DEEP + "]" * DEEP), Raw('{"a":' * DEEP + "1" + "}" * DEEP), Raw("{a=" * DEEP + "1" + "}" * DEEP),
    Raw("nan"), Raw("-inf"), Raw("NaN"), Raw("-Infinity"), Raw("null"), Raw(""), Raw('"\\ud800"'),
    Raw('"\\udfff\\ud800"'),
    Raw('"\\u0000"'), Raw('"\\U00110000"'), Raw("'''\n\n'''"), Raw("0001-01-01"),
    Raw("9999-12-31T23:59:59.999999-23:59"),
    Raw("25:61:61"), Raw("07:32:00"), Raw("1_000"), Raw("0b1"), Raw("true"), Raw('"unterminated'), Raw("[1, 2"),
)  # fmt: skip
NUMBERS = (
    0, 1, -1, 2, 3, 10, 100, 255, 1000, 4096, 65536, 10**6, 10**7, 2**31 - 1, 2**31, 2**53, 2**53 + 1, 2**63 - 1, 2**63,
    -(2**63), 2**64, 10**40, 0.0, -0.0, 0.5, 1.0, -0.5, 90.0, 180.0, 1e-9, 1e-300, 5e-324, 1e9, 1e30, 1e154, 1e155,
    1e300, 1.7e308, -1.7e308, math.nan, math.inf, -math.inf,
)  # fmt: skip
_INTEGERS = tuple(x for x in NUMBERS if isinstance(x, int))
_FLOATS = tuple(x for x in NUMBERS if isinstance(x, float))
TEXTS = (
    "", " ", "\n", "\t", "\x00", "\x1b[31mred\x1b[0m", "a\nb", "a\r\nb", "\u2028", "\u202eab", "\ufeff", "\ud800",
    "a\udcff", "é",
    "e\u0301", "年月日",
    "😀", "x" * 5000, "`$.a`", "$", "a.b", "..", "../../../../etc/passwd", "/dev/zero", "/", "~", "-x", "%s%n", "{0}",
    "[bold]x[/]",
    "</script>", "none", "None", "null", "true", "0", "1", "nan", "inf", "quay-day", "training", "plain", "dynamic",
    "uniform", "one-of", "constant", "two-by-four", "2022-01-26T14:05:37", "0001-01-01T00:00:00", "9999-12-31T23:59:59",
    "2022-01-26T14:05:37+14:00", "camera", "os:getcwd", "os:abort", "a+b", "+", "grab",
)  # fmt: skip
KEYS = (
    "", " ", "a", "a.b", "a\nb", "\x00", "é", "\u202e", "$", "`", "x" * 2000, "base", "vary", "model", "dist",
    "values", "seed",
    "frames", "name", "[0]", "0", "__class__", "self",
)  # fmt: skip

scalars: st.SearchStrategy[Any] = st.one_of(
    st.sampled_from(NUMBERS), st.sampled_from(TEXTS), st.sampled_from(RAW), st.booleans(), st.integers(), st.floats(),
    st.text(max_size=12),
)  # fmt: skip
values: st.SearchStrategy[Any] = st.recursive(
    scalars,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from(KEYS), inner, max_size=3),
    max_leaves=5,
)
keys = st.sampled_from(KEYS) | st.text(max_size=8)


def changed(draw: st.DrawFn, document: Any) -> Any:
    """Change some nodes of a document: nested dictionaries, lists and scalars."""
    for _ in range(draw(st.sampled_from(CHANGES))):
        paths = list(_paths(document))
        path = draw(st.sampled_from(paths))
        document = _at(document, path, draw(st.sampled_from(_CHANGES))(draw, _get(document, path), document))
    return document


class _Gone:
    """In place of what is removed."""


def _replace(draw: st.DrawFn, _old: Any, _whole: Any) -> Any:
    return draw(values)


def _near(draw: st.DrawFn, old: Any, _whole: Any) -> Any:
    """Change a value and keep its type, so that what comes after the types is reached."""
    if isinstance(old, bool):
        return not old
    if isinstance(old, int):
        whole = (old + 1, old - 1, -old, 2 * old, 10 * old, 1000 * old, old // 2)
        return draw(st.sampled_from(whole) | st.sampled_from(_INTEGERS) | st.integers(0, 100))
    if isinstance(old, float):
        some = (0.0, 1.0, -1.0, -old, 2 * old, old / 2, 1.1 * old, 1e-3 * old, 1e3 * old, 1e9 * old)
        return draw(st.sampled_from(some) | st.sampled_from(_FLOATS) | st.floats(0, 100))
    if isinstance(old, str):
        return draw(st.sampled_from(TEXTS) | st.text(max_size=6).map(old.__add__))
    if isinstance(old, list) and old:
        return draw(st.sampled_from((old[:-1], old + old[-1:], old[::-1], old * 50, [old[0]] * len(old))))
    return draw(values)


def _remove(_draw: st.DrawFn, _old: Any, _whole: Any) -> Any:
    return _Gone


def _swap(draw: st.DrawFn, _old: Any, whole: Any) -> Any:
    return _get(whole, draw(st.sampled_from(list(_paths(whole)))))


def _wrap(draw: st.DrawFn, old: Any, _whole: Any) -> Any:
    return draw(st.sampled_from(([old], {"a": old}, [old] * 300, {str(i): old for i in range(100)})))


def _add(draw: st.DrawFn, old: Any, whole: Any) -> Any:
    """Add a key to a table, or an item to a list."""
    if isinstance(old, dict):
        return {**old, draw(keys): draw(values)}
    if isinstance(old, list):
        return [*old, draw(values)]
    return _near(draw, old, whole)


def _rename(draw: st.DrawFn, old: Any, whole: Any) -> Any:
    if not isinstance(old, dict) or not old:
        return _near(draw, old, whole)
    name = draw(st.sampled_from(sorted(old)))
    return {(draw(keys) if key == name else key): value for key, value in old.items()}


_CHANGES: tuple[Callable[[st.DrawFn, Any, Any], Any], ...] = (
    *[_near] * 8, _replace, _replace, _remove, _swap, _wrap, _add, _rename,
)  # fmt: skip


def _paths(node: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    if path:
        yield path
    items: Sequence[tuple[str | int, Any]] = ()
    if isinstance(node, dict):
        items = list(node.items())
    elif isinstance(node, list):
        items = list(enumerate(node[:20]))
    for key, inner in items:
        yield from _paths(inner, (*path, key))
    if not path and not items:
        yield ()


def _get(node: Any, path: tuple[str | int, ...]) -> Any:
    for step in path:
        node = node[step]
    return node


def _at(node: Any, path: tuple[str | int, ...], new: Any) -> Any:
    """Copy a document with another value at a path."""
    if not path:
        return {} if new is _Gone else new
    step, rest = path[0], path[1:]
    gone = new is _Gone and not rest
    if isinstance(node, dict):
        return {k: v if k != step else _at(v, rest, new) for k, v in node.items() if not (gone and k == step)}
    return [v if i != step else _at(v, rest, new) for i, v in enumerate(node) if not (gone and i == step)]


def as_json(value: Any) -> str:
    """Write JSON, in which `Raw` stands as it is."""
    if isinstance(value, Raw):
        return value.text
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{json.dumps(k)}: {as_json(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(as_json, value)) + "]"
    return json.dumps(value)


def as_toml(value: Any) -> str:
    """Write TOML: the document's tables inline but for the outermost, without nulls."""
    if not isinstance(value, Mapping):
        return f"value = {inline(value)}\n"
    return "".join(f"{_key(k)} = {inline(v)}\n" for k, v in value.items() if v is not None)


def inline(value: Any) -> str:
    """Write a value of TOML in one line."""
    if isinstance(value, Raw):
        return value.text
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(k)} = {inline(v)}" for k, v in value.items() if v is not None) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(inline(v) for v in value if v is not None) + "]"
    if isinstance(value, float):
        return {"nan": "nan", "inf": "inf", "-inf": "-inf"}.get(repr(value), repr(value))
    return _text(value) if isinstance(value, str) else json.dumps(value)


def _key(name: str) -> str:
    return _text(name)


def _text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def encoded(draw: st.DrawFn, text: str) -> bytes:
    """Encode a text, now and then as no reader of UTF-8 expects it."""
    odd = draw(st.sampled_from([*[""] * 40, "utf-8-sig", "utf-16", "latin-1", "crlf", "nul"]))
    if odd in ("utf-8-sig", "utf-16", "latin-1"):
        return text.encode(odd, errors="replace")
    data = text.encode("utf-8", errors="surrogatepass")
    return data.replace(b"\n", b"\r\n") if odd == "crlf" else data + b"\0" if odd == "nul" else data


def toml(documents: Sequence[Any]) -> st.SearchStrategy[bytes]:
    """TOML files near any of several documents."""
    return _files(documents, as_toml)


def jsons(documents: Sequence[Any]) -> st.SearchStrategy[bytes]:
    """JSON files near any of several documents."""
    return _files(documents, as_json)


def _files(documents: Sequence[Any], write: Callable[[Any], str]) -> st.SearchStrategy[bytes]:
    @st.composite  # without arguments, which hypothesis would write out
    def file(draw: st.DrawFn) -> bytes:
        document = documents[draw(st.integers(0, len(documents) - 1))]
        return encoded(draw, write(changed(draw, document)))

    return file()
