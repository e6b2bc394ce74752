"""What the commands share that serve a page: their options, and how they wait."""

from __future__ import annotations

import signal
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from typing import TYPE_CHECKING, Any, TypeVar

import click

from simgrab.text import printable

if TYPE_CHECKING:
    from simgrab.pages.server.local import Address

F = TypeVar("F", bound=Callable[..., Any])


def page_options(function: F) -> F:
    """Add the options that say where a page is served and whether a browser opens it."""
    port = click.IntRange(0, 65535)
    for option in (
        click.option("--no-open", is_flag=True, help="Print the address only; open no browser."),
        click.option("--port", type=port, default=0, help="Port of 127.0.0.1.  [default: one that is free]"),
    ):
        function = option(function)
    return function


def show(title: str, serving: AbstractContextManager[Address], *, opens: bool) -> None:
    """Print the address of a page, and serve it until an interrupt."""
    from simgrab.pages.server import local

    with suppress(KeyboardInterrupt), serving as address:
        click.echo(printable(f"{title}: {address.url}"))
        click.echo("Ctrl-C ends it", err=True)
        with local.opened(address, wanted=opens):
            signal.pause()
