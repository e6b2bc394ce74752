"""Masks of a dataset's frames, from its COCO files: run lengths as text, refused unless they fill the whole picture."""

from __future__ import annotations

import codecs
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray
from pycocotools import mask as coco_mask

from simgrab.errors import DatasetError, one_line
from simgrab.io.parse import opened, read_bytes
from simgrab.model.truth import Row

MOST_COCO_BYTES = 4 * 2**30
_RUNS = re.compile("(?:[P-o]{0,5}[0-O])+")  # 5 bits a character, and whether another one follows


T = TypeVar("T", bound=msgspec.Struct)


class Coded(msgspec.Struct, frozen=True):
    """A mask's compressed run lengths, as the COCO API has them."""

    size: tuple[int, int]  # height and width, px
    counts: str

    def decoded(self, row: Row, where: object) -> NDArray[np.bool_]:
        """Decode, shape (height, width); raises `DatasetError` if it is not a mask of the row's picture."""
        with self._refusing(row, where):
            return _decoded(self.counts, *self.size)

    def checked(self, row: Row, where: object) -> Coded:
        """Return it as it is; raises `DatasetError` if it is of another size, or the COCO API would read beyond it."""
        with self._refusing(row, where):
            _check_runs(self.counts)
        return self

    @contextmanager
    def _refusing(self, row: Row, where: object) -> Iterator[None]:
        try:
            if self.size != (row.height_px, row.width_px):
                raise ValueError(f"it is of {self.size[1]} x {self.size[0]} px")
            yield
        except ValueError as problem:
            raise DatasetError(
                f"{where}: the mask of frame {row.frame} does not have {row.width_px} x {row.height_px} px: {problem}"
            ) from None


class _Annotation(msgspec.Struct, frozen=True):
    image_id: int
    segmentation: msgspec.Raw


class _Coco(msgspec.Struct, frozen=True):
    annotations: list[_Annotation]


_Spans = dict[int, tuple[int, int]]  # first byte of a frame's mask in its file, and the first after it


class Masks:
    """The masks in the COCO files of the dataset in a folder.

    Each file is read at the first request for a mask of its split; then only the place of each mask is kept.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._spans: dict[str, _Spans] = {}

    def coded(self, row: Row) -> Coded | None:
        """Look up the mask of a row; None where the labels hold none.

        Raises `DatasetError` if the file cannot be read.
        """
        file = self._path / coco_name(row.split)
        if row.split not in self._spans:
            self._spans[row.split] = _spans(file)
        if row.frame not in self._spans[row.split]:
            return None
        start, end = self._spans[row.split][row.frame]
        with opened(file, _refusal(file), most_bytes=MOST_COCO_BYTES) as handle:
            handle.seek(start)
            data = handle.read(end - start)
        return parsed(data, Coded, file)


def coco_name(split: str) -> str:
    """Path of a split's COCO file in the dataset."""
    return f"annotations/instances_{split}.json"


def _spans(file: Path) -> _Spans:
    data = read_bytes(file, _refusal(file), most_bytes=MOST_COCO_BYTES)
    found, at = _Spans(), 0
    for annotation in parsed(data.removeprefix(codecs.BOM_UTF8), _Coco, file).annotations:
        parsed(annotation.segmentation, Coded, file)
        start = data.index(annotation.segmentation, at)  # or of the same text before it
        at = start + len(memoryview(annotation.segmentation))
        found[annotation.image_id] = start, at
    return found


def parsed(data: bytes | msgspec.Raw, kind: type[T], file: Path) -> T:
    """Parse COCO labels, or a part of them, as a type; raises `DatasetError` if they cannot be read."""
    try:
        return msgspec.json.decode(data, type=kind)
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as problem:
        raise _refusal(file)(one_line(problem)) from None


def _refusal(file: Path) -> Callable[[object], DatasetError]:
    return lambda why: DatasetError(f"{file}: not readable COCO labels ({why})")


def _check_runs(counts: str) -> None:
    """Refuse a text with an incomplete last run, beyond which the COCO API reads."""
    if not _RUNS.fullmatch(counts):
        raise ValueError("its run lengths cannot be decoded")


def _decoded(counts: str, height: int, width: int) -> NDArray[np.bool_]:
    """Decode compressed run lengths that the COCO API wrote; raises ValueError if they do not fill the picture."""
    _check_runs(counts)  # the API leaves pixels after the last run undefined
    mask = np.asarray(coco_mask.decode({"size": [height, width], "counts": counts.encode()}))
    if coco_mask.encode(np.asfortranarray(mask))["counts"] != counts.encode():
        raise ValueError("its run lengths do not fill the picture")
    return mask.astype(bool)
