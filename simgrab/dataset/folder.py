"""A dataset's folder while it is being made: who may write there, what is done, and how it is taken up again.

A frame counts as done once its record lies in ``.partial/rows``; pictures and records appear whole or not at all.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from simgrab.dataset import manifest, tables
from simgrab.dataset.datasets import MANIFEST
from simgrab.dataset.stored import Record, StoredFrame
from simgrab.dataset.stores import Store
from simgrab.errors import DatasetError, first_line
from simgrab.io import files
from simgrab.io.destination import check_folder
from simgrab.io.parse import read_json
from simgrab.model.scenario import Scenario
from simgrab.model.truth import SPLITS
from simgrab.world.gl import Fingerprint


@dataclass(frozen=True)
class Folder:
    """An output folder.

    Parameters
    ----------
    path : Path
    """

    path: Path

    @property
    def partial(self) -> Path:
        """Working folder; it exists while the dataset is unfinished."""
        return self.path / ".partial"

    @property
    def begun(self) -> bool:
        """Whether it holds a dataset, of whatever identity: whose scenario was found possible, then."""
        return self._identity() is not None

    def _row(self, frame: int) -> Path:
        return self.partial / "rows" / f"{frame:08d}.json"

    def open(self, identity: dict[str, Any], *, resume: bool) -> bool:
        """Claim the folder for a dataset.

        Parameters
        ----------
        identity : dict
            What makes the dataset what it is (`simgrab.dataset.manifest.identity`).
        resume : bool
            Go on with an unfinished dataset of the same identity; leave a finished one as it is.

        Returns
        -------
        bool
            Whether frames remain to be made.

        Raises
        ------
        DatasetError
            If the folder holds anything else. Nothing in it is touched then.
        """
        if not self.check(identity, resume=resume):
            return False
        with writing(self.path):
            (self.partial / "rows").mkdir(parents=True, exist_ok=True)
            self.write(".partial/identity.json", json.dumps(identity, indent=1).encode())
        return True

    def check(self, identity: dict[str, Any], *, resume: bool) -> bool:
        """Find out what `open` would do, which takes, returns and raises the same.

        The working folder of a finished dataset is removed.
        """
        check_folder(self.path, DatasetError)
        known = self._identity()
        if known is not None:
            finished = (self.path / MANIFEST).exists()  # it comes last
            refuse_other(self.path, known, identity, unfinished=self.partial.exists(), resume=resume)
            if finished:
                self._drop_left()
                return False
        else:
            self._refuse_foreign()
        return True

    def _refuse_foreign(self) -> None:
        with writing(self.path):
            ours = {"rows", "lock", "identity.json"}
            inside = [p.name for p in self.partial.iterdir()] if self.partial.is_dir() else []
            foreign = any(name not in ours and not name.startswith("draft-") for name in inside)
            if self.path.is_dir() and (foreign or any(p != self.partial for p in self.path.iterdir())):
                raise DatasetError(f"{self.path} contains something other than a simgrab dataset; choose another --out")

    def _identity(self) -> dict[str, Any] | None:
        for path in (self.partial / "identity.json", self.path / MANIFEST):
            try:
                data = read_json(path, DatasetError)
            except DatasetError:
                continue
            if isinstance(data, dict) and "scenario" in data:
                return data
        return None

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Hold the folder against a second writer."""
        with locked(self.partial, self.path):
            yield

    def done(self) -> set[int]:
        """Frames that are finished."""
        return {int(path.stem) for path in (self.partial / "rows").glob("*.json")}

    def has(self, frame: int) -> bool:
        """Whether a frame is finished."""
        return self._row(frame).exists()

    def record(self, frame: int) -> Record:
        """Record of a finished frame."""
        row = self._row(frame)
        try:
            return msgspec.json.decode(row.read_bytes(), type=Record)
        except (OSError, ValueError, RecursionError) as problem:
            why = f"{type(problem).__name__}: {first_line(problem)}"
            raise DatasetError(f"{row} is damaged ({why}); delete it, and --resume renders the frame again") from None

    def store(self, frame: StoredFrame) -> None:
        """Keep a finished frame: pictures first, then its record, which makes it count."""
        with writing(self.path):
            for name, data in frame.files.items():
                self.write(name, data)
            row = self._row(frame.record.truth.frame)
            self.write(str(row.relative_to(self.path)), msgspec.json.encode(frame.record))

    def write(self, name: str, data: bytes) -> None:
        """Write a file whole or not at all; not synchronised to the disk, as `files.drafted` is."""
        with self.writing(name) as draft:
            draft.write_bytes(data)

    @contextmanager
    def writing(self, name: str) -> Iterator[Path]:
        """Give a file to write to, which takes the name at the end; left with an error, nothing does."""
        target = self.path / name
        target.parent.mkdir(parents=True, exist_ok=True)
        draft = self.partial / f"draft-{os.getpid()}-{name.replace('/', '-')}"
        yield draft
        draft.replace(target)

    def sha256(self, name: str) -> str:
        """SHA-256 of a file."""
        return files.sha256(self.path / name)

    def _drop_left(self) -> None:
        """Drop what the process that finished the dataset had no time to."""
        if self.partial.exists():
            with self.lock():
                self.close()

    def close(self) -> None:
        """Drop the working folder: the dataset is finished."""
        shutil.rmtree(self.partial)


