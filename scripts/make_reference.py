"""Write the reference pages that are made from the code alone: ``python -m scripts.make_reference``.

``docs/scene-keys.md`` is made from the JSON schema of scene files, and ``docs/help.md`` from the commands.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from typing import Any

import click

from scripts.make_tables import DOCS
from simgrab.cli import cli
from simgrab.model.scenario import schema
from simgrab.model.scenario.base import unit_of

_COLUMNS = 88
_TAGS = ("model", "dist")
_TYPES = {"number": "number", "integer": "integer", "string": "text", "boolean": "`true`, `false`", "null": "absent"}

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
        yield "<!-- Written by python -m scripts.make_reference. -->"
        yield ""
        yield (
            "Every key of a scene file, from the [JSON schema](writing-scenes.md#write-a-scene-file) of simgrab. "
            "[Scene reference](scenes.md) explains how they work together."
        )
        yield ""
        yield (
            "Keys of a table that comes in kinds depend on its `model`. "
            "A key that takes a *distribution* is a table with `dist` ([below](#distributions)), or a number, "
            "which is the same in every frame."
        )
        scenario = self._definitions["Scenario"]
        plain = {k: v for k, v in scenario["properties"].items() if not self._kinds(v) and k != "vary"}
        yield from self._section("Top level", 2, "", {"properties": plain})
        for key, value in scenario["properties"].items():
            if key not in plain and key != "vary":
                yield from self._tables(key, value, 2)
        yield from ("", "## vary", "", scenario["properties"]["vary"]["description"])
        yield "[Let keys vary](writing-scenes.md#let-keys-vary) shows how."
        yield from self._section("one-of", 3, 'dist = "one-of"', self._definitions["OneOf"])
        yield from ("", "## Distributions", "", "Values have the unit of the key that takes the distribution.")
        for name in self._distributions:
            table = self._definitions[name]
            dist = table["properties"]["dist"]["enum"][0]
            yield from self._section(dist, 3, f'dist = "{dist}"', table)

    def _tables(self, key: str, value: Table, level: int) -> Iterator[str]:
        """Sections of a table, of each of its kinds, and of the tables within."""
        kinds = self._kinds(value)
        if len(kinds) > 1 or "model" in self._definitions[kinds[0]]["properties"]:
            default = value.get("default")
            yield from ("", f"{'#' * level} {key}", "", value["description"])
            if isinstance(default, dict) and default:
                yield f"The default is `{default['model']}`."
            for name in kinds:
                table = self._definitions[name]
                model = table["properties"]["model"]["enum"][0]
                yield from self._section(f"{key}: {model}", level + 1, f'model = "{model}"', table)
        else:
            yield from self._section(key, level, "", self._definitions[kinds[0]])
        done: set[str] = set()
        for name in kinds:
            for inner, of in self._definitions[name]["properties"].items():
                if inner not in done and self._kinds(of) and not self._is_distribution(of):
                    done.add(inner)
                    yield from self._tables(f"{key}.{inner}", of, min(level + 1, 4))

    def _section(self, title: str, level: int, selected: str, table: Table) -> Iterator[str]:
        """Heading, description and keys of one table."""
        yield from ("", f"{'#' * level} {title}", "")
        if selected:
            yield from (f"`{selected}`", "")
        keys = {k: v for k, v in table.get("properties", {}).items() if k not in _TAGS}
        if not keys:
            yield "No keys."
            return
        yield from ("| key | unit | values | default | what it is |", "|---|---|---|---|---|")
        required = table.get("required", ())
        for key, value in keys.items():
            default = "required" if key in required else self._default(value)
            yield f"| `{key}` | {unit_of(key)} | {self._values(value)} | {default} | {_cell(value['description'])} |"

    def _kinds(self, value: Table) -> list[str]:
        """Names of the tables that a key takes."""
        parts = value.get("anyOf", [value])
        if value.get("type") == "array" and "$ref" in (value.get("items") or {}):
            parts = [value["items"]]
        if isinstance(each := value.get("additionalProperties"), dict):  # tables by name
            parts = each.get("anyOf", [each])
        return [part["$ref"].rsplit("/", 1)[1] for part in parts if "$ref" in part]

    def _is_distribution(self, value: Table) -> bool:
        return set(self._kinds(value)) == set(self._distributions)

    def _values(self, value: Table) -> str:
        if self._is_distribution(value):
            return "[distribution](#distributions)"
        if value.get("type") != "array" and "anyOf" in value and not self._kinds(value):
            return " or ".join(self._values(part) for part in value["anyOf"])
        if self._kinds(value):
            plain = [_TYPES[part["type"]] for part in value.get("anyOf", ()) if "type" in part]
            plain += [self._values(part) for part in value.get("anyOf", ()) if "enum" in part]
            return " or ".join([*plain, "tables" if value.get("type") == "array" else "table"])
        if "enum" in value:
            return ", ".join(f"`{json.dumps(one)}`" for one in value["enum"])
        if value.get("type") == "array":
            return self._list(value)
        kind = _TYPES[value["type"]] if "type" in value else "any"
        return f"{kind} {_bounds(value)}".strip()

    def _list(self, value: Table) -> str:
        inner = self._values(value["prefixItems"][0] if "prefixItems" in value else value.get("items", {}))
        least, most = value.get("minItems", 0), value.get("maxItems")
        if least == most:
            return f"list of {least}: {inner}"
        count = f"up to {most:,}" if most and not least else f"{least} to {most:,}" if most else f"at least {least}"
        return f"list: {inner}" if not most and not least else f"list of {count}: {inner}"

    def _default(self, value: Table) -> str:
        if "default" not in value:
            return ""
        default = value["default"]
        if default is None:
            return "absent"
        if isinstance(default, dict) and not self._is_distribution(value):
            return f"`{default['model']}`" if "model" in default else ""
        if isinstance(default, dict):
            numbers = ", ".join(f"{k} = {json.dumps(v)}" for k, v in default.items())
            return f"`{{ {numbers} }}`"
        return f"`{json.dumps(default, ensure_ascii=False)}`"


def _bounds(value: Table) -> str:
    low = value.get("minimum", value.get("exclusiveMinimum"))
    high = value.get("maximum", value.get("exclusiveMaximum"))
    above = "above " if "exclusiveMinimum" in value else ""
    if low is None:
        return "" if high is None else f"up to {_number(high)}"
    if high is None:
        return f"{above}{_number(low)}" if above else f"{_number(low)} or more"
    return f"{above}{_number(low)} to {_number(high)}"


def _number(value: float) -> str:
    return f"{value:,.16g}"


def _cell(text: str) -> str:
    return text.replace("|", r"\|")


def help_page() -> str:
    """Return the page of the ``--help`` of every command."""
    lines = ["# Options of every command", "", "<!-- Written by python -m scripts.make_reference. -->", ""]
    lines.append("The output of `--help` of each command. [Command reference](commands.md) has exit status and limits.")
    lines += _helps("simgrab", cli, None)
    return "\n".join(lines) + "\n"


def _helps(name: str, command: click.Command, parent: click.Context | None) -> Iterator[str]:
    context = click.Context(
        command, info_name=name, parent=parent, terminal_width=_COLUMNS, max_content_width=_COLUMNS,
        help_option_names=["-h", "--help"],
    )  # fmt: skip
    text = "\n".join(line.rstrip() for line in command.get_help(context).splitlines())
    yield from ("", f"## {context.command_path}", "", "```text", re.sub(r"\n{3,}", "\n\n", text), "```")
    if isinstance(command, click.Group):
        for inner in command.list_commands(context):
            found = command.get_command(context, inner)
            assert found is not None
            yield from _helps(inner, found, context)


PAGES: dict[str, Callable[[], str]] = {"scene-keys.md": scene_keys, "help.md": help_page}

if __name__ == "__main__":
    for page, text in PAGES.items():
        (DOCS / page).write_text(text(), encoding="utf-8")
