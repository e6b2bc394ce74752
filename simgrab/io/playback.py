"""Decoded frames of a video as a player shows them: deinterlaced, in standard range, with square pixels, upright.

A camera file describes these shown pictures, not the coded ones. A video states how to show its coded pictures: whether
they are interlaced, their transfer function, the width of a pixel, and how the picture is turned.
"""

from __future__ import annotations

import math
import struct
from fractions import Fraction
from typing import Any, BinaryIO, TypeVar

import av
import av.error
import numpy as np
from av.container import Container, InputContainer
from av.filter import Graph
from av.sidedata.sidedata import SideDataContainer
from av.stream import Disposition
from av.video.frame import VideoFrame
from av.video.stream import VideoStream
from numpy.typing import NDArray

from simgrab.errors import first_line
from simgrab.io.parse import Refuse
from simgrab.io.pictures import too_large
from simgrab.runtime.environment import MOST_PIXELS

T = TypeVar("T", bound=np.generic)
Turn = tuple[bool, bool, bool]  # whether rows become columns, then whether columns, and rows, are in reverse order

PATIENCE_S = (15.0, 15.0)  # to open a stream, and for its next packet
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
# For FFmpeg's muxer: an MP4 that can be read however early it breaks off. An ordinary one is lost with its index, which
# stands in one place. In fragments each group of pictures has its own, and the segment index before them states the
# length of the whole. A fragment starts at each key frame, or a minute after the last, so that memory is bounded.
# Pictures must come in the order of their time stamps, the first of which is 0.
FRAGMENTED = {
    "movflags": "+frag_keyframe+empty_moov+default_base_moof+global_sidx",
    "frag_duration": "60000000",
}

# Cover art, thumbnails and maps of depth: pictures beside the video, though in streams like it.
_NO_VIDEO = Disposition.attached_pic | Disposition.timed_thumbnails | Disposition.still_image | Disposition.dependent
_HDR = {16: "PQ", 18: "HLG"}  # by FFmpeg's AVColorTransferCharacteristic
_TO_SRGB = "out_transfer=iec61966-2-1:out_primaries=bt709:out_range=full"
_UPRIGHT = (False, False, False)
_TURNS = {
    (False, True, True): "turned by 180°",
    (False, True, False): "mirrored left to right",
    (False, False, True): "mirrored top to bottom",
    (True, True, False): "turned by 90° clockwise",
    (True, False, True): "turned by 90° counterclockwise",
    (True, False, False): "mirrored along the diagonal",
    (True, True, True): "mirrored along the other diagonal",
}
_SKEW = 0.01  # of a display matrix, whose entries are rounded


def open_video(source: str | BinaryIO, refuse: Refuse) -> InputContainer:
    """Open a video file, or the URL of a stream. Files that it names are not opened, so playlists are refused.

    ``refuse`` makes the error to raise from a message, for a video that cannot be opened, or whose pictures are missing
    or too large.
    """
    formats, protocols = (FORMATS, ("none",)) if not isinstance(source, str) else (FORMATS + STREAM_FORMATS, PROTOCOLS)
    rules = {"format_whitelist": ",".join(formats), "protocol_whitelist": ",".join(protocols)}
    try:
        try:
            container = av.open(source, "r", options=rules, timeout=PATIENCE_S)
        except av.error.FFmpegError:
            if isinstance(source, str):
                raise
            # An MP4 may break off within the index of a fragment, where FFmpeg looks by the list of all fragments.
            source.seek(0)
            container = av.open(source, "r", options=rules | {"fflags": "+ignidx"})
    except (av.error.ArgumentError, av.error.InvalidDataError):
        raise refuse(f"not a video that can be opened (damaged, cut off, or no {_KINDS})") from None
    except (av.error.FFmpegError, OSError, ValueError) as problem:
        raise refuse(f"not a video that can be opened ({first_line(problem)})") from None
    if refused := _problem(container):
        container.close()
        raise refuse(refused)
    # Pictures may change their size later.
    stream_of(container).codec_context.options = {"max_pixels": str(MOST_PIXELS)}
    return container


def _problem(container: InputContainer) -> str:
    if not _videos(container):
        return "it has no pictures"
    stream = stream_of(container)
    codec: Any = stream.codec_context  # None where FFmpeg has no decoder
    if codec is None:
        return "its pictures are coded in a way that is not known"
    # As shown: a pixel may be wide.
    return too_large(codec.width, codec.height) or too_large(*squared(codec.width, codec.height, aspect_of(stream)))


def stream_of(container: InputContainer) -> VideoStream:
    """Choose the stream that players show: the first one marked as the default, or else the first."""
    videos = _videos(container)
    return next((stream for stream in videos if stream.disposition & Disposition.default), videos[0])


def _videos(container: Container) -> list[VideoStream]:
    return [stream for stream in container.streams.video if not stream.disposition & _NO_VIDEO]


def squared(width: int, height: int, aspect: Fraction) -> tuple[int, int]:
    """Size, px, of a picture after its pixels are made square; the longer side of a pixel keeps its length."""
    return (round(width * aspect), height) if aspect > 1 else (width, round(height / aspect))


