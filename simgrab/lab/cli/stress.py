"""``simgrab stress``."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path
from typing import Any

import click
import msgspec

from simgrab.cli._options import PATH, WORKERS, cluster_option
from simgrab.cli._resume import resumable
from simgrab.errors import StressError
from simgrab.io.destination import check_folder
from simgrab.text import printable


@click.command(name="stress")
@click.argument("study", required=False)
@click.option("--all", "everything", is_flag=True, help="Run every bundled study of one fidelity.")
@click.option("--depth", help="Fidelity of the study; with --all, which studies to run.  [default: geometric]")
@click.option("--quick", is_flag=True, help="Few replications of short records (smoke test).")
@click.option("--out", type=PATH, default="runs/stress", show_default=True)
@click.option("--workers", type=WORKERS, help="Processes.  [default: one a core]")
@cluster_option
@click.option("--resume", is_flag=True, help="Continue an unfinished run.")
@click.option("--frames", "n", type=click.IntRange(10, 1_000_000), help="n, in place of the study's own.")
@click.option("--replications", type=click.IntRange(2, 10_000_000), help="M, in place of the study's own.")
@click.option("--seed", type=click.IntRange(0, 2**53), help="Random seed, in place of the study's own.")
@click.option("--replay", nargs=2, metavar="STUDY TRIAL", help="Repeat one replication, with its figure.")
@click.option("--at", "at", multiple=True, metavar="VALUE", help="Axis value, for --replay.  [default: the last]")
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
@click.option("--quiet", is_flag=True, help="No progress.")
def command(
    study: str | None, everything: bool, depth: str | None, quick: bool, out: Path, workers: int | None,
    cluster: str | None, resume: bool,
    n: int | None, replications: int | None, seed: int | None, replay: tuple[str, str] | None, at: tuple[str, ...],
    as_json: bool, quiet: bool,
) -> None:  # fmt: skip
    """Violate an assumption and measure every estimator.

    STUDY is a bundled study or a TOML file; without one the bundled studies are listed. Exit status: 0 all limits of
    the studies are met, 1 at least one is not.
    """
    if [study is not None, everything, replay is not None].count(True) > 1:
        raise click.UsageError("STUDY, --all and --replay exclude each other.")
    if at and replay is None:
        raise click.UsageError("--at goes with --replay.")
    if study is not None or everything or replay is not None:
        check_folder(out, StressError)
        sys.path.insert(0, str(Path.cwd()))  # an estimator of one's own lies where one works
    from simgrab.lab.stress import catalogue
    from simgrab.lab.stress.study import Study, quickened, resized

    def load(name: str) -> Study:
        chosen = catalogue.load(name)
        if depth is not None and depth != chosen.depth:
            chosen = msgspec.structs.replace(chosen, depth=depth)
            catalogue.check(chosen)
        kept = everything and any(sweep.axis == "n" for sweep in chosen.axes)
        return resized(quickened(chosen) if quick else chosen, None if kept else n, replications, seed)

    if replay is not None:
        _replay(load(replay[0]), replay[1], at, out, as_json)
    elif everything or study is not None:
        from simgrab.runtime import machine

        chosen = [load(name) for name in (catalogue.of(depth or "geometric") if everything else [str(study)])]
        _run(chosen, out, machine.cores() if workers is None else workers, cluster, resume, as_json, quiet)
    else:
        _list(catalogue.titles(), as_json)


def _list(titles: dict[str, str], as_json: bool) -> None:
    width = max(map(len, titles))
    lines = (printable(f"{name:<{width}}  {title}") for name, title in titles.items())
    click.echo(json.dumps(titles, ensure_ascii=False) if as_json else "\n".join(lines))


def _run(
    chosen: list[Any], out: Path, workers: int, cluster: str | None, resume: bool, as_json: bool, quiet: bool
) -> None:
    from simgrab.cli._progress import bar
    from simgrab.lab.stress.laboratory import REPORT, failures, outcome, run

    with resumable(out), bar("stress", shown=not (quiet or as_json), unit="replications") as progress:
        findings = run(chosen, out, workers=workers, cluster=cluster, resume=resume, progress=progress)
    failed = failures(findings)
    if as_json:
        click.echo(json.dumps([dataclasses.asdict(v) for f in findings for v in f.verdicts], ensure_ascii=False))
    else:
        for verdict in failed:
            click.echo(printable(f"{verdict.study}: {verdict.text}: found {verdict.found}"))
        click.echo(f"{outcome(findings)}; report: {printable(out / REPORT)}")
    sys.exit(1 if failed else 0)


def _replay(study: Any, trial: str, at: tuple[str, ...], out: Path, as_json: bool) -> None:
    from simgrab.lab.stress import replay

    again = replay.replay(study, replay.parse_trial(study, trial), replay.parse_point(study, at))
    paths = replay.pictures(again, out)
    click.echo(json.dumps(again.as_json(), ensure_ascii=False) if as_json else again.as_text())
    if not as_json:
        click.echo("\n".join(printable(f"picture: {path}") for path in paths))
