"""`simgrab paper`: the simulation study of the paper, run again."""

from __future__ import annotations

from pathlib import Path

import click

from simgrab.cli._options import FOLDER


@click.command()
@click.option("--out", type=FOLDER, default="paper", show_default=True)
@click.option(
    "--replications", type=click.IntRange(20, 100_000), default=1000, show_default=True, help="M; the paper's is 1000."
)
@click.option("--seed", type=click.IntRange(0, 2**53), default=0, show_default=True)
def command(out: Path, replications: int, seed: int) -> None:
    """Run section 4.4 of the paper and print published and measured values side by side.

    Writes the figures (SVG and PNG) and paper.html, which needs no other file, into the folder OUT.
    """
    from simgrab.lab.paper.paper import PaperSettings
    from simgrab.lab.paper.run import run
    from simgrab.lab.paper.table import INCONSISTENT, rows
    from simgrab.reports.terminal import cell, stdout, table

    console = stdout()
    settings = PaperSettings(replications=replications, seed=seed)
    study = run(out, settings, report=lambda what: click.echo(what, err=True))
    console.print(table(rows(study), ("section", "", "published", "measured", "")))
    console.print("Contradictions within the text of the paper:")
    for section, text in INCONSISTENT:
        console.print(f"  {section}: {text}", markup=False)
    console.print(f"page: {cell(out / 'paper.html')}", soft_wrap=True)
