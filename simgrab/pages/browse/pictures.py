"""Pictures as the page shows them, and a store of those used last."""

from __future__ import annotations

import threading
from collections import OrderedDict

import cv2
import numpy as np

from simgrab.io import pictures

TILE_WIDTH_PX = 320
MOST_KEPT_BYTES = 48 * 2**20
_QUALITY = 82
_LARGE_BYTES = 100_000


class LruCache:
    """Bytes by row, those used last, of a limited size together."""

    def __init__(self, most_bytes: int = MOST_KEPT_BYTES) -> None:
        self._most, self.size_bytes = most_bytes, 0
        self._kept, self._lock = OrderedDict[int, bytes](), threading.Lock()

    def get(self, row: int) -> bytes | None:
        """Give what is kept of a row."""
        with self._lock:
            if row in self._kept:
                self._kept.move_to_end(row)
            return self._kept.get(row)

    def put(self, row: int, data: bytes) -> None:
        """Keep something, in place of what was used least recently."""
        with self._lock:
            self.size_bytes += len(data) - len(self._kept.pop(row, b""))
            self._kept[row] = data
            while self.size_bytes > self._most:
                self.size_bytes -= len(self._kept.popitem(last=False)[1])


def tile(data: bytes, name: str) -> bytes:
    """Make a JPEG of at most `TILE_WIDTH_PX` of a picture file."""
    picture = pictures.decode(data, name, half=len(data) > _LARGE_BYTES)
    if picture.shape[1] > TILE_WIDTH_PX:
        height = max(round(picture.shape[0] * TILE_WIDTH_PX / picture.shape[1]), 1)
        small = cv2.resize(picture, (TILE_WIDTH_PX, height), interpolation=cv2.INTER_AREA)
        picture = np.asarray(small, np.uint8)
    return pictures.encode(picture[..., ::-1], "jpeg", _QUALITY)


def shown(data: bytes, name: str) -> tuple[bytes, str]:
    """Give a picture file as the page shows it, and its type: JPEG and PNG files as they are, others as JPEG."""
    if data.startswith(b"\xff\xd8\xff"):
        return data, "image/jpeg"
    if data.startswith(b"\x89PNG\r\n\x1a\n"):
        return data, "image/png"
    return pictures.encode(pictures.decode(data, name)[..., ::-1], "jpeg"), "image/jpeg"
