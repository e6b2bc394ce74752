"""Stop calls that take too long. One thread watches all running calls, at almost no cost.

A picture needs several runs of nets; a thread for each run would double a detector's time on a busy machine.
"""

from __future__ import annotations

import itertools
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_EVERY_S = 0.5

_numbers = itertools.count()
_under_way: dict[int, tuple[float, Callable[[], object]]] = {}
_lock = threading.Lock()
_watches = False


@contextmanager
def within(seconds: float, stop: Callable[[], object]) -> Iterator[None]:
    """Call ``stop``, in another thread, unless the block ends within so many seconds; half a second late at most."""
    _watch()
    number = next(_numbers)
    _under_way[number] = time.monotonic() + seconds, stop
    try:
        yield
    finally:
        _under_way.pop(number, None)


def _watch() -> None:
    global _watches
    with _lock:
        if not _watches:
            threading.Thread(target=_stop_late_ones, name="simgrab deadlines", daemon=True).start()
            _watches = True


def _stop_late_ones() -> None:
    while True:
        time.sleep(_EVERY_S)
        now = time.monotonic()
        for number, (due, stop) in list(_under_way.items()):
            if now > due and _under_way.pop(number, None) is not None:
                stop()


def _forked() -> None:
    """Start over in a forked process, which has no other thread."""
    global _watches, _lock
    _watches, _lock = False, threading.Lock()
    _under_way.clear()


os.register_at_fork(after_in_child=_forked)
