"""Estimate what a dataset or video takes, from a few of its frames made on this machine before it is rendered."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from itertools import pairwise

import msgspec
from rich.filesize import decimal

from simgrab.dataset import stored
from simgrab.dataset.pool import vet
from simgrab.runtime import machine
from simgrab.world.extensions import Recipe
from simgrab.world.frames import FrameGenerator

FEW = 200
"""Frames from which an estimate pays: it takes about as long as ten of them."""
_PLACES = 4  # of the dataset, at which frames are made: what they show takes more or less, by the weather above all
_LEAST, _LONGEST_S = 2, 20.0  # places; time after which no other is tried


@dataclass(frozen=True)
class Price:
    """What rendering takes.

    Attributes
    ----------
    frames, worlds : int
        Worlds are the draws of what varies most seldom.
    seconds : float
    size : int
        Bytes on the disk.
    measured : int
        Worlds of which frames were made.
    """

    frames: int
    worlds: int
    seconds: float
    size: int
    measured: int

    def __str__(self) -> str:
        worlds = f" of {self.worlds} worlds" if self.worlds > 1 else ""
        checked = ", with the check of all draws," if self.worlds > 1 else ""
        judged = f", judged by {self.measured} of them" if self.worlds > self.measured else ""
        return (
            f"{self.frames} frames{worlds}: about {_duration(self.seconds)}{checked} and {decimal(self.size)}{judged}"
        )


def measured(recipe: Recipe, workers: int, *, files: bool = True, video: bool = False) -> Price:
    """Estimate the price of a dataset, of a video or of both, as rendered by this number of processes.

    Worlds are checked before, and a frame that begins a draw of what varies takes longer than the next. At a few places
    of the dataset a frame of each kind is made, in one process; several share the cores, so they take at least the
    cores' time for it all. A video's size is at most that of its bit rate; one process renders a clip of it, and what
    coding takes is left out.

    Raises
    ------
    ScenarioError, RendererError, ExtensionError
        If a frame is impossible.
    """
    frames, periods = recipe.scenario.frames, _periods(recipe)
    groups = math.ceil(frames / periods[0])
    check = len(periods)  # its kind, beside those of frames: of all frames of one place
    counts = [*_counts(periods, frames), groups if recipe.varies else 0]
    walls, cores, sizes = ([list[float]() for _ in counts] for _ in range(3))
    begun = time.perf_counter()
    with FrameGenerator(recipe) as generator:
        for tried, place in enumerate(sorted({groups * n // _PLACES for n in range(_PLACES)}), 1):
            first = place * periods[0]
            checked = [(check, first)] if recipe.varies and tried == 1 else []
            for kind, frame in [*checked, *_samples(periods, first, frames)]:
                wall, core = time.perf_counter(), time.process_time()
                if kind == check:
                    vet(recipe, range(frame, min(frame + periods[0], frames)))
                else:
                    made = stored.make(generator, frame)
                    sizes[kind].append(sum(map(len, made.files.values())) + len(msgspec.json.encode(made.record)))
                walls[kind].append(time.perf_counter() - wall)
                cores[kind].append(time.process_time() - core)
            if tried >= _LEAST and time.perf_counter() - begun > _LONGEST_S:
                break

    def total(each: list[list[float]]) -> float:
        return sum(count * sum(some) / len(some) for count, some in zip(counts, each, strict=True) if some)

    clip, size = recipe.scenario.clip, total(sizes) if files else 0.0
    if video:
        workers = min(workers, clip.count(frames))
        size += frames / clip.frame_rate_hz * clip.bit_rate_mbit_s * 1e6 / 8
    seconds = max(total(walls) / workers, total(cores) / machine.cores())
    worlds = groups if recipe.varies else 1
    return Price(frames, worlds, seconds, round(size), min(tried, worlds))


def _periods(recipe: Recipe) -> list[int]:
    """After how many frames something is drawn anew, the longest first; 1 is of every frame."""
    scenario = recipe.scenario
    if not recipe.varies:
        return [scenario.frames, 1]
    return sorted({scenario.clip.clip_frames or scenario.frames, *scenario.every.values(), 1}, reverse=True)


def _counts(periods: list[int], frames: int) -> list[int]:
    """Frames that begin each period and no longer one."""
    begun = [0, *(math.ceil(frames / period) for period in periods)]
    return [more - fewer for fewer, more in pairwise(begun)]


def _samples(periods: list[int], first: int, frames: int) -> list[tuple[int, int]]:
    """Kinds and numbers of the frames to make from a place on: the beginning of each period, and some of the others."""
    last = len(periods) - 1
    others = [(last, first + n) for n in (1, 2) if last and n < periods[last - 1]]
    begin = [(kind, first + periods[kind]) for kind in range(last - 1, 0, -1)]
    return [(kind, frame) for kind, frame in [(0, first), *others, *begin] if frame < frames]


def _duration(seconds: float) -> str:
    for unit, length in (("days", 86_400), ("hours", 3_600), ("minutes", 60)):
        if seconds >= 2 * length:
            return f"{seconds / length:.{int(seconds < 10 * length)}f} {unit}"
    return f"{seconds:.0f} seconds"
