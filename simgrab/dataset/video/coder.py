"""H.264 coding of one video, the same bytes every time."""

from __future__ import annotations

import re
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from types import TracebackType

import av
import numpy as np
from av.packet import Packet
from av.video import VideoStream
from av.video.reformatter import ColorPrimaries, ColorRange, Colorspace, ColorTrc
from numpy.typing import NDArray

from simgrab.io.playback import FRAGMENTED
from simgrab.model.scenario import Camera, Clip

# A camera's coder has no look-ahead and has no B-frames. One thread: x264 codes differently with more.
X264 = {"preset": "veryfast", "tune": "zerolatency", "sc_threshold": "0", "threads": "1"}
BUFFER_S = 2.0  # of the bit rate, by which what was sent may run ahead
BUFFER_FRAMES = 2  # but at least so many, at slow frame rates
MOST_BUFFER_BITS = 2**31 - 1  # FFmpeg's


class Coder:
    """Codes pictures into a file one by one; an MP4 is written in fragments. Use as a context manager.

    Colours are BT.709, limited range, 4:2:0, and tagged so. The camera's width and height are even; the clip has frame
    rate, bit rate and distance of key frames. ``x264`` is the version of the encoder, once it has coded a frame.

    Parameters
    ----------
    container : str
        FFmpeg's name of the format, e.g. ``"mp4"``.
    ticks_per_s : int
        Resolution of the time stamps.
    """

    def __init__(self, path: Path, container: str, ticks_per_s: int, camera: Camera, clip: Clip) -> None:
        bits_per_s = clip.bit_rate_mbit_s * 1e6
        buffer_s = max(BUFFER_S, BUFFER_FRAMES / clip.frame_rate_hz)
        rates = {"b": bits_per_s, "maxrate": bits_per_s, "bufsize": min(bits_per_s * buffer_s, MOST_BUFFER_BITS)}
        options = X264 | {name: str(round(value)) for name, value in rates.items()}
        self.x264 = ""
        self._tick, self._lasting = Fraction(1, ticks_per_s), round(ticks_per_s / clip.frame_rate_hz)
        # Bit-exact: neither dates nor random identifiers.
        muxing = {"fflags": "+bitexact"} | (FRAGMENTED if container == "mp4" else {})
        self._file = av.open(str(path), "w", format=container, container_options=muxing)
        rate = Fraction(clip.frame_rate_hz).limit_denominator(1001)
        self._stream = self._file.add_stream("libx264", rate=rate, options=options)
        self._stream.width, self._stream.height, self._stream.pix_fmt = camera.width_px, camera.height_px, "yuv420p"
        self._stream.time_base = self._tick
        codec = self._stream.codec_context
        codec.time_base, codec.gop_size, codec.max_b_frames = self._tick, clip.gop_frames, 0
        codec.color_range, codec.colorspace = ColorRange.MPEG, Colorspace.ITU709
        codec.color_primaries, codec.color_trc = ColorPrimaries.BT709, ColorTrc.BT709

    def __enter__(self) -> Coder:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        try:
            if kind is None:
                self._write(self._stream.encode(None))
        finally:
            self._file.close()

    def send(self, rgb: NDArray[np.uint8], pts: int) -> None:
        """Encode a picture, shape (height, width, 3), at a time in ticks that exceeds the previous one's."""
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(rgb), format="rgb24").reformat(
            format="yuv420p", dst_colorspace=Colorspace.ITU709, dst_color_range=ColorRange.MPEG, threads=1
        )
        frame.pts, frame.time_base, frame.duration = pts, self._tick, self._lasting
        self._write(self._stream.encode(frame))

    def _write(self, packets: Iterable[Packet[VideoStream]]) -> None:
        for packet in packets:
            if not self.x264:  # it introduces itself in its first packet
                found = re.search(rb"x264 - (core \d+(?: r\w+ \w+)?)", bytes(packet))
                self.x264 = found[1].decode() if found else "unknown"
            self._file.mux(packet)
