"""A linear Kalman filter, and the pendulum that most of the rivals' filters share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgrab.errors import RecordError
from simgrab.instrument.estimate.chain import update
from simgrab.instrument.estimate.frames import interpolated
from simgrab.instrument.estimate.inertial.readings import ImuReadings
from simgrab.instrument.estimate.intervals import split
from simgrab.lab.rivals.contract import Series, Swing
from simgrab.model.geometry import STANDARD_GRAVITY, Array

STEP_S = 0.02
"""Readings are averaged over so long."""
SILENT_S = 0.2
"""There is no angle where a sensor is silent for longer."""
MOST_SD = np.radians(1.0)
"""There is no angle while a filter is less certain of it."""
START_SD = np.repeat([np.radians(10.0), 0.1], 2)
"""Standard deviations of a pendulum's state at the start, rad and rad/s."""
LONGER_M, DAMPING, FORCING = 0.4, 0.005, 1e-3
"""Of a pendulum: how much longer it is than the rope, its share of critical damping, and white acceleration, m²/s³."""
LEAN, SPEED = slice(0, 2), slice(2, 4)
"""Of a pendulum's state: angles along x and y, rad, and their rates over the ground, rad/s."""


def kalman(
    readings: Array, start_sd: Array, advance: Array, noise: Array, reading: Array, reading_sd: Array,
    start: Array | float = 0.0, drive: Array | float = 0.0, known: Array | float = 0.0,
) -> tuple[Array, Array]:  # fmt: skip
    """Filter m readings at n steps by a linear model with d states.

    Parameters
    ----------
    readings : ndarray, shape (n, m)
        Those that are NaN are left out.
    start_sd : ndarray, shape (d,)
    advance : ndarray, shape (n, d, d)
        From one step to the next; the last is not used.
    noise : ndarray, shape (n, d)
        Variances that each step adds.
    reading : ndarray, shape (m, d), or (n, m, d)
        What the readings are of the state.
    reading_sd : ndarray, shape (m,)
    start : ndarray, shape (d,), or float
    drive : ndarray, shape (n, d), or float
        Added by each step.
    known : ndarray, shape (n, m), or float
        Added to the readings.

    Returns
    -------
    states : ndarray, shape (n, d)
        After the reading of the step.
    covariances : ndarray, shape (n, d, d)
    """
    n, d = noise.shape
    x, p = np.zeros(d) + start, np.diag(start_sd**2)
    drive, r = np.broadcast_to(drive, (n, d)), reading_sd**2
    states, covariances = np.empty((n, d)), np.empty((n, d, d))
    h = np.broadcast_to(reading, (n, *reading.shape[-2:]))
    left = readings - known
    for i in range(n):
        if (some := np.flatnonzero(np.isfinite(readings[i]))).size:
            of_some = h[i, some]
            change, p = update(p, of_some, left[i, some] - of_some @ x, np.diag(r[some]))
            x = x + change
        states[i], covariances[i] = x, p
        x = advance[i] @ x + drive[i]
        p = advance[i] @ p @ advance[i].T + np.diag(noise[i])
    return states, covariances


