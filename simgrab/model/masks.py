"""Masks of a dataset's frames, from its COCO files: run lengths as text, which hold a whole picture or are refused."""

from __future__ import annotations

import codecs
from pathlib import Path
from typing import Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from simgrab.errors import DatasetError, one_line
from simgrab.io.parse import read_bytes
from simgrab.model.truth import Row

MOST_COCO_BYTES = 4 * 2**30
_MOST_CHARACTERS = 7  # of a run length, of 5 bits each


class Coded(msgspec.Struct, frozen=True):
    """A mask's compressed run lengths, as the COCO API has them.

    Attributes
    ----------
    size : tuple of 2 int
        Height and width, px.
    counts : str
    """

    size: tuple[int, int]
    counts: str

    def decoded(self, row: Row, where: object) -> NDArray[np.bool_]:
        """Decode, shape (height, width); raises `DatasetError` where it is not a mask of the row's picture."""
        try:
            if self.size != (row.height_px, row.width_px):
                raise ValueError(f"it is of {self.size[1]} x {self.size[0]} px")
            return _decoded(self.counts, *self.size)
        except ValueError as problem:
            raise DatasetError(
                f"{where}: the mask of frame {row.frame} is not one of {row.width_px} x {row.height_px} px: {problem}"
            ) from None


class MaskFiles(Protocol):
    """Masks in a dataset's COCO files."""

    def coded(self, row: Row) -> Coded | None:
        """Look up the mask of a row; None where there is none. Raises `DatasetError` where a file cannot be read."""

    def file(self, split: str) -> Path:
        """Path of a split's COCO file."""


class _Annotation(msgspec.Struct, frozen=True):
    image_id: int
    segmentation: Coded


class _Coco(msgspec.Struct, frozen=True):
    annotations: list[_Annotation]


class Masks:
    """The masks in a dataset's COCO files, each of which is read when a mask of its split is first asked for.

    Parameters
    ----------
    path : Path
        Of the dataset.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._coded: dict[str, dict[int, Coded]] = {}

    def coded(self, row: Row) -> Coded | None:
        """Look up the mask of a row; None where the labels hold none.

        Raises
        ------
        DatasetError
            If the file cannot be read.
        """
        if row.split not in self._coded:
            self._coded[row.split] = self._read(row.split)
        return self._coded[row.split].get(row.frame)

    def file(self, split: str) -> Path:
        """Path of a split's COCO file."""
        return self._path / "annotations" / f"instances_{split}.json"

    def _read(self, split: str) -> dict[int, Coded]:
        file = self.file(split)

        def refusal(why: object) -> DatasetError:
            return DatasetError(f"{file}: not readable COCO labels ({why})")

        data = read_bytes(file, refusal, most_bytes=MOST_COCO_BYTES).removeprefix(codecs.BOM_UTF8)
        try:
            known = msgspec.json.decode(data, type=_Coco)
        except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as problem:
            raise refusal(one_line(problem)) from None
        return {annotation.image_id: annotation.segmentation for annotation in known.annotations}


def _decoded(counts: str, height: int, width: int) -> NDArray[np.bool_]:
    """Decode the text of a mask's run lengths, as the COCO API writes it.

    Runs go down the columns, those outside of the mask and those inside by turns. Each has 5 bits a character, the
    lowest first, and the last one's highest bit is the sign. From the fourth run on, what is written is the difference
    to the run two before it.
    https://github.com/cocodataset/cocoapi/blob/master/common/maskApi.c, ``rleToString``.
    """
    if len(counts) > height * width + 1:  # each run has a pixel, but for the first
        raise ValueError("it has more run lengths than pixels")
    codes = np.frombuffer(counts.encode(), np.uint8).astype(np.int64) - ord("0")
    ends = np.flatnonzero(codes & 0x20 == 0) + 1
    starts = np.concatenate([[0], ends[:-1]])
    sizes = np.diff(ends, prepend=0)
    whole = sizes.sum() == len(codes) > 0 and sizes.max() <= _MOST_CHARACTERS
    if not whole or codes.min() < 0 or codes.max() > 0x3F:
        raise ValueError("its run lengths cannot be decoded")
    shifts = 5 * (np.arange(len(codes)) - np.repeat(starts, sizes))
    runs = np.add.reduceat((codes & 0x1F) << shifts, starts)
    runs -= (codes[ends - 1] >> 4 & 1) << 5 * sizes
    runs[1::2] = np.cumsum(runs[1::2])
    runs[2::2] = np.cumsum(runs[2::2])
    if runs.min() < 0 or runs.max() > height * width or runs.sum() != height * width:
        raise ValueError(f"its run lengths sum to {runs.sum()} px")
    inside = np.arange(len(runs)) % 2 == 1
    return np.repeat(inside, runs).reshape(width, height).T
