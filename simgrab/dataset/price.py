"""Estimate what a dataset or video takes, from a few of its frames made on this machine before it is rendered."""

from __future__ import annotations

import contextlib
import functools
import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import msgspec
import numpy as np
from rich.filesize import decimal
from scipy import special

from simgrab.dataset import stored
from simgrab.dataset.pool import FrameNumbers, Tick, Workers, vet
from simgrab.model.geometry import Array
from simgrab.runtime import machine
from simgrab.world.extensions import Recipe
from simgrab.world.frames import FrameGenerator

FEW = 200
"""Frames from which an estimate pays: it takes about as long as ten of them."""
SURE_SIZE = 0.1
"""Error of the size, as a share, up to which it is not stated."""
FEW_A_WORLD = 8
"""Below as many frames of a world, worlds that take more than half of the time are named."""
_PLACES, _ORDER = 4, (0, 2, 1, 3)  # of the dataset, at which frames are made: by what they show they take more or less
_LEAST, _SHARE = 2, 0.05  # places at first; share of the time for it all, after which no others are tried


@dataclass(frozen=True)
class Price:
    """What rendering takes, in seconds and bytes on the disk, estimated from frames that were ``tried``.

    ``size_error`` is the half width of the size's 95 % interval, as a share, from what frames take at the places tried;
    0 where a single one was, as of a scene that does not vary, and of a video.
    Worlds are the draws of what varies; 1 if nothing does. ``by_worlds``: they take more than half of the time, and
    have few frames each.
    """

    frames: int
    worlds: int
    seconds: float
    size: int
    tried: int
    by_worlds: bool = False
    size_error: float = 0.0

    def __str__(self) -> str:
        worlds = f" of {self.worlds} worlds" if self.worlds > 1 else ""
        checked = ", with the check of all draws," if self.worlds > 1 else ""
        off = f" (± {self.size_error:.0%})" if self.size_error <= 1 else ", or a few times as much"
        size = f"{decimal(self.size)}{off if self.size_error > SURE_SIZE else ''}"
        cure = "; worlds take most of it: a larger clip.clip_frames makes fewer" if self.by_worlds else ""
        return (
            f"{self.frames} frames{worlds}: about {_duration(self.seconds)}{checked} and {size}, "
            f"estimated from {self.tried} frames{cure}"
        )


def announce(priced: Callable[[Price], None] | None, workers: Workers, *, files: bool, video: bool) -> None:
    """Call ``priced`` with the price; see `measured`. Of a cluster it is not known."""
    if priced and workers.cluster is None:
        priced(measured(workers, files=files, video=video))


