"""How far a training is, on the terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

if TYPE_CHECKING:
    from simgrab.training.loop import Report


class Board:
    """A bar for each step of the work, and a line for each epoch."""

    def __init__(self, bars: Progress) -> None:
        self._bars = bars

    def step(self, name: str) -> Callable[[int, int], None]:
        """Begin a step; gives what takes how much is done and how much there is."""
        task = self._bars.add_task(name, total=None, rate="")

        def progress(done: int, total: int) -> None:
            self._bars.update(task, completed=done, total=total)

        return progress

    def training(self, name: str) -> Callable[[Report], None]:
        """Begin a training; gives what takes its reports."""
        task = self._bars.add_task(f"training {name}", total=None, rate="")

        def report(now: Report) -> None:
            done, total = (now.epoch - 1) * now.steps + now.step, now.epochs * now.steps
            self._bars.update(task, completed=done, total=total, rate=f"{now.examples_per_s:.0f} a second")
            if now.figures:
                figures = "  ".join(f"{key.replace('_', ' ')} {value:.4g}" for key, value in now.figures.items())
                self._bars.console.print(f"{name} epoch {now.epoch}/{now.epochs}  loss {now.loss:.4f}  {figures}")

        return report


@contextmanager
def board(*, shown: bool) -> Iterator[Board]:
    """Show progress on stderr."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True, quiet=not shown)) as bars:
        yield Board(bars)
