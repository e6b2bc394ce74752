"""Progress bars on stderr: of frames, and of the steps of some work."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

SPEED_OVER_S = 600.0  # a step may take minutes, and the time left is still shown

Counts = Callable[[int, int | None], None]


@contextmanager
def bar(what: str, *, shown: bool, unit: str = "frames") -> Iterator[Counts]:
    """Show a progress bar on stderr; gives what takes frames (or another unit) done and, where known, in all."""
    with bars(shown=shown) as shows:
        yield _counted(shows, shows.add_task(what, total=None, rate=""), unit)


@contextmanager
def drawing(what: str = "rendering", *, shown: bool) -> Iterator[tuple[Counts, Counts]]:
    """Show a progress bar of frames, and of a scene's many worlds while they are checked; gives what takes each."""
    with bars(shown=shown) as shows:
        checks = shows.add_task("checking worlds", total=None, rate="", visible=False)
        counted = _counted(shows, checks, "worlds")

        def checked(done: int, total: int | None) -> None:
            counted(done, total)
            shows.update(checks, visible=done != total)

        yield _counted(shows, shows.add_task(what, total=None, rate=""), "frames"), checked


@contextmanager
def steps(*, shown: bool) -> Iterator[Callable[[str, int, int], None]]:
    """Show a progress bar for each step of some work; gives what takes a step's name, how much is done, and in all."""
    with bars(shown=shown) as shows:
        tasks: dict[str, TaskID] = {}

        def progress(name: str, done: int, total: int) -> None:
            if name not in tasks:
                tasks[name] = shows.add_task(name, total=total, rate="")
            shows.update(tasks[name], completed=done)

        yield progress


def bars(*, shown: bool) -> Progress:
    """Make a display of bars, each with a text ``rate``."""
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
