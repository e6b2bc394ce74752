"""Openers that do what none of simgrab's may, one way each."""

import os
import time

import numpy as np

from simgrab.errors import SimgrabError


class _UnshownError(SimgrabError):
    """An error that leaves its message as it is."""

    def __str__(self):
        return str(self.args[0])


def _refuse(text):
    raise _UnshownError(text)


def _hold_memory():
    held = np.ones(400 << 17)  # 400 MiB
    time.sleep(60)
    return held


def _compute():
    while True:
        pass


FAULTS = {
    "accepted": lambda: None,
    "refused": lambda: _refuse("width_px: must be 1 at least, got 0"),
    "raises": lambda: {}["key"],
    "escape": lambda: _refuse("\x1b[31mred"),
    "long": lambda: _refuse("x" * 1001),
    "empty": lambda: _refuse(""),
    "aborts": os.abort,
    "dies": lambda: os._exit(7),
    "computes": _compute,
    "sleeps": lambda: time.sleep(600),
    "memory": _hold_memory,
}
OPENERS = {name: lambda _target, _corpus, fault=fault: fault() for name, fault in FAULTS.items()}
