"""Journal of a result made unit by unit: its identity, its owner, its finished units, and how it is resumed.

A dataset's units are frames, a video's are clips, a sharded dataset's are shards, and a study's are parts. The claim,
which states the result's identity, is written first; the file that marks the result as complete is written last.
Between the two, a unit is finished once its record exists. Every file appears complete or not at all.
"""

from __future__ import annotations

import contextlib
import json
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from simgrab.io.destination import LOCK, check_folder, locked_folder
from simgrab.io.parse import parse_json
from simgrab.io.stores import Store

MOST_BYTES = 2**30
"""Of an identity or a manifest, which lists the files of a result."""
PARTIAL = ".partial"
"""Working folder of a result in a folder; it exists while the result is unfinished."""
IDENTITY, ROWS = "identity.json", "rows"


@dataclass(frozen=True)
class Journal:
    """The units of one result.

    Parameters
    ----------
    store : Store
        Its drafts, if any, are made in the working folder.
    partial : str
        Name of the working folder. Empty if any number of processes on any machines may write: then there is no lock
        and there are no records, and ``claim`` alone marks the result as unfinished.
    claim : str
        Name of the file that holds the identity until the result is finished.
    whole : str
        Name of the file that comes last, and holds the identity from then on.
    kind, option : str
        Name of the result in messages, and the option that chooses another place.
    name : str
        Name of the place in messages; by default the store's.
    """

    store: Store
    partial: str = PARTIAL
    claim: str = f"{PARTIAL}/{IDENTITY}"
    whole: str = "manifest.json"
    kind: str = "dataset"
    option: str = "--out"
    name: str = ""

    @classmethod
    def of(cls, path: Path) -> Journal:
        """Keep the journal of a dataset in a folder."""
        return cls(Store(str(path), drafts=PARTIAL))

    @property
    def folder(self) -> Path:
        """Folder of the result, if it is stored in a folder."""
        folder = self.store.folder
        assert folder is not None
        return folder

    @property
    def begun(self) -> bool:
        """Whether a result of this kind exists, finished or not, with any identity."""
        return self.known(self.claim) is not None or self.known(self.whole) is not None

    def check(self, identity: dict[str, Any], *, resume: bool) -> bool:
        """Refuse a place that cannot be used or contains anything else; return whether anything remains to be made.

        With ``resume``, go on with an unfinished result of the same ``identity``, the data that define the result, and
        leave a finished one as it is. Leftovers of a finished result whose end was interrupted are removed.
        """
        if self.store.folder is not None:
            check_folder(self.folder, self.store.refuse, self.option)
        claimed, whole = self.known(self.claim), self.known(self.whole)
        known = whole if claimed is None else claimed
        if known is None:
            self._refuse_foreign()
            return True
        if not resume:
            unfinished = whole is None or claimed is not None
            state, advice = ("an unfinished", "continue with --resume, or ") if unfinished else ("a finished", "")
            raise self._refusal(f"holds {state} {self.kind}; {advice}choose another {self.option}")
        self.refuse_other(known, identity)
        if whole is not None and (claimed is not None or self.partial in self.store.names()):
            with self._locked():
                self.close()
        return whole is None

    def refuse_other(self, known: dict[str, Any], identity: dict[str, Any]) -> None:
        """Refuse to resume a result whose ``known`` identity is another."""
        identity = json.loads(_json(identity))  # as it is read back: lists in place of tuples
        if any(known.get(key) != identity.get(key) for key in {*identity, "extensions"}):
            found, cure = differences(known, identity), f"or choose another {self.option}"
            if self.kind == "dataset" and found == "scenario.frames, frames":
                cure = (
                    "as a dataset cannot grow or shrink: for more frames, render with another --seed into another "
                    f"{self.option}, and train on both"
                )
            raise self._refusal(f"holds another {self.kind} (its {found} differs); --resume needs the same, {cure}")

    def _refusal(self, what: str) -> Exception:
        return self.store.refuse(f"{self.name or self.store.place} {what}")

    def _refuse_foreign(self) -> None:
        ours = {IDENTITY, LOCK, ROWS}
        inside = self.store.names(self.partial) if self.partial else set()
        foreign = {name for name in inside - ours if not name.startswith("draft-")}
        if foreign or self.store.names() - {self.partial}:
            raise self._refusal(f"contains something other than a simgrab {self.kind}; choose another {self.option}")

    def known(self, name: str) -> dict[str, Any] | None:
        """Identity that a file of the result states; None if there is no such file."""
        if not self.store.exists(name):
            return None
        what = f"{self.store.place}/{name}: it is not valid JSON"
        found = parse_json(self.store.read(name, most_bytes=MOST_BYTES), self.store.refuse, what)
        if not (isinstance(found, dict) and "simgrab" in found):
            return None
        if isinstance(found.get("shards"), dict):  # as a manifest states what is `shard_frames` in the identity
            found["shard_frames"] = found["shards"].get("frames")
        return found

    @contextlib.contextmanager
    def opened(self, identity: dict[str, Any]) -> Iterator[None]:
        """Claim the place, and hold it against a second writer."""
        with self._locked():
            self.store.write(self.claim, _json(identity))
            yield

    @contextlib.contextmanager
    def _locked(self) -> Iterator[None]:
        if not self.partial:
            yield
            return
        partial = self.folder / self.partial
        with self.store.guarded():
            (partial / ROWS).mkdir(parents=True, exist_ok=True)
            with locked_folder(partial, self.store.refuse, name=self.name or self.store.place):
                yield

    def finish(self, identity: dict[str, Any]) -> None:
        """Write the last file, and remove the files of an unfinished result."""
        self.store.write(self.whole, _json(identity))
        self.close()

    def close(self) -> None:
        """Remove the files that only an unfinished result has."""
        if self.partial:
            with self.store.guarded():
                shutil.rmtree(self.folder / self.partial)
        else:
            with contextlib.suppress(Exception):  # all is there, even where this fails
                self.store.remove(self.claim)

    def add(self, unit: str, record: bytes) -> None:
        """Keep the record of a unit whose other files exist. This marks the unit as finished."""
        self.store.write(self.record(unit), record)

    def record(self, unit: str) -> str:
        """Name of the file of a unit's record."""
        return f"{self.partial}/{ROWS}/{unit}"

    def has(self, unit: str) -> bool:
        """Whether a unit is finished."""
        return (self.folder / self.record(unit)).exists()

    def units(self) -> set[str]:
        """Names of the units that are finished."""
        return self.store.names(f"{self.partial}/{ROWS}")


def _json(identity: dict[str, Any]) -> bytes:
    return json.dumps(identity, indent=1, ensure_ascii=False).encode()


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
