"""`simgrab check`: a gate for CI."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from simgrab.cli._options import FOLDER, PATH, WORKERS, cluster_option
from simgrab.text import printable


@click.command(name="check")
@click.argument("suite")
@click.option("--instrument", help="Instrument to use instead of the suite's, as package.module:factory.")
@click.option("--baseline", type=PATH, help="Baseline folder.  [default: the suite's]")
@click.option("--update-baseline", "update", is_flag=True, help="Record the current figures as the baseline.")
@click.option("--seeds", type=click.IntRange(1, 1000), help="Number of seeds to record.  [default: the suite's]")
@click.option("--seed", type=click.IntRange(0, 2**53), help="Seed to use instead of the suite's.")
@click.option("--cache", type=FOLDER, help="Cache of rendered datasets.  [default: ~/.cache/simgrab]")
@click.option("--workers", type=WORKERS, default=1, show_default=True, help="Worker processes, at most.")
@cluster_option
@click.option(
    "--timeout", type=click.FloatRange(0, min_open=True), help="Fail a scene that is measured for more seconds."
)
@click.option("--out", type=FOLDER, help="Folder of the results.  [default: runs/check-SUITE]")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@click.option("--quiet", is_flag=True, help="Print failures only; notes go to stderr.")
def command(
    suite: str, instrument: str | None, baseline: Path | None, update: bool, seeds: int | None, seed: int | None,
    cache: Path | None, workers: int, cluster: str | None, timeout: float | None, out: Path | None, as_json: bool,
    quiet: bool,
) -> None:  # fmt: skip
    """Run an instrument on SUITE and compare its measurements with limits and baseline.

    SUITE is a bundled suite or a TOML file. OUT gets the page check.html, check.json, junit.xml and images of
    golden frames that differ. Exit status: 0 passed, 1 failed, 2 the suite is invalid.
    """
    from simgrab.cli._progress import steps
    from simgrab.errors import SuiteError
    from simgrab.io.destination import check_folder
    from simgrab.judge.check import gate, report
    from simgrab.judge.check import suite as suites
    from simgrab.judge.check.cache import default
    from simgrab.judge.check.page import page
    from simgrab.judge.check.table import show

    place = out or Path("runs") / f"check-{Path(suite).stem}"  # known of a suite that cannot be read, too
    report.clear(place)
    found = suites.load(suite)
    check_folder(place, SuiteError)
    if seeds is not None and not update:
        raise click.UsageError("--seeds needs --update-baseline")
    if seed is not None and update:
        raise click.UsageError("--seed cannot be combined with --update-baseline, which starts at the suite's seed")
    sys.path.insert(0, str(Path.cwd()))  # a pipeline under test lies where one works
    with steps(shown=not (quiet or as_json)) as progress:
        options = gate.CheckOptions(instrument, baseline, seed, cache or default(), workers, cluster, timeout, progress)
        result = gate.record(found, options, seeds) if update else gate.check(found, options)
    report.save(result, place, page(result))
    for note in result.notes if quiet else ():
        click.echo(printable(note), err=True)
    if as_json:
        click.echo(report.as_json(result))
    else:
        show(result, quiet=quiet)
        if not (quiet and result.passed):
            click.echo(f"page: {printable(place / report.PAGE)}")
    sys.exit(0 if result.passed else 1)
