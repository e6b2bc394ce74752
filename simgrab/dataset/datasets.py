"""Rendered datasets, read as files."""

from __future__ import annotations

import bisect
import contextlib
import hashlib
import operator
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Protocol, overload

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from simgrab.errors import DatasetError, first_line
from simgrab.io import pictures
from simgrab.io.parse import MOST_BYTES, is_file, parse_json, read_bytes
from simgrab.io.stores import Store
from simgrab.model import calibration
from simgrab.model import label_arrays as labels
from simgrab.model.calibration import Calibration
from simgrab.model.label_arrays import Labelled
from simgrab.model.masks import Coded, Masks, coco_name
from simgrab.model.records import frame_files
from simgrab.model.records.frame_files import FrameFile
from simgrab.model.truth import SPLITS, Row
from simgrab.runtime.versions import Fingerprint

if TYPE_CHECKING:
    from simgrab.model.scenario import Scenario

MANIFEST, CAMERA = "manifest.json", "camera.toml"
MOST_MANIFEST_BYTES = 2**30

Count = Annotated[int, msgspec.Meta(ge=0, le=2**53)]


class _Labels(msgspec.Struct, frozen=True):
    least_visible_fraction: Annotated[float, msgspec.Meta(ge=0, le=1)]


class _Scenario(msgspec.Struct, frozen=True):
    name: str
    labels: _Labels


class ShardCounts(msgspec.Struct, frozen=True):
    """How a dataset is cut into shards: frames of each but the last one, and the frames of each in its splits."""

    frames: Annotated[int, msgspec.Meta(ge=1, le=2**53)]
    splits: tuple[tuple[Count, Count, Count], ...]


class _Function(msgspec.Struct, frozen=True):
    role: str


class _Extensions(msgspec.Struct, frozen=True):
    functions: tuple[_Function, ...] = ()


class _Selection(msgspec.Struct, frozen=True):
    of_frames: Count


class Manifest(msgspec.Struct, frozen=True):
    """The part of a manifest that is read without parsing the scenario."""

    simgrab: str
    scenario: _Scenario
    digest: str
    seed: int
    renderer: Fingerprint
    extensions: _Extensions = _Extensions()
    selection: _Selection | None = None
    files: dict[str, str] = {}
    shards: ShardCounts | None = None


@dataclass(frozen=True)
class DatasetIdentity:
    """The name and digests of a dataset: of its scenario, from the manifest, and of ``labels.parquet``."""

    scenario: str
    scenario_digest: str
    labels_sha256: str
    seed: int
    frames: int


class DatasetFiles(Protocol):
    """Where a dataset keeps pictures and masks. A file that cannot be read raises `DatasetError`."""

    def path(self, row: Row) -> Path | None:
        """Path of a row's picture; None where it is part of another file."""

    def content(self, row: Row) -> bytes:
        """Read a row's picture file, and check it against the row's digest."""

    def buffers(self, row: Row) -> dict[str, bytes]:
        """Read a row's PNG files, by name (``ids``, ``depth``), of those that are stored."""

    def mask(self, row: Row) -> Coded | None:
        """Look up a row's mask; None where the labels hold none."""

    def name(self, row: Row) -> str:
        """Return the name of a row's picture in messages."""

    def mask_name(self, row: Row) -> str:
        """Return the name, in messages, of the file that holds a row's mask."""


@dataclass(frozen=True)
class LabelledFrame(Labelled):
    """One frame of a dataset: its labels, its picture and its mask. Picture and mask are decoded at each access.

    Pixels are continuous: (0, 0) is the outer corner of the top-left pixel. Poses are in metres, in the jib frame.

    Attributes
    ----------
    truth : Row
        Its row of labels.
    labelled : bool
        Whether detection labels hold a box and a mask.
    """

    truth: Row
    labelled: bool
    _files: DatasetFiles = field(repr=False, compare=False)

    @property
    def file(self) -> Path | None:
        """Path of the picture; None where the dataset keeps pictures in archives."""
        return self._files.path(self.truth)

    @property
    def content(self) -> bytes:
        """Content of the picture file; raises `DatasetError` if its digest differs from the labels'."""
        return self._files.content(self.truth)

    @property
    def buffers(self) -> dict[str, bytes]:
        """PNG files of ``ids`` and ``depth``, if the dataset stores them."""
        return self._files.buffers(self.truth)

    @property
    def rgb(self) -> NDArray[np.uint8]:
        """The same as `picture`, by the name that a `simgrab.world.frames.Frame` has for it."""
        return self.picture

    @property
    def picture(self) -> NDArray[np.uint8]:
        """RGB, shape (height, width, 3); raises `DatasetError` if the file's digest differs from the labels'."""
        return pictures.decode(self.content, self._files.name(self.truth))

    @property
    def coded_mask(self) -> Coded | None:
        """Pixels of the visible grab as COCO's compressed run lengths; None unless ``labelled``."""
        coded = self._files.mask(self.truth) if self.labelled else None
        return None if coded is None else coded.checked(self.truth, self._files.mask_name(self.truth))

    @property
    def mask(self) -> NDArray[np.bool_] | None:
        """Pixels of the visible grab, shape (height, width); None unless ``labelled``."""
        coded = self.coded_mask
        return None if coded is None else coded.decoded(self.truth, self._files.mask_name(self.truth))


