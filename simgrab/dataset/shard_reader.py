"""Datasets cut into shards: a tar archive of pictures for each split of a shard, and its labels as a Parquet table.

Below the dataset's URL lie ``shards/SPLIT-NUMBER.tar``, as WebDataset reads them, ``labels/NUMBER.parquet`` with a row
for each frame of the shard, ``camera.toml``, ``preview.jpg`` and, once complete, ``manifest.json``. A row states the
archive and the position of its picture, so that a frame can be read without the rest of its archive.
"""

from __future__ import annotations

import bisect
import hashlib
import io
import itertools
import operator
import tarfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path, PurePosixPath
from typing import Annotated

import msgspec
import pyarrow as pa

from simgrab.dataset import datasets
from simgrab.dataset.datasets import MANIFEST, Dataset, DatasetFiles, Manifest, ShardCounts
from simgrab.errors import DatasetError, first_line
from simgrab.io import parquet, pictures
from simgrab.io.parse import is_dir
from simgrab.io.stores import Store, is_url
from simgrab.model.masks import Coded
from simgrab.model.records import frame_files
from simgrab.model.truth import SPLITS, Row

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
    """Place of a frame's picture, and its mask: the columns `PLACE`."""

    shard: Annotated[str, msgspec.Meta(pattern=rf"^shards/({'|'.join(SPLITS)})-[0-9]{{6,}}\.tar\Z")]
    offset: Annotated[int, msgspec.Meta(ge=0, le=2**53)]
    size: Annotated[int, msgspec.Meta(ge=0, le=pictures.MOST_BYTES)]
    mask: str | None


@dataclass(frozen=True)
class Shard:
    """The frames of one shard, the places of their pictures by frame, and the schema of its table."""

    rows: tuple[Row, ...]
    places: dict[int, Place]
    schema: pa.Schema


@lru_cache(_KEPT_SHARDS)
def _read_shard(store: Store, number: int, digest: str) -> Shard:
    """Read a shard's labels and check the file's SHA-256; the latest ones are cached."""
    name = table(number)
    data, where = store.read(name, most_bytes=parquet.MOST_BYTES), f"{store.place}: {name}"
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
    for row in rows:
        datasets.check_box(row, where)
    return Shard(rows, {row.frame: place for row, place in zip(rows, places, strict=True)}, found.schema)


class _Group:
    """Consecutive pictures of an archive, all read when the first is requested."""

    def __init__(self, store: Store) -> None:
        self._store, self.places, self._read = store, dict[int, Place](), dict[int, bytes]()

    def takes(self, place: Place) -> bool:
        """Whether a picture of the archive follows the others closely enough to be read with them."""
        first, last = next(iter(self.places.values())), next(reversed(self.places.values()))
        near = 0 <= place.offset - (last.offset + last.size) <= MOST_GAP_BYTES
        return near and place.offset + place.size - first.offset <= READ_AHEAD_BYTES

    def take(self, frame: int) -> bytes | None:
        """Return a picture's bytes once, then None."""
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
    """Pictures and masks of one shard; ``group``, if given, holds neighbours that are read together."""

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
        """Read the members of the same frame that follow its picture in the archive."""
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
        return f"{self.store.place}: {self.places[row.frame].shard}, frame {row.frame}"

    def mask_name(self, row: Row) -> str:  # noqa: ARG002
        return f"{self.store.place}: labels"


