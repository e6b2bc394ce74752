"""Share the work on one scenario among processes, each with a studio of its own."""

from __future__ import annotations

import contextlib
import functools
import itertools
from collections.abc import Callable, Generator, Iterable
from typing import TypeVar

from simgrab.errors import DatasetError
from simgrab.scenario import Scenario
from simgrab.utilities.processes import Pool, tick
from simgrab.world.frames import Studio, refuse_unseen, vet
from simgrab.world.scenery.plan import Plan

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
    with contextlib.closing(share(scenario, None, clips, _vet, workers=workers, unit="world", progress=told)) as counts:
        refuse_unseen(scenario, sum(counts))
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
    unit: str,
    progress: Callable[[int], None],
) -> Generator[T, None, None]:
    """Do a piece of work for each item, in no set order, and yield what each gives. Close it to end the processes.

    Parameters
    ----------
    scenario : Scenario
    plan : Plan or None
        Of the same scenario's first variant, where it was drawn up already.
    items : iterable of int
        Frames or clips.
    work : callable
        Takes a studio, an item, and what it must call after every frame; picklable when there are several workers.
        It is done again where its process died, and then calls for every frame of the item again.
    workers : int
        Processes. The software renderer uses every core already, so more than one gains little there.
    unit : str
        What an item is: a frame, a clip or a world.
    progress : callable
        Called with the frames done so far, and with all of them before the last item is yielded.

    Raises
    ------
    WorkerError
        If processes die of an item again and again. What work raises is raised as it is.
    """
    if workers > 1:
        with Pool(workers, setup=functools.partial(_open, scenario)) as pool:
            done = pool.map(functools.partial(_serve, work), items, name=lambda item: f"{unit} {item}", ticked=progress)
            with contextlib.closing(done):
                yield from done
        return
    counted = itertools.count(1)
    with Studio(scenario, plan) as studio:
        for item in items:
            yield work(studio, item, lambda: progress(next(counted)))


_studio: Studio


def _open(scenario: Scenario) -> None:
    """Open the studio of a process that serves one scenario all its life."""
    global _studio
    _studio = Studio(scenario)


def _serve(work: Work[T], item: int) -> T:
    return work(_studio, item, tick)
