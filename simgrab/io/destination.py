"""Refuse, before anything is computed, a place that cannot be written, or to which another process writes."""

from __future__ import annotations

import errno
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from simgrab.errors import first_line
from simgrab.io.files import locked
from simgrab.io.parse import Refuse, kind_of

LOCK = ".lock"
LONGEST_SUFFIX = 40
"""Bytes that a draft's name has more than the name that it will take."""
LONGEST_INSIDE = 200
"""Bytes of a path within a folder of results."""


def check_folder(path: Path, refuse: Refuse, option: str = "--out") -> None:
    """Refuse a path at which no folder can be made, or whose parent folder cannot be written.

    ``refuse`` makes the error to raise from a line with path and reason; ``option`` chooses another place.
    """
    found = _lookup(path, refuse, option)
    if found is not None and not stat.S_ISDIR(found):
        raise refuse(f"{path} is {kind_of(found)}, not a folder; choose another {option}")
    _check_parents(path, refuse, option, inside=found is not None)


@contextmanager
def locked_folder(path: Path, refuse: Refuse, *, who: str = "simgrab", name: str = "") -> Iterator[None]:
    """Make a folder, and lock it against other processes until the context is left.

    Messages name the writer ``who``, and the folder by ``name`` or else by its path.
    """
    with ExitStack() as stack:
        try:
            path.mkdir(parents=True, exist_ok=True)
            stack.enter_context(locked(path / LOCK))
        except BlockingIOError:
            raise refuse(f"{name or path} is being written by another {who}") from None
        except OSError as problem:
            raise refuse(f"cannot write to {path}: {first_line(problem)}") from None
        yield


@contextmanager
def writing(what: str | Path, refuse: Refuse) -> Iterator[None]:
    """Turn an error of the file system into one line that names ``what`` is being written."""
    try:
        yield
    except OSError as problem:
        raise refuse(f"cannot write {what}: {problem.strerror or problem}") from None


def check_new_folder(path: Path, refuse: Refuse, option: str = "--out") -> None:
    """Refuse a path that is taken, or at which no folder can be made; parameters as for `check_folder`."""
    if _lookup(path, refuse, option) is not None:
        raise refuse(f"{path} exists; choose another {option}, or remove it")
    _check_parents(path, refuse, option)


def check_file(path: Path, refuse: Refuse, option: str = "--out") -> None:
    """Refuse a path at which no file can be written or replaced; parameters as for `check_folder`."""
    found = _lookup(path, refuse, option)
    if found is not None and not stat.S_ISREG(found):
        raise refuse(f"cannot write {path}: it is {kind_of(found)}, not a file; choose another {option}")
    _check_parents(path, refuse, option)


def _lookup(path: Path, refuse: Refuse, option: str) -> int | None:
    """Return the mode of the file at a path; None if there is no file."""
    try:
        return path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        if path.is_symlink():
            target = os.readlink(path)  # noqa: PTH115
            raise refuse(f"{path} is a link to {target}, which does not exist; choose another {option}") from None
        return None
    except (OSError, ValueError) as problem:  # ValueError: a NUL byte
        raise refuse(f"cannot write to {path}: {first_line(problem)}") from None


def _check_parents(path: Path, refuse: Refuse, option: str, *, inside: bool = False) -> None:
    """Refuse a path whose nearest folder that there is may not be written to; ``inside``: the path itself is that."""
    folder = path if inside else path.parent
    while not inside and _lookup(folder, refuse, option) is None and folder != folder.parent:
        folder = folder.parent
    mode = _lookup(folder, refuse, option) or 0
    if not stat.S_ISDIR(mode):
        raise refuse(f"cannot write to {path}: {folder} is {kind_of(mode)}, not a folder; choose another {option}")
    try:
        longest = os.pathconf(folder, "PC_NAME_MAX") - LONGEST_SUFFIX
        if any(len(os.fsencode(part)) > longest for part in path.relative_to(folder).parts):
            raise refuse(f"cannot write to {path}: a name must have at most {longest} bytes; choose another {option}")
        if len(os.fsencode(path.absolute())) > os.pathconf(folder, "PC_PATH_MAX") - LONGEST_INSIDE:
            raise OSError(errno.ENAMETOOLONG, os.strerror(errno.ENAMETOOLONG))
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as problem:
        raise refuse(f"cannot write to {path}: {folder}: {first_line(problem)}; choose another {option}") from None
