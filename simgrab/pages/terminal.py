"""Text for tables in the terminal."""

from __future__ import annotations

from rich.markup import escape

from simgrab.text import printable


def cell(text: object) -> str:
    """Write text of any origin for rich: markup stays text, and control characters are shown."""
    return escape(printable(text))
