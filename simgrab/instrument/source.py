"""Sources of frames: a video file, a stream, a folder of pictures, or a rendered dataset."""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias
from urllib.parse import urlsplit

from simgrab.errors import CalibrationError, LayoutError, PictureError, SimgrabError, SourceError, first_line
from simgrab.instrument.contract import Frame
from simgrab.instrument.video import UNTIMED_HZ, Stream, Video
from simgrab.io import pictures
from simgrab.io.parse import kind_of
from simgrab.model.calibration import Calibration
from simgrab.model.records import frame_files
from simgrab.text import encodable, printable

_RATE_IS_OF = "--rate applies to image folders and to videos without time stamps"
MATCHED = "matched"  # the folder that `simgrab match` writes by default
CLIP_GAP_S = 60.0  # between a dataset's clips, which are records of their own


@dataclass(frozen=True)
class PictureFiles:
    """Picture files, each read when it is needed."""

    name: str
    files: tuple[Path, ...]
    times: tuple[float | None, ...]
    root: Path
    labels_sha256: str = ""  # SHA-256 of a dataset's labels, which identifies it; empty for a folder of pictures
    bits: int | None = None  # bits of a value of 16-bit pictures, as `simgrab.io.pictures.bits` finds them
    note: str = ""  # assumptions on all pictures, or pictures left out; mostly empty
    live = False

    @property
    def count(self) -> int:
        """How many files."""
        return len(self.files)

    def __iter__(self) -> Iterator[Frame]:
        """Read each file; a file that is not a picture is a lost frame."""
        for path, time in zip(self.files, self.times, strict=True):
            name = encodable(path.relative_to(self.root))
            try:
                picture = pictures.read(path, bits=self.bits)
            except PictureError as problem:
                reason = f"{printable(name)} cannot be read as an image: {problem.reason}"
                yield Frame(None, time, reason, name)
            else:
                yield Frame(picture, time, name=name, note=self.note)


Source: TypeAlias = PictureFiles | Video | Stream


def open_source(source: str | Path, *, rate_hz: float | None = None) -> Source:
    """Open a source of frames.

    Parameters
    ----------
    source : str or path
        A video file, the URL of a stream (``rtsp://…``), a picture or a folder of pictures, or a rendered dataset.
        Nothing else is opened: playlists and scripts, which name other files, are refused.
    rate_hz : float, optional
        Frame rate of pictures in a folder, by default 9, or of a video without time stamps, by default its stated rate
        or else 9. It is an error for a source with its own times.

    Raises
    ------
    SourceError
        If the source is none of these, or cannot be opened.
    DatasetError
        If the source is a dataset that cannot be read.
    """
    _refuse_empty(source)
    if "://" in str(source):
        return _untimed(Stream(str(source), rate_hz), rate_hz)
    path = Path(source)
    try:
        mode = path.stat().st_mode
        if stat.S_ISDIR(mode):
            return dataset_files(path, rate_hz) if frame_files.is_dataset(path) else _folder(path, rate_hz)
    except FileNotFoundError:
        raise SourceError(f"{path}: there is no such file or folder") from None
    except SimgrabError:
        raise
    except (OSError, ValueError) as problem:  # ValueError: a name with a NUL byte
        raise SourceError(f"{path}: cannot be read ({first_line(problem)})") from None
    if not stat.S_ISREG(mode):
        raise SourceError(f"{path}: it is {kind_of(mode)}, not a file or folder")
    if path.suffix.lower() in pictures.SUFFIXES:
        if rate_hz is not None:
            raise SourceError(f"{path}: {_RATE_IS_OF}; this is one picture")
        bits = pictures.bits((path,))
        return PictureFiles(printable(path), (path,), (0.0,), path.parent, bits=bits, note=pictures.scaled(bits))
    return _untimed(Video(path, rate_hz), rate_hz)


def _refuse_empty(source: str | Path) -> None:
    if not isinstance(source, str | os.PathLike):
        raise SourceError(f"a source is a path or a URL, got {type(source).__name__}")
    if not str(source):  # which as a path would be the working folder
        raise SourceError("the source is empty: name a video, a stream's URL, a folder of pictures, or a dataset")


