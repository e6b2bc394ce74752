"""Worker processes that share items of work. A process that dies costs only the time of its item."""

from __future__ import annotations

import atexit
import contextlib
import fcntl
import logging
import os
import signal
import sys
import time
import traceback
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping
from dataclasses import dataclass
from multiprocessing import connection, get_context, parent_process, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from types import FrameType, TracebackType
from typing import Any, Generic, NamedTuple, Self, TypeVar

from simgrab.errors import WorkerError

ATTEMPTS = 3  # at an item, before it is given up
PLACE = "SIMGRAB_WORKER"  # environment variable of a worker: its number among those of its pool, from 0
STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # signals that ask a command to end
_PATIENCE_S = 10.0  # for a worker to end, before it is killed

Item = TypeVar("Item")
T = TypeVar("T")

_log = logging.getLogger(__name__)
_spawn = get_context("spawn")  # OpenGL contexts do not survive a fork


def pickled(value: object) -> bytes:
    """Pickle an object as it is sent to a worker process. Failure raises an error of any type."""
    return bytes(ForkingPickler.dumps(value))


def unpickled(data: bytes) -> Any:
    """Unpickle an object that this program pickled, on this machine or another machine of its cluster."""
    return ForkingPickler.loads(data)


@dataclass
class Job(Generic[Item]):
    """An item under way; ``heard_s`` is when its worker was last heard of, by the monotonic clock."""

    name: str
    item: Item
    deaths: int = 0
    ticks: int = 0
    most_ticks: int = 0
    heard_s: float = 0.0


class Answer(NamedTuple):
    """A worker's message: the handle of its item, the kind of message, and its value."""

    handle: Any
    kind: str
    value: Any


TICK, DONE, RAISED, DIED = "tick", "done", "raised", "died"
"""Kinds of an answer: so many steps, the result, an error with its traceback as text, and how its process ended."""


