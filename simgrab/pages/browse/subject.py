"""What a page shows: rows of a table, each of which is a frame, with its picture and what is drawn on it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import pyarrow as pa

from simgrab.dataset.datasets import Dataset, FolderRows
from simgrab.errors import DatasetError
from simgrab.model.masks import Coded
from simgrab.model.records import frame_files
from simgrab.model.truth import Row
from simgrab.pages.browse import columns
from simgrab.pages.browse.columns import Column
from simgrab.pages.outlines import marks


@dataclass(frozen=True)
class Order:
    """Order in which rows are shown first: by a column, those without a value last."""

    column: str
    descending: bool = False


@dataclass(frozen=True, eq=False)
class Subject:
    """A folder that is browsed."""

    name: str  # its path, as the user gave it
    kind: str  # `dataset` or `run`
    notes: tuple[str, ...]  # what the user is to know: that it is unfinished, what is missing
    table: pa.Table  # a row for each frame
    order: Order
    shown: tuple[str, ...]  # columns whose histograms are shown first, as far as there are such
    # labels of each row, which may hold values that no labels have; null where nothing is known of it; None where
    # nothing is known of any
    labels: FolderRows | None = None
    dataset: Dataset | None = None  # what a selection is exported from; None where nothing can be
    # reads a row's picture, by the row's number; None where pictures are those of the labels
    pictures: Callable[[int], bytes] | None = None
    size_px: tuple[int, int] | None = None  # width and height of pictures whose row has no labels

    def __len__(self) -> int:
        return self.table.num_rows

    @cached_property
    def columns(self) -> tuple[Column, ...]:
        """Columns of the table."""
        return columns.of(self.table)

    def values(self, row: int) -> dict[str, Any]:
        """Everything that the table holds of a row, by column."""
        plain: dict[str, Any] = self.table.slice(row, 1).to_pylist()[0]
        return plain

    def row(self, row: int) -> Row | None:
        """Give a row's labels; None where there are none, or values that no labels have."""
        try:
            return None if self.labels is None else next(self.labels.at(range(row, row + 1)))[0]
        except DatasetError:
            return None

    def mask(self, row: int) -> Coded | None:
        """Look up a row's mask; None where there is none. Raises `DatasetError` where its file cannot be read."""
        known = self.row(row)
        return None if self.labels is None or known is None else self.labels.files.mask(known)

    def content(self, row: int) -> bytes:
        """Read a row's picture: a JPEG or PNG file, or another that OpenCV reads.

        Raises `SimgrabError` if it cannot be read, or does not have the digest that its labels state.
        """
        if self.pictures is not None:
            return self.pictures(row)
        known = self.row(row)
        if self.labels is None or known is None:
            raise DatasetError(f"{self.name}: row {row} of the labels holds values that no labels have")
        frame_files.check_files(self.labels.files.folder, (known,))
        return self.labels.files.content(known)


_MEASURED = {"box": ("box_x0_px", "box_y0_px", "box_x1_px", "box_y1_px"), "centre": ("u_px", "v_px")}


def overlay(subject: Subject, row: int, outline: Sequence[Sequence[float]] | None) -> dict[str, Any]:
    """Give what is drawn on a row's picture, in its px, as plain data; the mask by its outline."""
    known = subject.row(row)
    width, height = (known.width_px, known.height_px) if known else subject.size_px or (16, 9)
    drawn: dict[str, Any] = {"row": row, "frame": subject.table["frame"][row].as_py(), "width": width, "height": height}
    if known is not None:
        drawn["truth"] = marks(known, outline)
    if subject.kind == "run":
        plain = subject.values(row)
        measured = {key: [plain[name] for name in names] for key, names in _MEASURED.items()}
        drawn["measured"] = {key: None if None in values else values for key, values in measured.items()}
    return drawn
