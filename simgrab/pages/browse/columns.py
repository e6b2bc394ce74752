"""Columns of a table as a page gets them: numbers, or codes of texts, one array each.

A column is sent when the page first needs it: as 64-bit floats, in which NaN stands for no value, or as 32-bit codes.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from simgrab.text import encodable, printable

MOST_LEVELS = 200
"""Of a column of texts that is shown as categories, with a bar for each; one with more is searched."""

_MOST_DIGITS = 16  # of whole numbers, which floats hold
_FEW = 8  # levels that are shown even of few rows; else each needs two rows on average

Kind = Literal["number", "category", "text", "list"]


@dataclass(frozen=True, eq=False)
class Column:
    """A column of a table."""

    name: str
    unit: str
    description: str
    kind: Kind  # `number`; `category`: few different texts, or whether something is so; `text`; `list` of numbers
    values: pa.ChunkedArray
    levels: tuple[str | None, ...] = ()  # of categories, sorted; None, the last, where some rows have no value
    span: tuple[float, float] | None = None  # least and largest number; None without any

    @property
    def codes(self) -> NDArray[np.uint32]:
        """Shape (n,): of categories the index in ``levels``, of texts the rank among all of them, sorted."""
        coded = _coded(self.values)
        count = len(coded.dictionary)
        ranks = np.append(pc.rank(coded.dictionary).to_numpy() - 1, count).astype(np.uint32)
        return ranks[coded.indices.fill_null(count).to_numpy(zero_copy_only=False)]

    def content(self) -> bytes:
        """Give the column as bytes, little-endian: float64 of numbers, uint32 of categories and texts."""
        if self.kind == "number":
            return numbers(self.values).astype("<f8").tobytes()
        return self.codes.astype("<u4").tobytes()

    def matches(self, text: str) -> NDArray[np.bool_]:
        """Rows whose text contains another, whatever its case, shape (n,)."""
        found = pc.match_substring(self.values, text, ignore_case=True).fill_null(False)
        return np.asarray(found.to_numpy(), bool)

    def about(self) -> dict[str, Any]:
        """Describe it for the page."""
        levels = [None if level is None else printable(level) for level in self.levels]
        return {
            "name": printable(self.name), "unit": printable(self.unit), "description": printable(self.description),
            "kind": self.kind, "levels": levels, "span": self.span,
        }  # fmt: skip


def column(name: str, values: pa.ChunkedArray, unit: str = "", description: str = "") -> Column:
    """Make a column of Arrow's values, which are numbers, truth values, texts, or lists of numbers."""
    if pa.types.is_dictionary(values.type):
        values = values.cast(values.type.value_type)
    if pa.types.is_list(values.type):
        return Column(name, unit, description, "list", values)
    if pa.types.is_boolean(values.type):
        values = pc.if_else(values, "yes", "no")
    if not pa.types.is_string(values.type):
        known = numbers(values)
        known = known[np.isfinite(known)]
        span = (float(known.min()), float(known.max())) if len(known) else None
        return Column(name, unit, description, "number", values, span=span)
    coded = _coded(values)
    if len(coded.dictionary) > min(MOST_LEVELS, max(_FEW, len(values) // 2)):
        return Column(name, unit, description, "text", values)
    levels = (*sorted(coded.dictionary.to_pylist()), *((None,) if values.null_count else ()))
    return Column(name, unit, description, "category", values, levels)


def of(table: pa.Table) -> tuple[Column, ...]:
    """Give the columns of a table, with units and descriptions of its metadata."""
    found = []
    for field, values in zip(table.schema, table.columns, strict=True):
        about = {key.decode(): value.decode() for key, value in (field.metadata or {}).items()}
        found.append(column(field.name, values, about.get("unit", ""), about.get("description", "")))
    return tuple(found)


def numbers(values: pa.ChunkedArray) -> NDArray[np.float64]:
    """Arrow's numbers as floats, shape (n,); NaN where there is none."""
    return np.asarray(values.cast(pa.float64(), safe=False).fill_null(np.nan).to_numpy(), float)


def expanded(values: pa.ChunkedArray, prefix: str) -> list[tuple[str, pa.ChunkedArray]]:
    """Take the entries out of texts of JSON objects: a column of numbers or texts for each key, by name.

    Texts that hold no object have none. What is neither a number nor a text is written as JSON.
    """
    coded = _coded(values)
    objects = [_object(text) for text in coded.dictionary.to_pylist()]
    indices = coded.indices.fill_null(len(objects)).to_numpy(zero_copy_only=False)
    found = []
    for key in sorted({key for one in objects for key in one}):
        each = [one.get(key) for one in objects] + [None]
        plain = all(value is None or (isinstance(value, int | float) and not isinstance(value, bool)) for value in each)
        kind = pa.float64() if plain else pa.string()
        kept = pa.array(each if plain else [_text(value) for value in each], kind)
        found.append((f"{prefix}{encodable(key)}", pa.chunked_array([kept.take(pa.array(indices))])))
    return found


def _coded(values: pa.ChunkedArray) -> pa.DictionaryArray:
    coded = values.dictionary_encode().combine_chunks()
    return coded.chunk(0) if isinstance(coded, pa.ChunkedArray) else coded


def _object(text: str) -> dict[str, Any]:
    try:
        data = json.loads(text, parse_int=_whole) if text else {}
    except (ValueError, RecursionError):
        return {}
    return data if isinstance(data, dict) else {}


def _whole(digits: str) -> float:
    return int(digits) if len(digits) < _MOST_DIGITS else float(digits)


def _text(value: Any) -> str | None:
    if value is None:
        return None
    return encodable(value if isinstance(value, str) else json.dumps(value, ensure_ascii=False))
