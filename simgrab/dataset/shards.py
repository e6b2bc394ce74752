"""Write a dataset of shards, below a URL; `simgrab.dataset.shard_reader` has the format and reads it.

A shard is a run of frames that depends on the scenario and its number alone. Its archives are written first and its
labels last; a shard with labels is complete. Any process on any machine may make any shard, even twice, without a lock.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import io
import math
import tarfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from simgrab.dataset import preview, tables
from simgrab.dataset import shard_reader as shards
from simgrab.dataset.datasets import Manifest
from simgrab.dataset.shard_reader import PLACE, Place, archive
from simgrab.dataset.summary import Tally
from simgrab.errors import DatasetError
from simgrab.io import parquet
from simgrab.io.files import sha256
from simgrab.io.journal import Journal
from simgrab.io.stores import Store
from simgrab.model.masks import Coded
from simgrab.model.scenario import Scenario
from simgrab.model.truth import Row
from simgrab.runtime.versions import Fingerprint

FRAMES = 256
"""Of a shard, unless given: 100 to 150 MB of 1080p JPEG."""
UNFINISHED = "unfinished.json"
_ABOUT = "simgrab_shard"  # key of the labels' metadata


class ShardMetadata(msgspec.Struct, frozen=True):
    """Description of a shard in the metadata of its labels; ``archives`` have sizes in bytes and SHA-256."""

    digest: str
    rendered_by: Fingerprint
    archives: dict[str, tuple[int, str]]


class Done(msgspec.Struct, frozen=True):
    """Result of making a shard, as a process returns it."""

    number: int
    labels_sha256: str
    rendered_by: Fingerprint
    tally: Tally


def frames_of(scenario: Scenario, frames: int | None, *, varies: bool) -> int:
    """Frames of a shard: the requested number, but at most all frames; refuses a number below 1.

    They are rounded up to whole clips where worlds vary, and to all frames that share a draw.
    """
    wanted = FRAMES if frames is None else frames
    if wanted < 1:
        raise DatasetError(f"a shard must have 1 frame or more, got {wanted}")
    each = max(scenario.clip.clip_frames or scenario.frames, *scenario.every.values(), 0) if varies else 1
    return min(math.ceil(wanted / each) * each, scenario.frames)


def spans(scenario: Scenario, frames: int) -> list[range]:
    """Frames of each shard, given their number; see `frames_of`."""
    total = scenario.frames
    return [range(first, min(first + frames, total)) for first in range(0, total, frames)]


def check_claimed(journal: Journal, scenario: Scenario) -> None:
    """Refuse a place that has lost its claim, for example because the file system is no longer mounted."""
    claimed, place = journal.known(UNFINISHED), journal.store.place
    if claimed is None:
        raise DatasetError(f"{place} was removed or finished by another process; it has no {UNFINISHED}")
    if claimed.get("digest") != scenario.digest():
        raise DatasetError(f"{place} is being written by another process, from another scenario")


def complete(store: Store, scenario: Scenario, count: int) -> Iterator[Done]:
    """Find the complete ones of so many shards: their labels can be read, and their archives exist."""
    sizes = store.sizes("shards")
    there = store.sizes("labels")
    for number in range(count):
        name = shards.table(number)
        if name not in there:
            continue
        data = store.read(name, most_bytes=parquet.MOST_BYTES)
        try:
            found = shards.parse_shard(data, f"{store.place}: {name}")
            about = _about(found.schema, f"{store.place}: {name}")
        except DatasetError:  # damaged: it is made again
            continue
        if about.digest != scenario.digest():
            raise DatasetError(f"{store.place}: {name} is of another dataset; choose another --out")
        if all(sizes.get(key) == size for key, (size, _) in about.archives.items()):
            tally = Tally.of(found.rows, scenario)
            yield Done(number, hashlib.sha256(data).hexdigest(), about.rendered_by, tally)


class Packed(NamedTuple):
    """A frame in a shard: its row, its mask if detection labels contain a box, and its files by name."""

    row: Row
    mask: Coded | None
    files: dict[str, bytes]


def write(store: Store, number: int, frames: Iterable[Packed], scenario: Scenario, rendered_by: Fingerprint) -> Done:
    """Write a shard: its archives, then its labels."""
    rows = list[tuple[Row, Place]]()
    archives: dict[str, tuple[int, str]] = {}
    opened: dict[str, tuple[Path, tarfile.TarFile]] = {}
    with contextlib.ExitStack() as stack:
        for row, mask, files in frames:
            name = archive(row.split, number)
            if name not in opened:
                path = stack.enter_context(store.writing(name))
                opened[name] = path, stack.enter_context(tarfile.open(path, "w", format=tarfile.USTAR_FORMAT))
            _, tar = opened[name]
            about = {"truth": row, "labelled": mask is not None, "mask": mask}
            _add(tar, f"{row.frame:06d}.json", msgspec.json.encode(about))
            for file, data in files.items():
                spot = _add(tar, _member(file), data)
                if file == row.file:
                    rows.append((row, Place(name, *spot, mask.counts if mask else None)))
        for name, (path, tar) in opened.items():
            tar.close()  # completes it
            archives[name] = path.stat().st_size, sha256(path)
    labels = _labels(rows, ShardMetadata(scenario.digest(), rendered_by, dict(sorted(archives.items()))))
    store.write(shards.table(number), labels)
    tally = Tally.of((row for row, _ in rows), scenario)
    return Done(number, hashlib.sha256(labels).hexdigest(), rendered_by, tally)


def finish(
    store: Store, core: dict[str, Any], frames: int, done: Sequence[Done], scenario: Scenario,
    rendered_by: Fingerprint, written: dict[str, str],
) -> None:  # fmt: skip
    """Write the files that depend on all shards, given the number of frames of each; the manifest comes last.

    Parameters
    ----------
    core : dict
        See `simgrab.dataset.manifest.identity`.
    done : sequence of Done
        All shards, by number.
    written : dict of str to str
        SHA-256 of the other files written, by name.
    """
    digests = {shards.table(one.number): one.labels_sha256 for one in done} | written
    about = {"frames": frames, "splits": [one.tally.splits for one in done]}
    tally = functools.reduce(Tally.__add__, (one.tally for one in done))
    if "selection" not in core:  # of which a manifest counts nothing
        core = core | tally.stated(scenario)
    core = core | {"shards": about}
    known = msgspec.convert(core | {"files": digests, "renderer": rendered_by}, Manifest, from_attributes=True)
    dataset = shards.of_shards(store, known)
    contents = tables.Contents(core, scenario, rendered_by, preview.tiles(dataset), tally, "webdataset")
    tables.describe(store, contents, digests)


def _add(archive: tarfile.TarFile, name: str, data: bytes) -> tuple[int, int]:
    """Add a file without owner and time; returns the position of its first byte in the archive, and its size."""
    member = tarfile.TarInfo(name)
    member.size = len(data)
    start: int = archive.offset + tarfile.BLOCKSIZE  # after its header
    archive.addfile(member, io.BytesIO(data))
    return start, len(data)


def _member(file: str) -> str:
    """Name a frame's file in its archive: ``000012.jpg``, ``000012.ids.png``, ``000012.depth.png``."""
    folder, _, stem = file.partition("/")
    name = stem.rpartition("/")[2]
    return name if folder == "images" else name.replace(".", f".{folder}.", 1)


def _labels(rows: list[tuple[Row, Place]], about: ShardMetadata) -> bytes:
    """Write the labels of a shard as Parquet."""
    schema = tables.labels_schema()
    for name, (kind, text) in PLACE.items():
        schema = schema.append(tables.column(name, kind, "", text))
    schema = schema.with_metadata({**schema.metadata, _ABOUT: msgspec.json.encode(about)})
    plain = [msgspec.structs.asdict(row) | msgspec.structs.asdict(place) for row, place in rows]
    sink = io.BytesIO()
    pq.write_table(pa.Table.from_pylist(plain, schema=schema), sink, compression="zstd")
    return sink.getvalue()


def _about(schema: pa.Schema, where: str) -> ShardMetadata:
    try:
        return msgspec.json.decode((schema.metadata or {})[_ABOUT.encode()], type=ShardMetadata)
    except (msgspec.DecodeError, KeyError, RecursionError, UnicodeDecodeError) as problem:
        raise DatasetError(f"{where}: not labels of a shard ({type(problem).__name__})") from None
