"""Does simgrab survive any file? ``scripts/python -m scripts.fuzz [--only KIND] [--count N] [--seed S]``.

Makes hostile files of every kind that a user hands to simgrab by damaging the bytes of sound ones; half of the
documents, tables and nets by replacing their values. Opens each as the command line does. The law: it is accepted, or
refused by a `SimgrabError` of one printable line of 1,000 characters at most; within a limit of time and memory; and
nothing else is raised, nor does the process die. Failing inputs are written to ``--out``, each with its traceback.
Exits with 1 if there is any.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table

from scripts.fuzzing import corpus, generators
from scripts.fuzzing.watch import ACCEPTED, FAILED, LIMIT, MESSAGE, REFUSED, SIGNAL, TRACEBACK, Limits, Outcome, Watched

COLUMNS = {
    "accepted": ACCEPTED, "refused": REFUSED, "tracebacks": TRACEBACK, "messages": MESSAGE, "signals": SIGNAL,
    "limits": LIMIT,
}  # fmt: skip


@dataclass
class Tally:
    """What became of the inputs of a kind."""

    kind: str
    counts: Counter[str] = field(default_factory=Counter)
    seconds: float = 0.0
    memory_mib: float = 0.0
    failures: list[tuple[Path, Outcome]] = field(default_factory=list)


def fuzz(
    kinds: Sequence[str], count: int, seed: int, out: Path, *, made: Path | None = None, limits: Limits | None = None,
    progress: Callable[[Tally], None] | None = None,
) -> list[Tally]:  # fmt: skip
    """Open ``count`` hostile inputs, shared out among kinds of `generators.KINDS`, and keep failing ones in ``out``.

    ``made`` is a folder of `corpus.make`, which is made first by default; ``progress`` gets each kind's tally.
    """
    tallies = []
    with tempfile.TemporaryDirectory(prefix="fuzz-") as temporary:
        scratch = Path(temporary)
        made = made or corpus.make(scratch / "corpus")
        with Watched("scripts.fuzzing.openers", made, scratch / "printed", limits or Limits()) as watched:
            for i, kind in enumerate(kinds):
                tally = Tally(kind)
                for case in generators.cases(kind, count // len(kinds) + (i < count % len(kinds)), seed, made):
                    case.write(scratch / "case")
                    outcome = watched.open(kind, scratch / "case" / case.target)
                    shutil.rmtree(scratch / "case", ignore_errors=True)
                    tally.counts[outcome.status] += 1
                    tally.seconds = max(tally.seconds, outcome.seconds)
                    tally.memory_mib = max(tally.memory_mib, outcome.memory_mib)
                    if outcome.status in FAILED:
                        tally.failures.append((case.keep(out / f"{kind}-{case.number:05d}", outcome.text), outcome))
                tallies.append(tally)
                if progress:
                    progress(tally)
    return tallies


def table(tallies: Sequence[Tally]) -> Table:
    """Show tallies."""
    result = Table("kind", "inputs", *COLUMNS, "worst time (s)", "worst memory (MiB)")
    for column in result.columns[1:]:
        column.justify = "right"
    for tally in tallies:
        counts = [str(tally.counts[status]) for status in COLUMNS.values()]
        worst = f"{tally.seconds:.2f}", f"{tally.memory_mib:.0f}"
        result.add_row(tally.kind, str(tally.counts.total()), *counts, *worst)
    total: Counter[str] = sum((tally.counts for tally in tallies), Counter())
    worst = f"{max(t.seconds for t in tallies):.2f}", f"{max(t.memory_mib for t in tallies):.0f}"
    result.add_section()
    result.add_row("all", str(total.total()), *(str(total[status]) for status in COLUMNS.values()), *worst)
    return result


@click.command()
@click.option("--count", default=10_000, show_default=True, help="Inputs, shared out among the kinds.")
@click.option("--seed", default=0, show_default=True)
@click.option("--only", multiple=True, type=click.Choice(list(generators.KINDS)), help="Kind; as often as wanted.")
@click.option(
    "--out", type=click.Path(path_type=Path), default="runs/fuzz", show_default=True, help="Of failing inputs."
)
@click.option("--seconds", default=Limits.seconds, show_default=True, help="Limit of each input, processor time.")
@click.option("--memory", default=Limits.memory_mib, show_default=True, help="Limit of the process that opens it, MiB.")
def main(count: int, seed: int, only: tuple[str, ...], out: Path, seconds: float, memory: float) -> None:
    """Open hostile inputs of every kind."""
    limits = Limits(seconds=seconds, memory_mib=memory)

    def progress(tally: Tally) -> None:
        failures = [f"{outcome.status} {path}" for path, outcome in tally.failures]
        print(f"{tally.kind}: {dict(tally.counts)}", *failures, sep="\n", file=sys.stderr, flush=True)

    tallies = fuzz(only or list(generators.KINDS), count, seed, out, limits=limits, progress=progress)
    Console(width=140).print(table(tallies))
    sys.exit(any(tally.failures for tally in tallies))


if __name__ == "__main__":
    main()
