"""Files of pages: read once, by name, so that no path of a request is ever joined to one of the disk."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

_KINDS = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}

SHARED = Path(__file__).with_name("static")
ENTER = (SHARED / "enter.html").read_bytes()
"""The page behind the address that holds the token, which leads to the page itself."""


@dataclass(frozen=True)
class Asset:
    """A file of a page, and its type."""

    content: bytes
    kind: str


def read(*folders: Path) -> dict[str, Asset]:
    """Read the files of folders by name, and those that all pages share."""
    return {
        path.name: Asset(path.read_bytes(), _KINDS[path.suffix])
        for folder in (SHARED, *folders)
        for path in sorted(folder.iterdir())
        if path.suffix in _KINDS
    }
