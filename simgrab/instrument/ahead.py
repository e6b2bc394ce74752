"""Work ahead in a thread."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")


def ahead(items: Iterable[T], most: int = 3) -> Iterator[T]:
    """Make the next few items in a thread while one is worked on, in order; errors come in their place.

    Decoding and detection release Python's lock, so that each has a core. Never more than ``most`` items wait.
    """
    end = object()
    source = iter(items)
    with ThreadPoolExecutor(1) as thread:
        waiting = deque(thread.submit(next, source, end) for _ in range(most))
        while (item := waiting.popleft().result()) is not end:
            waiting.append(thread.submit(next, source, end))
            yield item  # type: ignore[misc]  # not the end, hence a T
            del item  # a picture must not be held while the next is awaited
