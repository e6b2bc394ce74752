"""Videos and streams, decoded by FFmpeg: what was lost leaves lost frames, what breaks off gives what it held.

A source is the one file or stream that was named: FFmpeg gets an open file, or a network protocol, and only formats
that hold pictures themselves. Playlists and scripts, which name other files, are refused.
"""

from __future__ import annotations

import math
import os
from collections import deque
from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from statistics import median
from typing import Any, BinaryIO

import av
import av.error
import numpy as np
from av.container import InputContainer
from av.packet import Packet
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from simgrab.errors import SourceError, first_line
from simgrab.instrument.contract import Frame
from simgrab.instrument.estimate.frames import LATEST_S
from simgrab.text import printable
from simgrab.utilities import containers
from simgrab.utilities.environment import MOST_PIXELS
from simgrab.utilities.pictures import too_large

PATIENCE_S = (15.0, 15.0)  # to open a stream, and for its next packet
MOST_LOST = 600  # frames that a gap counts as; a longer one is one lost frame
# FFmpeg's names of formats that hold pictures themselves and open nothing else.
FORMATS = (
    "mov", "mp4", "matroska", "webm", "avi", "mpegts", "mpeg", "mpegvideo", "h264", "hevc", "m4v", "mjpeg", "obu",
    "ivf", "flv", "live_flv", "asf", "dhav", "mxf", "ogg", "dv", "nut", "yuv4mpegpipe", "mpjpeg", "gif", "wtv", "rm",
)  # fmt: skip
STREAM_FORMATS = ("rtsp", "rtp")
SCHEMES = ("rtsp", "rtsps", "rtmp", "rtmps", "http", "https", "srt", "udp", "rtp", "tcp")
PROTOCOLS = (*SCHEMES, "srtp", "tls", "httpproxy")
_KINDS = "MP4, MOV, Matroska, AVI, MPEG, FLV, ASF, MXF, Ogg or a raw stream; playlists are not followed"
_STEPS = 31  # time steps of which the median is what a step should be
_UNTIMED_HZ = 9.0  # of a stream that does not state its rate


class Video:
    """A video file.

    Parameters
    ----------
    path : Path

    Attributes
    ----------
    name : str
    count : int or None
        Frames, where the file states them or its length; then about so many.

    Raises
    ------
    SourceError
        If it cannot be opened, has no pictures or too large ones.
    """

    live = False

    def __init__(self, path: Path) -> None:
        self.name, self._path = printable(path), path
        with self._file() as file:
            self._extent = containers.extent(file)
        with self._opened() as container:
            self.count = _count(container.streams.video[0])

    def __iter__(self) -> Iterator[Frame]:
        """Decode from the beginning. The time of a frame is its time stamp.

        Raises
        ------
        SourceError
            If the file is gone, or breaks off before its first picture.
        """
        with self._opened() as container:
            yield from _with_gaps(_decoded(container, self.name, whole=self._extent.whole))

    def from_time(self, time_s: float) -> Generator[Frame, None, None]:
        """Decode from the last key frame at or before a time; frames have their time stamps.

        Raises
        ------
        SourceError
            If the file is gone, or cannot be read from there.
        """
        with self._opened() as container:
            stream = container.streams.video[0]
            if stream.time_base is not None:
                try:
                    container.seek(math.floor(time_s / stream.time_base), stream=stream, backward=True)
                except (av.error.FFmpegError, OSError, OverflowError) as problem:
                    raise SourceError(
                        f"{self.name}: cannot be read from {time_s:g} s ({first_line(problem)})"
                    ) from None
            yield from _decoded(container, self.name, whole=self._extent.whole)

    def _file(self) -> BinaryIO:
        try:
            return self._path.open("rb")
        except OSError as problem:
            raise SourceError(f"{self.name}: cannot be read ({first_line(problem)})") from None

    @contextmanager
    def _opened(self) -> Iterator[InputContainer]:
        # No protocol: FFmpeg opens nothing itself.
        rules = {"format_whitelist": ",".join(FORMATS), "protocol_whitelist": "none"}
        with self._file() as file, closing(_open(_First(file, self._extent.end), self.name, rules)) as container:
            yield container


class _First:
    """The first bytes of a file, as a file."""

    def __init__(self, file: BinaryIO, end: int) -> None:
        self._file, self._end = file, end
        self.name, self.tell = file.name, file.tell  # FFmpeg knows some formats by their names

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        if whence == os.SEEK_END:
            return self._file.seek(self._end + offset)
        return self._file.seek(offset, whence)

    def read(self, size: int) -> bytes:
        return self._file.read(max(min(size, self._end - self._file.tell()), 0))


class Stream:
    """A stream, which can be read once.

    Parameters
    ----------
    url : str

    Attributes
    ----------
    name : str
    count : int or None
        Frames, where the stream is a file that states them.

    Raises
    ------
    SourceError
        If it cannot be opened, has no pictures or too large ones.
    """

    live = True

    def __init__(self, url: str) -> None:
        self.name = printable(url)
        scheme = url.partition("://")[0].lower()
        if scheme not in SCHEMES:
            streams = ", ".join(f"{s}://" for s in SCHEMES)
            raise SourceError(f"{self.name}: a stream URL must begin with {streams}; give a file by its path alone")
        rules = {
            "format_whitelist": ",".join((*FORMATS, *STREAM_FORMATS)),
            "protocol_whitelist": ",".join(PROTOCOLS),
        }
        self._container: InputContainer | None = _open(url, self.name, rules)
        self.count = _count(self._container.streams.video[0])

    def __iter__(self) -> Iterator[Frame]:
        """Decode from now on. The time of a frame is its time stamp.

        Raises
        ------
        SourceError
            If it is read a second time, or breaks off before its first picture.
        """
        container, self._container = self._container, None
        if container is None:
            raise SourceError(f"{self.name}: a stream can be read once")
        with container:
            yield from _with_gaps(_decoded(container, self.name, whole=True))


