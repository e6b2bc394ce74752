"""Environment variables that OpenCV and NumPy read when imported: those with which they cannot work are ignored."""

from __future__ import annotations

import logging
import os
import re

from simgrab.errors import shortened
from simgrab.text import printable

MOST_PIXELS = 100_000_000  # of a picture: three times 8K; as RGB it takes 300 MB
MOST_SIDE = 16_384  # a detector pads a narrow strip to the net's aspect, and OpenCV warps no more than 32,766

_LEAST = {
    "OPENCV_IO_MAX_IMAGE_PIXELS": MOST_PIXELS, "OPENCV_IO_MAX_IMAGE_WIDTH": MOST_SIDE,
    "OPENCV_IO_MAX_IMAGE_HEIGHT": MOST_SIDE, "OPENCV_IO_MAX_IMAGE_PARAMS": 2,
}  # fmt: skip
_OF_NUMBERS = re.compile(r"OPENCV_\w*(_MAX_|_NUM$|_WAIT_|_GRANULARITY$|_LIMIT$|_DEPTH_)\w*|NUMPY_MADVISE_HUGEPAGE")
_NUMBER = re.compile(r"(\d+)(?:([KM])b)?", re.IGNORECASE)

_log = logging.getLogger(__name__)


def ignore(variables: dict[str, str], why: str) -> None:
    """Warn that variables, which were taken out of the environment, are ignored, and why."""
    if variables:
        names = ", ".join(f"{name}={value}" for name, value in variables.items())
        _log.warning("%s", shortened(printable(f"simgrab ignores {names}: {why}")))


def take_out_numbers() -> None:
    """Take out numbers that end the process, unnamed, as OpenCV or NumPy is imported, or refuse simgrab's own files."""
    names = [name for name in os.environ if _OF_NUMBERS.fullmatch(name) and not _is_enough(name, os.environ[name])]
    ignore({name: os.environ.pop(name) for name in names}, "no numbers with which OpenCV and NumPy work")


def _is_enough(name: str, value: str) -> bool:
    number = _NUMBER.fullmatch(value)
    if number is None:
        return False
    factor = {None: 1, "k": 2**10, "m": 2**20}[number[2] and number[2].lower()]
    return _LEAST.get(name, 0) <= int(number[1]) * factor < 2**64