class Executor(ABC):
    """Processes that call one function for each of many items. Use as a context manager."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    @abstractmethod
    def close(self) -> None:
        """End the processes; those at work abandon their items."""

    @abstractmethod
    def _room(self) -> int:
        """Most items that may be under way."""

    @abstractmethod
    def _submit(self, work: Callable[[Item], T], item: Item, running: Collection[Any]) -> Any:
        """Let a process do an item; returns a handle that no running item has."""

    @abstractmethod
    def _answers(self, running: Mapping[Any, Job[Any]]) -> Iterator[Answer]:
        """Wait for answers, until one arrives or the time is over."""

    @abstractmethod
    def _cancel(self, running: Collection[Any]) -> None:
        """Give up items."""

    def map(
        self,
        work: Callable[[Item], T],
        items: Iterable[Item],
        *,
        name: Callable[[Item], str] | None = None,
        ticked: Callable[[int], None] | None = None,
    ) -> Generator[T, None, None]:
        """Call ``work`` for each item, and yield the results in any order.

        Errors of ``work`` are raised unchanged, and `WorkerError` if workers die at one item `ATTEMPTS` times.

        Parameters
        ----------
        work : callable
            Takes an item; both are picklable. It may call `tick`.
        items : iterable
            Items, taken one at a time and in order as workers become free.
        name : callable, optional
            Makes an item's name in messages.
        ticked : callable, optional
            Called with the number of ticks so far. A repeated item counts the ticks of its longest attempt. All ticks
            of an item are counted before its result is yielded.
        """
        waiting, running, finished = deque[Job[Item]](), dict[Any, Job[Item]](), 0
        fresh = (Job(name(item) if name else f"item {number}", item) for number, item in enumerate(items, 1))

        def fill() -> None:
            while len(running) < self._room() and (job := waiting.popleft() if waiting else next(fresh, None)):
                running[self._submit(work, job.item, running)] = job
                job.ticks, job.heard_s = 0, time.monotonic()

        try:
            while True:
                fill()
                if not running:
                    return
                for handle, kind, value in self._answers(running):
                    job = running[handle]
                    job.heard_s = time.monotonic()
                    if kind == TICK:
                        job.ticks += value
                        job.most_ticks = max(job.ticks, job.most_ticks)
                        if ticked:
                            ticked(finished + sum(one.most_ticks for one in (*running.values(), *waiting)))
                        continue
                    del running[handle]
                    if kind == RAISED:
                        problem, where = value
                        raise problem from RemoteError(where)
                    if kind == DIED:
                        job.deaths += 1
                        if job.deaths == ATTEMPTS:
                            raise WorkerError(
                                f"{job.name}: {ATTEMPTS} worker processes died processing it; the last {value}"
                            )
                        _log.warning("%s: its worker process %s; the item is retried", job.name, value)
                        waiting.append(job)
                        continue
                    finished += job.most_ticks
                    fill()
                    yield value
        finally:
            self._cancel(running)


class Pool(Executor):
    """Processes of this machine.

    Each worker has a pipe of its own and shares no lock, so that none waits for one that died. A dead worker (out of
    memory, a crash within a library) is replaced, with a warning in the log, and its item is repeated. Repeated work
    must give the same result, even after an unfinished attempt. (An executor of `concurrent.futures` is broken by the
    first death, knows no ticks, and waits for a worker that hangs.)

    Parameters
    ----------
    workers : int
        Greatest number of processes; each is started when there is an item for it.
    setup : callable, optional
        Called in each process before its first item; picklable. Its errors are raised for each item. It may be
        replaced; the new one applies to processes started later.
    environment : mapping of str to str, optional
        Variables of the processes, besides those of this one.
    silent_s : float, optional
        How long a worker may neither tick nor finish, before it is killed and replaced as one that hangs.
    """

    def __init__(
        self,
        workers: int,
        *,
        setup: Callable[[], None] | None = None,
        environment: Mapping[str, str] | None = None,
        silent_s: float | None = None,
    ) -> None:
        self.setup, self._environment, self._silent_s = setup, environment or {}, silent_s
        self._workers: list[_Worker | None] = [None] * workers  # by place, which is the handle of an item
        atexit.register(self.close)  # else Python, ending with this left open, would wait for the workers

    def close(self) -> None:
        """End the processes; those at work abandon their items."""
        self._cancel(range(len(self._workers)))
        atexit.unregister(self.close)

    def _room(self) -> int:
        return len(self._workers)

    def _submit(self, work: Callable[[Item], T], item: Item, running: Collection[int]) -> int:
        """Send an item to a worker; start a worker if there is no living one."""
        place = next(place for place in range(len(self._workers)) if place not in running)
        if (idle := self._workers[place]) is not None:
            try:
                idle.pipe.send((work, item))
                return place
            except OSError:
                self._discard(place)
        fresh = self._workers[place] = _Worker(self.setup)
        fresh.start({**self._environment, PLACE: str(place)})
        with contextlib.suppress(OSError):  # it died of this, or at once: its pipe is at its end then
            fresh.pipe.send((work, item))
        return place

    def _answers(self, running: Mapping[int, Job[Any]]) -> Iterator[Answer]:
        workers = {worker.pipe: place for place, worker in enumerate(self._workers) if worker and place in running}
        most, now = self._silent_s, time.monotonic()
        left_s = None if most is None else max(0.0, min(job.heard_s for job in running.values()) + most - now)
        heard = connection.wait(list(workers), left_s)
        for pipe, place in workers.items():
            if pipe in heard:
                try:
                    kind, value = pipe.recv()
                except (EOFError, OSError):
                    kind, value = DIED, self._discard(place)
                yield Answer(place, kind, value)
            elif not heard and most is not None and time.monotonic() - running[place].heard_s >= most:
                self._discard(place, kill=True)
                yield Answer(place, DIED, f"neither ticked nor finished for {most:g} s, and was killed")

    def _discard(self, place: int, *, kill: bool = False) -> str:
        """Forget a worker that died or was killed; returns how it died."""
        worker, self._workers[place] = self._workers[place], None
        assert worker is not None
        if kill:
            worker.process.kill()
        worker.pipe.close()
        worker.process.join()
        return _death(worker.process.exitcode)

    def _cancel(self, running: Iterable[int]) -> None:
        """End workers. Those at work abandon their items and leave no drafts."""
        ending = [worker for place in running if (worker := self._workers[place]) is not None]
        try:
            for worker in ending:
                worker.ask_to_end()
            until = time.monotonic() + _PATIENCE_S
            for worker in ending:
                worker.end(max(until - time.monotonic(), 0.0))
        finally:
            for worker in ending:
                worker.end(0.0)
                self._workers[self._workers.index(worker)] = None


class RemoteError(Exception):
    """Cause of an error that work raised: the traceback, as text."""

    def __str__(self) -> str:
        return f"\n{self.args[0]}"


class _Worker:
    """A process, and the pipe to it."""

    def __init__(self, setup: Callable[[], None] | None) -> None:
        self.pipe, self._theirs = _spawn.Pipe()
        self.process = _spawn.Process(target=_serve, args=(self._theirs, setup))

    def start(self, environment: Mapping[str, str]) -> None:
        resource_tracker.ensure_running()  # else the first start would do so, and unblock signals
        # Signals are blocked in a worker until it has set its handlers. This process gets them a moment later.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, STOPS)
        try:
            with _variables(environment), self._theirs:
                self.process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def ask_to_end(self) -> None:
        if self.process.pid is not None:  # else it was not started
            self.process.terminate()

    def end(self, patience_s: float) -> None:
        """Wait for the process to end; kill it after a while."""
        if self.process.pid is not None:
            self.process.join(patience_s)
            self.process.kill()
            self.process.join()
        self.pipe.close()


@contextlib.contextmanager
def _variables(environment: Mapping[str, str]) -> Iterator[None]:
    """Set variables, which processes started meanwhile inherit."""
    before = {name: os.environ.get(name) for name in environment}
    os.environ.update(environment)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _death(status: int | None) -> str:
    """Say how a process ended."""
    if status is None or status >= 0:
        return f"ended with status {status}"
    names = {number.value: number.name for number in signal.Signals}
    text = f"was ended by {names.get(-status, f'signal {-status}')}"
    return f"{text} (out of memory?)" if -status == signal.SIGKILL else text


_on_tick: Callable[[], None] | None = None


def tick() -> None:
    """Count a step of the current item; no effect outside of a worker."""
    assert _on_tick is not None
    _on_tick()


def call_on_tick(function: Callable[[], None]) -> None:
    """Let `tick` call a function in this process."""
    global _on_tick
    _on_tick = function


class _Ended(BaseException):
    """A worker was asked to end."""


def _serve(pipe: Connection[Any, Any], setup: Callable[[], None] | None) -> None:
    """Do the items that come through the pipe until it is closed.

    The process then exits without the interpreter's shutdown: no work is left, and library threads have aborted
    processes during shutdown.
    """
    status = 1
    try:
        _handle_signals()
        pipe.poll(None)  # for the first item: by then `die_with_parent` can be called
        die_with_parent()
        call_on_tick(lambda: pipe.send((TICK, 1)))
        problem = set_up(setup)
        while True:
            data = pipe.recv_bytes()
            pipe.send_bytes(_answer(data) if problem is None else _refusal(problem))
    except (EOFError, ConnectionError):  # all is done, or nobody waits for it
        status = 0
    except _Ended:
        status = 128 + signal.SIGTERM
    except BaseException:
        traceback.print_exc()
    finally:
        for stream in (sys.stdout, sys.stderr):  # None where they are closed
            with contextlib.suppress(OSError, ValueError, AttributeError):
                stream.flush()
        os._exit(status)


def die_with_parent() -> None:
    """Let Linux kill this process when its parent ends, or has already ended; it would otherwise go on unnoticed.

    The parent, however it ends, closes its end of the pipe through which `multiprocessing` started this process. The
    kernel kills this process then, also within C code that holds the GIL. (A signal at the parent's death, by prctl,
    would come as soon as the thread ends that started this process.) Call it once the parent's ``start`` has returned:
    a write to the pipe would kill as well. Where the parent forks without exec, its children keep the pipe open.
    """
    parent = parent_process()
    assert parent is not None
    pipe = parent.sentinel
    fcntl.fcntl(pipe, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(pipe, fcntl.F_SETSIG, signal.SIGKILL)
    fcntl.fcntl(pipe, fcntl.F_SETFL, os.O_ASYNC)
    if connection.wait([pipe], 0):
        os._exit(1)


def _handle_signals() -> None:
    """Ignore interrupts, which the parent handles for all processes of the terminal; end when the parent asks."""

    def end(_number: int, _frame: FrameType | None) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # once is enough
        raise _Ended

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, end)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, STOPS)


def set_up(setup: Callable[[], None] | None) -> BaseException | None:
    """Call a worker's ``setup`` before its first item; returns its error, if any."""
    try:
        if setup is not None:
            setup()
    except Exception as problem:
        return problem
    return None


def _answer(data: bytes) -> bytes:
    try:
        work, item = unpickled(data)
        return pickled((DONE, work(item)))
    except _Ended:
        raise
    except BaseException as problem:
        return _refusal(problem)


def _refusal(problem: BaseException) -> bytes:
    return pickled((RAISED, portable(problem)))


def portable(problem: BaseException) -> tuple[BaseException, str]:
    """Return a picklable form of an error, with its traceback as text; if it cannot be pickled, its text alone."""
    where = "".join(traceback.format_exception(problem))
    try:
        unpickled(pickled(problem))
    except Exception:
        problem = RuntimeError(f"{type(problem).__name__}: {problem}")
    return problem, where
