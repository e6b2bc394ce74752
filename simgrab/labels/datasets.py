"""Rendered datasets, read as files."""

from __future__ import annotations

import hashlib
import operator
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, overload

import msgspec
import numpy as np
from numpy.typing import NDArray

from simgrab import calibration
from simgrab.calibration import Calibration
from simgrab.errors import DatasetError, first_line
from simgrab.labels import arrays as labels
from simgrab.labels.arrays import Labelled
from simgrab.labels.masks import Masks
from simgrab.labels.truth import SPLITS, Row
from simgrab.records import frame_files
from simgrab.utilities.parse import parse_json, read_json

if TYPE_CHECKING:
    from simgrab.scenario import Scenario


class _Labels(msgspec.Struct, frozen=True):
    least_visible_fraction: Annotated[float, msgspec.Meta(ge=0, le=1)]


class _Scenario(msgspec.Struct, frozen=True):
    name: str
    labels: _Labels


class Manifest(msgspec.Struct, frozen=True):
    """What of a manifest is read without the scenario as a whole."""

    scenario: _Scenario
    digest: str
    seed: int


@dataclass(frozen=True)
class Data:
    """What names a dataset.

    Attributes
    ----------
    scenario : str
        Its name.
    scenario_digest, labels_sha256 : str
        Of the scenario, from the manifest; of ``labels.parquet``.
    seed, frames : int
    """

    scenario: str
    scenario_digest: str
    labels_sha256: str
    seed: int
    frames: int


@dataclass(frozen=True)
class LabelledFrame(Labelled):
    """One frame of a dataset: what is known of it, and its picture and mask, decoded each time they are asked for.

    Pixels are continuous: (0, 0) is the outer corner of the top-left pixel. Poses are in metres, in the jib frame.

    Attributes
    ----------
    truth : Row
        Its row of labels.
    file : Path
        Of the picture.
    labelled : bool
        Whether detection labels hold a box and a mask.
    """

    truth: Row
    file: Path
    labelled: bool
    _masks: Masks = field(repr=False, compare=False)

    @property
    def rgb(self) -> NDArray[np.uint8]:
        """The same as `picture`, by the name that a `simgrab.world.frames.Frame` has for it."""
        return self.picture

    @property
    def picture(self) -> NDArray[np.uint8]:
        """RGB, shape (height, width, 3); raises `DatasetError` where the file is not the labels' picture."""
        return frame_files.picture(self.file, self.truth)

    @property
    def mask(self) -> NDArray[np.bool_] | None:
        """Pixels of the visible grab, shape (height, width); None unless ``labelled``."""
        return self._masks.of(self.truth)


