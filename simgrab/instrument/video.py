"""Videos and streams, decoded by FFmpeg. Gaps become lost frames; a truncated video gives the frames before its end."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from statistics import median
from typing import Any

import av
import av.error
from av.container import InputContainer
from av.packet import Packet
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from simgrab.errors import SourceError, first_line
from simgrab.instrument.contract import Frame
from simgrab.instrument.estimate.frames import LATEST_S
from simgrab.io.parse import Refuse
from simgrab.io.playback import SCHEMES, Playback, open_video, stream_of
from simgrab.text import printable

GIVE_UP_S, RETRY_S = 600.0, 2.0  # how long a lost stream is asked for, and the pause before each time
JUMP_S = 5.0  # by which a live stream's time stamps may run ahead of this computer's clock, or go back
MOST_LOST = 600  # frames that a gap counts as; a longer one is one lost frame
_STEPS = 31  # time steps of which the median is what a step should be
UNTIMED_HZ = 9.0  # of the port's camera, where nothing states a rate
_BACK_S = (0.0, 10.0, math.inf)  # by how much earlier a file is searched where there is no key frame before a time
_MOST_HZ = 1000  # that a coded picture's rate is believed
_CUT_OFF = "the file is cut off"
_MOST_UNSTATED = 2  # frames by which a whole video may be shorter than its container states
_NO_TIMESTAMPS = 0x80  # FFmpeg's AVFMT_NOTIMESTAMPS


class Video:
    """A video file.

    Parameters
    ----------
    path : Path
    rate_hz : float, optional
        Rate of the frames, where the file has no time stamps; 9 unless it states a rate.

    Attributes
    ----------
    name : str
    count : int or None
        Number of frames, if the file states it; approximate if it states only its length.
    timed : bool
        Whether the file has time stamps, or a rate in their place.

    Raises
    ------
    SourceError
        If it cannot be opened, has no pictures or too large ones.
    """

    live = False

    def __init__(self, path: Path, rate_hz: float | None = None) -> None:
        self.name, self._path, self._rate_hz = printable(path), path, rate_hz
        with self.opened() as stream:
            self.count, self.timed = _count(stream), _timed(stream)

    def __iter__(self) -> Iterator[Frame]:
        """Decode from the beginning, as `simgrab.io.playback` shows frames. Time counts from the first.

        Raises `SourceError` if the file is gone, is truncated before its first picture, or its pictures are turned by
        other than quarter turns.
        """
        with self.opened() as stream:
            yield from _with_gaps(_decoded(stream, _Clock(stream, self.timed, self._rate_hz), self.name))

    def from_time(self, time_s: float) -> Generator[Frame, None, None]:
        """Decode from a key frame at or before a time, or from the beginning if the file cannot be searched.

        Raises `SourceError` if the file is gone, or cannot be read from there.
        """
        for back_s in _BACK_S:
            with self.opened() as stream:
                clock = _Clock(stream, self.timed, self._rate_hz)
                searched = clock.searchable and back_s < math.inf
                if searched:
                    clock.origin = self._origin
                    self._seek(stream, time_s - back_s + clock.origin)
                frames = _decoded(stream, clock, self.name)
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
        """Open the container, and its stream of pictures; raises `SourceError` if the file is gone."""
        try:
            file = self._path.open("rb")
        except OSError as problem:
            raise SourceError(f"{self.name}: cannot be read ({first_line(problem)})") from None
        with file, closing(open_video(file, _refusal(self.name))) as container:
            yield stream_of(container)

    @cached_property
    def _origin(self) -> float:
        """Time stamp that counts as 0, s: the first frame's."""
        with self.opened() as stream:
            clock = _Clock(stream, self.timed)
            frames = _decoded(stream, clock, self.name)
            return next((clock.origin for _ in frames if clock.origin is not None), 0.0)


