"""Write ``docs/scene-keys.md`` from the JSON schema of scene files: ``scripts/python -m scripts.make_reference``."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from scripts.make_tables import DOCS
from simgrab.model.scenario import schema
from simgrab.model.scenario.base import UNITS

PAGE = DOCS / "scene-keys.md"
_TYPES = {"number": "number", "integer": "integer", "string": "text", "boolean": "`true`, `false`"}

Table = dict[str, Any]


def scene_keys() -> str:
    """Return the page of every key of a scene file."""
    return "\n".join(_KeysPage(schema()).lines()) + "\n"


class _KeysPage:
    """The page of keys, from a schema whose definitions it looks up."""

    def __init__(self, whole: Table) -> None:
        self._definitions = whole["$defs"]
        self._distributions = self._kinds(self._definitions["Alpha"]["properties"]["law"])

    def lines(self) -> Iterator[str]:
        yield "# Scene keys"
        yield ""
        yield "<!-- Written by scripts/python -m scripts.make_reference. -->"
        yield ""
        yield (
            "Every key of a scene file, from the [JSON schema](writing-scenes.md#write-a-scene-file) of simgrab. "
            "[Scene reference](scenes.md) explains how they work together."
        )
        yield ""
        yield (
            "A range stands for a number. A *distribution* is a table with `dist` ([below](#distributions)), "
            "or a number, which is the same in every frame. A table's `model` selects further keys, under its name. "
            "The end of a key's name is its unit: " + ", ".join(f"`{end}` {unit}" for end, unit in UNITS.items()) + "."
        )
        scenario = self._definitions["Scenario"]["properties"]
        plain = {k: v for k, v in scenario.items() if not self._kinds(v)}
        yield from ("", "## Top level", *self._keys([{"properties": plain}]))
        for key, value in scenario.items():
            if key == "vary":
                yield from ("", "## vary", "", value["description"])
                yield "[Let keys vary](writing-scenes.md#let-keys-vary) shows how."
                yield from self._keys([self._definitions["OneOf"]])
            elif key not in plain:
                yield from self._tables(key, value, 2)
        yield from ("", "## Distributions", "", "Values have the unit of the key that takes the distribution.")
        yield from self._keys([self._definitions[name] for name in self._distributions])

    def _tables(self, key: str, value: Table, level: int) -> Iterator[str]:
        """Sections of a table, or of its kinds, and of the tables within."""
        tables = [self._definitions[name] for name in self._kinds(value)]
        yield from ("", f"{'#' * level} {key}")
        if level == 2:  # else a row of the table around it describes it
            yield from ("", value["description"])
        yield from self._keys(tables, value.get("default"))
        within = {k: v for table in tables for k, v in table["properties"].items() if self._kinds(v)}
        for inner, of in within.items():
            if not self._is_distribution(of):
                yield from self._tables(f"{key}.{inner}", of, min(level + 1, 4))

    def _keys(self, tables: list[Table], default: Any = None) -> Iterator[str]:
        """Keys of a table or of its kinds; a key that several kinds share comes once."""
        usual = default.get("model") if isinstance(default, dict) else None
        tag = next((tag for tag in ("model", "dist") if tag in tables[0]["properties"]), "")
        kinds = [table["properties"][tag]["enum"][0] if tag else "" for table in tables]
        if tag:
            options = [f"`{kind}` (default)" if kind == usual else f"`{kind}`" for kind in kinds]
            yield from ("", f"`{tag}`: {', '.join(options)}.")
        of: dict[str, list[str]] = {}
        for table, kind in zip(tables, kinds, strict=True):
            for key, value in table["properties"].items():
                preset = "required" if key in table.get("required", ()) else self._default(value)
                if key != tag:
                    row = f"| `{key}` | {self._values(value)} | {preset} | {value['description']} |"
                    of.setdefault(row, []).append(kind)
        groups: dict[tuple[str, ...], list[str]] = {}
        for row, having in of.items():
            groups.setdefault(tuple(having), []).append(row)
        yield from ("", "| key | values | default | meaning |", "|---|---|---|---|")
        for names, rows in sorted(groups.items(), key=lambda group: -len(group[0])):
            if len(kinds) > 1:
                yield f"| **{'every kind' if len(names) == len(kinds) else ', '.join(names)}** |"
            yield from rows

    def _kinds(self, value: Table) -> list[str]:
        """Names of the tables that a key takes."""
        if "$ref" in (value.get("items") or {}):
            value = value["items"]
        each = value.get("additionalProperties") or value  # tables by name
        return [part["$ref"].rsplit("/", 1)[1] for part in _parts(each) if "$ref" in part]

    def _is_distribution(self, value: Table) -> bool:
        return set(self._kinds(value)) == set(self._distributions)

    def _values(self, value: Table) -> str:
        if self._is_distribution(value):
            return "[distribution](#distributions)"
        parts = [part for part in _parts(value) if part.get("type") != "null"]  # null is the default where it is valid
        if len(parts) > 1:
            return " or ".join(dict.fromkeys(map(self._values, parts)))
        (value,) = parts
        if self._kinds(value):
            return "tables" if value.get("type") == "array" else "table"
        if "enum" in value:
            return ", ".join(f"`{json.dumps(one)}`" for one in value["enum"])
        if value.get("type") == "array":
            return self._list(value)
        if "additionalProperties" in value:
            return f"{self._values(value['additionalProperties'])}, by name"
        return _range(value) or (_TYPES[value["type"]] if "type" in value else "any")

    def _list(self, value: Table) -> str:
        inner = self._values(value["prefixItems"][0] if "prefixItems" in value else value.get("items", {}))
        least, most = value.get("minItems", 0), value.get("maxItems")
        if least == most:
            return f"list of {least}: {inner}"
        count = f"up to {most:,}" if most and not least else f"{least} to {most:,}" if most else f"at least {least}"
        return f"list: {inner}" if not most and not least else f"list of {count}: {inner}"

    def _default(self, value: Table) -> str:
        default = value.get("default", {})
        if isinstance(default, dict):
            numbers = ", ".join(f"{k} = {json.dumps(v)}" for k, v in default.items())
            return f"`{{ {numbers} }}`" if self._is_distribution(value) else ""  # a section has those of other tables
        return "absent" if default is None else f"`{json.dumps(default, ensure_ascii=False)}`"


def _parts(value: Table) -> list[Table]:
    """Alternatives of a value."""
    return [one for part in value["anyOf"] for one in _parts(part)] if "anyOf" in value else [value]


def _range(value: Table) -> str:
    """Bounds of a number; empty where it has none."""
    if "maximum" not in value:
        return ""
    low = f"above {value['exclusiveMinimum']:,.16g}" if "exclusiveMinimum" in value else f"{value['minimum']:,.16g}"
    return f"{'integer ' * (value['type'] == 'integer')}{low} to {value['maximum']:,.16g}"


if __name__ == "__main__":
    PAGE.write_text(scene_keys(), encoding="utf-8")