def _folder(path: Path, rate_hz: float | None) -> PictureFiles:
    files = pictures.of(path)
    if not files:
        raise SourceError(f"{path}: it contains no pictures ({', '.join(pictures.SUFFIXES)})")
    rate = UNTIMED_HZ if rate_hz is None else rate_hz
    times = tuple(i / rate for i in range(len(files)))
    bits = pictures.bits(files)
    note = "; ".join(filter(None, (pictures.scaled(bits), pictures.hidden(path))))
    return PictureFiles(printable(path), files, times, path, bits=bits, note=note)


def _untimed(video: Video | Stream, rate_hz: float | None) -> Source:
    if rate_hz is not None and video.timed:
        raise SourceError(f"{video.name} has its own time stamps; {_RATE_IS_OF}")
    return video


def dataset_files(path: Path, rate_hz: float | None = None) -> PictureFiles:
    """Find the pictures of a dataset; independent frames have no time."""
    if rate_hz is not None:
        raise SourceError(f"{printable(path)} is a dataset, whose labels contain the times; {_RATE_IS_OF}")
    rows, labels_sha256 = frame_files.read(path)
    times: list[float | None] = []
    begin, clip = 0.0, rows[0].clip
    for row in rows:
        if row.clip != clip:
            begin, clip = max((t for t in times if t is not None), default=0.0) + CLIP_GAP_S, row.clip
        times.append(None if row.time_s is None else begin + row.time_s)
    files = tuple(path / row.file for row in rows)
    return PictureFiles(printable(path), files, tuple(times), path, labels_sha256)


def camera_beside(source: str | Path) -> Path:
    """Find the camera TOML of a source.

    In a folder it is ``camera.toml``. Of a video or picture it is ``NAME.camera.toml`` beside it, as
    `simgrab render --video` writes it, or ``camera.toml`` beside it, or in the folder ``matched`` beside it or here, as
    `simgrab match` writes it; the first of these.

    Raises
    ------
    SourceError
        If there is no camera file, or no source.
    DatasetError
        If the source is a dataset that cannot be read, such as an unfinished one.
    """
    _refuse_empty(source)
    path = Path(source)
    if "://" not in str(source):
        # Unlike Path's methods these answer no where a name is too long or a folder closed.
        if os.path.isdir(path):  # noqa: PTH112
            places = [path / "camera.toml"]
        else:
            folders = (path.parent, path.parent / MATCHED, Path(MATCHED))
            places = [path.with_suffix(".camera.toml"), *(folder / "camera.toml" for folder in folders)]
        for place in places:
            if os.path.isfile(place):  # noqa: PTH113
                return place
        open_source(path)  # which raises the reason for an invalid source
    raise SourceError(
        f"{source}: there is no camera file in it or beside it; name one by --camera (simgrab match writes one)"
    )


def plain_name(source: str) -> str:
    """Name of a source for a folder of results: without folders, suffix, and what a URL has beside its path."""
    if "://" in source:
        return Path(urlsplit(source).path).stem or "stream"
    path = Path(os.path.abspath(source))  # noqa: PTH100
    return path.name if os.path.isdir(path) else path.stem  # noqa: PTH112


def fitting(frames: Iterator[Frame], calibration: Calibration) -> Iterator[Frame]:
    """Turn pictures of another size than the camera's into lost frames.

    Raises `SourceError` if the first picture has another size: then source and camera file do not belong together.
    """
    size = (calibration.width_px, calibration.height_px)
    seen = False
    for frame in frames:
        if frame.picture is not None:
            given = (frame.picture.shape[1], frame.picture.shape[0])
            if given != size:
                problem = f"an image of {given[0]}x{given[1]} px, but the camera file states {size[0]}x{size[1]} px"
                if not seen:
                    named = f"{frame.name} is {problem}" if frame.name else problem
                    note = f" ({frame.note})" if frame.note else ""
                    cure = ""
                    with contextlib.suppress(CalibrationError, LayoutError):
                        calibration.scaled(*given)
                        cure = f"; if the view is the same, simgrab.calibration.load(FILE).scaled{given} is the camera"
                    raise SourceError(f"{named}: they do not match{note}{cure}")
                frame = Frame(None, frame.time_s, problem, frame.name)
            seen = True
        yield frame
