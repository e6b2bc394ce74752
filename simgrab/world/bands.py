"""Pictures are worked on in bands of rows: what lies between two steps stays in the cache, and threads share the bands.

NumPy and OpenCV let other threads run while they compute. No result depends on how many there are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

ROWS = 32  # 0.7 MB of float32 colours at 1080p

Picture = NDArray[np.float32]
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


def each_band(height: int, work: Callable[[slice], None], rows: int = ROWS) -> None:
    """Do work on every band of a picture's rows.

    Parameters
    ----------
    height : int
        Of the picture, px.
    work : callable
        Takes a band, and writes to no other rows.
    rows : int
        Height of a band, px.
    """
    share(work, (slice(y, min(y + rows, height)) for y in range(0, height, rows)))


def share(work: Callable[[_Item], _Result], items: Iterable[_Item]) -> list[_Result]:
    """Do work on every item, in as many threads as OpenCV may use, and return the results in order."""
    threads = cv2.getNumThreads()
    return list(_pool(threads).map(work, items)) if threads > 1 else [work(item) for item in items]


@lru_cache(maxsize=1)
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="bands")


def enlarged(coarse: Picture, size: tuple[int, int], rows: slice) -> Picture:
    """Enlarge a picture bilinearly, and return some rows of that.

    Parameters
    ----------
    coarse : ndarray of float32, shape (h, w) or (h, w, n)
    size : tuple of 2 ints
        Width and height of the whole enlarged picture, px.
    rows : slice
        Of the enlarged picture.

    Returns
    -------
    ndarray of float32, shape (rows, width) or (rows, width, n)
    """
    width, height = size
    last = len(coarse) - 1
    at = np.clip((np.arange(rows.start, rows.stop) + 0.5) * (len(coarse) / height) - 0.5, 0, last)
    above = at.astype(int)
    share = (at - above).astype(np.float32).reshape(-1, *[1] * (coarse.ndim - 1))
    between = coarse[above] * (1 - share) + coarse[np.minimum(above + 1, last)] * share
    return np.asarray(cv2.resize(between, (width, len(at)), interpolation=cv2.INTER_LINEAR))
