"""Share the work on one scenario among processes, each with a studio of its own."""

from __future__ import annotations

import itertools
import multiprocessing
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.sharedctypes import Synchronized
from multiprocessing.synchronize import Event
from typing import TypeVar

from simgrab.errors import DatasetError
from simgrab.processes import die_with
from simgrab.scenario import Scenario
from simgrab.world.frames import Studio, refuse_unseen, vet
from simgrab.world.plan import Plan

LOOK_S = 0.25  # how often the ticks of other processes are counted

T = TypeVar("T")
Progress = Callable[[int, int], None]
Tick = Callable[[], None]
Work = Callable[[Studio, int, Tick], T]


def check(workers: int) -> None:
    """Refuse a number of processes that cannot work."""
    if workers < 1:
        raise DatasetError(f"workers must be 1 or more, got {workers}")


def vetted(scenario: Scenario, workers: int, checking: Progress | None = None) -> Plan | None:
    """Refuse, before anything is drawn, a scenario with an impossible frame or whose camera never sees the grab.

    Returns the plan of its world, or None where it has many: those are drawn up for nothing else, among the workers,
    and ``checking`` is told how many of how many.
    """
    if not scenario.vary:
        seen, plan = vet(scenario)
        refuse_unseen(scenario, seen)
        return plan
    clips = range(scenario.clip.count(scenario.frames))
    told = report(checking, 0, len(clips))
    refuse_unseen(scenario, sum(share(scenario, None, clips, _vet, workers=workers, progress=told)))
    return None


def _vet(studio: Studio, clip: int, tick: Tick) -> int:
    seen, _ = vet(studio.scenario, clip)
    tick()
    return seen


def report(progress: Progress | None, ahead: int, total: int) -> Callable[[int], None]:
    """Turn frames done in this run into frames done in all, ``ahead`` of them earlier; tells of those at once."""

    def tell(done: int) -> None:
        if progress:
            progress(ahead + done, total)

    tell(0)
    return tell


def share(
    scenario: Scenario,
    plan: Plan | None,
    items: Iterable[int],
    work: Work[T],
    *,
    workers: int,
    progress: Callable[[int], None],
) -> Iterator[T]:
    """Do a piece of work for each item, in no set order, and yield what each gives.

    Parameters
    ----------
    scenario : Scenario
    plan : Plan or None
        Of the same scenario's first variant, where it was drawn up already.
    items : iterable of int
        Frames or clips.
    work : callable
        Takes a studio, an item, and what it must call after every frame; picklable when there are several workers.
    workers : int
        Processes. The software renderer uses every core already, so more than one gains little there.
    progress : callable
        Called now and then with the frames done so far, and with all of them before the last item is yielded.
    """
    if workers > 1:
        yield from _among_processes(scenario, items, work, workers, progress)
        return
    counted = itertools.count(1)
    with Studio(scenario, plan) as studio:
        for item in items:
            yield work(studio, item, lambda: progress(next(counted)))


def _among_processes(
    scenario: Scenario, items: Iterable[int], work: Work[T], workers: int, progress: Callable[[int], None]
) -> Iterator[T]:
    spawn = multiprocessing.get_context("spawn")  # OpenGL contexts do not survive a fork
    ticks, stop = spawn.Value("q", 0), spawn.Event()
    with ProcessPoolExecutor(workers, mp_context=spawn, initializer=_hear, initargs=(os.getpid(), ticks, stop)) as pool:
        jobs = (pool.submit(_serve, scenario, work, item) for item in items)
        try:
            running = set(itertools.islice(jobs, 3 * workers))
            while running:
                done, running = wait(running, timeout=LOOK_S, return_when=FIRST_COMPLETED)
                running |= set(itertools.islice(jobs, len(done)))
                progress(ticks.value)
                for future in done:
                    yield future.result()
        except BrokenProcessPool:
            raise DatasetError(
                "a worker process died (out of memory?); go on with --resume and fewer --workers"
            ) from None
        finally:
            stop.set()
            pool.shutdown(cancel_futures=True)


_studio: Studio | None = None
_ticks: Synchronized[int]
_stop: Event


def _hear(parent: int, ticks: Synchronized[int], stop: Event) -> None:
    """Take what a worker shares with the process that feeds it; errors in here would reach nobody."""
    global _ticks, _stop
    die_with(parent)
    _ticks, _stop = ticks, stop


def _serve(scenario: Scenario, work: Work[T], item: int) -> T:
    """Work in a process that serves one scenario all its life."""
    global _studio
    if _studio is None:
        _studio = Studio(scenario)
    return work(_studio, item, _tick)


def _tick() -> None:
    with _ticks.get_lock():
        _ticks.value += 1
    if _stop.is_set():  # an item may be hours long
        raise DatasetError("stopped")
