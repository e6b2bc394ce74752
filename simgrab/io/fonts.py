"""Font files for the display, read and checked before anything is drawn with them.

A scenario names one by the file's name and the SHA-256 of its content, as it names models of grabs; the bytes are kept
in the process (`simgrab.io.models`).
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

from simgrab.io.models import ModelFile, check_ending, remember
from simgrab.io.parse import Refuse, read_bytes

FORMATS = ("ttf", "otf")
MOST_BYTES = 32 * 2**20
CHARACTERS = "0123456789."
_NO_CHARACTER = "\uffff"  # never assigned: fonts show what they show for a missing one
_EM = 64  # font size of the check
_LARGEST = 4  # ems that a character may reach from the middle of its baseline


def read(path: str | Path, refuse: Refuse) -> ModelFile:
    """Read a font, and keep it for `simgrab.io.models.recall`.

    ``refuse`` makes the error to raise from a message, for a file that cannot be read, is larger than `MOST_BYTES`, is
    not a font, or lacks one of `CHARACTERS`.
    """
    path = Path(path)
    check_ending(path.name, FORMATS, refuse)
    return of_files(path.name, {path.name: read_bytes(path, refuse, most_bytes=MOST_BYTES)}, refuse)


def of_files(name: str, files: Mapping[str, bytes], refuse: Refuse) -> ModelFile:
    """Keep a font given as bytes, with the checks of `read`."""
    check_ending(name, FORMATS, refuse)
    if set(files) != {name} or len(files[name]) > MOST_BYTES:
        raise refuse(f"{name}: is not one font file of at most {MOST_BYTES >> 20} MiB")
    try:
        missing = _missing(sized(files[name], _EM))
    except (OSError, ValueError, MemoryError):  # what FreeType refuses is an OSError
        raise refuse(f"{name}: is damaged, or not a scalable font") from None
    if missing:
        raise refuse(f"{name}: has no usable glyph for {' '.join(missing)}")
    return remember(ModelFile(name, files))


def sized(data: bytes | Path, size: int) -> ImageFont.FreeTypeFont:
    """Open a font at a size in pixels."""
    source = io.BytesIO(data) if isinstance(data, bytes) else str(data)
    return ImageFont.truetype(source, size, layout_engine=ImageFont.Layout.BASIC)


def _missing(font: ImageFont.FreeTypeFont) -> str:
    """Characters that are blank, far too large, or drawn like a missing character."""
    for character in CHARACTERS:
        if max(map(abs, font.getbbox(character, anchor="ms"))) > _LARGEST * _EM:
            return character
    missing = _drawn(font, _NO_CHARACTER)
    return "".join(c for c in CHARACTERS if (drawn := _drawn(font, c)) == missing or not any(drawn))


def _drawn(font: ImageFont.FreeTypeFont, character: str) -> bytes:
    side = 2 * _LARGEST * _EM
    picture = Image.new("L", (side, side))
    ImageDraw.Draw(picture).text((side // 2, side // 2), character, 255, font, anchor="ms")
    return picture.tobytes()
