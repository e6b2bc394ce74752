"""Hostile TOML and JSON: valid documents of which some keys and values are replaced."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from random import Random
from typing import Any

CHANGES = (1, 1, 1, 2, 3)  # at a time: one is the most likely to get past the first check


@dataclass(frozen=True)
class Raw:
    """Text that stands in the document as it is."""

    text: str


DEEP = 3000
RAW = tuple(map(Raw, (
    "9" * 6000, "-" + "1" * 400, "0x" + "f" * 6000, "1e999999", "1e-999999", "0." + "1" * 5000,
    "[" * DEEP + "]" * DEEP, '{"a":' * DEEP + "1" + "}" * DEEP, "{a=" * DEEP + "1" + "}" * DEEP, "nan", "-inf", "NaN",
    "-Infinity", "null", "", '"\\ud800"', '"\\udfff\\ud800"', '"\\u0000"', '"\\U00110000"', "'''\n\n'''", "0001-01-01",
    "9999-12-31T23:59:59.999999-23:59", "25:61:61", "07:32:00", "1_000", "0b1", "true", '"unterminated', "[1, 2",
)))  # fmt: skip
INTEGERS = (
    0, 1, -1, 2, 3, 10, 100, 255, 1000, 4096, 65536, 10**6, 10**7, 2**31 - 1, 2**31, 2**53, 2**53 + 1, 2**63 - 1, 2**63,
    -(2**63), 2**64, 10**40,
)  # fmt: skip
FLOATS = (
    0.0, -0.0, 0.5, 1.0, -0.5, 90.0, 180.0, 1e-9, 1e-300, 5e-324, 1e9, 1e30, 1e154, 1e155, 1e300, 1.7e308, -1.7e308,
    math.nan, math.inf, -math.inf,
)  # fmt: skip
TEXTS = (
    "", " ", "\n", "\t", "\x00", "\x1b[31mred\x1b[0m", "a\nb", "a\r\nb", "\u2028", "\u202eab", "\ufeff", "\ud800",
    "a\udcff", "é", "e\u0301", "年月日", "😀", "x" * 5000, "`$.a`", "$", "a.b", "..", "../../../../etc/passwd",
    "/dev/zero", "/", "~", "-x", "%s%n", "{0}", "[bold]x[/]", "</script>", "none", "None", "null", "true", "0", "1",
    "nan", "inf", "quay-day", "training", "plain", "dynamic", "uniform", "one-of", "constant", "two-by-four",
    "2022-01-26T14:05:37", "0001-01-01T00:00:00", "9999-12-31T23:59:59", "2022-01-26T14:05:37+14:00", "camera",
    "os:getcwd", "os:abort", "a+b", "+", "grab",
)  # fmt: skip
KEYS = (
    "", " ", "a", "a.b", "a\nb", "\x00", "é", "\u202e", "$", "`", "x" * 2000, "base", "vary", "model", "dist", "values",
    "seed", "frames", "name", "[0]", "0", "__class__", "self",
)  # fmt: skip


def text(rng: Random, most: int = 8) -> str:
    """Draw a short text of any characters, surrogates aside."""
    ranges = ((32, 127), (32, 127), (0, 0x300), (0, 0xD800), (0xE000, 0x110000))
    return "".join(chr(rng.randrange(*rng.choice(ranges))) for _ in range(rng.randrange(most)))


def number(rng: Random) -> float:
    """Draw a float of any bits, or a small one."""
    (any_bits,) = struct.unpack("d", rng.randbytes(8))
    return rng.choice((float(any_bits), rng.uniform(0, 100)))


def key(rng: Random) -> str:
    """Draw the name of a key."""
    return rng.choice(KEYS) if rng.random() < 0.5 else text(rng)


def value(rng: Random, depth: int = 3) -> Any:
    """Draw a value: most are scalars, some lists and tables."""
    if depth and rng.random() < 0.25:
        inner = [value(rng, depth - 1) for _ in range(rng.randrange(5))]
        return inner if rng.random() < 0.5 else {rng.choice(KEYS): one for one in inner}
    drawn = (
        rng.choice(INTEGERS), rng.choice(FLOATS), rng.choice(TEXTS), rng.choice(RAW), rng.random() < 0.5,
        rng.getrandbits(rng.choice((4, 16, 40, 70, 200))) * rng.choice((1, -1)), number(rng), text(rng, 12),
    )  # fmt: skip
    return rng.choice(drawn)


def changed(rng: Random, document: Any) -> Any:
    """Change some nodes of a document: nested dictionaries, lists and scalars."""
    for _ in range(rng.choice(CHANGES)):
        path = rng.choice(list(_paths(document)))
        document = _at(document, path, rng.choice(_CHANGES)(rng, _get(document, path), document))
    return document


class _Gone:
    """In place of what is removed."""


def _near(rng: Random, old: Any, _whole: Any) -> Any:
    """Change a value and keep its type, so that what comes after the types is reached."""
    if isinstance(old, bool):
        return not old
    if isinstance(old, int):
        some = (old + 1, old - 1, -old, 2 * old, 10 * old, 1000 * old, old // 2)
        return rng.choice((rng.choice(some), rng.choice(INTEGERS), rng.randrange(100)))
    if isinstance(old, float):
        near = (0.0, 1.0, -1.0, -old, 2 * old, old / 2, 1.1 * old, 1e-3 * old, 1e3 * old, 1e9 * old)
        return rng.choice((rng.choice(near), rng.choice(FLOATS), rng.uniform(0, 100)))
    if isinstance(old, str):
        return rng.choice((rng.choice(TEXTS), old + text(rng)))
    if isinstance(old, list) and old:
        return rng.choice((old[:-1], old + old[-1:], old[::-1], old * 50, [old[0]] * len(old)))
    return value(rng)


def _add(rng: Random, old: Any, whole: Any) -> Any:
    """Add a key to a table, or an item to a list."""
    if isinstance(old, dict):
        return {**old, key(rng): value(rng)}
    return [*old, value(rng)] if isinstance(old, list) else _near(rng, old, whole)


def _rename(rng: Random, old: Any, whole: Any) -> Any:
    if not isinstance(old, dict) or not old:
        return _near(rng, old, whole)
    name, other = rng.choice(sorted(old)), key(rng)
    return {(other if one == name else one): inner for one, inner in old.items()}


_CHANGES: tuple[Callable[[Random, Any, Any], Any], ...] = (
    *[_near] * 8,
    *[lambda rng, _old, _whole: value(rng)] * 2,
    lambda _rng, _old, _whole: _Gone,
    lambda rng, _old, whole: _get(whole, rng.choice(list(_paths(whole)))),
    lambda rng, old, _whole: rng.choice(([old], {"a": old}, [old] * 300, {str(i): old for i in range(100)})),
    _add,
    _rename,
)


def _paths(node: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    items: Sequence[tuple[str | int, Any]] = ()
    if isinstance(node, dict):
        items = list(node.items())
    elif isinstance(node, list):
        items = list(enumerate(node[:20]))
    if path or not items:
        yield path
    for step, inner in items:
        yield from _paths(inner, (*path, step))


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
    return "".join(f"{_quoted(k)} = {inline(v)}\n" for k, v in value.items() if v is not None)


def inline(value: Any) -> str:
    """Write a value of TOML in one line."""
    if isinstance(value, Raw):
        return value.text
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_quoted(k)} = {inline(v)}" for k, v in value.items() if v is not None) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(inline(v) for v in value if v is not None) + "]"
    if isinstance(value, float):
        return repr(value)
    return _quoted(value) if isinstance(value, str) else json.dumps(value)


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def hostile(rng: Random, documents: Sequence[Any], write: Callable[[Any], str]) -> bytes:
    """Write a file near one of several documents, now and then encoded as no reader of UTF-8 expects it."""
    written = write(changed(rng, rng.choice(documents)))
    odd = rng.choice([*[""] * 40, "utf-8-sig", "utf-16", "latin-1", "crlf", "nul"])
    if odd in ("utf-8-sig", "utf-16", "latin-1"):
        return written.encode(odd, errors="replace")
    data = written.encode("utf-8", errors="surrogatepass")
    return data.replace(b"\n", b"\r\n") if odd == "crlf" else data + b"\0" if odd == "nul" else data
