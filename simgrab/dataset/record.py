"""The stored form of a frame: its row of labels, its mask, and its files."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec

from simgrab.errors import DatasetError, first_line
from simgrab.io.journal import Journal
from simgrab.model.masks import Coded
from simgrab.model.truth import Row
from simgrab.runtime.versions import Fingerprint

MOST_RECORD_BYTES = 2**24


class FrameRecord(msgspec.Struct, frozen=True):
    """Labels, and the mask of the visible grab in the whole picture, of a stored frame."""

    truth: Row
    mask: Coded
    rendered_by: Fingerprint


def unit(frame: int) -> str:
    """Name a frame in the journal of a dataset."""
    return f"{frame:08d}.json"


def known(journal: Journal, frame: int) -> FrameRecord:
    """Read the record of a finished frame."""
    name = journal.record(unit(frame))
    try:
        return msgspec.json.decode(journal.store.read(name, most_bytes=MOST_RECORD_BYTES), type=FrameRecord)
    except (msgspec.DecodeError, ValueError, RecursionError) as problem:
        why = f"{type(problem).__name__}: {first_line(problem)}"
        raise DatasetError(
            f"{journal.store.place}/{name} is damaged ({why}); delete this file; --resume then renders the frame again"
        ) from None


@dataclass(frozen=True, eq=False)
class StoredFrame:
    """A stored frame: its record, and its files by name."""

    record: FrameRecord
    files: dict[str, bytes]

    def keep(self, journal: Journal) -> None:
        """Store the frame: its pictures, then its record, which marks it as finished."""
        for name, data in self.files.items():
            journal.store.write(name, data)
        journal.add(unit(self.record.truth.frame), msgspec.json.encode(self.record))