def _open(source: str | _First, name: str, rules: dict[str, str]) -> InputContainer:
    try:
        container = av.open(source, "r", options=rules, timeout=PATIENCE_S)
    except (av.error.ArgumentError, av.error.InvalidDataError):
        raise SourceError(f"{name}: not a video that can be opened (damaged, cut off, or no {_KINDS})") from None
    except (av.error.FFmpegError, OSError, ValueError) as problem:
        raise SourceError(f"{name}: not a video that can be opened ({first_line(problem)})") from None
    if refused := _problem(container):
        container.close()
        raise SourceError(f"{name}: {refused}")
    # Pictures may change their size later.
    container.streams.video[0].codec_context.options = {"max_pixels": str(MOST_PIXELS)}
    return container


def _problem(container: InputContainer) -> str:
    if not container.streams.video:
        return "it has no pictures"
    codec: Any = container.streams.video[0].codec_context  # None where FFmpeg has no decoder
    if codec is None:
        return "its pictures are coded in a way that is not known"
    return too_large(codec.width, codec.height)


def _count(stream: VideoStream) -> int | None:
    rate = stream.guessed_rate or stream.average_rate
    if stream.frames or not (stream.duration and stream.time_base and rate):
        return stream.frames or None
    return round(stream.duration * stream.time_base * rate)


def _decoded(container: InputContainer, name: str, *, whole: bool) -> Iterator[Frame]:
    """Pictures as they come, damaged ones as lost frames; ends with a lost frame where the video breaks off."""
    stream = container.streams.video[0]
    stream.codec_context.thread_count = 1  # the next picture is decoded while a core processes this one
    clock = _Clock(stream)
    packets = container.demux(stream)
    broken, ended, seen = "" if whole else "the file is cut off", False, False
    while not ended:
        try:
            packet = next(packets)
        except StopIteration:
            break
        except (av.error.FFmpegError, OSError) as problem:
            broken, ended = first_line(problem), True
        else:
            ended = packet.is_corrupt and not whole  # the last one, of which only a part is there
        for frame in _pictures(_rest(stream) if ended else packet, clock):
            seen = seen or frame.picture is not None
            yield frame
    if broken and not seen:
        raise SourceError(f"{name}: the video ends before its first image ({broken}){_advice(name, container)}")
    if broken:
        yield Frame(None, clock.next(None), f"the video is truncated here ({broken})")


def _advice(name: str, container: InputContainer) -> str:
    if name.lower().startswith("http") and "mp4" in container.format.name:
        return "; an MP4 with its index at the end needs an HTTP server with byte ranges: download it first"
    return ""


def _rest(stream: VideoStream) -> Packet[Any]:
    """Give the packet after the last, for which a decoder gives the pictures that it holds back."""
    packet = Packet()
    packet.stream = stream
    if stream.time_base is not None:
        packet.time_base = stream.time_base
    return packet


def _pictures(packet: Packet[Any], clock: _Clock) -> Iterator[Frame]:
    try:
        for picture in packet.decode():
            yield _frame(picture, clock)
    except av.error.FFmpegError as problem:
        yield Frame(None, clock.next(None), f"cannot be decoded ({first_line(problem)})")


def _frame(picture: VideoFrame, clock: _Clock) -> Frame:
    time = clock.next(picture.time)
    if picture.is_corrupt:
        return Frame(None, time, "damaged in the video")
    return Frame(np.asarray(picture.to_ndarray(format="rgb24"), np.uint8), time)


class _Clock:
    """Times of frames: their time stamps, as long as these increase."""

    def __init__(self, stream: VideoStream) -> None:
        rate = stream.average_rate or stream.guessed_rate
        self.step = 1 / float(rate) if rate else 1 / _UNTIMED_HZ
        self._last: float | None = None

    def next(self, stamp: float | None) -> float:
        """Time of the next frame; a step after the last where its stamp is missing, goes back or exceeds LATEST_S."""
        if stamp is None or not abs(stamp) <= LATEST_S or (self._last is not None and stamp <= self._last):
            # A step may be less than what doubles resolve there.
            stamp = 0.0 if self._last is None else max(self._last + self.step, math.nextafter(self._last, math.inf))
        self._last = stamp
        return stamp


def _with_gaps(frames: Iterator[Frame]) -> Iterator[Frame]:
    """Put lost frames where the times leave room for them; the rate may change and is followed."""
    steps: deque[float] = deque(maxlen=_STEPS)
    last: float | None = None
    for frame in frames:
        assert frame.time_s is not None
        if last is not None:
            gap = frame.time_s - last
            missing = round(gap / median(steps)) - 1 if steps else 0
            steps.append(gap)
            if missing > MOST_LOST:
                yield Frame(None, last + gap / 2, f"{gap:.0f} s without a picture")
            else:
                for k in range(1, missing + 1):
                    yield Frame(None, last + gap * k / (missing + 1), f"lost: {gap:.2f} s without a picture")
        last = frame.time_s
        yield frame