class Playback:
    """Shows the frames of one stream; refuses frames that are not turned by a multiple of 90°."""

    def __init__(self, stream: VideoStream, refuse: Refuse) -> None:
        self.aspect = aspect_of(stream)
        self._refuse = refuse
        self._videos = len(_videos(stream.container))
        self._index = stream.index
        self._graphs = dict[tuple[str, ...], tuple[object, Graph]]()

    def picture(self, frame: VideoFrame) -> NDArray[np.uint8]:
        """Show a frame: RGB, shape (height, width, 3)."""
        return self.placed(np.asarray(self.plain(frame).to_ndarray(format="rgb24"), np.uint8), frame)

    def plain(self, frame: VideoFrame) -> VideoFrame:
        """Deinterlace a frame, and convert it to standard dynamic range.

        Of an interlaced frame what moves is as in the first field, interpolated, and what stands still is of both: a
        display keeps its resolution. What moves is found by comparison with the frame given before.
        """
        if frame.interlaced_frame:
            frame = self._filtered(frame, 2, "bwdif", "mode=send_frame")
        if frame.color_trc in _HDR:
            frame = self._filtered(frame, 1, "scale", _TO_SRGB, "format", "pix_fmts=rgb24")
        return frame

    def _filtered(self, frame: VideoFrame, times: int, *chain: str) -> VideoFrame:
        """Filter a frame. A filter that waits for the next frame gets this one twice."""
        kind = frame.width, frame.height, frame.format.name, frame.colorspace, frame.color_range, frame.color_trc
        known = self._graphs.get(chain)
        if known is None or known[0] != kind:
            known = self._graphs[chain] = kind, _graph(frame, *chain)
        for _ in range(times):
            known[1].push(frame)
        found = None
        while True:
            try:
                found = known[1].vpull()
            except (BlockingIOError, EOFError):
                assert found is not None
                return found

    def placed(self, picture: NDArray[T], frame: VideoFrame) -> NDArray[T]:
        """Make a frame's pixels square and turn it: any array of shape (height, width) or (height, width, 3)."""
        size = squared(frame.width, frame.height, self.aspect)
        if size != (frame.width, frame.height):
            import cv2  # by this alone, and scenes, which may name videos, are read without it

            picture = cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR)
        swapped, columns, rows = turn = self._turn(frame)
        if turn == _UPRIGHT:
            return picture
        picture = picture.swapaxes(0, 1) if swapped else picture
        return np.ascontiguousarray(picture[:: -1 if rows else 1, :: -1 if columns else 1])

    def note(self, frame: VideoFrame) -> str:
        """Return a note on unusual changes made to a frame; empty if there were none."""
        notes, coded = [], (frame.width, frame.height)
        if self._videos > 1:
            notes.append(f"of {self._videos} video streams FFmpeg's #{self._index} is read")
        if frame.interlaced_frame:
            notes.append("of interlaced pictures the first field is read where they move")
        if frame.color_trc in _HDR:
            notes.append(f"HDR ({_HDR[frame.color_trc]}) is brought to standard range")
        if (size := squared(*coded, self.aspect)) != coded:
            aspect = f"{self.aspect.numerator}:{self.aspect.denominator}"
            notes.append(f"pixels of {aspect} are made square: {coded[0]}x{coded[1]} px become {size[0]}x{size[1]} px")
        if (turn := self._turn(frame)) != _UPRIGHT:
            notes.append(f"pictures are {_TURNS[turn]}")
        return "; ".join(notes)

    def _turn(self, frame: VideoFrame) -> Turn:
        """Read the display matrix: x' = a x + c y, y' = b x + d y; scale and shift are ignored."""
        # frame.side_data would refer to the frame, which then stays in memory until garbage is collected.
        data: Any = SideDataContainer(frame).get("DISPLAYMATRIX")  # type: ignore[call-arg]  # missing in the stub
        if data is None:
            return _UPRIGHT
        a, b, _, c, d, *_ = struct.unpack("=9i", bytes(data))
        swapped = abs(b) > abs(a)
        right, down, skew = (c, b, max(abs(a), abs(d))) if swapped else (a, d, max(abs(b), abs(c)))
        if skew > _SKEW * min(abs(right), abs(down)):
            angle = math.degrees(math.atan2(b, a))
            raise self._refuse(f"its pictures are to be turned by {angle:.0f}°; only quarter turns are read")
        return swapped, right < 0, down < 0


def aspect_of(stream: VideoStream) -> Fraction:
    """Width of a pixel over its height, as the container or else the coder states it; 1 if neither does."""
    return stream.sample_aspect_ratio or Fraction(1)


def _graph(frame: VideoFrame, *chain: str) -> Graph:
    """Build a chain of FFmpeg's filters, given as names and arguments in turn, for frames like this one."""
    graph = Graph()
    graph.threads = 1
    nodes = [graph.add_buffer(width=frame.width, height=frame.height, format=frame.format, time_base=frame.time_base)]
    nodes += [graph.add(name, args) for name, args in zip(chain[::2], chain[1::2], strict=True)]
    graph.link_nodes(*nodes, graph.add("buffersink")).configure()
    return graph
