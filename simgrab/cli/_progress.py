"""Progress bars on stderr: of frames, of the steps of some work, and of a training."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from simgrab.training.loop import Report

SPEED_OVER_S = 600.0  # a step may take minutes, and the time left is still shown

Counts = Callable[[int, int | None], None]


@contextmanager
def bar(what: str, *, shown: bool, unit: str = "frames") -> Iterator[Counts]:
    """Show a progress bar on stderr; gives what takes frames (or another unit) done and, where known, in all."""
    with _bars(shown=shown) as shows:
        yield _counted(shows, shows.add_task(what, total=None, rate=""), unit)


@contextmanager
def drawing(what: str = "rendering", *, shown: bool) -> Iterator[tuple[Counts, Counts]]:
    """Show a progress bar of frames, and of a scene's many worlds while they are checked; gives what takes each."""
    with _bars(shown=shown) as shows:
        checks = shows.add_task("checking worlds", total=None, rate="", visible=False)
        counted = _counted(shows, checks, "worlds")

        def checked(done: int, total: int | None) -> None:
            counted(done, total)
            shows.update(checks, visible=done != total)

        yield _counted(shows, shows.add_task(what, total=None, rate=""), "frames"), checked


@contextmanager
def steps(*, shown: bool) -> Iterator[Callable[[str, int, int], None]]:
    """Show a progress bar for each step of some work; gives what takes a step's name, how much is done, and in all."""
    with _bars(shown=shown) as shows:
        tasks: dict[str, TaskID] = {}

        def progress(name: str, done: int, total: int) -> None:
            if name not in tasks:
                tasks[name] = shows.add_task(name, total=total, rate="")
            shows.update(tasks[name], completed=done)

        yield progress


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
    """Show the progress of trainings."""
    with _bars(shown=shown) as shows:
        yield Board(shows)


def _bars(*, shown: bool) -> Progress:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    return Progress(*columns, console=Console(stderr=True, quiet=not shown), speed_estimate_period=SPEED_OVER_S)


def _counted(shows: Progress, task: TaskID, unit: str) -> Counts:
    def progress(done: int, total: int | None) -> None:
        speed = shows.tasks[task].speed  # none is ever removed, so that its number is its place
        shows.update(task, completed=done, total=total, rate=f"{speed:.1f} {unit}/s" if speed else "")

    return progress
