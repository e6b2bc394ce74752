"""Rendered datasets, read as files."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from simgrab import labels
from simgrab.errors import DatasetError
from simgrab.records import Truth


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
class Dataset:
    """A rendered dataset.

    Attributes
    ----------
    path : Path
    rows : tuple of Truth
        By frame.
    data : Data
        What names it.
    least_visible_fraction : float
        From which on the dataset's detection labels hold a box.
    """

    path: Path
    rows: tuple[Truth, ...]
    data: Data
    least_visible_fraction: float

    def weather(self, row: Truth) -> str:
        """Name a row's weather: what a varied scene calls it, or else the scene."""
        varied = json.loads(row.varied) if row.varied else {}
        return next((str(value) for key, value in varied.items() if "weather" in key.split("+")), self.data.scenario)

    def image(self, row: Truth) -> Path:
        """Path of a row's picture."""
        return self.path / row.file

    def is_labelled(self, row: Truth) -> bool:
        """Whether detection labels hold a box for the row."""
        return labels.is_labelled(row, self.least_visible_fraction)


def is_dataset(path: Path) -> bool:
    """Whether a folder is a dataset, be it unfinished, and not just a folder of pictures."""
    return (path / "labels.parquet").is_file() or (path / ".partial").is_dir()


def read(path: str | Path) -> Dataset:
    """Read a dataset's labels and manifest.

    Raises
    ------
    DatasetError
        If it is none, is unfinished or empty, or lacks a picture.
    """
    path = Path(path)
    file = path / "labels.parquet"
    if not file.is_file():
        state = "unfinished; go on with simgrab render --resume" if (path / ".partial").exists() else "not a dataset"
        raise DatasetError(f"{path} is {state}: it has no labels.parquet")
    try:
        content = file.read_bytes()
        # `read_table` reads in threads, of which one that lets go of `content` while Python ends aborts the process.
        table = pq.ParquetFile(pa.BufferReader(content)).read(use_threads=False)
        rows = tuple(msgspec.convert(row, Truth) for row in table.to_pylist())
        manifest = json.loads((path / "manifest.json").read_text(encoding="utf-8"))
        scenario = manifest["scenario"]
        data = Data(
            scenario=scenario["name"], scenario_digest=manifest["digest"],
            labels_sha256=hashlib.sha256(content).hexdigest(), seed=manifest["seed"], frames=len(rows),
        )  # fmt: skip
        least = float(scenario["labels"]["least_visible_fraction"])
    except (OSError, ValueError, KeyError, TypeError, msgspec.ValidationError) as problem:
        raise DatasetError(f"{path}: not a simgrab dataset ({type(problem).__name__}: {problem})") from None
    if not rows:
        raise DatasetError(f"{path}: no frames in labels.parquet")
    for row in rows:
        if not (path / row.file).is_file():
            raise DatasetError(f"{path}: frame {row.frame} has labels and no picture; {row.file} is missing")
    return Dataset(path, rows, data, least)


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


def part(dataset: Dataset, split: str) -> Dataset:
    """Keep a dataset's frames of one split."""
    return replace(dataset, rows=tuple(row for row in dataset.rows if row.split == split))


def digest(datasets: Sequence[Dataset]) -> str:
    """One digest of several datasets' labels, and through them of their pictures."""
    return hashlib.sha256("".join(dataset.data.labels_sha256 for dataset in datasets).encode()).hexdigest()


def picture(file: Path, row: Truth, mode: int = cv2.IMREAD_COLOR_RGB) -> NDArray[np.uint8]:
    """Decode the picture of a row, once its SHA-256 is found to be the labels'.

    Parameters
    ----------
    file : Path
    row : Truth
    mode : int
        OpenCV's ``IMREAD_…``.

    Returns
    -------
    ndarray of uint8, shape (height, width, 3), or (height, width) where ``mode`` is grey

    Raises
    ------
    DatasetError
        If it is damaged, or not the labels' picture.
    """
    try:
        data = file.read_bytes()
    except OSError as problem:
        raise DatasetError(f"{file} cannot be read: {problem.strerror or problem}") from None
    if hashlib.sha256(data).hexdigest() != row.image_sha256:
        raise DatasetError(f"{file} is not the picture that its labels are of: it was changed or damaged")
    found = cv2.imdecode(np.frombuffer(data, np.uint8), mode)
    if found is None:
        raise DatasetError(f"{file} is not a picture")
    return np.asarray(found, np.uint8)
