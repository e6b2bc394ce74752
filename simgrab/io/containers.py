"""Video files that can be read however early they break off, and whether one does.

An MP4 file without fragments is lost with its index, which stands in one place. In fragments each group of pictures
comes with its own index, and the segment index before them (``sidx``) states how long the whole file is.
"""

from __future__ import annotations

import os
import re
import struct
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import BinaryIO

# For FFmpeg's muxer. A fragment starts at each key frame, or a minute after the last, so that memory is bounded.
# Pictures must come in the order of their time stamps, the first of which is 0.
FRAGMENTED = {
    "movflags": "+frag_keyframe+empty_moov+default_base_moof+global_sidx",
    "frag_duration": "60000000",
}

_MP4 = {b"ftyp", b"styp", b"moov", b"moof", b"mdat", b"free", b"skip", b"wide", b"sidx", b"pnot", b"uuid"}
_MOST_BOXES = 500_000  # that are examined: a day of a fragment for each of four frames
_MOST_INDEX = 2**20  # bytes; 65,535 references, the most, take 786 kB
_UNSTATED = 0xFFFFFFFF  # length of an AVI list whose recorder did not come back to write it
_EBML, _SEGMENT = b"\x1a\x45\xdf\xa3", b"\x18\x53\x80\x67"
_CROPS = (  # from the segment by tracks, an entry and its video to PixelCropBottom, Top, Left and Right
    {_SEGMENT}, {b"\x16\x54\xae\x6b"}, {b"\xae"}, {b"\xe0"}, {b"\x54\xaa", b"\x54\xbb", b"\x54\xcc", b"\x54\xdd"},
)  # fmt: skip
_CLEAN_APERTURE = re.compile(rb"\0\0\0\x28clap(.{32})", re.DOTALL)  # ISO/IEC 14496-12, 12.1.4
_MOST_HEAD = 2**24  # bytes of an MP4's description that are searched


@dataclass(frozen=True)
class Extent:
    """How far a video file goes.

    Attributes
    ----------
    end : int
        Bytes that a demuxer may read: without a last box that holds no pictures and is cut off, and without what is
        appended to an MP4.
    whole : bool
        Whether all pictures that the container states are there, as far as it states how many bytes they take.
    """

    end: int
    whole: bool


def extent(file: BinaryIO) -> Extent:
    """Find whether a video file is cut off: MP4, Matroska and AVI state their lengths; others count as whole.

    Parameters
    ----------
    file : binary file
        Is left anywhere.
    """
    size = file.seek(0, os.SEEK_END)
    start = _at(file, 0, 12)
    if start[4:8] in _MP4:
        return _mp4(file, size)
    if start[:4] == _EBML:
        return _matroska(file, size)
    if start[:4] == b"RIFF" and start[8:12] == b"AVI ":
        return _avi(file, size)
    return Extent(size, True)


def lacks_rate(file: BinaryIO) -> bool:
    """Whether a file is of raw pictures (YUV4MPEG2) and does not state their rate, for which FFmpeg makes up 25."""
    line = _at(file, 0, 256).partition(b"\n")[0]
    return line.startswith(b"YUV4MPEG2 ") and re.search(rb" F0*[1-9]", line) is None


def crops(file: BinaryIO, width: int, height: int) -> bool:
    """Whether a Matroska or MP4 states that its pictures are to be cropped, which FFmpeg's decoders do not.

    Parameters
    ----------
    file : binary file
        Is left anywhere.
    width, height : int
        Of the decoded pictures, px.
    """
    start = _at(file, 0, 12)
    if start[:4] == _EBML:
        return _states(file, 0, file.seek(0, os.SEEK_END), _CROPS)
    if start[4:8] not in _MP4:
        return False
    at, size = 0, file.seek(0, os.SEEK_END)
    for _ in range(_MOST_BOXES):
        length, kind = struct.unpack(">I4s", _at(file, at, 8).ljust(8, b"\0"))
        if length == 1:
            length = int.from_bytes(_at(file, at + 8, 8))
        if kind == b"moov":
            head = _at(file, at, min(length, _MOST_HEAD))
            stated = (struct.unpack(">4I", found[:16]) for found in _CLEAN_APERTURE.findall(head))
            return any(w != width * of or h != height * over for w, of, h, over in stated)
        at += length
        if length < 8 or at >= size:
            break
    return False


