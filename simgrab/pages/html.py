"""Self-contained HTML pages: figures inline as SVG, pictures inline as JPEG, and tables."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Collection, Sequence
from html import escape

from simgrab.pages.plots import Figure, rc_context
from simgrab.text import printable

_STYLE = """
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, sans-serif; color: #1c2126; max-width: 68rem;
  margin: 2.5rem auto; padding: 0 1.25rem; }
h1 { font-size: 1.7rem; margin: 0 0 .3rem; } h2 { font-size: 1.2rem; margin: 2.4rem 0 .6rem; }
p.lead { color: #4a535b; margin-top: 0; }
table { border-collapse: collapse; width: 100%; font-size: .86rem; }
th, td { text-align: left; padding: .32rem .6rem; border-bottom: 1px solid #dfe3e6; vertical-align: top; }
th { border-bottom: 2px solid #aab2b8; } td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; }
figure { margin: .8rem 0 0; } figure svg, figure img { width: 100%; height: auto; }
figcaption { color: #4a535b; font-size: .86rem; }
"""


def text(value: object) -> str:
    """Write text of any origin as HTML: markup stays text, and control characters are shown."""
    return escape(printable(value))


def page(title: str, lead: str, parts: Sequence[str], style: str = "") -> str:
    """Write a page; ``lead`` and ``parts`` are HTML, ``style`` is CSS of its own."""
    return "\n".join([
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>",
        "<meta name='viewport' content='width=device-width, initial-scale=1'>",
        f"<title>{text(title)}</title><style>{_STYLE}{style}</style></head><body><h1>{text(title)}</h1>",
        f"<p class='lead'>{lead}</p>", *parts, "</body></html>",
    ])  # fmt: skip


def section(title: str, content: str) -> str:
    """Put a heading above some HTML."""
    return f"<h2>{text(title)}</h2>{content}"


def svg(figure: Figure, name: str) -> str:
    """Write a figure as SVG; its ids begin with ``name``, as figures share a page."""
    buffer = io.StringIO()
    with rc_context({"svg.hashsalt": name}):  # else its ids are other ones in every process
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r'id="([^"]+)"', rf'id="{name}-\1"', text)
    return re.sub(r'(href="#|url\(#)', rf"\g<1>{name}-", text)


def drawing(figure: Figure, name: str, caption: str) -> str:
    """Inline a figure with its caption."""
    return f"<figure>{svg(figure, name)}<figcaption>{text(caption)}</figcaption></figure>"


def photograph(jpeg: bytes, caption: str) -> str:
    """Inline a JPEG."""
    data = base64.b64encode(jpeg).decode()
    said = text(caption)
    return f"<figure><img alt='{said}' src='data:image/jpeg;base64,{data}'><figcaption>{said}</figcaption></figure>"


def table(head: Sequence[str], body: Sequence[Sequence[str]], numbers: Collection[int] = ()) -> str:
    """Write a table of text; columns of numbers stand to the right."""

    def line(cells: Sequence[str], tag: str) -> str:
        marked = (f"<{tag} class='n'>" if i in numbers else f"<{tag}>" for i in range(len(cells)))
        return "<tr>" + "".join(f"{m}{text(c)}</{tag}>" for m, c in zip(marked, cells, strict=True)) + "</tr>"

    return f"<table><thead>{line(head, 'th')}</thead><tbody>{''.join(line(b, 'td') for b in body)}</tbody></table>"
