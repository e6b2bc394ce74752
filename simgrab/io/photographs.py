"""Photographs and videos that a scenario shows below the grab, read and checked before they are used.

A scenario names them by the name of a file or folder and the SHA-256 of the content, as it names models of grabs; the
bytes are kept in the process (`simgrab.io.models`).
"""

from __future__ import annotations

import hashlib
import io
import itertools
import os
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path, PurePosixPath

import av
import numpy as np
from av.container import InputContainer
from av.video.stream import VideoStream
from numpy.typing import NDArray

from simgrab.errors import PictureError, first_line
from simgrab.io import pictures
from simgrab.io.models import MOST_BYTES, ModelFile, ending, remember
from simgrab.io.parse import Refuse, is_dir, read_bytes
from simgrab.io.playback import Playback, aspect_of, open_video, squared, stream_of

PHOTOGRAPHS = ("jpg", "jpeg", "png", "webp", "bmp")
VIDEOS = ("mp4", "mkv", "avi", "mov")
MOST_PIXELS = 40_000_000
"""Of a photograph, or of a frame of a video."""
LEAST_SIDE_PX = 32
MOST_FILES = 1000
"""Of a folder."""
MOST_FRAMES = 20_000
"""Of a video."""
_KEPT = 4  # photographs that stay decoded

Picture = NDArray[np.uint8]


def read(path: str | Path, refuse: Refuse) -> ModelFile:
    """Read a photograph, a video, or the pictures of a folder, and keep them for `simgrab.io.models.recall`.

    ``refuse`` makes the error to raise from a message, for files that cannot be read or decoded, are larger than
    `simgrab.io.models.MOST_BYTES` in total, or than `MOST_PIXELS` each.
    """
    path, left = Path(path), MOST_BYTES
    if not is_dir(path, refuse):
        return of_files(path.name, {path.name: read_bytes(path, refuse, most_bytes=left)}, refuse)
    root, files = Path(os.path.realpath(path)), dict[str, bytes]()  # `Path.resolve` raises at a loop of links
    path = path if path.name not in ("", "..") else root
    if not path.name:
        raise refuse(f"{path} is the root of a disk; name a folder of photographs")
    try:
        listed = pictures.of(path, [f".{ending}" for ending in PHOTOGRAPHS])
    except OSError as problem:
        raise refuse(f"{path}: cannot be listed ({first_line(problem)})") from None
    for file in listed:
        if not Path(os.path.realpath(file)).is_relative_to(root):
            raise refuse(f"{file.name} is a link to a file outside {path.name}")
        if len(files) >= MOST_FILES:
            raise refuse(f"{path.name} has more than {MOST_FILES} photographs")
        files[f"{path.name}/{file.name}"] = read_bytes(file, refuse, most_bytes=left)
        left -= len(files[f"{path.name}/{file.name}"])
    return of_files(path.name, files, refuse)


def of_files(name: str, files: Mapping[str, bytes], refuse: Refuse) -> ModelFile:
    """Keep photographs given as bytes, with the checks of `read`."""
    if not files:
        raise refuse(f"{name} holds no photograph; they end in {', '.join('.' + ending for ending in PHOTOGRAPHS)}")
    if sum(map(len, files.values())) > MOST_BYTES or len(files) > MOST_FILES:
        raise refuse(f"{name}: more than {MOST_BYTES >> 20} MiB or {MOST_FILES} files")
    for file, data in files.items():
        if file == name and ending(file) in VIDEOS:
            _decoded(file, data, refuse)
        elif ending(file) in PHOTOGRAPHS:
            _photograph(file, data, refuse)
        else:
            known = ", ".join(f".{ending}" for ending in (*PHOTOGRAPHS, *VIDEOS))
            raise refuse(f"{file}: must be a folder, or end in one of {known}")
    return remember(ModelFile(name, files))


