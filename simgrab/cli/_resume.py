"""Advice printed when a command ends early and can be resumed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from simgrab.errors import ClusterError, WorkerError
from simgrab.io.stores import is_url


@contextmanager
def resumable(*places: Path | str, option: str = " with --resume") -> Iterator[None]:
    """Add advice on how to resume to the line printed after an interrupt, or after workers died."""
    advice = f"run the same command{option} to continue in {' and '.join(map(str, places))}"
    try:
        yield
    except (KeyboardInterrupt, ClusterError, WorkerError) as problem:
        begun = any(is_url(place) or Path(place).exists() for place in places)
        problem.add_note(advice if begun else "nothing was written")
        if isinstance(problem, WorkerError):
            problem.add_note("if memory is short, use fewer --workers")
        raise
