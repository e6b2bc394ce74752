"""Progress bars on stderr: of frames, and of the steps of some work."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress

SPEED_OVER_S = 600.0  # a step may take minutes, and the time left is still shown

Counts = Callable[[int, int | None], None]
"""Takes how much is done and, where it is known, how much there is."""


class Board:
    """A bar for each step of the work."""

    def __init__(self, bars: Progress) -> None:
        self.bars = bars

    def step(self, name: str, unit: str = "", *, whole: bool = True) -> Counts:
        """Begin a step; with a ``unit`` its speed is shown. If not ``whole``, it is shown only while it runs."""
        task = self.bars.add_task(name, total=None, rate="", visible=whole)

        def progress(done: int, total: int | None) -> None:
            speed = self.bars.tasks[task].speed if unit else None  # none is ever removed: its number is its place
            rate = f"{speed:.1f} {unit}/s" if speed else ""
            self.bars.update(task, completed=done, total=total, rate=rate, visible=whole or done != total)

        return progress


@contextmanager
def board(*, shown: bool) -> Iterator[Board]:
    """Show the progress of several steps on stderr."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    console = Console(stderr=True, quiet=not shown)
    with Progress(*columns, console=console, speed_estimate_period=SPEED_OVER_S) as bars:
        yield Board(bars)


@contextmanager
def bar(what: str, *, shown: bool, unit: str = "frames") -> Iterator[Counts]:
    """Show the progress of one step."""
    with board(shown=shown) as shows:
        yield shows.step(what, unit)


@contextmanager
def drawing(what: str = "rendering", *, shown: bool) -> Iterator[tuple[Counts, Counts]]:
    """Show the progress of frames, and of the check of many draws; yields the two functions to call with each."""
    with board(shown=shown) as shows:
        checking = shows.step("first: checking that draws are possible", "draws", whole=False)
        yield shows.step(what, "frames"), checking


@contextmanager
def steps(*, shown: bool) -> Iterator[Callable[[str, int, int], None]]:
    """Show a bar for each step; yields a function of a step's name, the amount done and the total."""
    with board(shown=shown) as shows:

        @functools.cache
        def each(name: str) -> Counts:
            if not (console := shows.bars.console).is_terminal:  # which shows no bar before its end
                console.print(f"{name} …")
            return shows.step(name)

        yield lambda name, done, total: each(name)(done, total)
