"""Render one recipe in several processes, each with its own frame generator."""

from __future__ import annotations

import contextlib
import functools
import itertools
from collections.abc import Callable, Generator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, TypeVar

import cv2

from simgrab.errors import DatasetError, ExtensionError, ScenarioError, first_line
from simgrab.io.journal import Journal
from simgrab.runtime import machine
from simgrab.runtime.cluster import ClusterPool, open_pool
from simgrab.runtime.processes import Executor, pickled, tick
from simgrab.world import gl
from simgrab.world.extensions import Recipe
from simgrab.world.frames import FrameGenerator
from simgrab.world.projection import Projection
from simgrab.world.scene import Planned
from simgrab.world.scenery.plan import Plan

T = TypeVar("T")
Progress = Callable[[int, int], None]
Tick = Callable[[], None]
FrameNumbers = Sequence[int]
Work = Callable[[FrameGenerator, FrameNumbers, Tick], T]
FRAMES_A_WORKER, WORLDS_A_WORKER = 150, 2
WORLD_BYTES, WORLDS_BYTES, PIXEL_BYTES, SAMPLE_BYTES = 1_500_000_000, 2_600_000_000, 200, 24
"""What a process needs for a world and its textures or for one after another, for each pixel, and for each sample."""
SILENT_S = 1800.0
"""How long a process may take for a frame, its world and the exposures before it included, until it counts as hung."""
MOST_PROJECTIONS = 4096
"""Frames whose projection is kept from vetting for rendering; a few kilobytes each."""


@dataclass(frozen=True, eq=False)
class Vetted:
    """Results of checking that a recipe is possible, kept so that they are not computed again."""

    seen: int  # frames that show the grab
    plan: Plan | None = None  # of the world; None if each clip has its own world
    projections: dict[int, Projection] = field(default_factory=dict)  # of at most `MOST_PROJECTIONS` frames


