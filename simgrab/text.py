"""Names that others chose, made fit for where they are shown: terminals, pages, tables and files."""

from __future__ import annotations

import re


def printable(text: object) -> str:
    r"""Write what would steer a terminal, break a line, or is no Unicode as escapes, e.g. ``\x1b`` or ``\u202e``.

    Examples
    --------
    >>> import os
    >>> print(printable("red\x1b[31m"), printable(os.fsdecode(b"a\xff.jpg")))
    red\x1b[31m a\xff.jpg
    """
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in encodable(text))


def encodable(text: object) -> str:
    """Write bytes of a file's name that are no UTF-8 as escapes, whatever the locale is: no file of text holds them."""
    whole = str(text)
    try:
        data = whole.encode("utf-8", "surrogateescape")
    except UnicodeEncodeError:  # surrogates that no file's name has
        data = whole.encode("utf-8", "backslashreplace")
    return data.decode("utf-8", "backslashreplace")


def cell(text: str) -> str:
    """Write text for CSV: controls as escapes, and a quote before what a spreadsheet would take for a formula."""
    text = printable(text)
    return f"'{text}" if text.startswith(("=", "+", "-", "@")) else text


def markdown(text: object) -> str:
    r"""Write text as a part of a line, or a cell, of Markdown: no HTML, link, code or cell of its own begins in it.

    That includes URLs, which GitHub links by themselves; it links e-mail addresses even where they are escaped.

    Examples
    --------
    >>> print(markdown("a|b <i> https://example.org www.example.org"))
    a\|b \<i> https\://example.org www\.example.org
    """
    return _MARKDOWN.sub(r"\\\g<0>", printable(text))


_MARKDOWN = re.compile(r"[\\`<|[]|:(?=//)|(?<=www)\.", re.IGNORECASE)
