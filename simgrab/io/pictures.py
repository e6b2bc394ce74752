"""Picture files from outside: decoded by OpenCV once their headers show a whole picture of a size within the limit.

OpenCV alone is not enough: it crashes on a path that is no UTF-8, decodes the first part of a file that is cut off, and
decodes whatever size a header states.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from cv2.utils import logging
from numpy.typing import NDArray

from simgrab.errors import DatasetError, PictureError, first_line
from simgrab.io.files import is_visible
from simgrab.io.parse import cannot, read_bytes
from simgrab.runtime.environment import MOST_PIXELS, MOST_SIDE

MOST_BYTES = 8 * MOST_PIXELS  # four channels of 16 bits, uncompressed

MOST_SCANS = 500  # of a JPEG, each of which takes time for all of its pixels; a progressive one has about 10

SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp")  # by which a folder's pictures are known

Size = tuple[int, int]

_BITS = (8, 10, 12, 14, 16)  # that cameras store in 16
_LOOKED_AT = 8  # pictures of a folder, to find how many bits they have
_CUT_OFF = "it is cut off"
_JPEG_MARKER = re.compile(rb"\xff[^\x00\x01\xd0-\xd8\xff]")  # without fill bytes and those that stand within coded data
_JPEG_END, _JPEG_SCAN = 0xD9, 0xDA
_JPEG_FRAME = set(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_TIFF_CODES = {1: "B", 3: "H", 4: "I", 13: "I", 16: "Q"}
_TIFF_KIND, _TIFF_WIDTH, _TIFF_HEIGHT, _TIFF_BITS, _TIFF_LARGEST, _TIFF_FORMAT = 254, 256, 257, 258, 281, 339
_TIFF_DATA = ((273, 279), (324, 325))  # offsets and lengths of strips, and of tiles
_TIFF_WANTED = {
    _TIFF_KIND, _TIFF_WIDTH, _TIFF_HEIGHT, _TIFF_BITS, _TIFF_LARGEST, _TIFF_FORMAT, *_TIFF_DATA[0], *_TIFF_DATA[1],
}  # fmt: skip
_TIFF_UNSIGNED = {1, 4}  # or not stated; others are signed or no whole numbers
_TIFF_BESIDE = 1 | 4  # kinds: a smaller copy, a mask


class _RefusedError(Exception):
    """Says why a file is not given to OpenCV."""


def of(folder: Path, suffixes: Collection[str] = SUFFIXES, *, below: bool = False) -> tuple[Path, ...]:
    """Picture files of a folder that `is_visible` admits, by the numbers in their names.

    Parameters
    ----------
    folder : Path
    suffixes : collection of str
        In lower case, with the dot; those of the files may be in upper case.
    below : bool
        Also of the folders in it.

    Raises
    ------
    OSError
        If the folder cannot be listed.
    """
    found = (
        path for path in (folder.rglob("*") if below else folder.iterdir())
        if path.suffix.lower() in suffixes and is_visible(path, folder) and not path.is_dir()
    )  # fmt: skip
    return tuple(sorted(found, key=_by_number))


def _by_number(path: Path) -> tuple[tuple[tuple[bool, int, str], ...], Path]:
    """Key that sorts frame2 before frame10, and numbers before letters, by the file's name."""
    parts = re.findall(r"[0-9]+|[^0-9]+", path.name)
    return tuple((False, int(part), "") if part[0] in "0123456789" else (True, 0, part) for part in parts), path


