"""Write the tables that docs repeat from the code: ``scripts/python -m scripts.make_tables [--check]``."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path

from simgrab.lab.stress.axes import AXES
from simgrab.match.data_sheets import CAMERAS
from simgrab.model import scenes
from simgrab.model.truth import columns

DOCS = Path(__file__).parents[1] / "docs"


def columns_table() -> str:
    """Columns of ``labels.parquet``."""
    rows = [f"| `{name}` | {unit} | {text.replace('|', chr(92) + '|')} |" for name, (unit, text) in columns().items()]
    return "\n".join(["| column | unit | what it is |", "|---|---|---|", *rows])


def scenes_table() -> str:
    """Bundled scenes."""
    rows = [f"| `{name}` | {scenes.load(name).description} |" for name in scenes.names()]
    return "\n".join(["| scene | what it shows |", "|---|---|", *rows])


def axes_table() -> str:
    """Axes of the stress studies."""
    rows = [
        f"| `{a.name}` | {a.unit} | {'' if a.holds is None else a.holds} | {a.description} |" for a in AXES.values()
    ]
    return "\n".join(["| axis | unit | no violation at | what it varies |", "|---|---|---|---|", *rows])


def cameras_table() -> str:
    """Cameras of `simgrab new`."""
    rows = [
        f"| {name} | {w}x{h} | {', '.join(f'{mm:g} mm: {across}° x {up}°' for mm, (across, up) in lenses.items())} |"
        for name, (w, h, lenses) in CAMERAS.items()
    ]
    return "\n".join(["| camera | picture, px | lenses |", "|---|---|---|", *rows])


# Page: the name of the table's place in it, and the table.
TABLES: dict[str, tuple[str, Callable[[], str]]] = {
    "labels.md": ("columns", columns_table),
    "scenes.md": ("scenes", scenes_table),
    "stress.md": ("axes", axes_table),
    "writing-scenes.md": ("cameras", cameras_table),
}


def filled(page: str) -> str:
    """Return a page's text with its table up to date."""
    text, (name, table) = (DOCS / page).read_text(encoding="utf-8"), TABLES[page]
    place = re.compile(rf"(<!-- {name} -->\n).*?(<!-- /{name} -->)", re.DOTALL)
    assert place.search(text), f"there is no place for {name} in {page}"
    return place.sub(lambda found: f"{found[1]}{table()}\n{found[2]}", text)


if __name__ == "__main__":
    for page in TABLES:
        path, text = DOCS / page, filled(page)
        if "--check" in sys.argv and text != path.read_text(encoding="utf-8"):
            sys.exit(f"{path.name} is out of date: run scripts/python -m scripts.make_tables")
        path.write_text(text, encoding="utf-8")
