"""Datasets cut into shards: a tar archive of pictures for each split of a shard, and its labels as a Parquet table.

Below the dataset's URL lie ``shards/SPLIT-NUMBER.tar``, as WebDataset reads them, ``labels/NUMBER.parquet`` with a row
for each frame of the shard, ``camera.toml``, ``preview.jpg`` and, once all is there, ``manifest.json``. A row says
where in which archive its picture lies, so that a frame can be read without the rest of its archive.
"""

from __future__ import annotations

import bisect
import hashlib
import io
import itertools
import operator
import tarfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Annotated, Any, overload

import msgspec
import pyarrow as pa

from simgrab.dataset import datasets
from simgrab.dataset.datasets import MANIFEST, Data, Dataset, LabelledFrame, Manifest
from simgrab.dataset.stores import Store, is_url
from simgrab.errors import DatasetError, first_line
from simgrab.io import parquet, pictures
from simgrab.io.parse import MOST_BYTES, is_dir, parse_json
from simgrab.model import calibration
from simgrab.model import label_arrays as arrays
from simgrab.model.calibration import Calibration
from simgrab.model.masks import Coded
from simgrab.model.records import frame_files
from simgrab.model.truth import SPLITS, Row

if TYPE_CHECKING:
    from simgrab.model.scenario import Scenario

CAMERA, PREVIEW = "camera.toml", "preview.jpg"
MOST_MANIFEST_BYTES = 2**30
READ_AHEAD_BYTES = 16 * 2**20
"""Of pictures that lie one after another, and are read at once where frames are taken in order."""
MOST_GAP_BYTES = 2**18
"""Between two of them; what stands between is read too."""
_KEPT_SHARDS, _MOST_HEADER = 4, tarfile.BLOCKSIZE

PLACE = {
    "shard": (pa.string(), "archive that holds the picture, relative to the dataset"),
    "offset": (pa.int64(), "first byte of the picture file in its archive"),
    "size": (pa.int64(), "bytes of the picture file"),
    "mask": (pa.string(), "visible grab as COCO's compressed run lengths; empty unless detection labels hold a box"),
}
"""Columns of a shard's labels besides those of ``labels.parquet``, with their types and descriptions."""


def archive(split: str, shard: int) -> str:
    """Name the archive of a shard's frames of one split."""
    return f"shards/{split}-{shard:06d}.tar"


def table(shard: int) -> str:
    """Name a shard's labels."""
    return f"labels/{shard:06d}.parquet"


class Place(msgspec.Struct, frozen=True):
    """Where a frame's picture lies, and its mask. The columns `PLACE`."""

    shard: Annotated[str, msgspec.Meta(pattern=rf"^shards/({'|'.join(SPLITS)})-[0-9]{{6,}}\.tar$")]
    offset: Annotated[int, msgspec.Meta(ge=0, le=2**53)]
    size: Annotated[int, msgspec.Meta(ge=0, le=pictures.MOST_BYTES)]
    mask: str | None


@dataclass(frozen=True)
class Shard:
    """The frames of one shard, and where their pictures lie.

    Attributes
    ----------
    rows : tuple of Row
    places : dict of int to Place
        By number of the frame.
    schema : pyarrow.Schema
        Of its table, whose metadata names the scenario and the archives' digests.
    """

    rows: tuple[Row, ...]
    places: dict[int, Place]
    schema: pa.Schema


@lru_cache(_KEPT_SHARDS)
def _read_shard(store: Store, number: int, digest: str) -> Shard:
    """Read a shard's labels, whose file must have this SHA-256; those read last are kept."""
    name = table(number)
    data, where = store.read(name, most_bytes=parquet.MOST_BYTES), f"{store.url}: {name}"
    if hashlib.sha256(data).hexdigest() != digest:
        raise DatasetError(f"{where} does not match the digest in the manifest: it was changed or damaged")
    return parse_shard(data, where)