def bits(files: Sequence[Path]) -> int | None:
    """Find how many bits the values of a folder's 16-bit pictures have: cameras store 10, 12 or 14 of them in 16.

    They are as many as the files state (PNG's ``sBIT``, TIFF's ``MaxSampleValue``), or else as hold the greatest value
    of a few pictures that are spread over the folder. All of its pictures are then scaled alike.

    Parameters
    ----------
    files : sequence of Path

    Returns
    -------
    int or None
        8, 10, 12, 14 or 16, or what is stated; None where those that were looked at are no 16-bit pictures.
    """
    greatest, stated = -1, 0
    for path in files[:: max(len(files) // _LOOKED_AT, 1)]:
        try:
            data = _bytes(path)
            if not _problem(data) and _depth(data) > 8:
                greatest = max(greatest, int(_decoded(data, path, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH).max()))
                stated = max(stated, _stated(data))
        except PictureError:  # which is reported when its turn comes
            continue
    known = (stated,) if 8 <= stated <= 16 else _BITS
    return None if greatest < 0 else next((n for n in known if greatest < 1 << n), 16)


def scaled(bits: int | None) -> str:
    """Say that pictures are scaled from fewer bits than 16; empty where they are not."""
    return f"16-bit pictures are read as of {bits} bits: no greater value was found" if bits and bits < 16 else ""


def read(path: Path, mode: int = cv2.IMREAD_COLOR_RGB, bits: int | None = None) -> NDArray[np.uint8]:
    """Read a picture file.

    Parameters
    ----------
    path : Path
        JPEG, PNG, BMP, TIFF or WebP, by its content.
    mode : int
        OpenCV's ``IMREAD_…``.
    bits : int, optional
        Of a 16-bit picture's values, as `bits` finds them in the folder. Unless given, a picture whose values are all
        below 2¹⁴ is refused: it may have 14 bits or fewer, or be dark.

    Returns
    -------
    ndarray of uint8, shape (height, width, 3), or (height, width) where ``mode`` is grey
        As OpenCV decodes it: turned as EXIF states, without transparency.

    Raises
    ------
    PictureError
        If it cannot be read, or `decode` refuses it.
    """
    return decode(_bytes(path), path, mode, bits)


def _bytes(path: Path) -> bytes:
    def refusal(line: str) -> PictureError:
        return PictureError(path, line.removeprefix(f"{cannot(path)}: "))

    return read_bytes(path, refusal, most_bytes=MOST_BYTES)


def decode(
    data: bytes, path: Path | str, mode: int = cv2.IMREAD_COLOR_RGB, bits: int | None = None
) -> NDArray[np.uint8]:
    """Decode the bytes of a picture file; see `read`. ``path`` is for the message.

    Raises
    ------
    PictureError
        If it is no JPEG, PNG, BMP, TIFF or WebP, is cut off or damaged, holds several pictures, has values of more
        than 16 bits or than ``bits``, more than `MOST_PIXELS` pixels, a side above `MOST_SIDE` or more than
        `MOST_SCANS` scans.
    """
    if problem := _problem(data):
        raise PictureError(path, problem)
    if _depth(data) == 8:
        return _decoded(data, path, mode)
    if mode != cv2.IMREAD_COLOR_RGB:
        return _eight_bits(_decoded(data, path, mode | cv2.IMREAD_ANYDEPTH), path, bits)
    # OpenCV 5.0 gives wrong colours for a TIFF of 16 bits in this order.
    bgr = _eight_bits(_decoded(data, path, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH), path, bits)
    return np.ascontiguousarray(bgr[..., ::-1])


def _eight_bits(picture: NDArray[np.uint16], path: Path | str, bits: int | None) -> NDArray[np.uint8]:
    greatest = int(picture.max())
    if bits is None and greatest < 1 << _BITS[-2]:
        why = f"its 16-bit values are at most {greatest}: it has fewer bits or is dark"
        raise PictureError(path, f"{why}; store 8 bits")
    if greatest >> (bits or 16):
        raise PictureError(path, f"its values reach {greatest}, above the {bits} bits of other pictures in its folder")
    return np.asarray(picture >> ((bits or 16) - 8), np.uint8)


def _decoded(data: bytes, path: Path | str, mode: int) -> NDArray[Any]:
    level = logging.setLogLevel(logging.LOG_LEVEL_SILENT)  # else OpenCV prints what is wrong with a TIFF
    try:
        found = cv2.imdecode(np.frombuffer(data, np.uint8), mode)
    except cv2.error as error:
        raise PictureError(path, first_line(error)) from None
    finally:
        logging.setLogLevel(level)
    if found is None:
        raise PictureError(path, "it is damaged")
    return np.asarray(found)


def _depth(data: bytes) -> int:
    """Bits in which a picture that is not refused stores each value, from 8 to 16."""
    if data.startswith(b"\x89PNG"):
        return max(data[24], 8)
    return max((8, *_tiff_tags(data)[0].get(_TIFF_BITS, ()))) if _is_tiff(data) else 8


def _is_tiff(data: bytes) -> bool:
    return data[:2] in (b"II", b"MM")


def _stated(data: bytes) -> int:
    """Bits of the values, as a PNG or TIFF states them; else 0."""
    if data.startswith(b"\x89PNG"):
        head = data[: data.find(b"IDAT")]
        at = head.find(b"sBIT")
        return max(head[at + 4 : at + 4 + int.from_bytes(head[at - 4 : at])], default=0) if at > 0 else 0
    if not _is_tiff(data):
        return 0
    depth, largest = _depth(data), max(_tiff_tags(data)[0].get(_TIFF_LARGEST) or (0,))
    return depth if depth < 16 else largest.bit_length()


def too_large(width: int, height: int) -> str:
    """Say that a picture of this size is too large; empty where it is not."""
    if width * height <= MOST_PIXELS and max(width, height) <= MOST_SIDE:
        return ""
    most = f"{MOST_PIXELS / 1e6:.0f} megapixels and {MOST_SIDE} px a side"
    return f"it has {width} x {height} px; the limit is {most}"


def _problem(data: bytes) -> str:
    """Say why a file is not given to OpenCV; empty where it is."""
    if not data:
        return "it is empty"
    for starts, size in _KINDS:
        if starts.match(data):
            try:
                return too_large(*size(data))
            except struct.error:
                return _CUT_OFF
            except _RefusedError as reason:
                return str(reason)
    return "it is not a JPEG, PNG, BMP, TIFF or WebP"


def _within(data: bytes, end: int) -> None:
    if end > len(data):
        raise _RefusedError(_CUT_OFF)


def _jpeg(data: bytes) -> Size:
    """Go from marker to marker up to the end of the image. What a camera appends after it does not count."""
    size, scans, at = (0, 0), 0, 2
    while marker := _JPEG_MARKER.search(data, at):
        code = data[marker.end() - 1]
        if code == _JPEG_END:
            return size
        scans += code == _JPEG_SCAN
        if scans > MOST_SCANS:
            raise _RefusedError(f"it has more than {MOST_SCANS} scans")
        (length,) = struct.unpack_from(">H", data, marker.end())
        if code in _JPEG_FRAME and size == (0, 0):
            height, width = struct.unpack_from(">HH", data, marker.end() + 3)
            size = width, height
        at = marker.end() + length
    raise _RefusedError(_CUT_OFF)


def _png(data: bytes) -> Size:
    """Go from chunk to chunk up to the last; libpng would print which checksum is wrong."""
    at, kind = 8, b""
    while kind != b"IEND":
        length, kind = struct.unpack_from(">I4s", data, at)
        end = at + 8 + length
        _within(data, end + 4)
        checksum = int.from_bytes(data[end : end + 4])
        if kind == b"acTL" and int.from_bytes(data[at + 8 : at + 12]) > 1:
            raise _RefusedError("it is an animation of several pictures")
        if kind[:1].isupper() and zlib.crc32(memoryview(data)[at + 4 : end]) != checksum:  # the picture needs it
            raise _RefusedError("it is damaged")
        at = end + 4
    width, height = struct.unpack_from(">II", data, 16)
    return width, height


def _bmp(data: bytes) -> Size:
    (start, header) = struct.unpack_from("<II", data, 10)
    if header == 12:
        width, height, _, bits = struct.unpack_from("<HHHH", data, 18)
        coding = 0
    else:
        width, height, _, bits, coding = struct.unpack_from("<iiHHI", data, 18)
    width, height = abs(width), abs(height)
    if coding in (0, 3):  # not run lengths
        _within(data, start + (width * bits + 31) // 32 * 4 * height)
    return width, height


def _tiff(data: bytes) -> Size:
    """Read the first directory; its strips or tiles must lie within the file."""
    found, following = _tiff_tags(data)
    for offsets, lengths in _TIFF_DATA:
        for start, length in zip(found.get(offsets, ()), found.get(lengths, ()), strict=False):
            _within(data, start + length)
    if following and not (_tiff_tags(data, following)[0].get(_TIFF_KIND) or (0,))[0] & _TIFF_BESIDE:
        raise _RefusedError("it has several pages")
    if max(found.get(_TIFF_BITS) or (1,)) > 16 or not _TIFF_UNSIGNED.issuperset(found.get(_TIFF_FORMAT, ())):
        raise _RefusedError("its values are not whole numbers of at most 16 bits")
    width, height = ((found.get(tag) or (0,))[0] for tag in (_TIFF_WIDTH, _TIFF_HEIGHT))
    return width, height


def _tiff_tags(data: bytes, at: int | None = None) -> tuple[dict[int, tuple[int, ...]], int]:
    """Read a directory, the first unless its offset is given: tags that are wanted, and where the next one is or 0."""
    order = "<" if data[:2] == b"II" else ">"
    (version,) = struct.unpack_from(f"{order}H", data, 2)
    offset, count, entry = ("Q", "Q", f"{order}HHQ8s") if version == 43 else ("I", "H", f"{order}HHI4s")
    if at is None:
        (at,) = struct.unpack_from(order + offset, data, 8 if version == 43 else 4)
    (entries,) = struct.unpack_from(order + count, data, at)
    first = at + struct.calcsize(order + count)
    _within(data, first + entries * struct.calcsize(entry))
    found: dict[int, tuple[int, ...]] = {}
    for tag, kind, number, value in struct.iter_unpack(entry, data[first : first + entries * struct.calcsize(entry)]):
        if tag in _TIFF_WANTED and kind in _TIFF_CODES:
            values = f"{order}{number}{_TIFF_CODES[kind]}"
            if struct.calcsize(values) > len(value):
                (where,) = struct.unpack(order + offset, value)
                found[tag] = struct.unpack_from(values, data, where)
            else:
                found[tag] = struct.unpack_from(values, value)
    (following,) = struct.unpack_from(order + offset, data, first + entries * struct.calcsize(entry))
    return found, following


def _webp(data: bytes) -> Size:
    (length,) = struct.unpack_from("<I", data, 4)
    _within(data, 8 + length)
    kind = data[12:16]
    if kind == b"VP8X":
        if data[20] & 2:
            raise _RefusedError("it is an animation of several pictures")
        width, height = (1 + int.from_bytes(data[at : at + 3], "little") for at in (24, 27))
    elif kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        width, height = 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    else:
        width, height = (side & 0x3FFF for side in struct.unpack_from("<HH", data, 26))
    return width, height


_KINDS: tuple[tuple[re.Pattern[bytes], Callable[[bytes], Size]], ...] = (
    (re.compile(rb"\xff\xd8\xff"), _jpeg),
    (re.compile(rb"\x89PNG\r\n\x1a\n"), _png),
    (re.compile(rb"BM"), _bmp),
    (re.compile(rb"II[*+]\0|MM\0[*+]"), _tiff),
    (re.compile(rb"RIFF....WEBP", re.DOTALL), _webp),
)


def encode(picture: NDArray[np.generic], kind: str, quality: int = 95) -> bytes:
    """Encode a BGR or single-channel picture as ``jpeg`` or ``png``."""
    if kind == "jpeg":
        ok, data = cv2.imencode(".jpg", np.ascontiguousarray(picture), [cv2.IMWRITE_JPEG_QUALITY, quality])
    else:
        ok, data = cv2.imencode(".png", np.ascontiguousarray(picture), [cv2.IMWRITE_PNG_COMPRESSION, 3])
    if not ok:
        raise DatasetError(f"cannot encode a picture as {kind}")
    return data.tobytes()
