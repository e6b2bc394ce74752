"""Progress of trainings on stderr."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from simgrab.cli._progress import Board

if TYPE_CHECKING:
    from simgrab.training.loop import TrainingReport


def follow(board: Board, name: str) -> Callable[[TrainingReport], None]:
    """Begin a training: a bar, and a line for each epoch; gives what takes its reports."""
    task = board.bars.add_task(f"training {name}", total=None, rate="")

    def report(now: TrainingReport) -> None:
        done, total = (now.epoch - 1) * now.steps + now.step, now.epochs * now.steps
        board.bars.update(task, completed=done, total=total, rate=f"{now.examples_per_s:.0f} a second")
        if now.figures:
            figures = "  ".join(f"{key.replace('_', ' ')} {value:.4g}" for key, value in now.figures.items())
            board.bars.console.print(f"{name} epoch {now.epoch}/{now.epochs}  loss {now.loss:.4f}  {figures}")

    return report
