"""Hostile pictures and videos: valid files of unusual formats, and files whose heads promise what does not follow."""

from __future__ import annotations

import contextlib
import io
import struct
import zlib
from fractions import Fraction
from random import Random
from typing import Any

import av
import numpy as np
from PIL import Image

from scripts.fuzzing import corpus
from scripts.fuzzing.bytewise import with_checksums

FITTING = corpus.WIDTH, corpus.HEIGHT  # as the camera file states
SIZES = (1, 2, 3, 16, 31, 32, 33, 63, 64, 97, 160, 480)
SIDES = (0, 1, 7, 255, 256, 4096, 16384, 20000, 32767, 32768, 65500, 65535, 2**24, 2**31 - 1, 2**31, 2**32 - 1)
MODES = ("1", "L", "LA", "P", "RGB", "RGBA", "CMYK", "YCbCr", "I;16", "I", "F", "LAB")
_SAVED: tuple[tuple[str, dict[str, Any]], ...] = (
    ("JPEG", {"quality": 1}), ("JPEG", {"progressive": True}), ("JPEG", {"quality": 100, "subsampling": 0}),
    ("PNG", {}), ("PNG", {"compress_level": 0}), ("BMP", {}), ("WEBP", {"lossless": True}), ("WEBP", {"quality": 10}),
    ("TIFF", {}), ("TIFF", {"compression": "tiff_lzw"}), ("TIFF", {"compression": "tiff_adobe_deflate"}),
    ("TIFF", {"compression": "jpeg"}), ("GIF", {}), ("JPEG2000", {}), ("PPM", {}), ("TGA", {}),
)  # fmt: skip
SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp", ".JPG")


def picture(rng: Random) -> tuple[str, bytes]:
    """Suffix and content of a picture file."""
    kind, options = rng.choice(_SAVED)
    if kind == "PNG" and rng.random() < 0.5:
        return ".png", _blank_png(rng)
    size = FITTING if rng.random() < 0.5 else (rng.choice(SIZES), rng.choice(SIZES))
    data = _saved(_picture(size, rng.choice(MODES)), kind, options, rng.randrange(10))
    if rng.random() < 0.25:
        data = _promising(data, kind, rng.choice(SIDES), rng.choice(SIDES))
    suffix = {"JPEG": ".jpg", "PNG": ".png", "BMP": ".bmp", "TIFF": ".tif", "WEBP": ".webp"}.get(kind, ".png")
    return rng.choice([*[suffix] * 6, *SUFFIXES]), data


def _picture(size: tuple[int, int], mode: str) -> Image.Image:
    grey = np.random.default_rng(size).integers(0, 256, size[::-1], np.uint8)
    return Image.fromarray(grey).convert(mode)


def _saved(picture: Image.Image, kind: str, options: dict[str, Any], orientation: int) -> bytes:
    out = io.BytesIO()
    exif = Image.Exif()
    exif[0x0112] = orientation  # of which 1 to 8 exist
    if kind in ("JPEG", "PNG", "WEBP", "TIFF") and orientation:
        options = options | {"exif": exif}
    try:
        picture.save(out, kind, **options)
    except (OSError, ValueError, KeyError, RuntimeError):
        out = io.BytesIO()
        picture.convert("RGB").save(out, kind)
    return out.getvalue()


def _promising(data: bytes, kind: str, width: int, height: int) -> bytes:
    """Write other sides into the head of a file."""
    result = bytearray(data)
    places = {"PNG": (16, ">II"), "BMP": (18, "<II"), "GIF": (6, "<HH"), "TGA": (12, "<HH")}
    if kind in places:
        at, form = places[kind]
        most = 2**32 - 1 if "I" in form else 2**16 - 1
        struct.pack_into(form, result, at, width & most, height & most)
        return with_checksums(bytes(result))
    if kind == "JPEG":
        at = next((i for i in range(len(data) - 9) if data[i] == 0xFF and data[i + 1] in (0xC0, 0xC1, 0xC2)), 0)
        struct.pack_into(">HH", result, at + 5, height & 0xFFFF, width & 0xFFFF)
    elif kind == "TIFF" and data[:2] == b"II":
        _patch_tags(result, {256: width, 257: height})
    elif kind == "WEBP" and data[12:16] == b"VP8 ":
        struct.pack_into("<HH", result, 26, width & 0x3FFF, height & 0x3FFF)
    return bytes(result)


def _patch_tags(tiff: bytearray, tags: dict[int, int]) -> None:
    (at,) = struct.unpack_from("<I", tiff, 4)
    with contextlib.suppress(struct.error):
        (count,) = struct.unpack_from("<H", tiff, at)
        for entry in range(at + 2, at + 2 + 12 * count, 12):
            tag, kind = struct.unpack_from("<HH", tiff, entry)
            if tag in tags:
                struct.pack_into(
                    "<H" if kind == 3 else "<I", tiff, entry + 8, tags[tag] & (0xFFFF if kind == 3 else 2**32 - 1)
                )


