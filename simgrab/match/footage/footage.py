"""Footage: the first seconds of a video as luma, with what its file states of coder, rate and quantisation."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any

import av.error
import cv2
import numpy as np
from av.video.frame import VideoFrame
from av.video.reformatter import ColorRange
from av.video.stream import VideoStream
from numpy.typing import NDArray

from simgrab.errors import SourceError, first_line
from simgrab.instrument.video import Video
from simgrab.io.playback import Playback, squared
from simgrab.model.srgb import decoded

MOST_FRAMES = 150
MOST_STACK_PX = 160_000_000
"""Of all frames together."""
FEW = 8
LEAST_FRAMES = 8
"""For anything that changes in time."""
BT709, BT601 = (0.2126, 0.7152, 0.0722), (0.299, 0.587, 0.114)
_PARAMETERS = "<IxxxxQQii"  # FFmpeg's AVVideoEncParams: blocks, their offset and size, type, quantisation parameter

Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Footage:
    """The first seconds of a video."""

    name: str
    # (frames, height, width), Y' as players show it (`simgrab.io.playback`), brought to 0 … 255 where it is coded in
    # the limited range
    luma: NDArray[np.uint8]
    rgb: NDArray[np.uint8]  # (k, height, width, 3), a few of the frames, spread over the footage
    codec: str  # FFmpeg's name of the coder
    frame_rate_hz: float | None
    # as the file states it, else of the packets that were read, over the time that they show
    bit_rate_mbit_s: float | None
    gop_frames: int | None  # distance of key frames, where two were read
    # mean step by which H.264 quantised the luma residual, levels of 0 … 255; None for other coders
    quantiser: float | None
    weights: tuple[float, float, float]  # of red, green and blue in luma
    note: str = ""  # how pictures differ from the coded ones; empty where they do not

    @property
    def frames(self) -> int:
        """How many frames were read."""
        return len(self.luma)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, px."""
        return self.luma.shape[2], self.luma.shape[1]

    @property
    def few(self) -> NDArray[np.uint8]:
        """Luma of up to eight frames, spread over the footage."""
        return self.luma[:: max(self.frames // FEW, 1)][:FEW]

    @cached_property
    def mean(self) -> Floats:
        """Mean luma over time, shape (height, width), levels."""
        return np.asarray(self.luma.mean(axis=0, dtype=np.float32))

    @cached_property
    def mean_rgb(self) -> Floats:
        """Mean of the few colour frames, shape (height, width, 3), levels."""
        return np.asarray(self.rgb.mean(axis=0, dtype=np.float32))

    @cached_property
    def grey(self) -> bool:
        """Whether no frame shows any colour."""
        few = self.rgb.astype(np.int16)
        return bool(np.abs(few[..., 0] - few[..., 1]).max() <= 3 and np.abs(few[..., 2] - few[..., 1]).max() <= 3)


def read(path: str | Path) -> Footage:
    """Read the first seconds of a video.

    Raises `SourceError` if it cannot be opened, or breaks off before its first picture.
    """
    video = Video(Path(path))
    with video.opened() as stream:
        return _read(stream, video)


def _read(stream: VideoStream, video: Video) -> Footage:
    container: Any = stream.container
    name, codec = video.name, stream.codec_context
    playback = Playback(stream, lambda why: SourceError(f"{name}: {why}"))
    codec.options |= {"export_side_data": "venc_params"}
    width, height = squared(codec.width, codec.height, playback.aspect)
    most = max(min(MOST_FRAMES, MOST_STACK_PX // max(width * height, 1)), LEAST_FRAMES)
    luma, rgb, times = list[NDArray[np.uint8]](), list[NDArray[np.uint8]](), list[float]()
    sizes, keys, steps, broken = list[int](), list[int](), list[float](), ""
    weights, every, note = BT709, max(most // 12, 1), ""
    try:
        for packet in container.demux(stream):
            for frame in packet.decode():
                plain = playback.plain(frame)
                grey = playback.placed(_luma(plain), frame)
                if luma and grey.shape != luma[0].shape:
                    raise SourceError(f"{name}: the picture's size changes at frame {len(luma)}")
                if len(luma) % every == 0:
                    rgb.append(playback.placed(np.asarray(plain.to_ndarray(format="rgb24"), np.uint8), frame))
                if frame.key_frame:
                    keys.append(len(luma))
                weights = BT709 if int(plain.colorspace) == 1 else BT601
                note = note or playback.note(frame)
                luma.append(grey)
                times.append(float(frame.time) if video.timed and frame.time is not None else float("nan"))
                steps += _step(frame)
                if len(luma) >= most:
                    break
            sizes.append(packet.size)
            if len(luma) >= most:
                break
    except (av.error.FFmpegError, OSError) as problem:
        broken = first_line(problem)
    if not luma:
        raise SourceError(f"{name}: the video ends before its first image{f' ({broken})' if broken else ''}")
    gaps = [b - a for a, b in pairwise(times) if b > a]
    rate = 1 / median(gaps) if gaps else None
    return Footage(
        name=name, luma=np.stack(luma), rgb=np.stack(rgb), codec=codec.codec.name, frame_rate_hz=rate,
        bit_rate_mbit_s=1e-6 * (stream.bit_rate or 8 * sum(sizes) * rate / len(luma)) if rate else None,
        gop_frames=int(median(b - a for a, b in pairwise(keys))) if len(keys) > 1 else None,
        quantiser=float(np.mean(steps)) if steps else None, weights=weights, note=note,
    )  # fmt: skip


def _luma(frame: VideoFrame) -> NDArray[np.uint8]:
    """Y' of a frame at 0 … 255."""
    return np.asarray(frame.reformat(format="gray", dst_color_range=ColorRange.JPEG).to_ndarray(), np.uint8)


def _step(frame: VideoFrame) -> list[float]:
    """Quantisation step of an H.264 frame in levels: 2^((QP − 4)/6), after its standard."""
    side_data: Any = frame.side_data
    for data in side_data:
        if data.type.name == "VIDEO_ENC_PARAMS":
            content = bytes(data)
            blocks, offset, size, kind, base = struct.unpack_from(_PARAMETERS, content)
            if kind != 1 or not blocks or offset + blocks * size > len(content):
                return []
            delta = np.frombuffer(content, np.int32, offset=offset).reshape(-1, size // 4)[:blocks, 4]
            return [float(np.exp2((base + delta - 4) / 6).mean())]
    return []


def block_means(values: NDArray[np.floating[Any]], side_px: int) -> NDArray[Any]:
    """Means of a picture's whole blocks of ``side_px``, shape (rows, columns)."""
    rows, columns = (length // side_px for length in values.shape)
    whole = values[: rows * side_px, : columns * side_px]
    return np.asarray(cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA))


def to_linear(levels: NDArray[Any]) -> NDArray[np.float64]:
    """Turn levels, 0 … 255, to linear light, by the transfer function of sRGB."""
    return decoded(np.clip(levels, 0, 255).astype(float) / 255)


def slope(linear: NDArray[Any]) -> NDArray[np.float64]:
    """Levels per unit of linear light, by the transfer function of sRGB."""
    light = np.maximum(linear, 1e-9)
    return np.asarray(255 * np.where(light <= 0.0031308, 12.92, 1.055 / 2.4 * light ** (1 / 2.4 - 1)))
