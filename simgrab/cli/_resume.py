"""Advice printed when a command ends early and can be resumed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from simgrab.errors import ClusterError, WorkerError
from simgrab.io.stores import is_url


@contextmanager
def resumable(*places: Path | str) -> Iterator[None]:
    """Add advice on how to resume to the line printed after an interrupt, or after workers died."""
    advice = f"run the same command with --resume to continue in {' and '.join(map(str, places))}"
    try:
        yield
    except (KeyboardInterrupt, ClusterError, WorkerError) as problem:
        begun = any(is_url(place) or Path(place).exists() for place in places)
        memory = ["if memory is short, use fewer --workers"] if isinstance(problem, WorkerError) else []
        if notes := [advice] * begun + memory:
            problem.add_note("; ".join(notes))
        raise
