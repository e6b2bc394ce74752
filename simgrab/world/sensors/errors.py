"""Errors of a sensor: its clock, and the difference of readings from true values."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from simgrab.model.geometry import Array
from simgrab.model.rng import stream
from simgrab.model.scenario.sensors import Clocked, ImuNoise

Open = Callable[[str], np.random.Generator]
"""Opens the stream of one of a sensor's variables."""


def streams(seed: int, clip: int, sensor: str) -> Open:
    """Streams of a sensor's variables: keyed by seed, clip, the sensor's name and the variable's."""
    return lambda variable: stream(seed, clip, f"sensors/{sensor}/{variable}")


@dataclass(frozen=True)
class SensorClock:
    """A sensor's clock, which determines sample times and time stamps.

    At the true time t of the clip it shows ``offset + (1 + drift) t``; it samples ``rate_hz`` times in a second of its
    own.
    """

    rate_hz: float
    offset: float = 0.0  # s
    drift: float = 0.0

    @classmethod
    def draw(cls, rate_hz: float, errors: Clocked | ImuNoise, opened: Open) -> SensorClock:
        """Draw a clock, given the standard deviations of offset and drift."""
        offset, drift = opened("clock").standard_normal(2).tolist()
        return cls(rate_hz, offset * errors.clock_offset_ms / 1000, drift * errors.clock_drift_ppm / 1e6)

    def times(self, samples: Array) -> Array:
        """Give the true times of samples by number, s since the clip began."""
        return np.asarray(samples / (self.rate_hz * (1 + self.drift)))

    def stamps(self, samples: Array) -> Array:
        """Give the time stamps of samples by number, s."""
        return np.asarray(self.offset + samples / self.rate_hz)


class SensorErrors:
    """Errors of k axes, sample by sample: y = (I + E) x + b + n, limited and counted.

    E holds scale errors and misalignments, b a bias that begins at its turn-on value and then walks at random; n is
    white. Of a white noise of density N, a sample has the standard deviation N √rate; the walk of density K grows by
    K/√rate between samples. The errors continue from call to call; they do not depend on how samples are divided into
    calls.

    Parameters
    ----------
    axes : int
    opened : callable
        Opens the streams ``scale``, ``zero``, ``noise`` and ``walk``, of E, the bias at turn-on, n and the walk.
    density, walk : float
        N, in unit/√Hz, and K, in unit/s/√Hz.
    bias, scale_error, misalignment : float
        Standard deviations of draws for each axis: unit, relative, rad.
    limit : float or None
        Readings stay within ± this.
    resolution : float
        Size of a count; 0 is none.
    rate_hz : float
    """

    def __init__(
        self, axes: int, opened: Open, *, density: float = 0.0, walk: float = 0.0, bias: float = 0.0,
        scale_error: float = 0.0, misalignment: float = 0.0, limit: float | None = None, resolution: float = 0.0,
        rate_hz: float = 1.0,
    ) -> None:  # fmt: skip
        spread = np.full((axes, axes), misalignment)
        np.fill_diagonal(spread, scale_error)
        self._matrix = np.eye(axes) + spread * opened("scale").standard_normal((axes, axes))
        self._bias = bias * opened("zero").standard_normal(axes)
        self._density, self._walk = density * math.sqrt(rate_hz), walk / math.sqrt(rate_hz)
        self._limit, self._resolution = limit, resolution
        self._noise, self._steps = opened("noise"), opened("walk")

    def read(self, true: Array) -> tuple[Array, Array]:
        """Give the readings of true values (n, k), and the bias in them, shapes (n, k)."""
        steps = self._walk * self._steps.standard_normal(true.shape)
        walked = np.cumsum(np.concatenate([self._bias[None], steps]), axis=0)
        self._bias, bias = walked[-1], walked[:-1]
        read = true @ self._matrix.T + bias + self._density * self._noise.standard_normal(true.shape)
        return counted(read, self._resolution, self._limit), bias


def counted(values: Array, resolution: float, limit: float | None = None) -> Array:
    """Round to whole counts, and keep within ± a limit."""
    if resolution:
        values = np.round(values / resolution) * resolution
    return values if limit is None else np.clip(values, -limit, limit)
