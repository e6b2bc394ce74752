"""`simgrab grab`: a user's own grab."""

from __future__ import annotations

from pathlib import Path

import click

from simgrab.cli._options import FOLDER, PATH, FiniteRange


@click.group(name="grab")
def command() -> None:
    """Work with your own grab, from a GLB, glTF, OBJ, PLY or STL file; STEP files are converted."""


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
    from simgrab.judge import own_grab
    from simgrab.model import scenes
    from simgrab.reports.terminal import cell, stdout, table

    scene = own_grab.scene_of(file, scenes.parse_changes(assignments))
    found = own_grab.check(scene)
    folder = Path(f"{file.stem}-check") if out is None else out
    earlier = own_grab.page_of(folder)
    found.save(folder, file.name)
    console = stdout()
    console.print(table(found.facts, ("", "")))
    for doubt in found.doubts or ["nothing"]:
        console.print(f"looks wrong: {cell(doubt)}", soft_wrap=True)
    replaces = f", in place of that of {cell(earlier)}" if earlier else ""
    console.print(f"page: {cell(folder / own_grab.PAGE)}{replaces}", soft_wrap=True)


@command.command()
@click.argument("file", type=PATH)
@click.option("--out", type=PATH, help="GLB file to write.  [default: FILE's name and .glb]")
@click.option(
    "--tolerance-mm",
    type=FiniteRange(0.01, 100),
    default=2.0,
    show_default=True,
    help="Largest distance of a facet from a curved surface.",
)
def convert(file: Path, out: Path | None, tolerance_mm: float) -> None:
    """Convert FILE, a STEP file of a CAD program, to the GLB file that a scene can name.

    Needs `pip install 'simgrab[step]'`.
    """
    from simgrab.errors import ScenarioError
    from simgrab.io import files, step
    from simgrab.io.destination import check_new_folder, writing
    from simgrab.text import printable

    def refuse(problem: str) -> ScenarioError:
        return ScenarioError("file", problem)

    target = Path(f"{file.stem}.glb") if out is None else out
    check_new_folder(target, refuse)
    data = step.glb(file, refuse, tolerance_mm=tolerance_mm)
    with writing(target, refuse):
        files.write(target, data)
    click.echo(f"{printable(target)}: check it by simgrab grab check {printable(target)}")
