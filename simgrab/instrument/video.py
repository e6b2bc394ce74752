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
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from statistics import median
from typing import Any, BinaryIO

import av
import av.error
from av.container import InputContainer
from av.packet import Packet
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from simgrab.errors import SourceError, first_line
from simgrab.instrument.contract import Frame
from simgrab.instrument.estimate.frames import LATEST_S
from simgrab.io import containers
from simgrab.io.pictures import too_large
from simgrab.io.playback import Playback, aspect_of, squared, stream_of
from simgrab.runtime.environment import MOST_PIXELS
from simgrab.text import printable

PATIENCE_S = (15.0, 15.0)  # to open a stream, and for its next packet
MOST_LOST = 600  # frames that a gap counts as; a longer one is one lost frame
# FFmpeg's names of formats that hold pictures themselves and open nothing else.
FORMATS = (
    "mov", "mp4", "matroska", "webm", "avi", "mpegts", "mpeg", "mpegvideo", "h264", "hevc", "m4v", "mjpeg", "obu",
    "ivf", "flv", "live_flv", "asf", "dhav", "mxf", "ogg", "dv", "nut", "yuv4mpegpipe", "mpjpeg", "jpeg_pipe", "gif",
    "apng", "wtv", "rm",
)  # fmt: skip
STREAM_FORMATS = ("rtsp", "rtp")
SCHEMES = ("rtsp", "rtsps", "rtmp", "rtmps", "http", "https", "srt", "udp", "rtp", "tcp")
PROTOCOLS = (*SCHEMES, "srtp", "tls", "httpproxy")
_KINDS = "MP4, MOV, Matroska, AVI, MPEG, FLV, ASF, MXF, Ogg or a raw stream; playlists are not followed"
_STEPS = 31  # time steps of which the median is what a step should be
UNTIMED_HZ = 9.0  # of the port's camera, where nothing states a rate
_BACK_S = (0.0, 10.0, math.inf)  # by how much earlier a file is searched where there is no key frame before a time
_MOST_HZ = 1000  # that a coded picture's rate is believed
_NO_TIMESTAMPS = 0x80  # FFmpeg's AVFMT_NOTIMESTAMPS