def measured(workers: Workers, *, files: bool = True, video: bool = False) -> Price:
    """Estimate the price of a dataset, of a video or of both; raises an error if a frame is impossible.

    Worlds are checked before, and a frame that begins a draw of what varies takes longer than the next. At a few places
    of the dataset a frame of each kind is made, by the processes that will make them all; these take at least the
    cores' time for it all. A video's size is at most that of its bit rate; one process renders a clip of it, and what
    coding takes is left out.
    """
    scenario, varies = workers.recipe.scenario, workers.recipe.varies
    frames, periods = scenario.frames, _periods(workers.recipe)
    slowest = math.ceil(frames / periods[0])
    counts = [*_counts(periods, frames), slowest if varies else 0]  # of each kind of frame, and of checks
    processes = min(workers.count, scenario.clip_count) if video else workers.count
    places = list(dict.fromkeys(slowest * n // _PLACES * periods[0] for n in _ORDER))
    samples, sizes_of, tried, begun, seconds = list[_Sample](), list[float](), 0, time.perf_counter(), math.inf
    while tried < len(places) and time.perf_counter() - begun < _SHARE * seconds:
        units = [(place,) for place in places[tried : tried + max(1 if tried else _LEAST, workers.count)]]
        work = functools.partial(_sampled, periods, check=varies)
        with contextlib.closing(workers.map(work, units, progress=lambda _: None)) as each:
            for some in each:
                samples += some
                sizes_of.append(float(np.mean([size for kind, *_, size in some if kind < len(periods)])))
        tried += len(units)
        means = _means(samples, len(counts))
        walls, cores, sizes = (counts @ means).tolist()
        seconds = max(walls / processes, cores / machine.cores())
    size = sizes if files else 0.0
    if video:
        size += frames / scenario.clip.frame_rate_hz * scenario.clip.bit_rate_mbit_s * 1e6 / 8
    worlds = scenario.clip_count if varies else 1
    made = sum(kind < len(periods) for kind, *_ in samples)
    without = frames * float(means[len(periods) - 1, 0])  # of frames that begin nothing
    by_worlds = varies and periods[-2] < FEW_A_WORLD and without < walls / 2
    error = 0.0
    if tried > 1 and files and not video:
        spread = float(np.std(sizes_of, ddof=1) / np.mean(sizes_of))
        error = float(special.stdtrit(len(sizes_of) - 1, 0.975)) * spread / len(sizes_of) ** 0.5
    return Price(frames, worlds, seconds, round(size), made, by_worlds, error)


_Sample = tuple[int, float, float, int]
"""What making a frame takes, or checking all of one place: its kind, wall and core time, s, and size, bytes."""


def _sampled(
    periods: list[int], generator: FrameGenerator, place: FrameNumbers, _tick: Tick, *, check: bool
) -> list[_Sample]:
    """Make a frame of each kind from a place on. At the first, check all draws of a place too."""
    (first,), frames = place, generator.scenario.frames
    samples = list[_Sample]()
    checked = [(len(periods), first)] if check and first == 0 else []
    for kind, frame in [*checked, *_samples(periods, first, frames)]:
        wall, core, size = time.perf_counter(), time.process_time(), 0
        if kind == len(periods):
            vet(generator.recipe, range(frame, min(frame + periods[0], frames)))
        else:
            made = stored.make(generator, frame)
            size = sum(map(len, made.files.values())) + len(msgspec.json.encode(made.record))
        samples.append((kind, time.perf_counter() - wall, time.process_time() - core, size))
    return samples


def _means(samples: list[_Sample], kinds: int) -> Array:
    """Mean wall time, core time and size of each kind, shape (kinds, 3); 0 of a kind without samples."""
    made = np.array(samples, float)
    each = (made[made[:, 0] == kind, 1:] for kind in range(kinds))
    return np.array([some.mean(axis=0) if len(some) else np.zeros(3) for some in each])


def _periods(recipe: Recipe) -> list[int]:
    """After how many frames something is drawn again, the longest first; the last, 1, is of every frame."""
    scenario = recipe.scenario
    if not recipe.varies:
        return [scenario.frames, 1]
    return [*sorted({scenario.clip.clip_frames or scenario.frames, *scenario.every.values()}, reverse=True), 1]


def _counts(periods: list[int], frames: int) -> list[int]:
    """Frames that begin each period and no longer one."""
    return np.diff([0, *(math.ceil(frames / period) for period in periods)]).tolist()


def _samples(periods: list[int], first: int, frames: int) -> list[tuple[int, int]]:
    """Kinds and numbers of the frames to make from a place on: the beginning of each period, and some of the others.

    Where each frame begins one, the first is made again, which draws nothing.
    """
    last = len(periods) - 1
    others = [(last, first + n) for n in (1, 2) if n < periods[last - 1]] or [(last, first)]
    begin = [(kind, first + periods[kind]) for kind in range(last - 1, 0, -1)]
    return [(kind, frame) for kind, frame in [(0, first), *others, *begin] if frame < frames]


def _duration(seconds: float) -> str:
    for unit, length in (("days", 86_400), ("hours", 3_600), ("minutes", 60)):
        if seconds >= 2 * length:
            return f"{seconds / length:.{int(seconds < 10 * length)}f} {unit}"
    return f"{seconds:.0f} seconds"
