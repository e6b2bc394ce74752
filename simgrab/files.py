"""Files and folders that appear whole or not at all.

What is being written is called a draft: it lies beside the place it will take, hidden, under the number of its process.
Each thread is to write to places of its own; processes that write to one place are to be of one machine.
"""

from __future__ import annotations

import contextlib
import fcntl
import glob
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path


def by_number(path: Path) -> tuple[tuple[tuple[bool, int, str], ...], str]:
    """Key that sorts frame2 before frame10, and numbers before letters, by the file's name."""
    parts = re.findall(r"[0-9]+|[^0-9]+", path.name)
    return tuple((False, int(part), "") if part[0] in "0123456789" else (True, 0, part) for part in parts), path.name


@contextlib.contextmanager
def drafted(path: Path) -> Iterator[Path]:
    """Give a file to write to, which takes the place of ``path`` once it lies whole on the disk.

    So it does if the process or the machine stops at any time. Left with an error, the draft is gone and what lay at
    ``path`` is untouched. Folders that lack are made.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    with _draft(path) as draft:
        yield draft
        _to_disk(draft)
        draft.replace(path)
        with contextlib.suppress(OSError):  # not every file system does this, and the file is whole already
            _to_disk(path.parent)


@contextlib.contextmanager
def drafted_folder(path: Path) -> Iterator[Path]:
    """Give a folder to write into, which takes the name ``path`` at the end; a full folder there is in its way.

    So it does if the process stops at any time; what a stopping machine loses of its files is not looked after.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    with _draft(path) as draft:
        draft.mkdir()
        yield draft
        draft.replace(path)


@contextlib.contextmanager
def held(lock: Path) -> Iterator[None]:
    """Hold a lock, which is a file, against other processes and threads, until left or the process stops.

    Raises
    ------
    BlockingIOError
        If another holds it.
    OSError
        If it cannot be written.
    """
    with lock.open("w") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield


@contextlib.contextmanager
def _draft(path: Path) -> Iterator[Path]:
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f".{path.name}.{os.getpid()}.draft")
    for left in path.parent.glob(f".{glob.escape(path.name)}.*.draft"):
        if left == draft or not _runs(left.suffixes[-2].lstrip(".")):
            _remove(left)
    try:
        yield draft
    finally:
        _remove(draft)


def _runs(process: str) -> bool:
    """Whether a process of this number runs; a name that is no number is not ours to judge."""
    try:
        os.kill(int(process), 0)
    except ProcessLookupError:
        return False
    except (ValueError, OverflowError, PermissionError):
        return True
    return True


def _remove(draft: Path) -> None:
    with contextlib.suppress(OSError):
        if draft.is_dir():
            shutil.rmtree(draft, ignore_errors=True)
        else:
            draft.unlink()


def _to_disk(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
