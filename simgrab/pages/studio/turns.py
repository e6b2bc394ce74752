"""One thread that does what is asked for, one thing after another: of each asker, only the latest."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple, TypeVar

T = TypeVar("T")


class SupersededError(Exception):
    """Something newer was asked for before this was begun."""


class _Waiting(NamedTuple):
    rank: int
    work: Callable[[], Any]
    future: Future[Any]


class Turns:
    """A thread and what waits for it. What it does last, it does when `end` is called."""

    def __init__(self, last: Callable[[], object]) -> None:
        self._last, self._thread = last, ThreadPoolExecutor(1)
        self._waiting, self._lock, self._ended = dict[str, _Waiting](), threading.Lock(), False

    def ask(self, asker: str, work: Callable[[], T], rank: int = 0) -> Future[T]:
        """Have work done, in place of what waits for the same asker, which then raises `SupersededError`.

        The lowest rank goes first; within a rank, who asked first, also where it has asked again since.
        """
        future: Future[T] = Future()
        with self._lock:
            if self._ended:
                future.set_exception(SupersededError())
                return future
            before = self._waiting.get(asker)
            self._waiting[asker] = _Waiting(rank, work, future)
            if before is None:
                self._thread.submit(self._do_next)
        if before is not None:
            _drop(before.future)
        return future

    def end(self) -> None:
        """Drop what waits, finish what is being done, and end the thread."""
        with self._lock:
            self._ended, left = True, list(self._waiting.values())
            self._waiting.clear()
        for one in left:
            _drop(one.future)
        with contextlib.suppress(Exception):
            self._thread.submit(self._last).result()
        self._thread.shutdown()

    def _do_next(self) -> None:
        with self._lock:
            if not self._waiting:
                return
            one = self._waiting.pop(min(self._waiting, key=lambda asker: self._waiting[asker].rank))
        if not one.future.set_running_or_notify_cancel():  # its asker has gone
            return
        try:
            one.future.set_result(one.work())
        except BaseException as problem:
            one.future.set_exception(problem)


def _drop(future: Future[Any]) -> None:
    if future.set_running_or_notify_cancel():
        future.set_exception(SupersededError())
