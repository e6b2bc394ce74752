"""``simgrab studio``."""

from __future__ import annotations

import signal
from contextlib import suppress

import click

from simgrab.text import printable


@click.command(name="studio")
@click.argument("scene", default="quay-day")
@click.option(
    "--port", type=click.IntRange(0, 65535), default=0, help="Port of 127.0.0.1.  [default: one that is free]"
)
@click.option("--no-open", is_flag=True, help="Print the address only; open no browser.")
def command(scene: str, port: int, no_open: bool) -> None:
    """Edit SCENE in the browser of this machine, beside its frames and their labels.

    SCENE is a bundled scene, a TOML file or a dataset's manifest.json. Every key has a control. Scenes are opened and
    saved in the folder that the command is started in, or below it. Ctrl-C ends it.
    """
    from simgrab.pages.server import local

    local.check_installed()
    from simgrab.pages.studio import studio

    documents = studio.open(scene)
    click.echo(printable(f"rendering the first frame of {scene} …"), err=True)
    with suppress(KeyboardInterrupt), studio.serving(documents, port) as address:
        click.echo(printable(f"{scene}: {address.url}"))
        click.echo("Ctrl-C ends it", err=True)
        with local.opened(address, wanted=not no_open):
            signal.pause()
