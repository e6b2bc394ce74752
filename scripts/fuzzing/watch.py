"""Opens inputs in a process of its own, so that a crash, a hang or a hunger for memory is seen and attributed."""

from __future__ import annotations

import contextlib
import faulthandler
import importlib
import multiprocessing
import os
import signal
import time
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from types import TracebackType
from typing import Any

import psutil

from simgrab.errors import SimgrabError
from simgrab.runtime.processes import die_with_parent

ACCEPTED, REFUSED, TRACEBACK, MESSAGE, SIGNAL, LIMIT = "accepted", "refused", "traceback", "message", "signal", "limit"
FAILED = (TRACEBACK, MESSAGE, SIGNAL, LIMIT)
MOST_MESSAGE = 1000  # characters of a refusal
_MIB = 1 << 20
_POLL_S = 0.05


@dataclass(frozen=True)
class Limits:
    """What one input may take: processor time, waiting in all, and resident memory of the process that opens it."""

    seconds: float = 20.0
    waiting: float = 300.0
    memory_mib: float = 2048.0


@dataclass(frozen=True)
class Outcome:
    """What became of an input: a status, and the refusal, traceback, signal or limit; processor time, peak memory."""

    status: str
    text: str = ""
    seconds: float = 0.0
    memory_mib: float = 0.0


class Watched:
    """A process that opens inputs, replaced where it dies. Use as a context manager.

    ``openers`` is a module whose ``OPENERS`` are called with the path of an input and ``corpus``; ``log`` gets what
    libraries print.
    """

    def __init__(self, openers: str, corpus: Path, log: Path, limits: Limits) -> None:
        self._arguments = openers, corpus, log
        self.limits = limits
        self._log = log
        self._pipe: Connection | None = None
        self._process: Any = None

    def __enter__(self) -> Watched:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._stop()

    def open(self, kind: str, target: Path) -> Outcome:
        """Open an input."""
        if self._pipe is None:
            self._start()
        assert self._pipe is not None
        self._log.write_bytes(b"")
        self._pipe.send((kind, os.fsencode(target)))
        peak, outcome = 0.0, None
        try:
            self._pipe.recv()  # it begins
            begun, worker = time.monotonic(), psutil.Process(self._process.pid)
            used = sum(worker.cpu_times()[:2])
            while not self._pipe.poll(_POLL_S):
                seconds, peak = sum(worker.cpu_times()[:2]) - used, max(peak, worker.memory_info().rss / _MIB)
                if seconds > self.limits.seconds:
                    outcome = Outcome(LIMIT, f"longer than {self.limits.seconds:g} s", seconds, peak)
                elif time.monotonic() - begun > self.limits.waiting:
                    outcome = Outcome(LIMIT, f"not done after {self.limits.waiting:g} s", seconds, peak)
                elif peak > self.limits.memory_mib:
                    outcome = Outcome(LIMIT, f"more than {self.limits.memory_mib:g} MiB", seconds, peak)
                if outcome is not None:
                    os.kill(self._process.pid, signal.SIGABRT)  # its stack goes to the log
                    self._process.join(5)
                    break
            else:
                outcome = self._pipe.recv()
        except (EOFError, ConnectionError, psutil.NoSuchProcess):
            self._process.join()
            code = self._process.exitcode
            name = signal.Signals(-code).name if code < 0 else f"exit with {code}"
            outcome = Outcome(SIGNAL, name, 0.0, peak)
        if outcome.status in (SIGNAL, LIMIT):
            self._stop()
            printed = self._log.read_text(encoding="utf-8", errors="backslashreplace")[-6000:]
            return Outcome(outcome.status, f"{outcome.text}\n{printed}", outcome.seconds, outcome.memory_mib)
        if outcome.status not in FAILED and outcome.memory_mib > self.limits.memory_mib:
            return Outcome(LIMIT, f"more than {self.limits.memory_mib:g} MiB", outcome.seconds, outcome.memory_mib)
        return outcome

    def _start(self) -> None:
        spawn = multiprocessing.get_context("spawn")  # a fork would share the state of OpenGL and of threads
        self._pipe, theirs = spawn.Pipe()
        self._process = spawn.Process(target=_work, args=(theirs, *self._arguments), daemon=True)
        self._process.start()
        theirs.close()
        self._pipe.recv()  # it is ready: importing is no part of an input's time

    def _stop(self) -> None:
        if self._pipe is not None:
            self._pipe.close()
            self._process.kill()
            self._process.join()
            self._pipe = None


def _work(pipe: Connection, openers: str, corpus: Path, log: Path) -> None:
    """Open inputs as they come."""
    die_with_parent()
    printed = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(printed, 1)
    os.dup2(printed, 2)
    faulthandler.enable()
    known = importlib.import_module(openers).OPENERS
    pipe.send("ready")
    while True:
        with contextlib.suppress(EOFError):
            kind, target = pipe.recv()
            pipe.send("begun")
            pipe.send(_attempt(known, kind, Path(os.fsdecode(target)), corpus))
            continue
        return


def _attempt(openers: Mapping[str, Any], kind: str, target: Path, corpus: Path) -> Outcome:
    _forget_peak()
    begun = time.process_time()
    try:
        openers[kind](target, corpus)
        status, text = ACCEPTED, ""
    except SimgrabError as problem:
        status, text = _judged(problem)
    except BaseException:
        status, text = TRACEBACK, traceback.format_exc()
    return Outcome(status, text, time.process_time() - begun, _peak_mib())


def _judged(problem: SimgrabError) -> tuple[str, str]:
    """Whether a refusal is one line that a terminal shows as it is."""
    try:
        text = str(problem)
    except Exception:
        return TRACEBACK, traceback.format_exc()
    if not text:
        return MESSAGE, f"{type(problem).__name__} without a text\n{traceback.format_exc()}"
    if len(text) > MOST_MESSAGE:
        return MESSAGE, f"{len(text)} characters: {text[:300]} …\n{traceback.format_exc()[-3000:]}"
    if not text.isprintable():
        return MESSAGE, f"not printable: {text!r}\n{traceback.format_exc()[-3000:]}"
    return REFUSED, f"{type(problem).__name__}: {text}"


def _peak_mib() -> float:
    fields = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return int(fields["VmHWM"].split()[0]) * 1024 / _MIB


def _forget_peak() -> None:
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
