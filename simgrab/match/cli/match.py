"""`simgrab match`: a scene that looks like a camera's own footage."""

from __future__ import annotations

import json
from pathlib import Path

import click

from simgrab.cli._options import FOLDER, PATH, detector_option


@click.command(name="match")
@click.argument("videos", type=PATH, nargs=-1, required=True, metavar="VIDEO...")
@click.option("--out", type=FOLDER, default=Path("matched"), show_default=True, help="Folder for scene and page.")
@detector_option
@click.option("--night", is_flag=True, help="They were recorded at night, by floodlights: footage does not show it.")
@click.option("--compare/--no-compare", default=True, show_default=True, help="Render the scene, and write the page.")
@click.option("--json", "as_json", is_flag=True, help="Print the quantities as JSON.")
def command(videos: tuple[Path, ...], out: Path, detector_name: str, night: bool, compare: bool, as_json: bool) -> None:
    """Measure what VIDEO... show of their camera, and write a scene that looks alike.

    Writes two scenes for `simgrab render`: matched.toml, a clip, and training.toml, worlds to train a detector on; and
    camera.toml for `simgrab run`, which names what footage does not determine. match.html shows footage and scene side
    by side. Each quantity has a 95 % interval, or the reason why the footage does not determine it.
    """
    from rich.console import Console

    from simgrab.instrument.detect import detector
    from simgrab.match import scene as matching
    from simgrab.reports.terminal import cell, table
    from simgrab.text import printable

    def report(line: str) -> None:
        click.echo(printable(line), err=True)

    matched = matching.match(videos, detector(detector_name), night=night, compare=compare, report=report)
    matched.save(out)
    rows = matched.theirs.rows()
    console = Console()
    if as_json:
        click.echo(json.dumps(dict(rows), ensure_ascii=False))
        return
    console.print(table(rows, ("", "")))
    files = (("scene", matching.SCENE), ("to train on", matching.TRAINING), ("camera, for run", matching.CAMERA))
    for label, name in files:
        console.print(f"{label}: {cell(out / name)}", soft_wrap=True)
    if compare:
        console.print(f"page: {cell(out / matching.PAGE)}", soft_wrap=True)