class Stream:
    """A stream, which can be read once. One without an end is connected again where it is lost.

    Parameters
    ----------
    url : str
    rate_hz : float, optional
        As of a `Video`.

    Attributes
    ----------
    name : str
    count : int or None
        Number of frames, if the stream is a file that states it.
    timed : bool
        Whether it has time stamps.

    Raises
    ------
    SourceError
        If it cannot be opened, has no pictures or too large ones.
    """

    live = True

    def __init__(self, url: str, rate_hz: float | None = None) -> None:
        self.name, self._url, self._rate_hz = printable(url), url, rate_hz
        scheme = url.partition("://")[0].lower()
        if scheme not in SCHEMES:
            streams = ", ".join(f"{s}://" for s in SCHEMES)
            raise SourceError(f"{self.name}: a stream URL must begin with {streams}; give a file by its path alone")
        self._container: InputContainer | None = open_video(url, _refusal(self.name))
        stream = stream_of(self._container)
        self.count, self.timed = _count(stream), _timed(stream)

    def __iter__(self) -> Iterator[Frame]:
        """Decode from now on, as a `Video`; time counts from the first frame.

        Raises `SourceError` if it is read a second time, or ends before its first picture.
        """
        container, self._container = self._container, None
        if container is None:
            raise SourceError(f"{self.name}: a stream can be read only once")
        begin_s, last_s, ahead_s = 0.0, 0.0, -math.inf
        arrived, note, lost = time.monotonic(), "", False
        while container is not None:
            with container:
                stream = stream_of(container)
                endless = self.count is None and not container.duration and container.size <= 0
                clock = _Clock(stream, self.timed, self._rate_hz, begin_s, ahead_s, live=endless)
                try:
                    for frame in _with_gaps(_decoded(stream, clock, self.name, live=endless)):
                        yield replace(frame, note="; ".join(filter(None, (note, frame.note)))) if note else frame
                        note = ""
                        if frame.picture is not None:
                            last_s, ahead_s, arrived = frame.time_s or 0.0, clock.ahead_s, time.monotonic()
                except SourceError:  # it ends before its first picture
                    if not lost:
                        raise
            container = None
            while endless and container is None and time.monotonic() - arrived < GIVE_UP_S:
                time.sleep(RETRY_S)
                lost, begin_s = True, time.monotonic() + ahead_s
                note = f"connected again after {begin_s - last_s:.0f} s"
                try:
                    container = open_video(self._url, _refusal(self.name))
                except SourceError as problem:
                    yield Frame(None, time.monotonic() + ahead_s, f"no connection ({problem})")


def _refusal(name: str) -> Refuse:
    return lambda why: SourceError(f"{name}: {why}")


def _timed(stream: VideoStream) -> bool:
    """Whether the container has time stamps or a rate. Without either, FFmpeg assumes 25 frames/s."""
    kind = stream.container.format
    return not kind.flags & _NO_TIMESTAMPS and not kind.name.endswith("_pipe")


def _count(stream: VideoStream) -> int | None:
    rate = stream.guessed_rate or stream.average_rate
    if stream.frames or not (stream.duration and stream.time_base and rate):
        return stream.frames or None
    return round(stream.duration * stream.time_base * rate)


def _decoded(stream: VideoStream, clock: _Clock, name: str, *, live: bool = False) -> Iterator[Frame]:
    """Yield pictures, with damaged ones as lost frames; a truncated video ends with a lost frame."""
    stream.codec_context.thread_count = 1  # the next picture is decoded while a core processes this one
    playback = Playback(stream, _refusal(name))
    broken, seen = "", False
    for packet in _packets(stream, live=live):
        if isinstance(packet, str):
            broken = packet
            break
        for frame in _pictures(packet, clock, playback):
            seen = seen or frame.picture is not None
            yield frame
    if broken and not seen:
        raise SourceError(f"{name}: the video ends before its first image ({broken}){_advice(name, stream)}")
    if broken:
        yield Frame(None, clock.next(None), f"the video is truncated here ({broken})")


def _packets(stream: VideoStream, *, live: bool) -> Iterator[Packet[Any] | str]:
    """Yield the packets of a stream, one that flushes the decoder, and the reason of the end.

    The reason is empty if the stream is as long as the container states, as far as FFmpeg reports it.
    """
    container: Any = stream.container
    states_end, end = any(name in container.format.name for name in ("mp4", "matroska", "avi")), -math.inf
    try:
        for packet in container.demux(stream):
            if packet.is_corrupt and not live and states_end:  # it is the last, of which a part is there
                yield _rest(stream)
                yield _CUT_OFF
                return
            if packet.pts is not None and packet.time_base is not None:
                end = max(end, float((packet.pts + (packet.duration or 0)) * packet.time_base))
            yield packet
    except (av.error.FFmpegError, OSError) as problem:
        if not live:  # of a stream that stood still, the rest is of long ago
            yield _rest(stream)
        yield first_line(problem)
    else:
        rate = stream.average_rate or stream.guessed_rate
        if not live and rate and end + _MOST_UNSTATED / rate < _stated_end(stream):
            yield _CUT_OFF