@dataclass(frozen=True, eq=False)
class Pendulum:
    """A pendulum of changing length at n equal steps, in axes that turn about the vertical."""

    length: Array  # (n,), rope length, m
    turning: Array  # (n,), rate of the axes about the vertical, rad/s

    @property
    def equivalent(self) -> Array:
        """Length of the equivalent simple pendulum, m, shape (n,)."""
        return np.asarray(self.length + LONGER_M)

    def rates(self, d: int) -> Array:
        """Return derivatives of d states by themselves, shape (n, d, d): l θ̈ + 2 (l̇ + ζωl) θ̇ + g θ = 0."""
        length, n = self.equivalent, len(self.length)
        paid_out = np.gradient(self.length, STEP_S)
        a = np.zeros((n, d, d))
        a[:, 0, 2] = a[:, 1, 3] = 1
        a[:, 2, 0] = a[:, 3, 1] = -STANDARD_GRAVITY / length
        drag = 2 * (paid_out / length + DAMPING * np.sqrt(STANDARD_GRAVITY / length))
        a[:, 2, 2] = a[:, 3, 3] = -drag
        for i in (0, 2):
            a[:, i, i + 1] += self.turning
            a[:, i + 1, i] -= self.turning
        return a

    def noise(self, d: int) -> Array:
        """Variances (n, d) that a step adds."""
        q = np.zeros((len(self.length), d))
        q[:, SPEED] = (FORCING * STEP_S / self.equivalent**2)[:, None]
        return q

    def drive(self, acceleration: Array) -> Array:
        """Return what the pivot's acceleration (n, 2), m/s², adds in a step, shape (n, 4)."""
        push = -acceleration / self.equivalent[:, None]
        return np.hstack([push * STEP_S**2 / 2, push * STEP_S])

    def filtered(self, readings: Array, reading: Array, reading_sd: Array, **known: Array) -> tuple[Array, Array]:
        """States (n, 4) and their covariances by `kalman`, of the pendulum alone."""
        return kalman(readings, START_SD, advance(self.rates(4)), self.noise(4), reading, reading_sd, **known)


def advance(rates: Array) -> Array:
    """Transition (n, d, d) over a step under constant rates (n, d, d), to third order."""
    a = rates * STEP_S
    return np.asarray(np.eye(a.shape[-1]) + a @ (np.eye(a.shape[-1]) + a @ (np.eye(a.shape[-1]) + a / 3) / 2))


def grid(*sensors: ImuReadings | Series) -> Array:
    """Equal steps over the time that all sensors last; raises `RecordError` where they have none in common."""
    first, last = max(s.time[0] for s in sensors), min(s.time[-1] for s in sensors)
    if last - first < 2 * STEP_S:
        raise RecordError(f"the sensors have less than {2 * STEP_S:g} s in common")
    return np.arange(first, last, STEP_S)


def averaged(time: Array, values: Array, at: Array) -> Array:
    """Means of values (n, k) over the steps about instants (m,), shape (m, k); NaN where there is no value."""
    cell = np.rint((time - at[0]) / STEP_S).astype(np.int64)
    inside = (cell >= 0) & (cell < len(at))
    count = np.bincount(cell[inside], minlength=len(at))
    with np.errstate(invalid="ignore", divide="ignore"):
        sums = [np.bincount(cell[inside], column[inside], len(at)) / count for column in values.T]
    return np.stack(sums, axis=-1)


def filled(values: Array) -> Array:
    """Values (n, k) whose rows of NaN lie on lines between their neighbours."""
    seen, i = np.isfinite(values).all(axis=1), np.arange(len(values))
    return interpolated(i, i[seen], values[seen])


def silent(time: Array, at: Array, most_s: float = SILENT_S) -> NDArray[np.str_]:
    """Why there is no reading near instants (m,); empty where there is one."""
    after = np.searchsorted(time, at)
    before = np.clip(after - 1, 0, len(time) - 1)
    gap = time[np.clip(after, 0, len(time) - 1)] - time[before]
    reason = np.where(gap > most_s, "the sensor was silent", "")
    reason = np.where(at < time[0] - STEP_S, "before the sensor's first reading", reason)
    return np.where(at > time[-1] + STEP_S, "after the sensor's last reading", reason)


def swing(at: Array, steps: Array, states: Array, covariances: Array, times: Array, most_s: float = SILENT_S) -> Swing:
    """Return the swing at instants (m,) from a filter's states at steps (n,), whose sensor read at times (k,)."""
    lean = interpolated(at, steps, states[:, LEAN])
    of_lean = covariances[np.clip(np.searchsorted(steps, at), 0, len(steps) - 1), LEAN, LEAN]
    sd = np.sqrt(np.maximum(split(of_lean, lean)[0], 0))
    reason = silent(times, at, most_s)
    worst = np.sqrt(np.linalg.eigvalsh(of_lean)[:, -1])
    reason = np.where((reason == "") & (worst > MOST_SD), "the filter has not converged", reason)
    return Swing.of(lean, sd, reason)