@dataclass(frozen=True)
class FolderFiles:
    """Pictures in files of a folder, and what looks up a row's mask; see `DatasetFiles`."""

    folder: Path
    coded: Callable[[Row], Coded | None]

    def path(self, row: Row) -> Path:  # noqa: D102
        return self.folder / row.file

    def content(self, row: Row) -> bytes:  # noqa: D102
        return frame_files.content(self.path(row), row)

    def buffers(self, row: Row) -> dict[str, bytes]:  # noqa: D102
        paths = {kind: self.folder / name for kind, name in buffer_names(row.file).items()}
        return {
            kind: read_bytes(path, DatasetError, most_bytes=pictures.MOST_BYTES)
            for kind, path in paths.items()
            if is_file(path, DatasetError)
        }

    def mask(self, row: Row) -> Coded | None:  # noqa: D102
        return self.coded(row)

    def name(self, row: Row) -> str:  # noqa: D102
        return str(self.path(row))

    def mask_name(self, row: Row) -> str:  # noqa: D102
        return str(self.folder / coco_name(row.split))


class RowStore(Protocol):
    """The rows of a dataset, or of one of its splits, by frame, and the places of their files."""

    def __len__(self) -> int: ...

    def at(self, positions: Sequence[int]) -> Iterator[tuple[Row, DatasetFiles]]:
        """Return the rows at these positions, in this order."""

    def find(self, number: int) -> int:
        """Position of a frame; raises `KeyError` if there is no such frame."""

    def split(self, name: str) -> RowStore:
        """Keep the rows of one split."""


@dataclass(frozen=True)
class FolderRows:
    """The table ``labels.parquet``, of which rows are made at each access, and files of a folder; see `RowStore`."""

    table: pa.Table
    files: FolderFiles = field(repr=False, compare=False)

    def __len__(self) -> int:
        return int(self.table.num_rows)

    def at(self, positions: Sequence[int]) -> Iterator[tuple[Row, DatasetFiles]]:  # noqa: D102
        if isinstance(positions, range) and positions.step == 1:
            some = self.table.slice(positions.start, len(positions))
        else:
            some = self.table.take(pa.array(positions, pa.int64()))
        return ((row, self.files) for row in frame_files.converted(some, Row, self.files.folder))

    def find(self, number: int) -> int:  # noqa: D102
        frames = self.table["frame"]
        position = bisect.bisect_left(range(len(self)), number, key=lambda at: frames[at].as_py())
        if position == len(self) or frames[position].as_py() != number:
            raise KeyError(number)
        return position

    def split(self, name: str) -> FolderRows:  # noqa: D102
        return replace(self, table=self.table.filter(pc.equal(self.table["split"], name)))


