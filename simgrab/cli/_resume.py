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
    except KeyboardInterrupt as stop:
        stop.add_note(advice)
        raise
    except ClusterError as problem:
        if any(is_url(place) or Path(place).exists() for place in places):  # else nothing is begun
            problem.add_note(advice)
        raise
    except WorkerError as problem:
        problem.add_note(f"{advice}; if memory is short, use fewer --workers")
        raise
