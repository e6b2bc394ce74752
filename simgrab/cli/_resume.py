"""Advice printed when a command ends early and can be resumed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from simgrab.errors import ClusterError, WorkerError
from simgrab.io.stores import is_url


@contextmanager
def resumable(*places: Path | str, but: str = "") -> Iterator[None]:
    """Add advice on how to resume in those places that are begun to the line of an interrupt, or of dead workers."""
    try:
        yield
    except (KeyboardInterrupt, ClusterError, WorkerError) as problem:
        begun = [str(place) for place in places if is_url(place) or Path(place).exists()]
        advice = f"run the same command with --resume to continue in {' and '.join(begun)}{but}"
        problem.add_note(advice if begun else "nothing was written")
        if isinstance(problem, WorkerError):
            problem.add_note("if memory is short, use fewer --workers")
        raise
