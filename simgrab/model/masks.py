"""Masks of a dataset's frames, from its COCO files: run lengths as text, refused unless they fill the whole picture."""

from __future__ import annotations

import codecs
import re
from pathlib import Path
from typing import Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray
from pycocotools import mask as coco_mask

from simgrab.errors import DatasetError, one_line
from simgrab.io.parse import read_bytes
from simgrab.model.truth import Row

MOST_COCO_BYTES = 4 * 2**30
_RUNS = re.compile("(?:[P-o]{0,5}[0-O])+")  # 5 bits a character, and whether another one follows


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
        """Decode, shape (height, width); raises `DatasetError` if it is not a mask of the row's picture."""
        try:
            if self.size != (row.height_px, row.width_px):
                raise ValueError(f"it is of {self.size[1]} x {self.size[0]} px")
            return _decoded(self.counts, *self.size)
        except ValueError as problem:
            raise DatasetError(
                f"{where}: the mask of frame {row.frame} does not have {row.width_px} x {row.height_px} px: {problem}"
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
    """The masks in a dataset's COCO files. Each file is read at the first request for a mask of its split.

    Parameters
    ----------
    path : Path
        Folder of the dataset.
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
    """Decode compressed run lengths that the COCO API wrote; raises ValueError if they do not fill the picture.

    The API itself reads beyond a text with an incomplete last run, and leaves pixels after the last run undefined.
    """
    if not _RUNS.fullmatch(counts):
        raise ValueError("its run lengths cannot be decoded")
    mask = np.asarray(coco_mask.decode({"size": [height, width], "counts": counts.encode()}))
    if coco_mask.encode(np.asfortranarray(mask))["counts"] != counts.encode():
        raise ValueError("its run lengths do not fill the picture")
    return mask.astype(bool)
