"""A sensor in one clip: its sample times, its readings, and their truth."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgrab.model.geometry import Array
from simgrab.model.scenario import Draws, Scenario
from simgrab.world.sensors.errors import Open, SensorClock
from simgrab.world.sensors.motion import Motion

SWING = ("alpha [deg]", "azimuth [deg]")
"""Columns of the truth that is to be found out."""


@dataclass(frozen=True)
class Setting:
    """Surroundings of a sensor in one clip."""

    scenario: Scenario
    world: Draws  # keys of the random details of the place
    opened: Open  # opens the sensor's streams
    frames: range  # numbers of the clip's frames
    split: Callable[[int], str]  # gives the split of a frame
    renders: bool = False  # whether cameras render pictures; other values are the same without them


@dataclass(frozen=True, eq=False)
class SensorRows:
    """Rows of a sensor's two tables."""

    stamp_ns: NDArray[np.int64]  # (n,)
    values: Array  # (n, columns)
    truth: Array  # (n, truth columns), truth of each row; the first column is the true time
    pictures: Sequence[bytes] = ()  # encoded pictures, one for each row; only for a camera that renders


class Device(ABC):
    """A sensor in one clip, which gives its rows in order, one for every ``each`` samples.

    Attributes
    ----------
    columns, truth_columns : tuple of str
        Names of the columns of ``values`` and ``truth``, with units in brackets.
    body_from_sensor : ndarray, shape (4, 4), or None
        Nominal pose; None for a sensor without one.
    pictures : sequence of bytes
        Pictures of the rows that were read last.
    """

    columns: tuple[str, ...]
    truth_columns: tuple[str, ...]
    body_from_sensor: Array | None = None

    def __init__(self, clock: SensorClock, each: int = 1) -> None:
        self.clock, self._each, self._next = clock, each, 0
        self._kept = slice(None)  # of the samples that are read, those that it reports
        self._close: Callable[[], None] | None = None
        self.pictures: Sequence[bytes] = ()
        self._counts: NDArray[np.int64] | None = None  # rows of each sample that was read last; one unless set

    def instants(self, end: float) -> Array:
        """Return the next true sample times before ``end``, s."""
        clock = self.clock
        last = math.ceil(end * clock.rate_hz * (1 + clock.drift)) + 1
        samples = np.arange(self._next, max(last, self._next), dtype=float)
        times = clock.times(samples)
        times = times[times < end]
        self._next += len(times)
        return times

    def rows(self, motion: Motion) -> SensorRows:
        """Read the motion at the latest instants."""
        samples = np.arange(self._next - len(motion.time), self._next, dtype=float)
        self._kept = slice((len(motion.time) - self._next) % self._each, None, self._each)
        values, truth = self._read(motion)
        stamp = np.round(self.clock.stamps(samples[self._kept]) * 1e9).astype(np.int64)
        time = motion.time[self._kept]
        if self._counts is not None:
            stamp, time = np.repeat(stamp, self._counts), np.repeat(time, self._counts)
        return SensorRows(stamp, values, np.column_stack([time, truth]), self.pictures)

    def close(self) -> None:
        """Free the sensor's renderer, if any."""
        if self._close:
            self._close()
            self._close = None

    @abstractmethod
    def _read(self, motion: Motion) -> tuple[Array, Array]:
        """Return values and truth at the reported instants."""