@dataclass(frozen=True)
class ShardRows:
    """The rows of shards, or of the split ``name``, read shard by shard; see `simgrab.dataset.datasets.RowStore`."""

    store: Store
    manifest: Manifest
    name: str | None = None

    @cached_property
    def _counts(self) -> tuple[int, ...]:
        """Rows of each shard."""
        assert self.manifest.shards is not None
        each = self.manifest.shards.splits
        return tuple(sum(counts) if self.name is None else counts[SPLITS.index(self.name)] for counts in each)

    @cached_property
    def _ends(self) -> tuple[int, ...]:
        return tuple(itertools.accumulate(self._counts))

    def __len__(self) -> int:
        return sum(self._counts)

    def at(self, positions: Sequence[int]) -> Iterator[tuple[Row, DatasetFiles]]:  # noqa: D102
        for shard, places in itertools.groupby(map(self._at, positions), key=operator.itemgetter(0)):
            files, rows = self._shard(shard)
            yield from _ahead(files, [rows[rank] for _, rank in places])

    def find(self, number: int) -> int:  # noqa: D102
        shards = self.manifest.shards
        assert shards is not None
        shard = number // shards.frames
        if 0 <= shard < len(self._counts):
            _, rows = self._shard(shard)
            rank = bisect.bisect_left(rows, number, key=lambda row: row.frame)
            if rank < len(rows) and rows[rank].frame == number:
                return self._ends[shard] - self._counts[shard] + rank
        raise KeyError(number)

    def split(self, name: str) -> ShardRows:  # noqa: D102
        if self.name in (None, name):
            return replace(self, name=name)
        return replace(self, manifest=msgspec.structs.replace(self.manifest, shards=ShardCounts(1, ())))

    def _at(self, position: int) -> tuple[int, int]:
        """Shard of a position, and the position among the split's frames in it."""
        shard = bisect.bisect_right(self._ends, position)
        return shard, position - (self._ends[shard] - self._counts[shard])

    def _shard(self, number: int) -> tuple[_Archives, tuple[Row, ...]]:
        found = _read_shard(self.store, number, self.manifest.files.get(table(number), ""))
        rows = tuple(row for row in found.rows if self.name in (None, row.split))
        if len(rows) != self._counts[number]:
            raise DatasetError(f"{self.store.place}: {table(number)} does not contain the manifest's frames")
        return _Archives(self.store, found.places), rows


def _ahead(files: _Archives, rows: Sequence[Row]) -> Iterator[tuple[Row, DatasetFiles]]:
    """Return rows of a shard whose pictures are read several megabytes at a time, from the first request on."""
    groups, latest = dict[int, _Group](), dict[str, _Group]()
    for row in rows:
        place = files.places[row.frame]
        if place.shard not in latest or not latest[place.shard].takes(place):
            latest[place.shard] = _Group(files.store)
        groups[row.frame] = latest[place.shard]
        groups[row.frame].places[row.frame] = place
    latest.clear()
    for row in rows:
        yield row, replace(files, group=groups.pop(row.frame))


def of_shards(store: Store, known: Manifest) -> Dataset:
    """Make the dataset that a manifest of shards describes. Its labels' digest follows from the shards' digests."""
    rows = ShardRows(store, known)
    names = sorted(name for name in known.files if name.startswith("labels/"))
    digest = hashlib.sha256("".join(known.files[name] for name in names).encode()).hexdigest()
    return datasets.of_rows(store, known, digest, rows)


def read(store: Store) -> Dataset:
    """Open a finished dataset of shards; raises `DatasetError` if there is none, or it is unfinished."""
    if not store.exists(MANIFEST):
        state = "unfinished; continue with simgrab render --resume" if store.sizes() else "not a dataset"
        raise DatasetError(f"{store.place} is {state}: it has no {MANIFEST}")
    known = datasets.named(datasets.read_manifest(store), store.place)
    if known.shards is None:
        raise DatasetError(f"{store.place} is a dataset of files; give its path")
    return of_shards(store, known)


def open(place: str | Path) -> Dataset:
    """Open a finished dataset; `simgrab.open` is this function.

    For a folder, all labels are read at once, and the presence of each picture is checked. For a dataset of shards,
    labels are read shard by shard. Pictures and masks are read frame by frame.

    Parameters
    ----------
    place : str or Path
        Folder that `simgrab.render` finished, or URL of a dataset of shards.

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
    if is_url(place):
        return read(Store(str(place)))
    path = Path(place)
    if is_dir(path / "shards", DatasetError):
        return read(Store(path.absolute().as_uri()))
    return datasets.read(path)