def _at(file: BinaryIO, offset: int, length: int) -> bytes:
    file.seek(offset)
    return file.read(length)


def _mp4(file: BinaryIO, size: int) -> Extent:
    """Go from box to box; what follows the last, e.g. zeros or a dashcam's positions, is not of the container."""
    at = stated = 0
    kinds = set()
    for _ in range(_MOST_BOXES):
        header = _at(file, at, 16).ljust(16, b"\xff")
        length, kind = struct.unpack_from(">I4s", header)
        if length == 1:
            (length,) = struct.unpack_from(">Q", header, 8)
        elif length == 0 and kind in _MP4:  # up to the end of the file
            length = size - at
        if at + length > size and kind in _MP4:
            return Extent(size if kind == b"mdat" else at, False)
        if length < 8 or at + length > size:
            break
        if kind == b"sidx":
            stated = at + length + _indexed(_at(file, at, min(length, _MOST_INDEX)))
        kinds.add(kind)
        at += length
    else:
        return Extent(size, stated <= size)
    return Extent(at, stated <= at and {b"moov", b"mdat"} <= kinds)


def _indexed(box: bytes) -> int:
    """Bytes after a segment index of what it lists (ISO/IEC 14496-12, 8.16.3)."""
    try:
        fields = ">QQHH" if box[8] else ">IIHH"
        _, first, _, count = struct.unpack_from(fields, box, 20)
        references = struct.unpack_from(">" + "III" * count, box, 20 + struct.calcsize(fields))
    except (IndexError, struct.error):
        return 0
    return int(first) + sum(length & 0x7FFFFFFF for length in references[::3])


def _matroska(file: BinaryIO, size: int) -> Extent:
    """Compare the segment's length with the file's; one that was streamed states none."""
    for identity, start, length in _elements(file, 0, size):
        if identity == _SEGMENT:
            return Extent(size, length is None or start + length <= size)
    return Extent(size, True)


def _elements(file: BinaryIO, at: int, end: int) -> Iterator[tuple[bytes, int, int | None]]:
    """Give the elements of a Matroska from an offset on: identity, offset of the content, and length where stated."""
    for _ in range(_MOST_BOXES):
        head = _at(file, at, 12) if at < end else b""
        wide = 9 - head[0].bit_length() if head else 9
        width = 9 - head[wide].bit_length() if wide < len(head) else 9
        if wide > 4 or wide + width > len(head):
            return
        ones = (1 << 7 * width) - 1
        length = int.from_bytes(head[wide : wide + width], "big") & ones
        start = at + wide + width
        yield head[:wide], start, None if length == ones else length
        if length == ones:
            return
        at = start + length


def _states(file: BinaryIO, at: int, end: int, path: Sequence[Collection[bytes]]) -> bool:
    """Whether a Matroska holds a number other than 0 along a path of identities."""
    for identity, start, length in _elements(file, at, end):
        if identity in path[0]:
            stop = end if length is None else min(start + length, end)
            if path[1:]:
                found = _states(file, start, stop, path[1:])
            else:
                found = start < stop and any(_at(file, start, min(stop - start, 8)))
            if found:
                return True
    return False


def _avi(file: BinaryIO, size: int) -> Extent:
    """Go from one list of at most 1 GB to the next. Some recorders count the 8 bytes of a list's own header too."""
    at = 0
    while (header := _at(file, at, 8))[:4] == b"RIFF" and len(header) == 8:
        (length,) = struct.unpack_from("<I", header, 4)
        at += 8 + length + length % 2
        if at > size + 8 and length != _UNSTATED:
            return Extent(size, False)
    return Extent(size, True)