def parse_shard(data: bytes, where: str) -> Shard:
    """Parse the bytes of a shard's labels; ``where`` begins the error line."""
    found = parquet.parse_table(io.BytesIO(data), DatasetError, where)
    plain = parquet.rows(found, DatasetError, where)
    try:
        places = [msgspec.convert({key: row.pop(key) for key in PLACE}, Place) for row in plain]
        rows = msgspec.convert(plain, tuple[Row, ...])
    except (ValueError, LookupError, TypeError) as problem:
        why = f"{type(problem).__name__}: {first_line(problem)}"
        raise DatasetError(f"{where}: not labels of a shard ({why})") from None
    return Shard(rows, {row.frame: place for row, place in zip(rows, places, strict=True)}, found.schema)


class _Group:
    """Pictures that lie one after another in an archive, read at once when the first is asked for."""

    def __init__(self, store: Store) -> None:
        self._store, self.places, self._read = store, dict[int, Place](), dict[int, bytes]()

    def takes(self, place: Place) -> bool:
        """Whether a picture lies near enough behind the others to be read with them."""
        if not self.places:
            return True
        first, last = (self.places[frame] for frame in (next(iter(self.places)), next(reversed(self.places))))
        near = 0 <= place.offset - (last.offset + last.size) <= MOST_GAP_BYTES
        return place.shard == first.shard and near and place.offset + place.size - first.offset <= READ_AHEAD_BYTES

    def take(self, frame: int) -> bytes | None:
        """Give a picture's bytes once; None when they were given."""
        if self.places:
            places, self.places = self.places, {}
            start, end = min(p.offset for p in places.values()), max(p.offset + p.size for p in places.values())
            shard = places[frame].shard
            data = self._store.read(shard, most_bytes=pictures.MOST_BYTES, span=(start, end))
            for number, place in places.items():
                self._read[number] = data[place.offset - start : place.offset - start + place.size]
        return self._read.pop(frame, None)


@dataclass(frozen=True)
class _Archives:
    """Pictures and masks of one shard; ``group``, if any, are neighbours that are read together."""

    store: Store
    places: dict[int, Place]
    group: _Group | None = None

    def path(self, row: Row) -> None:  # noqa: ARG002
        return None

    def content(self, row: Row) -> bytes:
        place = self.places[row.frame]
        data = self.group.take(row.frame) if self.group else None
        if data is None:
            span = (place.offset, place.offset + place.size)
            data = self.store.read(place.shard, most_bytes=pictures.MOST_BYTES, span=span)
        return frame_files.sound(data, row, self.name(row))

    def buffers(self, row: Row) -> dict[str, bytes]:
        """Read the members that follow the picture in its archive and are of the same frame."""
        place, found = self.places[row.frame], dict[str, bytes]()
        stem, at = PurePosixPath(row.file).stem, place.offset + place.size
        while True:
            at += -at % tarfile.BLOCKSIZE
            header = self.store.read(place.shard, most_bytes=_MOST_HEADER, span=(at, at + tarfile.BLOCKSIZE))
            try:
                member = tarfile.TarInfo.frombuf(header, "utf-8", "strict")
            except tarfile.HeaderError:  # the end
                return found
            frame, _, kind = member.name.removesuffix(".png").partition(".")
            if frame != stem or kind not in ("ids", "depth"):
                return found
            start = at + tarfile.BLOCKSIZE
            at = start + min(member.size, pictures.MOST_BYTES)
            found[kind] = self.store.read(place.shard, most_bytes=pictures.MOST_BYTES, span=(start, at))

    def mask(self, row: Row) -> Coded | None:
        counts = self.places[row.frame].mask
        return None if counts is None else Coded((row.height_px, row.width_px), counts)

    def name(self, row: Row) -> str:
        return f"{self.store.url}: {self.places[row.frame].shard}, frame {row.frame}"

    def mask_name(self, row: Row) -> str:  # noqa: ARG002
        return f"{self.store.url}: labels"


