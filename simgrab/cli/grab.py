"""`simgrab grab`: a user's own grab."""

from __future__ import annotations

from pathlib import Path

import click

from simgrab.cli._options import FOLDER, PATH


@click.group(name="grab")
def command() -> None:
    """Work with your own grab, from a GLB, glTF, OBJ, PLY or STL file."""


@command.command()
@click.argument("file", type=PATH)
@click.option("--out", type=FOLDER, help="Folder for grab.html and turntable.jpg.  [default: FILE's name and -check]")
@click.option(
    "--set",
    "assignments",
    multiple=True,
    metavar="KEY=VALUE",
    help="Set a key of the scene, e.g. grab.scale=0.001; may be repeated.",
)
def check(file: Path, out: Path | None, assignments: tuple[str, ...]) -> None:
    """Report what simgrab reads from FILE and what looks wrong, and render it from all sides.

    FILE is a model, or a scene file whose [grab] is of the model "mesh". Exit status: 0 also with doubts, 2 where FILE
    cannot be a grab.
    """
    from simgrab import scenes
    from simgrab.judge import own_grab
    from simgrab.pages.terminal import cell, stdout, table

    scene = own_grab.scene_of(file, scenes.parse_changes(assignments))
    found = own_grab.check(scene)
    folder = Path(f"{file.stem}-check") if out is None else out
    found.save(folder, file.name)
    console = stdout()
    console.print(table(found.facts, ("", "")))
    for doubt in found.doubts or ["nothing"]:
        console.print(f"looks wrong: {cell(doubt)}", soft_wrap=True)
    console.print(f"page: {cell(folder / own_grab.PAGE)}", soft_wrap=True)
