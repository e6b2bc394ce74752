"""Users' picture files, read completely or refused. Pillow reads them, because it reads the size before the pixels.

OpenCV decodes TIFF, because Pillow lets libtiff print its errors, and 16-bit values, because Pillow drops half of the
bits.
"""

from __future__ import annotations

import io
import re
from collections.abc import Collection, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import ImageOps
from PIL.BmpImagePlugin import BmpImageFile
from PIL.ImageFile import ImageFile
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile
from PIL.TiffImagePlugin import TiffImageFile
from PIL.WebPImagePlugin import WebPImageFile

from simgrab.errors import DatasetError, PictureError, first_line
from simgrab.io.files import is_visible
from simgrab.io.parse import cannot, read_bytes
from simgrab.runtime.environment import MOST_PIXELS, MOST_SIDE

MOST_BYTES = 8 * MOST_PIXELS  # four channels of 16 bits, uncompressed

MOST_SCANS = 500  # of a JPEG, each of which takes time for all of its pixels; a progressive one has about 10

SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp")  # by which a folder's pictures are known

_BITS = (8, 10, 12, 14, 16)  # that cameras store in 16
_LOOKED_AT = 8  # pictures of a folder, to find how many bits they have
# By a file's first bytes. `PIL.Image.open` would add limits, and warnings, of its own.
_READERS: dict[bytes, type[ImageFile]] = {
    b"\xff\xd8\xff": JpegImageFile, b"\x89PNG\r\n\x1a\n": PngImageFile, b"BM": BmpImageFile, b"RIFF": WebPImageFile,
    b"II": TiffImageFile, b"MM": TiffImageFile,
}  # fmt: skip
_TIFF_KIND, _TIFF_BITS, _TIFF_LARGEST, _TIFF_FORMAT = 254, 258, 281, 339
_TIFF_BESIDE = 1 | 4  # kinds of a page: a smaller copy, a mask
_TIFF_UNSIGNED = {1, 4}  # formats of values, or not stated; others are signed or no whole numbers


def of(folder: Path, suffixes: Collection[str] = SUFFIXES, *, below: bool = False) -> tuple[Path, ...]:
    """Picture files of a folder, sorted by the numbers in their names; only those that `is_visible` accepts.

    Suffixes are in lower case, with the dot; the files' own may be in upper case. With ``below``, pictures of
    subfolders are listed too. Raises `OSError` if the folder cannot be listed.
    """
    found = (
        path for path in (folder.rglob("*") if below else folder.iterdir())
        if path.suffix.lower() in suffixes and is_visible(path, folder) and not path.is_dir()
    )  # fmt: skip
    return tuple(sorted(found, key=_by_number))


def hidden(folder: Path) -> str:
    """Return a sentence with the number of hidden pictures that `of` leaves out; empty if there are none."""
    few = [path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and not is_visible(path, folder)]
    return f"hidden pictures are not read: {len(few)}, such as {few[0].name}" if few else ""


def _by_number(path: Path) -> tuple[tuple[tuple[bool, int, str], ...], Path]:
    """Key that sorts frame2 before frame10, and numbers before letters, by the file's name."""
    parts = re.findall(r"[0-9]+|[^0-9]+", path.name)
    return tuple((False, int(part), "") if part[0] in "0123456789" else (True, 0, part) for part in parts), path


