"""A progress bar of frames."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

SPEED_OVER_S = 600.0  # a step may take minutes, and the time left is to be told all the same


@contextmanager
def bar(what: str, *, shown: bool, unit: str = "frames") -> Iterator[Callable[[int, int | None], None]]:
    """Show a progress bar on stderr; gives what takes frames (or another unit) done and, where known, in all."""
    columns = (
        TextColumn(what),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    console = Console(stderr=True, quiet=not shown)
    with Progress(*columns, console=console, speed_estimate_period=SPEED_OVER_S) as shows:
        task = shows.add_task("", total=None, rate="")

        def progress(done: int, total: int | None) -> None:
            speed = shows.tasks[0].speed
            shows.update(task, completed=done, total=total, rate=f"{speed:.1f} {unit}/s" if speed else "")

        yield progress
