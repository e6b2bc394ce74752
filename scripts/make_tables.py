"""Write the tables that the README repeats from the code: ``python -m scripts.make_tables [--check]``."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from simgrab import scenes
from simgrab.records import columns

README = Path(__file__).parents[1] / "README.md"


def tables() -> dict[str, str]:
    """Return Markdown tables by the name of their place in the README."""
    rows = [f"| `{name}` | {unit} | {text.replace('|', chr(92) + '|')} |" for name, (unit, text) in columns().items()]
    described = [f"| `{name}` | {scenes.load(name).description} |" for name in scenes.names()]
    return {
        "columns": "\n".join(["| column | unit | what it is |", "|---|---|---|", *rows]),
        "scenes": "\n".join(["| scene | what it shows |", "|---|---|", *described]),
    }


def filled(text: str) -> str:
    """Return the README's text with its tables up to date."""
    for name, table in tables().items():
        place = re.compile(rf"(<!-- {name} -->\n).*?(<!-- /{name} -->)", re.DOTALL)
        assert place.search(text), f"README.md has no place for {name}"
        text = place.sub(lambda found, table=table: f"{found[1]}{table}\n{found[2]}", text)  # type: ignore[misc]
    return text


if __name__ == "__main__":
    old = README.read_text(encoding="utf-8")
    if "--check" in sys.argv:
        sys.exit(0 if filled(old) == old else "README.md is out of date: run python -m scripts.make_tables")
    README.write_text(filled(old), encoding="utf-8")
