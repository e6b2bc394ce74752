"""Files and folders that appear complete or not at all.

A file or folder being written is called a draft. It is hidden, beside its final place, and locked (flock) while its
process runs. A draft without a lock was left by a dead process; the next process that writes to the same place removes
it. All processes that write to one place must run on one machine.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import functools
import glob
import hashlib
import os
import re
import secrets
import shutil
import stat
from collections.abc import Callable, Iterator
from pathlib import Path

_ITSELF = os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC  # follow no link, wait for no pipe


@contextlib.contextmanager
def drafted(path: Path) -> Iterator[Path]:
    """Yield a file to write to. It replaces ``path`` once it is complete on the disk.

    This holds if the process or the machine stops at any time. After an error the draft is removed and ``path`` is
    unchanged. Missing folders are made. Raises `OSError` if it cannot be written.
    """
    with _draft(path, functools.partial(Path.touch, exist_ok=False)) as draft:
        yield draft
        _to_disk(draft)
        draft.replace(path)
        with contextlib.suppress(OSError):  # not every file system does this, and the file is whole already
            _to_disk(path.parent)


def write(path: Path, content: bytes | str) -> None:
    """Write a file as `drafted` does: completely or not at all, text as UTF-8."""
    with drafted(path) as draft:
        draft.write_bytes(content.encode() if isinstance(content, str) else content)


def is_visible(path: Path, folder: Path) -> bool:
    """Whether a user put this path into the folder.

    False for hidden files and folders, such as macOS's ``._a.jpg`` beside ``a.jpg``, and for ``@eaDir``, a Synology
    NAS's folder of thumbnails.
    """
    return not any(part.startswith(".") or part == "@eaDir" for part in path.relative_to(folder).parts)


def sha256(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextlib.contextmanager
def drafted_folder(path: Path) -> Iterator[Path]:
    """Yield a folder to write into. It is renamed to ``path`` at the end; a folder there must be empty.

    This holds if the process stops at any time; files lost when the machine stops are not handled. Raises `OSError` if
    it cannot be written.
    """
    with _draft(path, Path.mkdir) as draft:
        yield draft
        draft.replace(path)


@contextlib.contextmanager
def scratch(path: Path) -> Iterator[Path]:
    """Yield a hidden folder beside ``path`` to work in; it is removed at the end."""
    with _draft(path, Path.mkdir) as folder:
        yield folder


def discard(path: Path) -> None:
    """Remove a folder or file in one step: it is never left half removed under its name."""
    with scratch(path) as folder:
        path.replace(folder / path.name)


def remove_left(path: Path) -> None:
    """Remove drafts of ``path`` that dead processes left."""
    for left in path.parent.glob(f".{glob.escape(path.name)}.*.draft"):
        if re.fullmatch(re.escape(f".{path.name}.") + r"[0-9]+(-[0-9]+)?\.draft", left.name):  # else it is not a draft
            with contextlib.suppress(OSError), _locked(left, fcntl.LOCK_NB):
                _remove(left)


@contextlib.contextmanager
def locked(lock: Path, *, wait: bool = False) -> Iterator[None]:
    """Lock a file against other processes and threads; it is made if missing, and its content is not changed.

    It stays locked until the context is left or the process ends. With ``wait``, wait until another process or thread
    unlocks it.

    Raises
    ------
    BlockingIOError
        If another has locked it, unless ``wait``.
    OSError
        If it cannot be opened to write, or is not a regular file: a link is not followed.
    """
    if lock.is_symlink():
        raise OSError(errno.ELOOP, f"{lock.name} is a link; it must be a regular file")
    with _locked(lock, 0 if wait else fcntl.LOCK_NB, os.O_RDWR | os.O_CREAT) as handle:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise OSError(errno.EINVAL, f"{lock.name} is not a file")
        yield


@contextlib.contextmanager
def _draft(path: Path, make: Callable[[Path], None]) -> Iterator[Path]:
    """Make a locked draft of ``path``; remove it at the end if it still exists."""
    path.parent.mkdir(parents=True, exist_ok=True)
    remove_left(path)
    with contextlib.ExitStack() as stack:
        while True:
            draft = path.with_name(f".{path.name}.{os.getpid()}-{secrets.randbelow(10**12)}.draft")
            try:
                make(draft)
            except FileExistsError:  # of a process that had our number
                continue
            stack.callback(_remove, draft)
            try:
                stack.enter_context(_locked(draft))
            except FileNotFoundError:  # another process removed it as one that was left, before it was locked
                continue
            except OSError:  # a file system without locks: then no draft is locked, and none is removed as left
                pass
            break
        yield draft


@contextlib.contextmanager
def _locked(path: Path, how: int = 0, flags: int = os.O_RDONLY) -> Iterator[int]:
    """Lock the file or folder that has this name, and return its descriptor; refuse one that has lost it."""
    handle = os.open(path, flags | _ITSELF, 0o666)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | how)
        if not os.path.samestat(os.fstat(handle), path.lstat()):
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path))
        yield handle
    finally:
        os.close(handle)


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
