"""One thread that does what is asked for, one thing after another: of each asker, only the latest."""

from __future__ import annotations

import contextlib
import itertools
import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any, TypeVar

T = TypeVar("T")

_SECONDS_TO_END = 10.0


class SupersededError(Exception):
    """Something newer was asked for before this was begun."""


@dataclass(order=True)
class _Waiting:
    rank: int
    number: int
    work: Callable[[], Any] = field(compare=False)
    future: Future[Any] = field(compare=False)


class Turns:
    """A thread and what waits for it. What it does last, it does when `end` is called.

    Parameters
    ----------
    last : callable
    """

    def __init__(self, last: Callable[[], object]) -> None:
        self._last, self._count = last, itertools.count()
        self._waiting, self._changed, self._ends = dict[str, _Waiting](), threading.Condition(), False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def ask(self, asker: str, work: Callable[[], T], rank: int = 0) -> Future[T]:
        """Have work done, in place of what waits for the same asker, which then raises `SupersededError`.

        Parameters
        ----------
        asker : str
        work : callable
        rank : int
            What has the lowest goes first; within a rank, what was asked for first.
        """
        future: Future[T] = Future()
        with self._changed:
            if self._ends:
                future.set_exception(SupersededError())
                return future
            before = self._waiting.pop(asker, None)
            # An asker that repeats keeps its place in the queue.
            number = before.number if before and before.rank == rank else next(self._count)
            self._waiting[asker] = _Waiting(rank, number, work, future)
            self._changed.notify()
        if before:
            _drop(before.future)
        return future

    def end(self) -> None:
        """Drop what waits, finish what is being done, and end the thread."""
        with self._changed:
            self._ends = True
            left = list(self._waiting.values())
            self._waiting.clear()
            self._changed.notify()
        for one in left:
            _drop(one.future)
        self._thread.join(_SECONDS_TO_END)

    def _run(self) -> None:
        while (one := self._next()) is not None:
            if not one.future.set_running_or_notify_cancel():  # its asker has gone
                continue
            try:
                result = one.work()
            except BaseException as problem:
                one.future.set_exception(problem)
            else:
                one.future.set_result(result)
        with contextlib.suppress(Exception):
            self._last()

    def _next(self) -> _Waiting | None:
        with self._changed:
            while not self._waiting and not self._ends:
                self._changed.wait()
            if self._ends:
                return None
            asker = min(self._waiting, key=lambda name: self._waiting[name])
            return self._waiting.pop(asker)


def _drop(future: Future[Any]) -> None:
    if future.set_running_or_notify_cancel():
        future.set_exception(SupersededError())