def _blank_png(rng: Random) -> bytes:
    """PNG of one colour, of few bytes, which may be large."""
    width, height = rng.choice((1, 64, 4096, 20000, 65535)), rng.choice((1, 64, 4096, 20000))
    depth, colour = rng.choice(((1, 0), (8, 0), (8, 2), (16, 2), (8, 6), (16, 6), (1, 3), (2, 3)))
    channels = {0: 1, 2: 3, 3: 1, 6: 4}[colour]
    row = 1 + (width * channels * depth + 7) // 8
    packer, body = zlib.compressobj(1), []
    for _ in range(min(height, 200_000_000 // row)):  # a file that breaks off there is hostile too
        body.append(packer.compress(bytes(row)))
    body.append(packer.flush())
    palette = [(b"PLTE", b"\0\0\0")] if colour == 3 else []
    head = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)
    chunks = [(b"IHDR", head), *palette, (b"IDAT", b"".join(body)), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data)) for name, data in chunks
    )


# Container, suffix, codec and pixel format.
CODED = (
    ("mp4", ".mp4", "libx264", "yuv420p"), ("mp4", ".mp4", "libx264", "yuv444p"), ("mp4", ".mp4", "mpeg4", "yuv420p"),
    ("mp4", ".mp4", "mjpeg", "yuvj420p"), ("matroska", ".mkv", "libx264", "yuv420p"),
    ("matroska", ".mkv", "ffv1", "gray"),
    ("matroska", ".mkv", "ffv1", "bgra"), ("matroska", ".mkv", "ffv1", "yuv420p10le"),
    ("matroska", ".mkv", "libvpx-vp9", "yuva420p"),
    ("webm", ".webm", "libvpx", "yuv420p"), ("avi", ".avi", "mjpeg", "yuvj422p"), ("avi", ".avi", "mpeg4", "yuv420p"),
    ("avi", ".avi", "rawvideo", "bgr24"), ("avi", ".avi", "png", "rgb24"), ("mjpeg", ".mjpeg", "mjpeg", "yuvj420p"),
    ("mpegts", ".ts", "libx264", "yuv420p"), ("flv", ".flv", "flv", "yuv420p"), ("gif", ".gif", "gif", "rgb8"),
    ("h264", ".h264", "libx264", "yuv420p"), ("mov", ".mov", "libx264", "yuv420p"), ("nut", ".nut", "ffv1", "rgb48le"),
)  # fmt: skip
_RATES: tuple[int | Fraction, ...] = (1, 9, 25, 120, 1000, Fraction(30000, 1001), Fraction(1, 100))
_STEPS = (1, 1, 1, 2, 0, -1, 100, 10**6, 10**12, 2**40)
PLAYLISTS = (
    b"ffconcat version 1.0\nfile '/etc/hostname'\n", b"ffconcat version 1.0\nfile clip.mp4\n",
    b"#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n/etc/hostname\n#EXT-X-ENDLIST\n",
    b"#EXTM3U\n#EXTINF:1,\nhttp://127.0.0.1:9/x.ts\n#EXT-X-ENDLIST\n",
    b"v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\nm=video 9 RTP/AVP 96\na=rtpmap:96 H264/90000\n",
    b"<?xml version='1.0'?><MPD xmlns='urn:mpeg:dash:schema:mpd:2011'></MPD>", b"", b"\x00" * 4096, b"P6 1 1 255 abc",
    b"YUV4MPEG2 W64 H64 F25:1 C420\nFRAME\n" + b"\x80" * 6144, b"YUV4MPEG2 W65535 H65535 F0:0\nFRAME\n",
    b"RIFF\xff\xff\xff\xffAVI ",
    b"WEBVTT\n\n00:00.000 --> 00:01.000\nx\n", b"text alone\n" * 200, b"1\n00:00:00,000 --> 00:00:01,000\nx\n",
)  # fmt: skip


def video(rng: Random) -> tuple[str, bytes]:
    """Suffix and content of a video file."""
    if rng.random() < 1 / 8:
        suffix = rng.choice((".mp4", ".avi", ".mkv", ".m3u8", ".txt", ".sdp", ".y4m"))
        return suffix, rng.choice(PLAYLISTS)
    container, suffix, codec, pixels = rng.choice(CODED)
    width, height = rng.choice(((64, 64), FITTING, FITTING, (16, 16), (66, 2), (480, 272), (1280, 720)))
    steps = rng.choices(_STEPS, k=rng.randrange(13))
    data = _coded(container, codec, pixels, (width, height), rng.choice(_RATES), steps)
    return video(rng) if data is None else (suffix, data)


def _coded(
    container: str, codec: str, pixels: str, size: tuple[int, int], rate: int | Fraction, steps: list[int]
) -> bytes | None:
    """Code a film whose time stamps go by these steps; None where FFmpeg refuses to."""
    out = io.BytesIO()
    try:
        with av.open(out, "w", format=container, container_options={"fflags": "+bitexact"}) as file:
            stream: Any = file.add_stream(codec, rate=rate)
            stream.width, stream.height, stream.pix_fmt = *size, pixels
            stamp = 0
            for i, step in enumerate([1, *steps]):
                grey = np.full((size[1], size[0], 3), 20 * i % 256, np.uint8)
                frame = av.VideoFrame.from_ndarray(grey, format="rgb24").reformat(format=pixels)
                frame.pts, stamp = stamp, stamp + step
                file.mux(stream.encode(frame))
            file.mux(stream.encode(None))
    except (av.error.FFmpegError, OSError, ValueError):
        return None
    return out.getvalue()
