"""`simgrab bench`: methods on the same clips, by the same scorer."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from simgrab.cli._options import AUTO_WORKERS, FILE, FOLDER, NEW_FOLDER, PATH
from simgrab.io.parse import shown
from simgrab.lab.bench.season import SENSORS
from simgrab.model import scenes
from simgrab.text import printable

quiet_option = click.option("--quiet", is_flag=True, help="Print errors only.")


def _sensors(_context: click.Context, _option: click.Parameter, text: str | None) -> tuple[str, ...]:
    """Read kinds of sensors, in any order."""
    given = [name.strip() for name in text.split(",")] if text else []
    if unknown := [name for name in given if name not in SENSORS]:
        raise click.BadParameter(f"{shown(unknown[0])}: no kind of sensor; there are: {', '.join(SENSORS)}")
    return tuple(kind for kind in SENSORS if kind in given)


@click.group(name="bench")
def command() -> None:
    """Compare methods on SwingBench: the same clips, and a scorer with a version."""


@command.command()
@click.option("--out", type=FOLDER, required=True, help="Folder of the season: clips, and the truth apart from them.")
@click.option("--season", "name", default="open", show_default=True, help="Its name.")
@click.option("--seed", type=click.IntRange(0, 2**53), default=0, show_default=True, help="Seed of all clips.")
@click.option("--hidden", is_flag=True, help="Draw a secret seed and salt, to be published when the season ends.")
@click.option("--full", "subset", flag_value="full", help="All 144 clips in place of the nightly 12.")
@click.option("--trial", "subset", flag_value="trial", help="Two of the 12, to try it out.")
@click.option("--sensors", callback=_sensors, help=f"Beside the camera: some of {','.join(SENSORS)}.  [default: none]")
@click.option(
    "--frames",
    type=click.IntRange(2, 100_000),
    default=540,
    show_default=True,
    help="Of each clip; an alarm needs some 480.",
)
@click.option("--size", callback=lambda _c, _o, text: scenes.parse_size(text), default="960x540", show_default=True)
@click.option("--workers", type=AUTO_WORKERS, help="Processes, a clip each.  [default: as cores and memory allow]")
@quiet_option
def prepare(
    out: Path, name: str, seed: int, hidden: bool, subset: str | None, sensors: tuple[str, ...], frames: int,
    size: tuple[int, int], workers: int | None, quiet: bool,
) -> None:  # fmt: skip
    """Render a season. Interrupted, the same command continues it."""
    from simgrab.cli._progress import bar
    from simgrab.lab.bench.files import hidden_like, prepare
    from simgrab.lab.bench.season import Season

    season = Season(name, subset or "nightly", frames, *size, seed, sensors=sensors)
    if hidden:
        season = hidden_like(season, out)
    with bar("rendering", shown=not quiet, unit="clips") as progress:
        prepare(season, out, workers=workers, progress=progress)
    if not quiet:
        click.echo(printable(f"commitment: {season.commitment}"))


@command.command()
@click.argument("season", type=PATH)
@click.option("--out", type=NEW_FOLDER, required=True, help="New folder for the entry.")
@click.option("--instrument", default="bundled", show_default=True, help="Or an estimator, or package.module:factory.")
@click.option("--method", default="", help="Name in the table.  [default: the instrument's]")
@click.option(
    "--track",
    default="picture+rope",
    show_default=True,
    help="Inputs that the method may use: picture, rope and sensors, joined with +.",
)
@quiet_option
def run(season: Path, out: Path, instrument: str, method: str, track: str, quiet: bool) -> None:
    """Let an instrument measure the clips of SEASON, and write its entry. It never reads the truth.

    With a track such as picture+rope+imu an instrument is given the folders of these sensors. Clips without
    any angle are named on stderr.
    """
    from simgrab.cli._progress import bar
    from simgrab.instrument.run.subject import open_instrument
    from simgrab.lab.bench.entry import run

    sys.path.insert(0, str(Path.cwd()))  # a pipeline lies where one works
    with bar("measuring", shown=not quiet, unit="clips") as progress:
        empty = run(season, out, open_instrument(instrument), track, method=method, progress=progress)
    for clip, reason in empty.items():
        click.echo(printable(f"{clip}: no angle: {reason}"), err=True)


@command.command()
@click.argument("season", type=PATH)
@click.argument("entry", type=PATH)
def check(season: Path, entry: Path) -> None:
    """Check the format of an ENTRY for SEASON, of which it reads the clips alone.

    Exit status: 0 valid, 1 invalid, with a line for each problem.
    """
    from simgrab.lab.bench.entry import problems
    from simgrab.lab.bench.files import published

    known = published(season)
    found = problems(entry, known)
    for problem in found:
        click.echo(printable(problem))
    if not found:
        click.echo("valid")
    sys.exit(1 if found else 0)


@command.command()
@click.argument("season", type=PATH)
@click.argument("entries", nargs=-1, type=PATH)
@click.option("--out", type=FILE, help="CSV file for the scores.")
@click.option("--page", type=FILE, help="HTML page for them.")
@quiet_option
def score(season: Path, entries: tuple[Path, ...], out: Path | None, page: Path | None, quiet: bool) -> None:
    """Score ENTRIES for SEASON. Three more are computed from the truth and test the scorer."""
    from simgrab.lab.bench import board
    from simgrab.lab.bench.entry import read
    from simgrab.lab.bench.files import published, season_of, targets
    from simgrab.lab.bench.score import score
    from simgrab.reports.terminal import stdout, table

    found, known = season_of(season), published(season)
    scores = score([read(entry, known) for entry in entries], targets(season))
    board.save(scores, found, csv_file=out, page=page)
    if not quiet:
        console = stdout()
        made = table(board.brief(scores), tuple(board.BRIEF.values()))
        for i, column in enumerate(made.columns):
            column.overflow = "fold"
            column.justify = "left" if i < 2 else "right"
        console.print(made)
        console.print(
            "recall: average recall; missed, false: alarms. Intervals and more figures: --out, --page.", highlight=False
        )


@command.command()
@click.argument("scores", nargs=-1, required=True, type=PATH)
@click.option("--out", type=FILE, required=True, help="HTML page.")
def report(scores: tuple[Path, ...], out: Path) -> None:
    """Make the leaderboard: a page with a table for each of SCORES, CSV files of `bench score --out`."""
    from simgrab.lab.bench import board

    board.save_page([board.read(path) for path in scores], out)