@dataclass(frozen=True)
class ShardedDataset(Sequence[LabelledFrame]):
    """A rendered dataset of shards, as a sequence of its frames; a slice of it, or a split, is a dataset again.

    Labels are read shard by shard, and the few shards used last are kept. Taken in order, frames come with pictures
    that were read some megabytes at a time; a single frame's picture is read alone.

    Attributes
    ----------
    store : Store
    manifest : Manifest
    """

    store: Store
    manifest: Manifest
    _counts: tuple[int, ...] = field(repr=False)  # of each shard
    _split: str | None = None
    _range: range | None = field(default=None, repr=False)  # of positions among the split's frames

    @property
    def data(self) -> Data:
        """What names it; its ``labels_sha256`` is the manifest's digest of the shards' labels."""
        return self.manifest.data(_digest(self.manifest), sum(self.splits.values()))

    @property
    def is_whole(self) -> bool:
        """Whether these are all frames of the dataset, in its order."""
        return self._split is None and self._positions == range(sum(self._counts))

    @property
    def least_visible_fraction(self) -> float:
        """From which on detection labels hold a box."""
        return self.manifest.scenario.labels.least_visible_fraction

    @cached_property
    def _ends(self) -> tuple[int, ...]:
        return tuple(itertools.accumulate(self._counts))

    @property
    def _positions(self) -> range:
        return range(sum(self._counts)) if self._range is None else self._range

    def __len__(self) -> int:
        return len(self._positions)

    @overload
    def __getitem__(self, index: int) -> LabelledFrame: ...

    @overload
    def __getitem__(self, index: slice) -> ShardedDataset: ...

    def __getitem__(self, index: int | slice) -> LabelledFrame | ShardedDataset:
        if isinstance(index, slice):
            return replace(self, _range=self._positions[index])
        try:
            position = self._positions[operator.index(index)]
        except IndexError:
            raise IndexError(f"{self.store.url}: index {index} is out of range of {len(self)} frames") from None
        shard, rank = self._at(position)
        files, rows = self._shard(shard)
        return self._frame(rows[rank], files)

    def __iter__(self) -> Iterator[LabelledFrame]:
        for shard, positions in itertools.groupby(map(self._at, self._positions), key=operator.itemgetter(0)):
            files, rows = self._shard(shard)
            yield from self._ahead(files, [rows[rank] for _, rank in positions])

    def frame(self, number: int) -> LabelledFrame:
        """Give the frame of this number.

        Raises
        ------
        KeyError
            If it is not among them.
        """
        shards = self.manifest.shards
        assert shards is not None
        number = operator.index(number)
        shard = number // shards.frames
        if 0 <= shard < len(self._counts):
            files, rows = self._shard(shard)
            rank = bisect.bisect_left(rows, number, key=lambda row: row.frame)
            first = self._ends[shard] - self._counts[shard]
            if rank < len(rows) and rows[rank].frame == number and first + rank in self._positions:
                return self._frame(rows[rank], files)
        raise KeyError(f"{self.store.url}: no frame {number} among these {len(self)}")

    @property
    def splits(self) -> dict[str, int]:
        """Number of frames in each split of the whole dataset that has any."""
        assert self.manifest.shards is not None
        sums = (sum(counts) for counts in zip(*self.manifest.shards.splits, strict=True))
        return {split: count for split, count in zip(SPLITS, sums, strict=True) if count}

    def split(self, name: str) -> ShardedDataset:
        """Keep the frames of one split of a whole dataset, maybe none.

        Raises
        ------
        KeyError
            If no split is called so.
        ValueError
            If this is a part of a dataset already.
        """
        if name not in SPLITS:
            raise KeyError(f"no split {name!r}; one of: {', '.join(SPLITS)}")
        if self._split is not None or self._range is not None:
            raise ValueError("a split is taken of a whole dataset: take it first, and slices of it")
        assert self.manifest.shards is not None
        counts = tuple(counts[SPLITS.index(name)] for counts in self.manifest.shards.splits)
        return replace(self, _counts=counts, _split=name)

    @property
    def calibration(self) -> Calibration:
        """What an instrument may know of the camera, from ``camera.toml``."""
        text = self.store.read(CAMERA, most_bytes=MOST_BYTES).decode(errors="replace")
        return calibration.parse(text, f"{self.store.url}/{CAMERA}")

    @property
    def scenario(self) -> Scenario:
        """The scenario that it was rendered from, with every default filled in."""
        from simgrab.model import scenes

        def read(name: str, most_bytes: int) -> bytes:
            return self.store.read(name, most_bytes=most_bytes)

        return scenes.of_manifest(_read_manifest(self.store), f"{self.store.url}/{MANIFEST}", read)

    def is_labelled(self, row: Row) -> bool:
        """Whether detection labels hold a box for the row."""
        return arrays.is_labelled(row, self.least_visible_fraction)

    def _at(self, position: int) -> tuple[int, int]:
        """Shard of a position, and the rank among the split's frames there."""
        shard = bisect.bisect_right(self._ends, position)
        return shard, position - (self._ends[shard] - self._counts[shard])

    def _shard(self, number: int) -> tuple[_Archives, tuple[Row, ...]]:
        found = _read_shard(self.store, number, self.manifest.files.get(table(number), ""))
        rows = tuple(row for row in found.rows if self._split in (None, row.split))
        if len(rows) != self._counts[number]:
            raise DatasetError(f"{self.store.url}: {table(number)} does not hold the frames that the manifest states")
        return _Archives(self.store, found.places), rows

    def _frame(self, row: Row, files: _Archives) -> LabelledFrame:
        return LabelledFrame(row, self.is_labelled(row), files)

    def _ahead(self, files: _Archives, rows: Sequence[Row]) -> Iterator[LabelledFrame]:
        """Give frames of a shard whose pictures are read some megabytes at a time, once the first is asked for."""
        groups, latest = dict[int, _Group](), dict[str, _Group]()
        for row in rows:
            place = files.places[row.frame]
            if place.shard not in latest or not latest[place.shard].takes(place):
                latest[place.shard] = _Group(self.store)
            groups[row.frame] = latest[place.shard]
            groups[row.frame].places[row.frame] = place
        latest.clear()
        for row in rows:
            yield self._frame(row, replace(files, group=groups.pop(row.frame)))