class Sequence:
    """The pictures of a model that `read` has read, by number; those of a video follow each other in time."""

    def __init__(self, model: ModelFile, refuse: Refuse) -> None:
        self._model, self._refuse = model, refuse
        self.is_video = ending(model.name) in VIDEOS and model.name in model.files
        self._names = sorted(model.files)
        self._count = _count(model.name, model.data, refuse) if self.is_video else len(self._names)
        self._frames: Iterator[av.VideoFrame] | None = None
        self._next = 0
        self._kept = lru_cache(maxsize=_KEPT)(lambda name: _photograph(name, model.files[name], refuse))

    def __len__(self) -> int:
        return self._count

    def shared_out(self, shares: Mapping[str, float]) -> dict[str, list[int]]:
        """Share the photographs out by the hash of their names alone, so that none moves as a folder grows.

        A part in whose share no hash lies yet takes the photograph of the nearest one. A video, and fewer photographs
        than parts, are not shared out: then nothing is returned.
        """
        if self.is_video or self._count < len(shares):
            return {}
        hashes = [_hash(PurePosixPath(name).name) for name in self._names]
        ends = dict(zip(shares, itertools.accumulate(shares.values()), strict=True))
        ends[[*shares][-1]] = 1.0  # in spite of rounding
        part_of = [next(part for part, end in ends.items() if at < end) for at in hashes]
        for part, end in ends.items():
            if part not in part_of:
                spare = [number for number, other in enumerate(part_of) if part_of.count(other) > 1]
                part_of[min(spare, key=lambda n: abs(hashes[n] - (end - shares[part] / 2)))] = part
        return {part: [n for n, other in enumerate(part_of) if other == part] for part in shares}

    def __getitem__(self, number: int) -> Picture:
        """Decode a picture, RGB, shape (height, width, 3); a video is decoded fastest in frame order."""
        if not self.is_video:
            picture: Picture = self._kept(self._names[number])
            return picture
        if self._frames is None or number < self._next:
            container, stream = _video(self._model.name, self._model.data, self._refuse)
            self._frames, self._next = container.decode(stream), 0
            self._playback = Playback(stream, lambda why: self._refuse(f"{self._model.name}: {why}"))
        try:
            while True:
                frame = next(self._frames)
                self._next += 1
                if self._next > number:
                    return self._playback.picture(frame)
        except (av.FFmpegError, StopIteration):
            self._frames = None
            raise self._refuse(f"{self._model.name}: frame {self._next} of {self._count} cannot be decoded") from None


def _hash(name: str) -> float:
    """Uniform in [0, 1)."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:6]) / 2**48


def _photograph(name: str, data: bytes, refuse: Refuse) -> Picture:
    try:
        picture = pictures.decode(data, name)
    except PictureError as problem:
        raise refuse(f"{name}: {problem.reason}") from None
    _check_size(name, picture.shape[1], picture.shape[0], refuse)
    return picture


def _check_size(name: str, width: int, height: int, refuse: Refuse) -> None:
    if width * height > MOST_PIXELS:
        raise refuse(f"{name}: has {width}x{height} pixels; at most {MOST_PIXELS // 10**6} million are shown")
    if min(width, height) < LEAST_SIDE_PX:
        raise refuse(f"{name}: has {width}x{height} pixels; at least {LEAST_SIDE_PX} a side are needed")


def _video(name: str, data: bytes, refuse: Refuse) -> tuple[InputContainer, VideoStream]:
    """Open a video and the stream that players show."""
    container = open_video(io.BytesIO(data), lambda why: refuse(f"{name}: {why}"))
    stream = stream_of(container)
    codec = stream.codec_context
    _check_size(name, *squared(codec.width, codec.height, aspect_of(stream)), refuse)
    return container, stream


def _decoded(name: str, data: bytes, refuse: Refuse) -> None:
    container, stream = _video(name, data, refuse)
    with container:
        try:
            Playback(stream, lambda why: refuse(f"{name}: {why}")).picture(next(container.decode(stream)))
        except (av.FFmpegError, StopIteration):
            raise refuse(f"{name}: no frame of it can be decoded") from None


def _count(name: str, data: bytes, refuse: Refuse) -> int:
    """Count the frames of a video without decoding them."""
    container, stream = _video(name, data, refuse)
    with container:
        try:
            count = sum(packet.size > 0 for packet in container.demux(stream))
        except av.FFmpegError:
            raise refuse(f"{name}: is truncated, or not a video") from None
    if not 0 < count <= MOST_FRAMES:
        raise refuse(f"{name}: has {count} frames; 1 to {MOST_FRAMES} are shown")
    return count