class Video:
    """A video file.

    Parameters
    ----------
    path : Path
    rate_hz : float, optional
        Of the frames, where the file has no time stamps; 9 unless it states a rate.

    Attributes
    ----------
    name : str
    count : int or None
        Frames, where the file states them or its length; then about so many.
    timed : bool
        Whether it has time stamps, or a rate in their place.

    Raises
    ------
    SourceError
        If it cannot be opened, has no pictures or too large ones.
    """

    live = False

    def __init__(self, path: Path, rate_hz: float | None = None) -> None:
        self.name, self._path, self._rate_hz = printable(path), path, rate_hz
        with self._file() as file:
            self._extent = containers.extent(file)
        with self.opened() as stream, self._file() as file:
            self.count, self.timed = _count(stream), _timed(stream) and not containers.lacks_rate(file)
            if containers.crops(file, stream.codec_context.width, stream.codec_context.height):
                raise SourceError(f"{self.name}: its container crops the pictures; crop the coded ones instead")

    def __iter__(self) -> Iterator[Frame]:
        """Decode from the beginning, as `simgrab.io.playback` shows frames. Time counts from the first.

        Raises
        ------
        SourceError
            If the file is gone, breaks off before its first picture, or its pictures are turned by less than a quarter.
        """
        with self.opened() as stream:
            yield from _with_gaps(self._decoded(stream, _Clock(stream, self.timed, self._rate_hz)))

    def from_time(self, time_s: float) -> Generator[Frame, None, None]:
        """Decode from a key frame at or before a time, or from the beginning where the file cannot be searched.

        Raises
        ------
        SourceError
            If the file is gone, or cannot be read from there.
        """
        for back_s in _BACK_S:
            with self.opened() as stream:
                clock = _Clock(stream, self.timed, self._rate_hz)
                searched = clock.searchable and back_s < math.inf
                if searched:
                    clock.origin = self._origin
                    self._seek(stream, time_s - back_s + clock.origin)
                frames = self._decoded(stream, clock)
                first = next(frames, None)
                # Some formats are searched to any frame, after which the next key frame is the first that is decoded.
                early = first is not None and first.picture is not None and (first.time_s or 0.0) <= time_s
                if first is not None and (early or not searched):
                    yield first
                    yield from frames
                    return

    def _seek(self, stream: VideoStream, stamp_s: float) -> None:
        container: Any = stream.container
        try:
            container.seek(math.floor(stamp_s / (stream.time_base or 1)), stream=stream, backward=True)
        except (av.error.FFmpegError, OSError, OverflowError) as problem:
            raise SourceError(f"{self.name}: cannot be read from {stamp_s:g} s ({first_line(problem)})") from None

    @contextmanager
    def opened(self) -> Iterator[VideoStream]:
        """Open the stream of its container that is read.

        Raises
        ------
        SourceError
            If the file is gone.
        """
        # No protocol: FFmpeg opens nothing itself.
        rules = {"format_whitelist": ",".join(FORMATS), "protocol_whitelist": "none"}
        with self._file() as file, closing(_open(_First(file, self._extent.end), self.name, rules)) as container:
            yield _stream(container)

    @cached_property
    def _origin(self) -> float:
        """Time stamp that counts as 0, s: the first frame's."""
        with self.opened() as stream:
            clock = _Clock(stream, self.timed)
            return next((clock.origin for _ in self._decoded(stream, clock) if clock.origin is not None), 0.0)

    def _decoded(self, stream: VideoStream, clock: _Clock) -> Iterator[Frame]:
        return _decoded(stream, clock, self.name, whole=self._extent.whole)

    def _file(self) -> BinaryIO:
        try:
            return self._path.open("rb")
        except OSError as problem:
            raise SourceError(f"{self.name}: cannot be read ({first_line(problem)})") from None


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
    rate_hz : float, optional
        As of a `Video`.

    Attributes
    ----------
    name : str
    count : int or None
        Frames, where the stream is a file that states them.
    timed : bool
        Whether it has time stamps.

    Raises
    ------
    SourceError
        If it cannot be opened, has no pictures or too large ones.
    """

    live = True

    def __init__(self, url: str, rate_hz: float | None = None) -> None:
        self.name, self._rate_hz = printable(url), rate_hz
        scheme = url.partition("://")[0].lower()
        if scheme not in SCHEMES:
            streams = ", ".join(f"{s}://" for s in SCHEMES)
            raise SourceError(f"{self.name}: a stream URL must begin with {streams}; give a file by its path alone")
        rules = {
            "format_whitelist": ",".join((*FORMATS, *STREAM_FORMATS)),
            "protocol_whitelist": ",".join(PROTOCOLS),
        }
        self._container: InputContainer | None = _open(url, self.name, rules)
        stream = _stream(self._container)
        self.count, self.timed = _count(stream), _timed(stream)

    def __iter__(self) -> Iterator[Frame]:
        """Decode from now on, as a `Video`; time counts from the first frame.

        Raises
        ------
        SourceError
            If it is read a second time, or breaks off before its first picture.
        """
        container, self._container = self._container, None
        if container is None:
            raise SourceError(f"{self.name}: a stream can be read once")
        with container:
            stream = _stream(container)
            yield from _with_gaps(_decoded(stream, _Clock(stream, self.timed, self._rate_hz), self.name, whole=True))


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
    _stream(container).codec_context.options = {"max_pixels": str(MOST_PIXELS)}
    return container


def _stream(container: InputContainer) -> VideoStream:
    stream = stream_of(container.streams.video)
    assert stream is not None  # else `_problem` refuses it
    return stream


def _problem(container: InputContainer) -> str:
    stream = stream_of(container.streams.video)
    if stream is None:
        return "it has no pictures"
    codec: Any = stream.codec_context  # None where FFmpeg has no decoder
    if codec is None:
        return "its pictures are coded in a way that is not known"
    # As shown: a pixel may be wide.
    return too_large(codec.width, codec.height) or too_large(*squared(codec.width, codec.height, aspect_of(stream)))


def _timed(stream: VideoStream) -> bool:
    """Whether the container has time stamps or a rate. Where it has none, FFmpeg makes up 25 frames/s."""
    kind = stream.container.format
    return not kind.flags & _NO_TIMESTAMPS and not kind.name.endswith("_pipe")


def _count(stream: VideoStream) -> int | None:
    rate = stream.guessed_rate or stream.average_rate
    if stream.frames or not (stream.duration and stream.time_base and rate):
        return stream.frames or None
    return round(stream.duration * stream.time_base * rate)


def _decoded(stream: VideoStream, clock: _Clock, name: str, *, whole: bool) -> Iterator[Frame]:
    """Pictures as they come, damaged ones as lost frames; ends with a lost frame where the video breaks off."""
    container: Any = stream.container
    stream.codec_context.thread_count = 1  # the next picture is decoded while a core processes this one
    playback = Playback(stream, lambda why: SourceError(f"{name}: {why}"))
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
        for frame in _pictures(_rest(stream) if ended else packet, clock, playback):
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


def _pictures(packet: Packet[Any], clock: _Clock, playback: Playback) -> Iterator[Frame]:
    try:
        for picture in packet.decode():
            yield _frame(picture, clock, playback)
    except av.error.FFmpegError as problem:
        yield Frame(None, clock.next(None), f"cannot be decoded ({first_line(problem)})")


def _frame(picture: VideoFrame, clock: _Clock, playback: Playback) -> Frame:
    time = clock.next(clock.stamp(picture))
    if picture.is_corrupt:
        return Frame(None, time, "damaged in the video")
    note = "; ".join(filter(None, (playback.note(picture), clock.note)))
    return Frame(playback.picture(picture), time, note=note)


class _Clock:
    """Times of frames, from the first: their time stamps, as long as these increase.

    Attributes
    ----------
    step : float
        Between frames that have no time stamps, s.
    note : str
        What was assumed of the step; empty where nothing was.
    origin : float or None
        Time stamp that counts as 0, s; None as long as there was none.
    searchable : bool
        Whether frames have the same times wherever decoding begins.
    """

    def __init__(self, stream: VideoStream, timed: bool, rate_hz: float | None = None) -> None:
        self._timed = timed
        self._numbered = stream.container.format.name == "avi"  # whose frames have numbers, in the order of decoding
        self.searchable = self._timed and not (self._numbered and stream.codec_context.has_b_frames)
        if self._timed:
            rate = stream.average_rate or stream.guessed_rate
        else:
            stated = stream.codec_context.framerate  # beside the pictures, which may be the resolution of lost stamps
            rate = Fraction(rate_hz) if rate_hz else stated if stated and stated <= _MOST_HZ else None
        self.note = "" if rate or self._timed else f"without time stamps, {UNTIMED_HZ:g} frames/s are assumed (--rate)"
        self.step = 1 / float(rate or UNTIMED_HZ)
        self.origin: float | None = None
        self._last: float | None = None

    def stamp(self, picture: VideoFrame) -> float | None:
        """Time stamp of a decoded frame, s, or None."""
        ticks = picture.dts if self._numbered else picture.pts
        return None if ticks is None or picture.time_base is None else float(ticks * picture.time_base)

    def next(self, stamp: float | None) -> float:
        """Time of the next frame; a step after the last where its stamp is missing, goes back or exceeds LATEST_S."""
        # A step may be less than what doubles resolve there.
        time = 0.0 if self._last is None else max(self._last + self.step, math.nextafter(self._last, math.inf))
        if self._timed and stamp is not None and abs(stamp) <= LATEST_S:
            self.origin = stamp - time if self.origin is None else self.origin
            stated = stamp - self.origin
            time = stated if self._last is None or stated > self._last else time
        self._last = time
        return time


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
