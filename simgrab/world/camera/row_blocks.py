"""Process pictures in blocks of rows: intermediate results stay in the cache, and threads share the blocks.

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

ROWS = 96  # 2.2 MB of float32 colours at 1080p: smaller blocks cost more to schedule than the cache saves

Picture = NDArray[np.float32]
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


def each_block(height: int, work: Callable[[slice], _Result]) -> list[_Result]:
    """Run work, which writes to no other rows, on every block of a picture's rows, and return its results in order."""
    return threaded_map(work, (slice(y, min(y + ROWS, height)) for y in range(0, height, ROWS)))


def threaded_map(work: Callable[[_Item], _Result], items: Iterable[_Item]) -> list[_Result]:
    """Map work, which must not nest, over items in as many threads as OpenCV may use; results are in order."""
    threads = cv2.getNumThreads()
    return list(_pool(threads).map(work, items)) if threads > 1 else [work(item) for item in items]


@lru_cache(maxsize=1)
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="blocks")


def enlarged(coarse: Picture, times: int, rows: slice, width: int) -> Picture:
    """Enlarge a picture (h, w) or (h, w, n) bilinearly, and return some rows of that.

    Its right end is cut off at ``width``, which is up to w · times.
    """
    first = max(rows.start // times - 1, 0)
    near = coarse[first : -(-rows.stop // times) + 1]
    fine = cv2.resize(near, None, fx=times, fy=times, interpolation=cv2.INTER_LINEAR)
    return np.asarray(fine[rows.start - first * times : rows.stop - first * times, :width])
