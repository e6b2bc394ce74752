"""``simgrab audit``."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path

import click

from simgrab.cli._options import PATH
from simgrab.cli._progress import steps
from simgrab.cli._scene import extension_options
from simgrab.text import printable

EXIT = {"passed": 0, "failed": 1, "incomplete": 3}


@click.command(name="audit")
@click.argument("dataset", type=PATH)
@extension_options
@click.option("--json", "as_json", is_flag=True, help="Print the checks as JSON.")
@click.option("--quiet", is_flag=True, help="Print nothing but failures.")
def command(
    dataset: Path, randomiser: str | None, trajectory: str | None, effects: tuple[str, ...], as_json: bool, quiet: bool
) -> None:
    """Check the labels of DATASET. Exit status: 0 passed, 1 failed, 3 a check could not be made."""
    from simgrab.judge.audit.audit import audit, summarise

    with steps(shown=not (quiet or as_json)) as progress:
        report = audit(dataset, progress=progress, randomiser=randomiser, trajectory=trajectory, effects=effects)
    if as_json:
        proofs = [dataclasses.asdict(p) | {"status": p.status} for p in report.proofs]
        click.echo(json.dumps({"status": report.status, "proofs": proofs}))
    else:
        shown = [p for p in report.proofs if p.status != "passed"] if quiet else report.proofs
        for line in summarise(shown):
            click.echo(printable(line))
        if not quiet or report.status != "passed":
            click.echo(printable(f"audit of {dataset}: {report.status}"))
    sys.exit(EXIT[report.status])
