"""Signals that end a command, which then leaves nothing half done behind."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

from simgrab.processes import STOPS

TOGETHER_S = 1.0  # within which signals are one: `timeout` sends its own twice, and a terminal to a whole group


class Stopped(KeyboardInterrupt):
    """The command was asked to end. Whatever cleans up at Ctrl-C cleans up."""


@dataclass
class Received:
    """The signal that asked the command to end; None as long as none did."""

    number: int | None = None
    time_s: float = 0.0


@contextmanager
def stoppable() -> Iterator[Received]:
    """Let the first of these signals raise `Stopped`, and a second one end the process at once.

    Signals that are ignored stay ignored.
    """
    received = Received()

    def stop(number: int, _frame: FrameType | None) -> None:
        now = time.monotonic()
        if received.number is None:
            received.number, received.time_s = number, now
            raise Stopped
        if now - received.time_s > TOGETHER_S:
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)

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
