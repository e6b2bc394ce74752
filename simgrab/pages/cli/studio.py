"""``simgrab studio``."""

from __future__ import annotations

from pathlib import Path

import click

from simgrab.pages.cli._pages import page_options, show
from simgrab.text import printable


@click.command(name="studio")
@click.argument("scene", default="quay-day")
@page_options
def command(scene: str, port: int, no_open: bool) -> None:
    """Edit SCENE in the browser of this machine, beside its frames and their labels.

    SCENE is a bundled scene, a TOML file or a dataset's manifest.json. Every key has a control. Scenes are opened and
    saved in the folder that the command is started in, or below it. Ctrl-C ends it.
    """
    from simgrab.pages.studio import studio
    from simgrab.pages.studio.documents import Documents

    documents = Documents(scene, Path())
    click.echo(printable(f"rendering the first frame of {scene} …"), err=True)
    show(scene, studio.serving(documents, port), opens=not no_open)
