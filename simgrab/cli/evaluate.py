"""`simgrab evaluate`: a run against the truth."""

from __future__ import annotations

import json
from pathlib import Path

import click

from simgrab.cli._options import FILE, PATH
from simgrab.text import printable


@click.command(name="evaluate")
@click.argument("run", type=PATH)
@click.argument("dataset", type=PATH)
@click.option("--start", type=float, help="Where a cut video begins in DATASET's, s.  [default: found by positions]")
@click.option("--page", "html", type=FILE, help="Write an HTML page with figures.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of the tables.")
def command(run: Path, dataset: Path, start: float | None, html: Path | None, as_json: bool) -> None:
    """Compare a RUN with the truth, and report each stage's share of the error.

    RUN is a run's folder, or CSV or parquet by another program with columns alpha_deg (empty without an angle) and
    frame (from 0), time_s of a video or file of a dataset. Other columns of a run's angles.csv may be there.

    DATASET is the rendered dataset that the run measured, or the rendered video, with its truth table beside it. The
    run may be on a copy of that video that was re-encoded, cut or resampled.
    """
    from simgrab.errors import RunError
    from simgrab.io import files
    from simgrab.io.destination import writing
    from simgrab.judge.evaluate.evaluation import evaluate
    from simgrab.judge.evaluate.opened import opened
    from simgrab.judge.evaluate.table import tables
    from simgrab.reports.terminal import cell, stdout, table

    measured, known = opened(run, dataset, start)
    found = evaluate(measured, known)
    if as_json:
        click.echo(json.dumps(found.to_dict()))
    else:
        console = stdout()
        for each in tables(found.to_dict()):
            made = table(each.rows, each.head, each.title)
            for column in made.columns[1:]:
                column.justify, column.no_wrap = "right", True
            console.print(made)
            if each.note:
                console.print(cell(each.note), highlight=False)
    if html is not None:
        from simgrab.judge.evaluate.page import page

        with writing(html, RunError):
            files.write(html, page(measured, known, found.to_dict()))
        click.echo(f"page: {printable(html)}", err=as_json)