def bits(files: Sequence[Path]) -> int | None:
    """Find how many bits the values of a folder's 16-bit pictures have: cameras store 10, 12 or 14 of them in 16.

    The files may state the number (PNG's ``sBIT``, TIFF's ``MaxSampleValue``). Otherwise it follows from the greatest
    value in a few pictures spread over the folder: 8, 10, 12, 14 or 16. None if the pictures read are not 16-bit
    pictures. All pictures of the folder are scaled alike.
    """
    greatest, stated = -1, 0
    for path in files[:: max(len(files) // _LOOKED_AT, 1)]:
        with suppress(PictureError):  # which is reported when its turn comes
            data = _bytes(path)
            with _opened(data, path) as image:
                if _depth(image, data) > 8:
                    greatest = max(greatest, int(_by_opencv(data, path).max()))
                    stated = max(stated, _stated(image, data))
    known = (stated,) if 8 <= stated <= 16 else _BITS
    return None if greatest < 0 else next((n for n in known if greatest < 1 << n), 16)


def scaled(bits: int | None) -> str:
    """Return a note that pictures are scaled from fewer than 16 bits; empty if they are not."""
    return f"16-bit pictures are read as of {bits} bits: no greater value was found" if bits and bits < 16 else ""


def read(path: Path, bits: int | None = None) -> NDArray[np.uint8]:
    """Read a JPEG, PNG, BMP, TIFF or WebP, by its content: RGB, turned as EXIF states, without transparency.

    Parameters
    ----------
    bits : int, optional
        Bits of a 16-bit picture's values, as `bits` finds them in the folder. Unless given, a picture whose values are
        all below 2¹⁴ is refused: it may have 14 bits or fewer, or be dark.

    Returns
    -------
    ndarray of uint8, shape (height, width, 3)

    Raises
    ------
    PictureError
        If it cannot be read, or `decode` refuses it.
    """
    return decode(_bytes(path), path, bits)


def _bytes(path: Path) -> bytes:
    def refusal(line: str) -> PictureError:
        return PictureError(path, line.removeprefix(f"{cannot(path)}: "))

    return read_bytes(path, refusal, most_bytes=MOST_BYTES)


def decode(data: bytes, path: Path | str, bits: int | None = None, *, half: bool = False) -> NDArray[np.uint8]:
    """Decode the bytes of a picture file; see `read`. ``path`` is for the message.

    With ``half``, a JPEG is decoded at half its size, in a fraction of the time.

    Raises `PictureError` if the picture is not a JPEG, PNG, BMP, TIFF or WebP, is truncated or damaged, contains
    several pictures, has values of more than 16 bits or of more than ``bits``, more than `MOST_PIXELS` pixels, a side
    above `MOST_SIDE`, or more than `MOST_SCANS` scans.
    """
    with _opened(data, path) as image:
        if isinstance(image, TiffImageFile) or _depth(image, data) > 8:
            picture = _by_opencv(data, path)
            return np.ascontiguousarray(picture if picture.dtype == np.uint8 else _eight_bits(picture, path, bits))
        try:
            if half:
                image.draft("RGB", (image.width // 2, image.height // 2))
            image.load()
        except Exception as problem:  # of any kind where the file is damaged
            raise _damaged(path, problem) from None
        with suppress(Exception):  # EXIF may be damaged, and the picture sound
            ImageOps.exif_transpose(image, in_place=True)
        return np.asarray(image if image.mode == "RGB" else image.convert("RGB"))


def _opened(data: bytes, path: Path | str) -> ImageFile:
    """Open a picture without decoding its pixels."""
    reader = next((reader for start, reader in _READERS.items() if data.startswith(start)), None)
    if reader is None:
        raise PictureError(path, "it is not a JPEG, PNG, BMP, TIFF or WebP" if data else "it is empty")
    if reader is JpegImageFile and data.count(b"\xff\xda") > MOST_SCANS:
        raise PictureError(path, f"it has more than {MOST_SCANS} scans")
    try:
        if reader is PngImageFile:
            reader(io.BytesIO(data)).verify()  # its checksums
        image = reader(io.BytesIO(data))
        several = getattr(image, "is_animated", False)
        if several and isinstance(image, TiffImageFile):
            image.seek(1)
            several = not image.tag_v2.get(_TIFF_KIND, 0) & _TIFF_BESIDE
            image.seek(0)
    except Exception as problem:
        raise _damaged(path, problem) from None
    if reason := _problem(image, several=several):
        raise PictureError(path, reason)
    return image


def _problem(image: ImageFile, *, several: bool) -> str:
    """Return why a picture is refused; empty if it is not."""
    if several:
        return "it holds several pictures"
    if isinstance(image, TiffImageFile):
        tags = image.tag_v2
        if max(tags.get(_TIFF_BITS, (1,))) > 16 or not _TIFF_UNSIGNED.issuperset(tags.get(_TIFF_FORMAT, ())):
            return "its values are not whole numbers of at most 16 bits"
    return too_large(*image.size)


def _damaged(path: Path | str, problem: Exception) -> PictureError:
    return PictureError(path, f"it is cut off or damaged ({first_line(problem)})")


def _depth(image: ImageFile, data: bytes) -> int:
    """Bits in which a picture stores each value."""
    if isinstance(image, PngImageFile):
        return data[24]
    return max(image.tag_v2.get(_TIFF_BITS, (1,))) if isinstance(image, TiffImageFile) else 8


def _stated(image: ImageFile, data: bytes) -> int:
    """Bits of a value that a PNG or TIFF states; 0 if none are stated."""
    if isinstance(image, TiffImageFile):
        depth, largest = _depth(image, data), image.tag_v2.get(_TIFF_LARGEST, 0)
        return depth if depth < 16 else int(np.max(largest)).bit_length()
    found = re.search(rb"\0\0\0[\1-\4]sBIT(.{1,4})", data.partition(b"IDAT")[0], re.DOTALL)  # which Pillow leaves out
    return max(found[1][: data[found.start() + 3]]) if found else 0


def _by_opencv(data: bytes, path: Path | str) -> NDArray[Any]:
    """Decode a picture of 8 or 16 bits, RGB."""
    import cv2
    from cv2.utils import logging

    level = logging.setLogLevel(logging.LOG_LEVEL_SILENT)  # else OpenCV prints what is wrong with a TIFF
    try:
        bgr = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    except cv2.error as error:
        raise _damaged(path, error) from None
    finally:
        logging.setLogLevel(level)
    if bgr is None:
        raise PictureError(path, "it is cut off or damaged")
    return np.asarray(bgr[..., ::-1])  # with IMREAD_COLOR_RGB OpenCV 5.0 gives wrong colours for a TIFF of 16 bits


def _eight_bits(picture: NDArray[np.uint16], path: Path | str, bits: int | None) -> NDArray[np.uint8]:
    greatest = int(picture.max())
    if bits is None and greatest < 1 << _BITS[-2]:
        why = f"its 16-bit values are at most {greatest}: it has fewer bits or is dark"
        raise PictureError(path, f"{why}; store 8 bits")
    if greatest >> (bits or 16):
        raise PictureError(path, f"its values reach {greatest}, above the {bits} bits of other pictures in its folder")
    return np.asarray(picture >> ((bits or 16) - 8), np.uint8)


def too_large(width: int, height: int) -> str:
    """Return an error line if a picture of this size is too large; empty if it is not."""
    if width * height <= MOST_PIXELS and max(width, height) <= MOST_SIDE:
        return ""
    most = f"{MOST_PIXELS / 1e6:.0f} megapixels and {MOST_SIDE} px a side"
    return f"it has {width} x {height} px; the limit is {most}"


def encode(picture: NDArray[np.generic], kind: str, quality: int = 95) -> bytes:
    """Encode a BGR or single-channel picture as ``jpeg`` or ``png``."""
    import cv2

    if kind == "jpeg":
        ok, data = cv2.imencode(".jpg", np.ascontiguousarray(picture), [cv2.IMWRITE_JPEG_QUALITY, quality])
    else:
        ok, data = cv2.imencode(".png", np.ascontiguousarray(picture), [cv2.IMWRITE_PNG_COMPRESSION, 3])
    if not ok:
        raise DatasetError(f"cannot encode a picture as {kind}")
    return data.tobytes()