@dataclass(frozen=True)
class Dataset(Sequence[LabelledFrame]):
    """A rendered dataset, as a sequence of its frames; a slice of it, or a split, is a dataset again.

    Labels of a dataset of shards are read shard by shard, and the few shards used last are kept. Iteration reads
    pictures several megabytes at a time; access to a single frame reads its picture alone.

    Attributes
    ----------
    store : Store
        Place of its files.
    data : DatasetIdentity
        The dataset's name and digests.
    least_visible_fraction : float
        Least visible fraction at which the dataset's detection labels contain a box.
    """

    store: Store
    data: DatasetIdentity
    least_visible_fraction: float
    _rows: RowStore = field(repr=False)
    _positions: Sequence[int] = field(repr=False)  # among these rows

    @property
    def path(self) -> Path:
        """Folder of the dataset; raises `DatasetError` if it is not stored in a folder."""
        if self.store.folder is None:
            raise DatasetError(f"{self.store.place} is not a folder")
        return self.store.folder

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """Rows of labels, by frame."""
        return tuple(row for row, _ in self._rows.at(self._positions))

    def __len__(self) -> int:
        return len(self._positions)

    @overload
    def __getitem__(self, index: int) -> LabelledFrame: ...

    @overload
    def __getitem__(self, index: slice) -> Dataset: ...

    def __getitem__(self, index: int | slice) -> LabelledFrame | Dataset:
        if isinstance(index, slice):
            return replace(self, _positions=self._positions[index])
        try:
            position = self._positions[operator.index(index)]
        except IndexError:
            raise IndexError(f"{self.store.place}: index {index} is out of range of {len(self)} frames") from None
        return self._frame(position)

    def __iter__(self) -> Iterator[LabelledFrame]:
        return (self._labelled(row, files) for row, files in self._rows.at(self._positions))

    def _frame(self, position: int) -> LabelledFrame:
        return self._labelled(*next(self._rows.at(range(position, position + 1))))

    def _labelled(self, row: Row, files: DatasetFiles) -> LabelledFrame:
        return LabelledFrame(row, self.is_labelled(row), files)

    def frame(self, number: int) -> LabelledFrame:
        """Return the frame with this number (`simgrab.model.truth.Row.frame`).

        Raises
        ------
        KeyError
            If the dataset has no such frame.
        """
        with contextlib.suppress(KeyError):
            position = self._rows.find(operator.index(number))
            if position in self._positions:
                return self._frame(position)
        raise KeyError(f"{self.store.place}: no frame {number} among these {len(self)}")

    @property
    def is_whole(self) -> bool:
        """Whether these are all frames of the dataset, in its order."""
        return self._positions == range(self.data.frames) == range(len(self._rows))

    @property
    def splits(self) -> dict[str, int]:
        """Number of frames in each split that has any."""
        if self._positions == range(len(self._rows)):  # which are counted without reading labels of shards
            count = Counter({split: len(self._rows.split(split)) for split in SPLITS})
        else:
            count = Counter(row.split for row in self.rows)
        return {split: count[split] for split in SPLITS if count[split]}

    def split(self, name: str) -> Dataset:
        """Keep the frames of one split. The result may be empty.

        Raises
        ------
        KeyError
            If there is no split of this name.
        ValueError
            If this is a slice.
        """
        if name not in SPLITS:
            raise KeyError(f"no split {name!r}; one of: {', '.join(SPLITS)}")
        if self._positions != range(len(self._rows)):
            raise ValueError("only a whole dataset can be split: take the split first, then slice it")
        rows = self._rows.split(name)
        return replace(self, _rows=rows, _positions=range(len(rows)))

    def without_hidden(self) -> Dataset:
        """Leave out frames that show some of the grab, but too little for a detection label."""
        rows = zip(self._positions, self._rows.at(self._positions), strict=True)
        kept = tuple(position for position, (row, _) in rows if not self.is_hidden(row))
        return self if len(kept) == len(self) else replace(self, _positions=kept)

    def with_rows(self, table: pa.Table) -> Dataset:
        """Replace the labels by other labels of the same folder, by frame, in the columns of ``labels.parquet``."""
        assert isinstance(self._rows, FolderRows)
        return replace(self, _rows=replace(self._rows, table=table), _positions=range(table.num_rows))

    @property
    def calibration(self) -> Calibration:
        """The camera as the instrument may know it, from ``camera.toml``."""
        text = self.store.read(CAMERA, most_bytes=MOST_BYTES).decode(errors="replace")
        return calibration.parse(text, f"{self.store.place}/{CAMERA}")

    @property
    def manifest(self) -> Any:
        """The manifest as plain data."""
        return read_manifest(self.store)

    @property
    def scenario(self) -> Scenario:
        """The scenario of the dataset, with every default filled in."""
        from simgrab.model import scenes

        def read(name: str, most_bytes: int) -> bytes:
            return self.store.read(name, most_bytes=most_bytes)

        return scenes.of_manifest(self.manifest, f"{self.store.place}/{MANIFEST}", read)

    def weather(self, row: Row) -> str:
        """Name a row's weather: its name in a scene that varies the weather, or else the scene's name."""
        where = f"{self.store.place}: labels, frame {row.frame}: varied is not JSON"
        varied = parse_json(row.varied, DatasetError, where) if row.varied else {}
        items = varied.items() if isinstance(varied, dict) else ()
        return next((str(value) for key, value in items if "weather" in key.split("+")), self.data.scenario)

    def image(self, row: Row) -> Path:
        """Path of a row's picture."""
        return self.path / row.file

    def is_labelled(self, row: Row) -> bool:
        """Whether detection labels hold a box for the row."""
        return labels.is_labelled(row, self.least_visible_fraction)

    def is_hidden(self, row: Row) -> bool:
        """Whether a row shows some of the grab, but too little for a detection label."""
        return row.box_x0_px is not None and not self.is_labelled(row)


