"""Tables in the terminal, the console that prints them, and text for them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from simgrab.text import printable


def stdout(width: int | None = None) -> Console:
    """Make a console for stdout that prints text of `cell` unchanged: ``mine:x:`` holds no emoji."""
    return Console(width=width, emoji=False)


def cell(text: object) -> str:
    """Write text of any origin for rich: markup stays text, and control characters are shown."""
    return escape(printable(text))


def table(rows: Iterable[Sequence[object]], head: Sequence[str] = (), title: str = "") -> Table:
    """Make a table of text of any origin; without a header where ``head`` is empty."""
    made = Table(*map(cell, head), title=cell(title) or None, title_justify="left", show_header=any(head))
    for row in rows:
        made.add_row(*map(cell, row))
    return made