def finish(
    place: Folder | Store, core: dict[str, Any], splits: Sequence[str], preview: bytes, scenario: Scenario,
    rendered_by: Fingerprint, *, written: Sequence[str] = (),
) -> None:  # fmt: skip
    """Write what a dataset of files has besides frames and tables; ``splits`` have frames. The manifest comes last.

    It also lists other files that are ``written``, by name.
    """
    folder = place.path if isinstance(place, Folder) else place.folder
    if folder is not None:
        for split in SPLITS:  # a split may be empty; a trainer still looks for its folder
            (folder / "images" / split).mkdir(parents=True, exist_ok=True)
    others = tables.others(splits, scenario) | {"preview.jpg": preview}
    for name, data in others.items():
        place.write(name, data)
    digests = {name: place.sha256(name) for name in {*tables.names(splits), *others, *written}}
    place.write(MANIFEST, manifest.compose(core, rendered_by, digests))


@contextmanager
def locked(partial: Path, path: Path) -> Iterator[None]:
    """Hold what is being made in ``partial`` and will lie at ``path`` against a second writer."""
    with writing(path), ExitStack() as stack:
        try:
            stack.enter_context(files.locked(partial / "lock"))
        except BlockingIOError:
            raise DatasetError(f"{path} is being written by another simgrab") from None
        yield


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn an error of the file system into one line that names the folder."""
    try:
        yield
    except OSError as problem:
        if problem.errno in (errno.ENOSPC, errno.EDQUOT):
            raise DatasetError(f"no space left for {path}; free some and continue with --resume") from None
        raise DatasetError(f"cannot write to {path}: {problem.strerror or problem}") from None


def refuse_other(
    place: object, known: dict[str, Any], identity: dict[str, Any], *, unfinished: bool, resume: bool
) -> None:
    """Refuse a place that holds a dataset, of the identity ``known``, unless it is to be resumed and is the same."""
    if not resume:
        state = "an unfinished" if unfinished else "a finished"
        advice = "continue with --resume, or choose" if unfinished else "choose"
        raise DatasetError(f"{place} holds {state} dataset; {advice} another --out")
    if differ(known, identity):
        raise DatasetError(
            f"{place} holds another dataset (its {differences(known, identity)} differs); "
            "--resume needs the same scenario and packages, or choose another --out"
        )


def differ(known: dict[str, Any], wanted: dict[str, Any]) -> bool:
    """Whether what is known to lie there is not of the identity that is wanted; what else is known does not count."""
    return any(known.get(key) != wanted.get(key) for key in {*wanted, "extensions"})


def differences(known: dict[str, Any], wanted: dict[str, Any], prefix: str = "") -> str:
    """Dotted keys in which two identities differ, the first few."""
    found: list[str] = []
    for key in wanted | (known if prefix else {"extensions": None}):
        a, b = known.get(key), wanted.get(key)
        if isinstance(a, dict) and isinstance(b, dict):
            inner = differences(a, b, f"{prefix}{key}.")
            found += [inner] if inner else []
        elif a != b and key != "digest":
            found.append(f"{prefix}{key}")
    return ", ".join(found[:3]) + (" …" if len(found) > 3 else "")