def _stated_end(stream: VideoStream) -> float:
    """Time of a video's end, s, as MP4 and Matroska state it; for other formats FFmpeg estimates it."""
    container: Any = stream.container
    if "mp4" in container.format.name and stream.duration and stream.time_base:
        return float(((stream.start_time or 0) + stream.duration) * stream.time_base)
    if "matroska" in container.format.name and container.duration and len(container.streams) == 1:  # else it is of all
        return float(container.duration / av.time_base)
    return -math.inf


def _advice(name: str, stream: VideoStream) -> str:
    if name.lower().startswith("http") and "mp4" in stream.container.format.name:
        return "; an MP4 with its index at the end needs an HTTP server with byte ranges: download it first"
    return ""


def _rest(stream: VideoStream) -> Packet[Any]:
    """Make the packet that flushes the decoder."""
    packet = Packet()
    packet.stream = stream
    if stream.time_base is not None:
        packet.time_base = stream.time_base
    return packet


def _pictures(packet: Packet[Any], clock: _Clock, playback: Playback) -> Iterator[Frame]:
    try:
        for picture in packet.decode():
            time_s = clock.next(clock.stamp(picture))
            if picture.is_corrupt:
                yield Frame(None, time_s, "damaged in the video")
            else:
                note = "; ".join(filter(None, (playback.note(picture), clock.note, clock.jumped)))
                yield Frame(playback.picture(picture), time_s, note=note)
    except av.error.FFmpegError as problem:
        yield Frame(None, clock.next(None), f"cannot be decoded ({first_line(problem)})")


class _Clock:
    """Times of frames since the first: their time stamps, if these increase.

    Where stamps of a live stream jump, the times go on by this computer's clock.

    Attributes
    ----------
    step : float
        Step between frames without time stamps, s.
    note : str
        Assumption on the step; empty if there is none.
    origin : float or None
        Time stamp that counts as 0, s; None before the first.
    searchable : bool
        Whether frames have the same times wherever decoding begins.
    jumped : str
        By how much the last stamp jumped; empty if it did not.
    ahead_s : float
        Times of frames less this computer's clock, at most; of an earlier connection at first, if there was one. Its
        first frames may have waited for long: the first that is waited for here shows the time.
    """

    def __init__(
        self, stream: VideoStream, timed: bool, rate_hz: float | None = None, begin_s: float = 0.0,
        ahead_s: float = -math.inf, *, live: bool = False,
    ) -> None:  # fmt: skip
        self._timed, self._begin_s, self._live = timed, begin_s, live
        self.ahead_s, self.jumped = ahead_s, ""
        self._unsure, self._arrived = ahead_s > -math.inf, math.inf
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
        found = (
            self._begin_s if self._last is None else max(self._last + self.step, math.nextafter(self._last, math.inf))
        )
        self.jumped, now = "", time.monotonic()
        if self._timed and stamp is not None and abs(stamp) <= LATEST_S:
            self.origin = stamp - found if self.origin is None else self.origin
            stated = stamp - self.origin
            if self._live and self._last is not None:
                jump = stated - self._last
                if jump <= -JUMP_S or stated >= now + self.ahead_s + JUMP_S:
                    self.jumped = f"time stamps jumped by {jump:+.0f} s"
                if self.jumped or (self._unsure and now - self._arrived > jump / 2):
                    stated, self._unsure = max(found, now + self.ahead_s), False
                    self.origin = stamp - stated
            found = stated if self._last is None or stated > self._last else found
        self._last, self._arrived, self.ahead_s = found, now, max(self.ahead_s, found - now)
        return found


def _with_gaps(frames: Iterator[Frame]) -> Iterator[Frame]:
    """Insert lost frames into gaps of the times; changes of the frame rate are followed."""
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
