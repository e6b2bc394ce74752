"""Write the tables that README and docs repeat from the code: ``python -m scripts.make_tables [--check]``."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from pathlib import Path

from simgrab import scenes
from simgrab.judge.stress.axes import AXES
from simgrab.records import columns

README = Path(__file__).parents[1] / "README.md"
STRESS = README.parent / "docs" / "stress.md"


def tables() -> dict[str, str]:
    """Return Markdown tables by the name of their place in the README."""
    rows = [f"| `{name}` | {unit} | {text.replace('|', chr(92) + '|')} |" for name, (unit, text) in columns().items()]
    described = [f"| `{name}` | {scenes.load(name).description} |" for name in scenes.names()]
    return {
        "columns": "\n".join(["| column | unit | what it is |", "|---|---|---|", *rows]),
        "scenes": "\n".join(["| scene | what it shows |", "|---|---|", *described]),
    }


def axes() -> dict[str, str]:
    """Return the table of docs/stress.md."""
    rows = [f"| `{a.name}` | {a.unit} | {'' if a.holds is None else a.holds} | {a.says} |" for a in AXES.values()]
    return {"axes": "\n".join(["| axis | unit | holds at | what it turns up |", "|---|---|---|---|", *rows])}


def filled(text: str, given: Mapping[str, str] | None = None) -> str:
    """Return the README's text, or another with the tables given, with its tables up to date."""
    for name, table in (given or tables()).items():
        place = re.compile(rf"(<!-- {name} -->\n).*?(<!-- /{name} -->)", re.DOTALL)
        assert place.search(text), f"there is no place for {name}"
        text = place.sub(lambda found, table=table: f"{found[1]}{table}\n{found[2]}", text)  # type: ignore[misc]
    return text


if __name__ == "__main__":
    for path, given in ((README, tables()), (STRESS, axes())):
        old = path.read_text(encoding="utf-8")
        if "--check" in sys.argv and filled(old, given) != old:
            sys.exit(f"{path.name} is out of date: run python -m scripts.make_tables")
        path.write_text(filled(old, given), encoding="utf-8")