def automatic(recipe: Recipe, *, by_clip: bool = False, shard_frames: int | None = None) -> tuple[int, str]:
    """Choose the number of processes for a recipe, and return the reason too.

    Software OpenGL uses several cores by itself, so a second process gains only a third, and each process builds its
    own worlds. A process pays off from `FRAMES_A_WORKER` frames on, or from `WORLDS_A_WORKER` worlds where worlds vary.
    With ``by_clip`` one process renders a clip from beginning to end, as for videos; with ``shard_frames`` so many
    frames, as for a dataset of shards.
    """
    scenario = recipe.scenario
    frames, clips = scenario.frames, scenario.clip_count
    cores, memory = machine.cores(), machine.free_bytes() // memory_bytes(recipe)
    limits = [(cores, f"{cores} cores"), (memory, "memory")]
    if recipe.varies:
        limits.append((clips // WORLDS_A_WORKER, f"{clips} worlds"))
    else:
        limits.append((frames // FRAMES_A_WORKER, f"{frames} frames"))
    if by_clip:
        limits.append((clips, f"{clips} clips"))
    if shard_frames is not None:
        shards = -(-frames // shard_frames)
        limits.append((shards, f"{shards} shards"))
    if _unpicklable(recipe):
        limits.append((1, "functions that worker processes cannot be given"))
    workers, limit = min(limits, key=lambda one: one[0])
    return max(1, workers), limit


def memory_bytes(recipe: Recipe) -> int:
    """Estimate the memory of a process that renders a recipe."""
    scenario, image = recipe.scenario, recipe.scenario.image
    pixels = scenario.camera.width_px * scenario.camera.height_px
    worlds = WORLDS_BYTES if recipe.varies else WORLD_BYTES
    return worlds + pixels * (PIXEL_BYTES + SAMPLE_BYTES * image.samples) + 8 * image.shadow_map_px**2


def _unpicklable(recipe: Recipe) -> str:
    """Return why a recipe cannot be sent to worker processes; empty if it can."""
    try:
        pickled(recipe)
    except MemoryError:
        raise
    except Exception as problem:
        return first_line(problem) or type(problem).__name__
    return ""


def check(recipe: Recipe, workers: int, cluster: str | None = None) -> None:
    """Refuse a number of processes or a cluster that cannot render a recipe."""
    if workers < 1:
        raise DatasetError(f"workers must be 1 or more, got {workers}")
    why = _unpicklable(recipe) if workers > 1 or cluster is not None else ""
    if why:
        raise ExtensionError(f"a function cannot be sent to worker processes: define it at the top of a module ({why})")
    if cluster is not None:
        with ClusterPool(cluster, memory_bytes=memory_bytes(recipe)) as pool:
            pool.check()


def vet(recipe: Recipe, frames: FrameNumbers | None = None, tick: Tick | None = None) -> Vetted:
    """Refuse impossible frames, of all or of these, a clip's together; ``tick`` is called after each variant."""
    k = recipe.scenario.camera.intrinsics
    seen, kept, plan = 0, dict[int, Projection](), None
    numbers = range(recipe.scenario.frames) if frames is None else frames
    for _, span in itertools.groupby(numbers, recipe.variant_number):
        first = next(span)
        planned = Planned(recipe.variant(first), recipe, plan)
        plan = planned.plan
        for frame in itertools.chain((first,), span):  # all of them: each may be impossible
            projection = planned.project(frame)
            seen += projection.meets(k.width_px, k.height_px)
            if len(kept) < MOST_PROJECTIONS:
                kept[frame] = projection
        if tick:
            tick()
    return Vetted(seen, plan, kept)


def vetted(workers: Workers, checking: Progress | None = None) -> Vetted:
    """Refuse a recipe with an impossible frame, or whose camera never sees the grab, before anything is rendered.

    Workers check the worlds if there are many; ``checking`` is called with the number checked and the total. Returns
    the results for later use.
    """
    recipe, scenario = workers.recipe, workers.recipe.scenario
    if not recipe.varies:
        found = vet(recipe)
        refuse_unseen(scenario.frames, found.seen)
        return found if workers.alone else replace(found, plan=None)  # worlds are painted where they are drawn
    done = report(checking, 0, scenario.clip_count)
    alike = [tuple(some) for _, some in itertools.groupby(range(scenario.frames), recipe.slowest_draw)]
    with contextlib.closing(workers.map(_vet, alike, progress=done)) as each:
        seen, kept = 0, dict[int, Projection]()
        for one in each:
            seen += one.seen
            kept |= itertools.islice(one.projections.items(), MOST_PROJECTIONS - len(kept))
        refuse_unseen(scenario.frames, seen)
    return Vetted(seen, None, kept)


def _vet(generator: FrameGenerator, frames: FrameNumbers, tick: Tick) -> Vetted:
    return replace(vet(generator.recipe, frames, tick), plan=None)


def refuse_unseen(frames: int, seen: int) -> None:
    """Refuse a scenario if none of its frames shows the grab."""
    if not seen:
        raise ScenarioError(
            "camera",
            f"the grab is outside the image, or absent, in all {frames} frames; lower swing.absent if it is 1, "
            "lower the tilt (camera.beta_deg) or the focal length, or set offset and azimuth so that it is in view",
        )


def report(progress: Progress | None, ahead: int, total: int) -> Callable[[int], None]:
    """Convert frames done in this run into frames done in all. ``ahead`` were done earlier and are reported at once."""

    def done(count: int) -> None:
        if progress:
            progress(ahead + count, total)

    done(0)
    return done


class Output(Protocol):
    """The output of a recipe, made unit by unit. A unit is a run of frames."""

    def check(self, *, resume: bool) -> bool:
        """Refuse a place that cannot be used, before anything is written; returns whether any unit remains."""

    @property
    def journal(self) -> Journal:
        """Where it is kept; once begun, an earlier run has checked that the recipe is possible."""

    @property
    def most(self) -> int:
        """Units at most; more processes have nothing to do."""

    def opened(self) -> AbstractContextManager[Sequence[FrameNumbers]]:
        """Claim the place; yields the units that remain."""

    @property
    def work(self) -> Work[Any]:
        """Return the function that makes a unit. It is picklable, and repeating it gives the same result."""

    def take(self, made: Any) -> None:
        """Take what `work` gave."""

    def finish(self) -> None:
        """Write the files that depend on all units."""


def fill(
    output: Output, recipe: Recipe, *, workers: int = 1, cluster: str | None = None, resume: bool = False,
    progress: Progress | None = None, checking: Progress | None = None, before: Callable[[Workers], None] | None = None,
) -> int:  # fmt: skip
    """Make the missing units of an output, and finish it; returns the number of frames made.

    Unless an earlier run has begun, ``before`` is called before the first frame, and before worlds that vary are
    checked.
    """
    if not output.check(resume=resume):
        return 0
    with contextlib.closing(Workers(recipe, min(workers, output.most), cluster)) as processes:
        if not output.journal.begun:
            if not recipe.varies:  # its plan then serves `before` too
                processes.known = vetted(processes)
            if before:
                before(processes)
            if recipe.varies:
                processes.known = vetted(processes, checking)
        with output.opened() as units:
            frames = sum(map(len, units))
            advance = report(progress, recipe.scenario.frames - frames, recipe.scenario.frames)
            with contextlib.closing(processes.map(output.work, units, progress=advance)) as rendering:
                for made in rendering:
                    output.take(made)
            processes.close()
            output.finish()
    return frames


class Workers:
    """Make frames of one recipe in this process, in several, or on a cluster; `close` ends them.

    Each process of this machine has a frame generator, which lasts from one `map` to the next. ``known`` has the
    results of checking the recipe, once there are any.

    Parameters
    ----------
    count : int
        Processes; 1 is this one. The software renderer uses every core already, so more than one gains little there.
    cluster : str, optional
        Address of a Ray cluster that works in place of processes of this machine.
    """

    def __init__(self, recipe: Recipe, count: int = 1, cluster: str | None = None) -> None:
        self.recipe, self.count, self.cluster = recipe, count, cluster
        self.known: Vetted | None = None
        self._pool: Executor | None = None
        self._generator: FrameGenerator | None = None

    @property
    def alone(self) -> bool:
        """Whether this process makes the frames."""
        return self.count == 1 and self.cluster is None

    def close(self) -> None:
        """End the processes, and free OpenGL."""
        for one in (self._pool, self._generator):
            if one is not None:
                one.close()
        self._pool = self._generator = None

    def map(
        self, work: Work[T], units: Sequence[FrameNumbers], *, progress: Callable[[int], None]
    ) -> Generator[T, None, None]:
        """Call ``work`` for each unit, in any order, and yield the results. Close the iterator to stop.

        Errors of ``work`` are raised unchanged, and `WorkerError` if processes die repeatedly at one unit.

        Parameters
        ----------
        work : callable
            Takes a frame generator, a unit, and a function to call after every frame; picklable if there are several
            workers. If its process dies it is called again, and reports every frame of the unit again.
        units : sequence of sequence of int
            Frames that are made one after another in one process.
        progress : callable
            Called with the number of frames done; it has reached the total before the last unit is yielded.
        """
        found = self.known.projections if self.known else {}
        if not self.alone:
            orders = ((unit, {n: found[n] for n in unit if n in found}) for unit in units)
            self._pool = self._pool or self._opened()
            done = self._pool.map(functools.partial(_serve, work), orders, name=_named, ticked=progress)
            with contextlib.closing(done):
                yield from done
            return
        counted = itertools.count(1)
        self._generator = self._generator or FrameGenerator(self.recipe, self.known.plan if self.known else None)
        self._generator.projections = found
        for unit in units:
            yield work(self._generator, unit, lambda: progress(next(counted)))

    def _opened(self) -> Executor:
        threads = None if self.cluster else max(1, machine.cores() // self.count)
        return open_pool(
            self.count, self.cluster, setup=functools.partial(_open, self.recipe, threads),
            memory_bytes=memory_bytes(self.recipe), environment=gl.threads(threads), silent_s=SILENT_S,
        )  # fmt: skip


def _named(order: tuple[FrameNumbers, object]) -> str:
    frames, _ = order
    return f"frame {frames[0]}" if len(frames) == 1 else f"frames {frames[0]} to {frames[-1]}"


_generator: FrameGenerator | None = None


def _open(recipe: Recipe, threads: int | None) -> None:
    """Open the frame generator of one process, with this number of threads for computing and for drawing."""
    global _generator
    if threads is not None:
        cv2.setNumThreads(threads)
    if _generator is not None:  # of a cluster's process, which serves one recipe after another
        _generator.close()
    _generator = FrameGenerator(recipe)


def _serve(work: Work[T], order: tuple[FrameNumbers, dict[int, Projection]]) -> T:
    assert _generator is not None
    unit, _generator.projections = order
    return work(_generator, unit, tick)
