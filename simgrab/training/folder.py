"""The folder of a training, and files in it that are written whole or not at all."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from simgrab.errors import TrainingError
from simgrab.io import files
from simgrab.io.destination import LOCK, check_folder, locked_folder, writing

TRACES = ("checkpoint.pt", "*/checkpoint.pt")
CURVE = ("*/*/checkpoint.pt", "learning-curve.json")  # of a learning curve


@contextmanager
def claim(out: Path, *, resume: bool, traces: Sequence[str] = TRACES) -> Iterator[None]:
    """Make the folder of a training and hold it against another.

    Parameters
    ----------
    resume : bool
        Take a folder that holds a training; one that is not empty is refused otherwise, and one that holds none always.
    traces : sequence of str
        Patterns of files by which a training's folder is known, if it was copied without its lock.

    Raises
    ------
    TrainingError
    """
    check(out, resume=resume, traces=traces)
    with locked_folder(out, TrainingError, who="training"):
        yield


def check(out: Path, *, resume: bool, traces: Sequence[str] = TRACES) -> None:
    """Refuse, before anything is computed, a folder that `claim` would refuse, with the same parameters and errors."""
    check_folder(out, TrainingError)
    try:
        full = out.is_dir() and any(path.name != LOCK for path in out.iterdir())
        known = full and any(any(out.glob(trace)) for trace in (LOCK, *traces))
    except OSError as problem:
        raise TrainingError(f"cannot write to {out}: {problem.strerror or problem}") from None
    if full and not known:
        raise TrainingError(f"{out} is not empty and does not contain a training; choose another --out")
    if full and not resume:
        raise TrainingError(f"{out} is not empty; continue with --resume, or choose another --out")


def write(path: Path, data: bytes) -> None:
    """Write a file whole or not at all; raises `TrainingError`."""
    with writing(path, TrainingError):
        files.write(path, data)
