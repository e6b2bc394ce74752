"""What HTML pages are made of: one look, tables, and figures inlined as SVG."""

from __future__ import annotations

import io
import re
from html import escape

from matplotlib.figure import Figure

STYLE = """
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, sans-serif; color: #1c2126; max-width: 68rem;
  margin: 2.5rem auto; padding: 0 1.25rem; }
h1 { font-size: 1.7rem; margin: 0 0 .3rem; } h2 { font-size: 1.2rem; margin: 2.4rem 0 .6rem; }
p.lead { color: #4a535b; margin-top: 0; }
table { border-collapse: collapse; width: 100%; font-size: .86rem; }
th, td { text-align: left; padding: .32rem .6rem; border-bottom: 1px solid #dfe3e6; vertical-align: top; }
th { border-bottom: 2px solid #aab2b8; } td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; }
figure { margin: .8rem 0 0; } figure svg { width: 100%; height: auto; }
figcaption { color: #4a535b; font-size: .86rem; }
"""


def svg(figure: Figure, name: str) -> str:
    """Write a figure as SVG; its ids begin with ``name``, since the figures of a page share one document."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r'id="([^"]+)"', rf'id="{name}-\1"', text)
    return re.sub(r'(href="#|url\(#)', rf"\g<1>{name}-", text)


def table(head: list[str], body: list[list[str]], numbers: set[int]) -> str:
    """Write a table; columns in ``numbers`` are set as such."""

    def line(cells: list[str], tag: str) -> str:
        marked = (f"<{tag} class='n'>" if i in numbers else f"<{tag}>" for i in range(len(cells)))
        return "<tr>" + "".join(f"{m}{escape(c)}</{tag}>" for m, c in zip(marked, cells, strict=True)) + "</tr>"

    return f"<table><thead>{line(head, 'th')}</thead><tbody>{''.join(line(b, 'td') for b in body)}</tbody></table>"