def _digest(manifest: Manifest) -> str:
    names = sorted(name for name in manifest.files if name.startswith("labels/"))
    return hashlib.sha256("".join(manifest.files[name] for name in names).encode()).hexdigest()


def _read_manifest(store: Store) -> Any:
    data = store.read(MANIFEST, most_bytes=MOST_MANIFEST_BYTES)
    return parse_json(data, DatasetError, f"{store.url}/{MANIFEST}: it is not valid JSON")


def read(store: Store) -> ShardedDataset:
    """Open a finished dataset of shards.

    Raises
    ------
    DatasetError
        If it is none, or is unfinished.
    """
    if not store.exists(MANIFEST):
        state = "unfinished; continue with simgrab render --resume" if store.sizes() else "not a dataset"
        raise DatasetError(f"{store.url} is {state}: it has no {MANIFEST}")
    known = datasets.named(_read_manifest(store), store.url)
    if known.shards is None:
        raise DatasetError(f"{store.url} is a dataset of files; give its path")
    return ShardedDataset(store, known, tuple(map(sum, known.shards.splits)))


def open(place: str | Path) -> Dataset | ShardedDataset:
    """Open a finished dataset; `simgrab.open` is this function.

    Of a folder, labels are read at once, and that each picture is there is checked. Of a dataset of shards, labels are
    read shard by shard. Pictures and masks are read frame by frame.

    Parameters
    ----------
    place : str or Path
        Folder that `simgrab.render` finished, or URL of a dataset of shards.

    Returns
    -------
    Dataset or ShardedDataset

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
    if is_url(place):
        return read(Store(str(place)))
    path = Path(place)
    if is_dir(path / "shards", DatasetError):
        return read(Store(path.absolute().as_uri()))
    return datasets.read(path)
