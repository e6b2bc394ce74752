"""Signals that end a command without leaving partial output."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

from simgrab.runtime.processes import STOPS

TOGETHER_S = 1.0  # within which signals are one: `timeout` sends its own twice, and a terminal to a whole group


@dataclass
class Received:
    """The signal that asked the command to end; None before any has."""

    number: int | None = None


@contextmanager
def stoppable() -> Iterator[Received]:
    """Raise KeyboardInterrupt at the first of these signals; end the process at the second.

    Python raises only between two of its own instructions: while a library computes or waits, the first signal is
    pending. A thread waits for the second signal, so that it takes effect at any time. Signals that are ignored stay
    ignored.
    """
    received = Received()

    def stop(number: int, _frame: FrameType | None) -> None:
        if received.number is None:
            received.number = number
            raise KeyboardInterrupt

    numbers, written = os.pipe()
    os.set_blocking(written, False)
    wakeup = signal.set_wakeup_fd(written, warn_on_full_buffer=False)
    threading.Thread(target=_end_at_the_second, args=(numbers,), daemon=True).start()
    before = {}
    for number in STOPS:
        if (handler := signal.getsignal(number)) not in (signal.SIG_IGN, None):
            before[number] = handler
            signal.signal(number, stop)
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(wakeup)
        os.close(written)


def _end_at_the_second(numbers: int) -> None:
    """Read the numbers of signals from a pipe, and end the process at one that comes some time after the first."""
    first_s: float | None = None
    while number := os.read(numbers, 1):
        now_s = time.monotonic()
        if number[0] not in STOPS:
            continue
        if first_s is None:
            first_s = now_s
        elif now_s - first_s > TOGETHER_S:
            os._exit(128 + number[0])
    os.close(numbers)