@dataclass(frozen=True)
class Dataset(Sequence[LabelledFrame]):
    """A rendered dataset, as a sequence of its frames; a slice of it, or a split, is a dataset again.

    Attributes
    ----------
    path : Path
    rows : tuple of Row
        By frame.
    data : Data
        What names it.
    least_visible_fraction : float
        From which on the dataset's detection labels hold a box.
    masks : Masks
    """

    path: Path
    rows: tuple[Row, ...]
    data: Data
    least_visible_fraction: float
    masks: Masks = field(repr=False, compare=False)

    def __len__(self) -> int:
        return len(self.rows)

    @overload
    def __getitem__(self, index: int) -> LabelledFrame: ...

    @overload
    def __getitem__(self, index: slice) -> Dataset: ...

    def __getitem__(self, index: int | slice) -> LabelledFrame | Dataset:
        if isinstance(index, slice):
            return replace(self, rows=self.rows[index])
        try:
            row = self.rows[operator.index(index)]
        except IndexError:
            raise IndexError(f"{self.path}: index {index} is out of range of {len(self)} frames") from None
        return LabelledFrame(row, self.image(row), self.is_labelled(row), self.masks)

    def frame(self, number: int) -> LabelledFrame:
        """Give the frame of this number, which `simgrab.labels.truth.Row.frame` holds.

        Raises
        ------
        KeyError
            If it is not among them.
        """
        try:
            return self[self._index[number]]
        except KeyError:
            raise KeyError(f"{self.path}: no frame {number} among these {len(self)}") from None

    @cached_property
    def _index(self) -> dict[int, int]:
        return {row.frame: index for index, row in enumerate(self.rows)}

    @property
    def splits(self) -> dict[str, int]:
        """Number of frames in each split that has any."""
        count = Counter(row.split for row in self.rows)
        return {split: count[split] for split in SPLITS if count[split]}

    def split(self, name: str) -> Dataset:
        """Keep the frames of one split, maybe none.

        Raises
        ------
        KeyError
            If no split is called so.
        """
        if name not in SPLITS:
            raise KeyError(f"no split {name!r}; one of: {', '.join(SPLITS)}")
        return replace(self, rows=tuple(row for row in self.rows if row.split == name))

    @property
    def calibration(self) -> Calibration:
        """What an instrument may know of the camera, from ``camera.toml``."""
        return calibration.load(self.path / "camera.toml")

    @property
    def scenario(self) -> Scenario:
        """The scenario that it was rendered from, with every default filled in."""
        from simgrab import scenes

        return scenes.load(self.path / "manifest.json")

    def weather(self, row: Row) -> str:
        """Name a row's weather: what a varied scene calls it, or else the scene."""
        where = f"{self.path}: labels.parquet, frame {row.frame}: varied is not JSON"
        varied = parse_json(row.varied, DatasetError, where) if row.varied else {}
        items = varied.items() if isinstance(varied, dict) else ()
        return next((str(value) for key, value in items if "weather" in key.split("+")), self.data.scenario)

    def image(self, row: Row) -> Path:
        """Path of a row's picture."""
        return self.path / row.file

    def is_labelled(self, row: Row) -> bool:
        """Whether detection labels hold a box for the row."""
        return labels.is_labelled(row, self.least_visible_fraction)


def read(path: str | Path) -> Dataset:
    """Open a finished dataset; `simgrab.open` is this function.

    Labels are read at once, and that each picture is there is checked. Pictures and masks are read frame by frame.

    Parameters
    ----------
    path : str or Path
        Folder that `simgrab.render` finished.

    Returns
    -------
    Dataset

    Examples
    --------
    >>> import simgrab
    >>> data = simgrab.open("runs/quay-day")
    >>> len(data), sum(data.splits.values()) == len(data)
    (6, True)
    >>> frame = data[-1]
    >>> frame.picture.dtype, frame.picture.shape[:2] == frame.mask.shape
    (dtype('uint8'), True)
    >>> rows, columns = frame.mask.nonzero()
    >>> frame.box.tolist() == [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
    True
    >>> sum(frame.truth.alpha_deg > 10 for frame in data.split("train"))
    0
    >>> data.scenario.camera.beta_deg
    3.0

    Raises
    ------
    DatasetError
        If it is none, is unfinished or empty, or lacks a picture.
    """
    path = Path(path)
    rows, _, labels_sha256 = frame_files.read_rows(path, Row)
    manifest = read_json(path / "manifest.json", DatasetError)
    try:
        known = msgspec.convert(manifest, Manifest)
        data = Data(
            scenario=known.scenario.name, scenario_digest=known.digest,
            labels_sha256=labels_sha256, seed=known.seed, frames=len(rows),
        )  # fmt: skip
    except (ValueError, LookupError, TypeError) as problem:
        raise DatasetError(f"{path}: not a simgrab dataset ({type(problem).__name__}: {first_line(problem)})") from None
    frame_files.check_files(path, rows)
    return Dataset(path, rows, data, known.scenario.labels.least_visible_fraction, Masks(path))


def read_all(paths: Sequence[str | Path], *splits: str) -> tuple[Dataset, ...]:
    """Read datasets that together must have frames in each of the splits.

    Raises
    ------
    DatasetError
    """
    if not paths:
        raise DatasetError("no dataset given")
    datasets = tuple(read(path) for path in paths)
    for split in splits:
        if not any(row.split == split for dataset in datasets for row in dataset.rows):
            given = ", ".join(str(dataset.path) for dataset in datasets)
            raise DatasetError(f"{given}: no frames in the split {split!r}; render more frames")
    return datasets


def digest(datasets: Sequence[Dataset]) -> str:
    """One digest of several datasets' labels, and through them of their pictures."""
    return hashlib.sha256("".join(dataset.data.labels_sha256 for dataset in datasets).encode()).hexdigest()
