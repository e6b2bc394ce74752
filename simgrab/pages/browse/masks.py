"""Masks of a large dataset: only where each stands in the COCO files is kept in memory.

The files are those that simgrab writes: each annotation names its image before its mask, and braces stand in no text.
What is written otherwise is not found; a mask that does not fit its picture is not used.
"""

from __future__ import annotations

import json
import re
import threading
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from simgrab.errors import DatasetError
from simgrab.io.parse import opened
from simgrab.model.masks import MOST_COCO_BYTES, Coded, Masks
from simgrab.model.truth import Row

_CHUNK_BYTES = 2**20
_MOST_BYTES = 2**22  # of one annotation
_IMAGE = re.compile(rb'"image_id": ?(\d{1,15}),')
_LONGEST = 40  # bytes of such a name, which may stand in two chunks
_MASK = re.compile(rb'"segmentation": ?(\{[^{}]*\})')


@dataclass(frozen=True, eq=False)
class _Index:
    """Where annotations begin.

    Attributes
    ----------
    path : Path
    frames : ndarray of int64, shape (n,), increasing
    spans : ndarray of int64, shape (n, 2)
        First byte, and the first of the next one.
    """

    path: Path
    frames: NDArray[np.int64]
    spans: NDArray[np.int64]

    def coded(self, frame: int) -> Coded | None:
        at = int(np.searchsorted(self.frames, frame))
        if at == len(self.frames) or self.frames[at] != frame:
            return None
        start, end = self.spans[at].tolist()
        with opened(self.path, DatasetError, most_bytes=MOST_COCO_BYTES) as file:
            file.seek(start)
            data = file.read(min(end - start, _MOST_BYTES))
        found = _MASK.search(data)
        try:
            return None if found is None else msgspec.convert(json.loads(found[1]), Coded)
        except ValueError:
            return None


class IndexedMasks:
    """The masks of a dataset in a folder. Each file is searched when a mask of its split is first asked for.

    Parameters
    ----------
    path : Path
        Of the dataset.
    """

    def __init__(self, path: Path) -> None:
        self._files, self._indices, self._lock = Masks(path), dict[str, _Index](), threading.Lock()

    def file(self, split: str) -> Path:
        """Path of a split's COCO file."""
        return self._files.file(split)

    def coded(self, row: Row) -> Coded | None:
        """Look up the mask of a row; None where none is found.

        Raises
        ------
        DatasetError
            If the file cannot be read.
        """
        with self._lock:
            if row.split not in self._indices:
                self._indices[row.split] = _indexed(self.file(row.split))
        return self._indices[row.split].coded(row.frame)


def _indexed(path: Path) -> _Index:
    frames, starts = list[int](), list[int]()
    with opened(path, DatasetError, most_bytes=MOST_COCO_BYTES) as file:
        left, begin = b"", 0
        while chunk := file.read(_CHUNK_BYTES):
            data = left + chunk
            taken = 0
            for found in _IMAGE.finditer(data):
                frames.append(int(found[1]))
                starts.append(begin + found.start())
                taken = found.end()
            keep = max(taken, len(data) - _LONGEST)
            begin, left = begin + keep, data[keep:]
        ends = [*starts[1:], begin + len(left)]
    spans = np.array([starts, ends], np.int64).T
    order = np.argsort(np.array(frames, np.int64), kind="stable")
    return _Index(path, np.array(frames, np.int64)[order], spans[order])
