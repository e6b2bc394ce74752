"""``simgrab browse``."""

from __future__ import annotations

from pathlib import Path

import click

from simgrab.cli._options import PATH
from simgrab.pages.cli._pages import page_options, show
from simgrab.text import printable


@click.command(name="browse")
@click.argument("path", type=PATH)
@click.option("--source", type=PATH, help="Dataset, video or folder of images that a run measured.")
@page_options
def command(path: Path, source: Path | None, port: int, no_open: bool) -> None:
    """Look through PATH, a dataset or the folder of `run`, in the browser of this machine.

    Filters, sorts and searches frames by any column, shows images with labels, and exports selections. A run is shown
    with its largest errors first; of a run on a video, --source names the video. Nothing is written into PATH. Ctrl-C
    ends it.
    """
    from simgrab.pages.browse import browse

    subject = browse.open(path, source)
    for note in subject.notes:
        click.echo(printable(f"note: {note}"), err=True)
    show(f"{len(subject)} frames of {path}", browse.serving(subject, port), opens=not no_open)
