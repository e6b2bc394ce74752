"""What the commands share that serve a page: their options, and how they wait."""

from __future__ import annotations

import signal
from contextlib import AbstractContextManager, suppress
from typing import TYPE_CHECKING

import click

from simgrab.cli._options import together
from simgrab.text import printable

if TYPE_CHECKING:
    from simgrab.pages.server.local import Address

page_options = together(
    click.option(
        "--port", type=click.IntRange(0, 65535), default=0, help="Port of 127.0.0.1.  [default: one that is free]"
    ),
    click.option("--no-open", is_flag=True, help="Print the address only; open no browser."),
)


def show(title: str, serving: AbstractContextManager[Address], *, opens: bool) -> None:
    """Print the address of a page, and serve it until an interrupt."""
    from simgrab.pages.server import local

    with suppress(KeyboardInterrupt), serving as address:
        click.echo(printable(f"{title}: {address.url}"))
        click.echo("Ctrl-C ends it", err=True)
        with local.opened(address, wanted=opens):
            signal.pause()
