"""Pictures as the nets see them, decoded once into files that are mapped into memory."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simgrab.dataset.boxed import BoxedDataset
from simgrab.dataset.datasets import Dataset
from simgrab.errors import TrainingError
from simgrab.instrument.detect.patches import Patch, Picture
from simgrab.io.destination import writing
from simgrab.io.files import drafted_folder
from simgrab.io.parse import read_json
from simgrab.model import label_arrays as labels
from simgrab.model.geometry import Array
from simgrab.model.records.frame_files import picture
from simgrab.model.truth import Boxed, Row

Progress = Callable[[int, int], None]
Watch = Callable[[str], Progress]
Make = Callable[[int, Picture], tuple[Picture, Sequence[Patch]]]
_MOST_BYTES = 4 * 2**30  # of the list of patches
_WORKERS = 2  # decoding lets go of Python's lock


@dataclass(frozen=True, eq=False)
class TrainingFrame:
    """One frame to learn from: row, picture's file, whether detection labels hold a box for it, and its weather."""

    row: Row | Boxed
    file: Path
    labelled: bool
    weather: str = ""

    @property
    def box(self) -> Array | None:
        """Labelled box x0, y0, x1, y1, px; None where detection labels hold none."""
        return labels.box(self.row) if self.labelled else None

    def picture(self) -> Picture:
        """Decode the picture, RGB; raises `DatasetError`."""
        return picture(self.file, self.row)


def frames(datasets: Sequence[Dataset], split: str) -> tuple[TrainingFrame, ...]:
    """Frames of a split, without those in which too little of the grab shows for a box: neither a grab nor none."""
    return tuple(
        TrainingFrame(row, dataset.image(row), dataset.is_labelled(row), dataset.weather(row))
        for dataset in datasets
        for row in dataset.rows
        if row.split == split and not dataset.is_hidden(row)
    )


@dataclass(frozen=True, eq=False)
class BoxedFrame(TrainingFrame):
    """A frame of which boxes alone are known."""

    row: Boxed


def boxed(dataset: BoxedDataset) -> tuple[BoxedFrame, ...]:
    """Frames of a dataset of boxes."""
    return tuple(BoxedFrame(row, dataset.path / row.file, row.box_x0_px is not None) for row in dataset.rows)


def build(
    folder: Path,
    chosen: Sequence[TrainingFrame],
    shape: tuple[int, ...],
    make: Make,
    progress: Progress | None = None,
) -> tuple[NDArray[np.uint8], list[list[Patch]]]:
    """Make what is to be learned from each picture, or find it made.

    Parameters
    ----------
    folder : Path
        Of the files; it exists once they are whole.
    shape : tuple of int
        Of what ``make`` gives for a frame.
    make : callable
        From a frame's number and its picture to bytes of that shape, and the patches that they show.
    progress : callable, optional
        Called with (frames done, frames in all).

    Returns
    -------
    bytes : ndarray of uint8, shape (frames, *shape), mapped
    patches : list of list of Patch
        Of each frame.
    """
    if not all((folder / name).exists() for name in ("patches.json", "bytes.npy")):  # it may be half removed
        _make(folder, chosen, shape, make, progress)
    try:
        listed = read_json(folder / "patches.json", TrainingError, most_bytes=_MOST_BYTES)
        patches = [[Patch(*map(int, p)) for p in row] for row in listed]
        found = np.load(folder / "bytes.npy", mmap_mode="r", allow_pickle=False)
        if found.dtype != np.uint8 or found.shape != (len(chosen), *shape) or len(patches) != len(chosen):
            raise ValueError("it belongs to other frames")
        return found, patches
    except (TrainingError, OSError, EOFError, ValueError, TypeError, OverflowError, AttributeError) as problem:
        raise TrainingError(f"{folder} is damaged ({type(problem).__name__}); delete it; it will be rebuilt") from None


def _make(
    folder: Path, chosen: Sequence[TrainingFrame], shape: tuple[int, ...], make: Make, progress: Progress | None
) -> None:
    with writing(folder, TrainingError):
        shutil.rmtree(folder, ignore_errors=True)
        with drafted_folder(folder) as draft:
            needed, free = len(chosen) * int(np.prod(shape)), shutil.disk_usage(draft).free
            if needed > free:  # a mapped file would end the process where the disk does
                raise TrainingError(f"{folder} needs {needed / 1e9:.1f} GB, and only {free / 1e9:.1f} GB are free")
            target = np.lib.format.open_memmap(draft / "bytes.npy", "w+", np.uint8, (len(chosen), *shape))

            def one(i: int) -> list[tuple[int, int, int, int]]:
                target[i], patches = make(i, chosen[i].picture())
                return [(p.x0, p.y0, p.x1, p.y1) for p in patches]

            rows = []
            pool = ThreadPoolExecutor(_WORKERS)
            try:
                for row in pool.map(one, range(len(chosen))):
                    rows.append(row)
                    if progress:
                        progress(len(rows), len(chosen))
            finally:
                pool.shutdown(cancel_futures=True)  # at an error, leave what waits
            target.flush()
            (draft / "patches.json").write_text(json.dumps(rows))
