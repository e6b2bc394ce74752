"""Videos and streams, decoded by FFmpeg: what was lost leaves lost frames, what breaks off gives what it held."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from statistics import median

import av
import av.error
import numpy as np
from av.container import InputContainer
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from simgrab.errors import SourceError, first_line
from simgrab.instrument.contract import Frame

PATIENCE_S = (15.0, 15.0)  # to open a stream, and for its next packet
MOST_LOST = 600  # frames that a gap counts as; a longer one is one lost frame
_STEPS = 31  # time steps of which the median is what a step should be
_NO_VIDEO = ("tty",)  # FFmpeg draws text files as a film of a terminal
_UNTIMED_HZ = 9.0  # of a stream that says nothing of its rate


class Video:
    """A video file or a stream.

    Parameters
    ----------
    name : str
        Path or URL.
    live : bool
        Whether it is a stream, to be read once.

    Raises
    ------
    SourceError
        If it cannot be opened or has no pictures.
    """

    def __init__(self, name: str, *, live: bool = False) -> None:
        self.name, self.live = name, live
        container = _opened(name)
        self.count = container.streams.video[0].frames or None
        self._stream = container if live else None  # a stream is opened once
        if not live:
            container.close()

    def __iter__(self) -> Iterator[Frame]:
        """Decode from the beginning, a stream from now on. The time of a frame is its time stamp.

        Raises
        ------
        SourceError
            If a stream is read a second time, or a file is gone.
        """
        if self.live and self._stream is None:
            raise SourceError(f"{self.name}: a stream can be read once")
        container, self._stream = self._stream or _opened(self.name), None
        with container:
            yield from _with_gaps(_decoded(container))


def _opened(name: str) -> InputContainer:
    try:
        container = av.open(name, timeout=PATIENCE_S)
    except (av.error.FFmpegError, OSError, ValueError) as problem:
        raise SourceError(f"{name}: not a video that can be opened ({first_line(problem)})") from None
    if not container.streams.video or container.format.name in _NO_VIDEO:
        container.close()
        raise SourceError(f"{name}: it has no pictures")
    return container


def _decoded(container: InputContainer) -> Iterator[Frame]:
    """Pictures as they come, damaged ones as lost frames; ends with a lost frame where the file breaks off."""
    stream = container.streams.video[0]
    stream.codec_context.thread_count = 1  # the next picture is decoded while a core looks at this one
    clock = _Clock(stream)
    packets = container.demux(stream)
    while True:
        try:
            packet = next(packets)
        except StopIteration:
            return
        except (av.error.FFmpegError, OSError) as problem:
            yield Frame(None, clock.next(None), f"the video breaks off here ({first_line(problem)})")
            return
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
        """Time of the next frame; a step after the last where its stamp is missing or goes back."""
        if stamp is None or not math.isfinite(stamp) or (self._last is not None and stamp <= self._last):
            stamp = 0.0 if self._last is None else self._last + self.step
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
