"""Annotated video of a run, with the measurements drawn into the pictures, and stills of the largest swings."""

from __future__ import annotations

import math
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import TypeAlias

import av
import cv2
import numpy as np
from av.video.stream import VideoStream
from numpy.typing import NDArray

from simgrab.instrument.alarm import DANGER, QUIET_S, RELEASED_AT, SCALE
from simgrab.instrument.contract import Frame, Measurement
from simgrab.instrument.video import UNTIMED_HZ
from simgrab.io.pictures import encode
from simgrab.io.playback import FRAGMENTED

Picture: TypeAlias = NDArray[np.uint8]
Colour: TypeAlias = tuple[int, int, int]
_Still: TypeAlias = tuple[float, int, bytes]  # swing, rad, number of the frame, and JPEG

WIDEST_PX = 1280
_TICKS_PER_S = 90_000
_X264 = {"preset": "veryfast", "crf": "26", "bf": "0", "g": "50"}  # no B-frames: fragments need pictures in order
_QUALITY = 80
_CALM: Colour = (70, 200, 90)
_DANGEROUS: Colour = (255, 60, 50)
_NOTHING: Colour = (160, 160, 160)


class OverlayVideo:
    """Writes annotated pictures one by one, H.264. Use as a context manager.

    Attributes
    ----------
    stills : dict of int to bytes
        JPEGs of the largest swing, and of the largest swing in every alarm, by frame.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._file = None if path is None else av.open(str(path), "w", format="mp4", container_options=FRAGMENTED)
        self._stream: VideoStream | None = None
        self._last: Picture | None = None
        self._index = self._pts = -1
        self._start = 0.0
        self._largest: _Still = (-1.0, 0, b"")
        self._peaks: list[_Still] = []  # of each stretch that may be an alarm
        self._until = -math.inf  # the end of the present stretch, unless it goes on

    def __enter__(self) -> OverlayVideo:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._file is not None:
            if self._stream is not None and kind is None:
                self._file.mux(self._stream.encode(None))
            self._file.close()
            if self._stream is None and self._path is not None:
                self._path.unlink(missing_ok=True)  # no picture, no video

    @property
    def stills(self) -> dict[int, bytes]:
        """JPEGs by frame."""
        return {frame: jpeg for _, frame, jpeg in (*self._peaks, self._largest) if jpeg}

    def add(self, frame: Frame, measured: Measurement) -> None:
        """Add a frame. For a lost frame the last picture is shown greyed, with the reason."""
        self._index += 1
        if frame.picture is not None:
            self._last = _shrunken(frame.picture)
        if self._last is None:
            return
        small = self._last if frame.picture is not None else np.asarray(self._last // 3, np.uint8)
        scale = 1.0 if frame.picture is None else small.shape[1] / frame.picture.shape[1]
        drawn = annotate(small, measured, scale)
        if measured.alpha is not None:
            self._keep(frame.time_s, measured.alpha, drawn)
        if self._file is not None:
            self._send(drawn, self._index / UNTIMED_HZ if frame.time_s is None else frame.time_s)

    def _send(self, picture: Picture, time_s: float) -> None:
        assert self._file is not None
        if self._stream is None:
            self._start = time_s
            self._stream = self._file.add_stream("libx264", rate=30, options=_X264)
            self._stream.height, self._stream.width = picture.shape[:2]
            self._stream.pix_fmt = "yuv420p"
            self._stream.time_base = self._stream.codec_context.time_base = Fraction(1, _TICKS_PER_S)
        frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
        self._pts = max(round((time_s - self._start) * _TICKS_PER_S), self._pts + 1)
        frame.pts, frame.time_base = self._pts, Fraction(1, _TICKS_PER_S)
        self._file.mux(self._stream.encode(frame))

    def _keep(self, time_s: float | None, alpha: float, drawn: Picture) -> None:
        """Keep the picture if it is that of the largest swing so far, of all or of the present stretch."""
        largest, begins, peak = alpha > self._largest[0], False, False
        if time_s is not None and alpha >= RELEASED_AT:
            begins = time_s > self._until
            peak = begins or alpha > self._peaks[-1][0]
            self._until = time_s + QUIET_S
        if not (largest or peak):
            return
        still = alpha, self._index, encode(drawn[..., ::-1], "jpeg", _QUALITY)
        if largest:
            self._largest = still
        if peak:
            self._peaks[len(self._peaks) if begins else -1 :] = [still]


def annotate(picture: Picture, measured: Measurement, scale: float = 1.0) -> Picture:
    """Draw a measurement into a picture, shape (h, w, 3), that is ``scale`` times the measured one's size."""
    drawn = picture.copy()
    unit = max(picture.shape[0] / 540, 0.5)
    colour = _NOTHING if measured.alpha is None else _DANGEROUS if measured.alpha > DANGER else _CALM
    thick = max(round(1.6 * unit), 1)
    if measured.box is not None:
        x0, y0, x1, y1 = (round(scale * edge) for edge in measured.box)
        cv2.rectangle(drawn, (x0, y0), (x1, y1), colour, thick)
    if measured.centre is not None:
        at = (round(scale * measured.centre[0]), round(scale * measured.centre[1]))
        cv2.drawMarker(drawn, at, colour, cv2.MARKER_CROSS, round(22 * unit), thick)
    _gauge(drawn, measured, colour, unit)
    if measured.alpha is not None and measured.alpha > DANGER:
        cv2.rectangle(drawn, (0, 0), (drawn.shape[1] - 1, drawn.shape[0] - 1), _DANGEROUS, max(round(6 * unit), 2))
    return drawn


def _gauge(drawn: Picture, measured: Measurement, colour: Colour, unit: float) -> None:
    """Draw the line of text at the bottom, and the scale from 0 to 20 degrees above it."""
    height, width = drawn.shape[:2]
    top, left, right = height - round(64 * unit), round(14 * unit), width - round(14 * unit)
    drawn[top:] = drawn[top:] // 3
    text = f"{measured.status}: {measured.reason}"
    if measured.alpha is not None:
        text = f"swing {math.degrees(measured.alpha):.2f} deg"
        if measured.alpha_low is not None and measured.alpha_high is not None:
            text += f" ({math.degrees(measured.alpha_low):.2f} to {math.degrees(measured.alpha_high):.2f})"
        if measured.rope_length_m is not None:
            text += f"   rope {measured.rope_length_m:.2f} m"
        if measured.alpha > DANGER:
            text += "   DANGER"
    # OpenCV's letters are ASCII.
    text = text.encode("ascii", "replace").decode()
    at = (left, height - round(14 * unit))
    cv2.putText(drawn, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.62 * unit, colour, max(round(1.4 * unit), 1), cv2.LINE_AA)
    y = top + round(14 * unit)

    def along(angle: float) -> int:
        return left + round((right - left) * min(angle / SCALE, 1.0))

    cv2.line(drawn, (left, y), (right, y), _NOTHING, max(round(unit), 1))
    cv2.line(drawn, (along(DANGER), y - round(7 * unit)), (along(DANGER), y + round(7 * unit)), _DANGEROUS, 2)
    if measured.alpha is not None:
        cv2.line(drawn, (left, y), (along(measured.alpha), y), colour, max(round(7 * unit), 2))


def _shrunken(picture: Picture) -> Picture:
    """Bring a picture to at most `WIDEST_PX` and to even sides, which subsampled colours need."""
    height, width = picture.shape[:2]
    scale = min(WIDEST_PX / width, 1.0)
    size = max(round(width * scale) // 2 * 2, 2), max(round(height * scale) // 2 * 2, 2)
    if size == (width, height):
        return picture
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