def read_manifest(store: Store) -> Any:
    """Read a dataset's manifest, as plain data."""
    data = store.read(MANIFEST, most_bytes=MOST_MANIFEST_BYTES)
    return parse_json(data, DatasetError, f"{store.place}/{MANIFEST}: it is not valid JSON")


def read(path: str | Path) -> Dataset:
    """Open a finished dataset in a folder; `simgrab.dataset.shard_reader.open` says how, and opens others too."""
    path = Path(path)
    table, labels_sha256 = frame_files.read_labels(path)
    named_files = list[FrameFile]()
    for row in frame_files.converted(table, Row, path):
        check_box(row, path)
        named_files.append(FrameFile(row.frame, row.file, row.clip, row.time_s, row.image_sha256))
    store = Store(str(path))
    known = named(read_manifest(store), path)
    frame_files.check_files(path, named_files)
    return of_rows(store, known, labels_sha256, FolderRows(table, FolderFiles(path, Masks(path).coded)))


def check_box(row: Row, where: object) -> None:
    """Refuse a row whose visible box lacks an edge, is empty, or is not in the picture."""
    x0, y0, x1, y1 = edges = (row.box_x0_px, row.box_y0_px, row.box_x1_px, row.box_y1_px)
    if x0 is None or y0 is None or x1 is None or y1 is None:
        sound = edges == (None,) * 4
    else:
        sound = x0 < x1 <= row.width_px and y0 < y1 <= row.height_px
    if not sound:
        raise DatasetError(
            f"{where}: frame {row.frame}: its box {edges} is none of {row.width_px} x {row.height_px} px"
        )


def of_rows(store: Store, known: Manifest, labels_sha256: str, rows: RowStore) -> Dataset:
    """Make the dataset that a manifest describes."""
    data = DatasetIdentity(known.scenario.name, known.digest, labels_sha256, known.seed, len(rows))
    return Dataset(store, data, known.scenario.labels.least_visible_fraction, rows, range(len(rows)))


def named(manifest: Any, where: object) -> Manifest:
    """Convert plain data to a manifest; raises `DatasetError` if they are not a manifest."""
    try:
        return msgspec.convert(manifest, Manifest)
    except (ValueError, LookupError, TypeError) as problem:
        why = f"{type(problem).__name__}: {first_line(problem)}"
        raise DatasetError(f"{where}: not a simgrab dataset ({why})") from None


def buffer_names(file: str) -> dict[str, str]:
    """Name the files of ids and depth beside a picture file."""
    stem = file.removeprefix("images/").rpartition(".")[0]
    return {kind: f"{kind}/{stem}.png" for kind in ("ids", "depth")}


def read_all(paths: Sequence[str | Path], *splits: str) -> tuple[Dataset, ...]:
    """Read datasets, and check that together they have frames in each of the splits."""
    if not paths:
        raise DatasetError("no dataset given")
    datasets = tuple(read(path) for path in paths)
    for split in splits:
        if not any(split in dataset.splits for dataset in datasets):
            given = ", ".join(str(dataset.path) for dataset in datasets)
            raise DatasetError(f"{given}: no frames in the split {split!r}; render more frames")
    return datasets


def digest(datasets: Sequence[Dataset]) -> str:
    """One digest of several datasets' labels, and through them of their pictures."""
    return hashlib.sha256("".join(dataset.data.labels_sha256 for dataset in datasets).encode()).hexdigest()
