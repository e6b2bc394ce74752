"""Files by name below a folder or a URL of an object store, by fsspec. A file appears complete or not at all."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import re
import tempfile
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import unquote_to_bytes

from simgrab.errors import DatasetError, SimgrabError, first_line
from simgrab.io import files
from simgrab.io.parse import Refuse

T = TypeVar("T")

ATTEMPTS = 4
"""At a request to a remote store, besides those of its own driver."""
_FIRST_PAUSE_S = 0.5
_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+://")
_EXTRAS = {"s3": "s3", "s3a": "s3"}
#: Stores in which an upload takes its name when it is complete; in others it is renamed then.
_ATOMIC = frozenset({"s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "adl", "oss", "memory"})
_PERMANENT = (FileNotFoundError, PermissionError, IsADirectoryError, NotADirectoryError)  # not worth another attempt
_FULL = (errno.ENOSPC, errno.EDQUOT)


def is_url(place: object) -> bool:
    """Whether a place is a URL, such as ``s3://bucket/name``, and not a path."""
    return isinstance(place, str) and _URL.match(place) is not None


@dataclass(frozen=True)
class Store:
    """Files below a place. It can be pickled; each process opens a connection of its own.

    Any error of a driver is raised as one line, which ``refuse`` makes an error of. Before that, requests to remote
    stores are repeated with growing pauses.

    Parameters
    ----------
    place : str
        Path of a folder, or a URL as fsspec takes it: ``s3://…``, ``gs://…``, ``file://…``; settings of the driver come
        from its environment, such as ``AWS_ENDPOINT_URL``.
    drafts : str
        Of a folder: name of a folder below it in which files are drafted. Drafts there are not synchronised with the
        disk, and those left by a dead process are not removed. By default drafts lie beside their files, are
        synchronised, and are removed.
    """

    place: str
    drafts: str = ""
    refuse: Refuse = field(default=DatasetError, repr=False)

    @property
    def _opened(self) -> tuple[Any, str]:
        """The file system, of which fsspec keeps one for each process and thread, and the path below it."""
        import fsspec

        if self.folder is not None:
            return fsspec.filesystem("file"), str(self.folder)
        scheme = self.place.partition(":")[0].lower()
        try:
            system, base = fsspec.core.url_to_fs(self.place, use_listings_cache=False)
        except ImportError as problem:
            extra = f": pip install 'simgrab[{_EXTRAS[scheme]}]'" if scheme in _EXTRAS else ""
            raise self.refuse(f"{self.place}: {first_line(problem)}{extra}") from None
        except ValueError as problem:
            raise self.refuse(f"{self.place} cannot be used: {first_line(problem)}") from None
        except Exception as problem:  # a driver may raise anything
            raise self._refusal("use", problem) from problem
        if not base.rstrip("/"):
            raise self.refuse(f"{self.place} cannot be used: it names no folder")
        return system, base.rstrip("/")

    @property
    def folder(self) -> Path | None:
        """The folder of the store; None for a remote one."""
        if not is_url(self.place):
            return Path(self.place)
        if not self.place.lower().startswith("file://"):
            return None
        path = os.fsdecode(unquote_to_bytes(self.place[len("file://") :]))
        if not path.startswith("/") or not path.strip("/"):
            raise self.refuse(f"{self.place} cannot be used: the URL of a folder begins with file:/// and its name")
        return Path(path)

    def _path(self, name: str) -> str:
        return f"{self._opened[1]}/{name}"

    def write(self, name: str, data: bytes) -> None:
        """Write a file."""
        with self.writing(name) as draft:
            draft.write_bytes(data)

    @contextlib.contextmanager
    def writing(self, name: str) -> Iterator[Path]:
        """Yield a local file to write to. It takes the name at the end, but not after an error."""
        with self.guarded(), contextlib.ExitStack() as stack:
            if self.folder is None:
                draft = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="simgrab-"))) / "draft"
                yield draft
                self._upload(name, draft.stat().st_size, lambda system, path: system.put_file(str(draft), path))
            elif self.drafts:
                (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
                draft = self.folder / self.drafts / f"draft-{os.getpid()}-{name.replace('/', '-')}"
                yield draft
                draft.replace(self.folder / name)
            else:
                yield stack.enter_context(files.drafted(self.folder / name))

    def _upload(self, name: str, size: int, send: Callable[[Any, str], object]) -> None:
        def attempt() -> None:
            system, target = self._opened[0], self._path(name)
            atomic = bool(_ATOMIC & set(_protocols(system)))
            place = target if atomic else f"{target}.{uuid.uuid4().hex}.draft"
            if not atomic:
                system.makedirs(target.rpartition("/")[0], exist_ok=True)
            send(system, place)
            found = system.info(place)["size"]
            if found != size:
                raise OSError(errno.EIO, f"{found} of {size} bytes arrived")
            if not atomic:
                system.mv(place, target)

        self._tried(f"write {name} to", attempt)

    def read(self, name: str, *, most_bytes: int, span: tuple[int, int] | None = None) -> bytes:
        """Read a file, or a span of its bytes (start included, end excluded).

        It is refused if it is missing, or longer than ``most_bytes``.
        """
        start, end = span or (0, None)
        if span is None:
            found = int(self._tried(f"read {name} of", lambda: self._opened[0].info(self._path(name)))["size"])
            if found > most_bytes:
                raise self.refuse(f"{self.place}: {name} has {found} bytes; the limit is {most_bytes}")

        def attempt() -> bytes:
            return bytes(self._opened[0].cat_file(self._path(name), start=start, end=end))

        data = self._tried(f"read {name} of", attempt)
        if span is not None and len(data) != span[1] - span[0]:
            raise self.refuse(f"{self.place}: {name} is cut off")
        return data

    def sha256(self, name: str) -> str:
        """SHA-256 of a file."""

        def attempt() -> str:
            with self._opened[0].open(self._path(name), "rb") as file:
                return hashlib.file_digest(file, "sha256").hexdigest()

        return self._tried(f"read {name} of", attempt)

    def exists(self, name: str) -> bool:
        """Whether there is a file of this name."""

        def attempt() -> bool:  # isfile() of fsspec's says no where it cannot find out
            try:
                return bool(self._opened[0].info(self._path(name))["type"] == "file")
            except FileNotFoundError:
                return False

        return self._tried(f"look up {name} in", attempt)

    def sizes(self, folder: str = "") -> dict[str, int]:
        """Names of the files of a folder, below the store's URL, with their sizes in bytes; drafts are left out."""
        system, base = self._opened

        def attempt() -> list[dict[str, Any]]:
            try:
                return list(system.ls(f"{base}/{folder}".rstrip("/"), detail=True))
            except FileNotFoundError:
                return []

        found = self._tried("list", attempt)
        names = ((one["name"].rpartition("/")[2], one) for one in found if _is_file(one))
        prefix = f"{folder}/" if folder else ""
        return {prefix + name: int(one["size"]) for name, one in names if not name.endswith(".draft")}

    def names(self, folder: str = "") -> set[str]:
        """Names of the files and folders directly in a folder, if there is one; drafts are left out."""
        system, base = self._opened

        def attempt() -> set[str]:
            try:
                if self.folder is not None:  # without looking at each
                    return set(os.listdir(self.folder / folder))  # noqa: PTH208
                found = system.ls(f"{base}/{folder}".rstrip("/"), detail=False)
                return {name.rstrip("/").rpartition("/")[2] for name in found}
            except FileNotFoundError:
                return set()

        return {name for name in self._tried("list", attempt) if name and not name.endswith(".draft")}

    def remove(self, name: str) -> None:
        """Remove a file."""
        self._tried(f"remove {name} from", lambda: self._opened[0].rm_file(self._path(name)))

    def _tried(self, what: str, attempt: Callable[[], T]) -> T:
        remote = self.folder is None
        for pause in range(ATTEMPTS):
            try:
                return attempt()
            except (MemoryError, SimgrabError):
                raise
            except Exception as problem:
                if not remote or isinstance(problem, _PERMANENT) or pause == ATTEMPTS - 1:
                    raise self._refusal(what, problem) from problem
                time.sleep(_FIRST_PAUSE_S * 2**pause)
        raise AssertionError

    @contextlib.contextmanager
    def guarded(self) -> Iterator[None]:
        """Raise an error of the local file system as one line."""
        try:
            yield
        except OSError as problem:
            if isinstance(problem, BrokenPipeError) or problem.errno == errno.ENOMEM:  # not of a file
                raise
            raise self._refusal("write to", problem) from problem

    def _refusal(self, what: str, problem: Exception) -> SimgrabError:
        if isinstance(problem, OSError) and problem.errno in _FULL:
            place = self.place if self.folder is not None else tempfile.gettempdir()
            return self.refuse(f"no space left for {place}; free some and continue with --resume")
        why = "it is not there" if isinstance(problem, FileNotFoundError) else first_line(problem)
        return self.refuse(f"cannot {what} {self.place}: {why}")


def _is_file(found: dict[str, Any]) -> bool:
    return bool(found["type"] == "file" and not found["name"].endswith("/"))  # as some tools mark a folder


def _protocols(system: Any) -> tuple[str, ...]:
    return (system.protocol,) if isinstance(system.protocol, str) else tuple(system.protocol)
