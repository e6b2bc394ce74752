"""Self-contained HTML pages from the templates of the rooms, which all extend ``base.html``.

Whatever a template shows is escaped, and control characters in it are shown: no template marks a text as safe.
"""

from __future__ import annotations

import base64
import io
import math
import re
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

from simgrab.reports.plots import Figure, rc_context
from simgrab.text import printable


def svg(figure: Figure, name: str, label: str) -> Markup:
    """Write a figure as SVG that screen readers call by a label; its ids begin with ``name``: figures share a page."""
    buffer = io.StringIO()
    with rc_context({"svg.hashsalt": name}):  # else its ids are other ones in every process
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    text = f'<svg role="img" aria-label="{escape(printable(label))}"' + text[text.index("<svg") + len("<svg") :]
    text = re.sub(r'id="([^"]+)"', rf'id="{name}-\1"', text)
    return Markup(re.sub(r'(href="#|url\(#)', rf"\g<1>{name}-", text))


ENVIRONMENT = Environment(
    loader=FileSystemLoader(sorted(Path(__file__).parents[1].glob("*/templates"))),
    autoescape=True,
    undefined=StrictUndefined,
    finalize=lambda value: value if isinstance(value, Markup) else printable(value),
    trim_blocks=True,
    lstrip_blocks=True,
)
ENVIRONMENT.filters |= {
    "svg": svg,
    "base64": lambda data: base64.b64encode(data).decode(),
    "degrees": math.degrees,
}
ENVIRONMENT.policies["json.dumps_kwargs"] = {}  # keys keep their order


def page(template: str, **values: object) -> str:
    """Render a page from the template of this name and its values."""
    return ENVIRONMENT.get_template(template).render(values)
