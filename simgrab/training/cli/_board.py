"""Progress of trainings on stderr: a bar for each step of the work, and a line for each epoch."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from simgrab.cli import _progress

if TYPE_CHECKING:
    from simgrab.training.loop import TrainingReport


class TrainingBoard(_progress.Board):
    """A bar for each step of the work, and of a training a line for each epoch."""

    def training(self, name: str) -> Callable[[TrainingReport], None]:
        """Begin a training; gives what takes its reports."""
        task = self.bars.add_task(f"training {name}", total=None, rate="")

        def report(now: TrainingReport) -> None:
            done, total = (now.epoch - 1) * now.steps + now.step, now.epochs * now.steps
            self.bars.update(task, completed=done, total=total, rate=f"{now.examples_per_s:.0f} a second")
            if now.figures:
                figures = "  ".join(f"{key.replace('_', ' ')} {value:.4g}" for key, value in now.figures.items())
                self.bars.console.print(f"{name} epoch {now.epoch}/{now.epochs}  loss {now.loss:.4f}  {figures}")

        return report


@contextmanager
def board(*, shown: bool) -> Iterator[TrainingBoard]:
    """Show the progress of trainings."""
    with _progress.board(shown=shown) as shows:
        yield TrainingBoard(shows.bars)
