"""How the crane's drives follow the speeds that are demanded of them, from which the jib's next seconds follow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simgrab.model.geometry import Array

RAMPS_S = np.geomspace(0.7, 15.0, 32)  # durations of a ramp that are considered, each with its probability
USUAL_S, SPREAD = 6.0, 0.5  # their median before any of the ramp is seen, and their logarithm's standard deviation
STOPPING_S = 4.5  # of a stop that is still to come
BEFORE_S, REST_S = 0.5, 2.0  # readings are used from so long before the setpoint's last change, at least so many
LEAST_READINGS = 5
LEAST_STEP = 0.05  # of the greatest setpoint: less is noise
SLIP, CREEP = 0.1, 1e-4  # standard deviation of the final speed: share of the setpoint, and rad/s or m/s
SPEED_SD = 1.0  # rad/s or m/s, of the speed before
MOST_MISFIT = 3.0  # of readings (root mean square) and of the final speed, over what is expected


@dataclass(frozen=True, eq=False)
class Drive:
    """An axis whose speed goes to the setpoint in a ramp of unknown duration.

    Attributes
    ----------
    value : float
        Now, rad or m.
    final : float
        Speed after the ramp, per second.
    age_s : float
        Time since the setpoint changed.
    change : ndarray, shape (32,)
        Final speed less that before the change, for each of `RAMPS_S`.
    weight : ndarray, shape (32,)
        Probability of each.
    """

    value: float
    final: float
    age_s: float
    change: Array
    weight: Array

    @classmethod
    def of(cls, time: Array, values: Array, setpoints: Array, sd: float) -> Drive | None:
        """Fit the readings; None if the axis does not follow the setpoint, or if there are too few of them.

        Parameters
        ----------
        time : ndarray, shape (n,)
            s, at most 0, which is now.
        values : ndarray, shape (n,)
            rad or m.
        setpoints : ndarray, shape (n,)
            Per second.
        sd : float
            Standard deviation of a value.
        """
        steps, late = np.abs(np.diff(setpoints)), 0.0
        changes = np.flatnonzero(steps > LEAST_STEP * np.abs(setpoints).max())
        age, some = RAMPS_S[-1] - time[0], time >= -REST_S
        if len(changes):
            last = slice(changes[-1], changes[-1] + 2)
            age, some = -float(time[last].mean()), time >= min(float(time[last].mean()) - BEFORE_S, -REST_S)
            late = float(np.ptp(time[last]) * np.ptp(setpoints[last])) / np.sqrt(12)
        t, setpoint = time[some], float(setpoints[-1])
        if len(t) < LEAST_READINGS:
            return None
        # A reading is value + final · t + change · lacking, which of final and change have normal prior distributions.
        start = values[some][-1]
        error = values[some] - start - setpoint * t
        parts = np.stack(np.broadcast_arrays(1.0, t[:, None], _lacking(t[:, None] + age, age)))
        parts = parts.transpose(2, 1, 0)
        tight = sd / np.array([np.inf, SLIP * abs(setpoint) + CREEP, SPEED_SD])
        fits = np.linalg.solve(parts.mT @ parts + np.diag(tight**2), parts.mT @ error[:, None])[..., 0]
        squares = np.sum((error - np.vecdot(parts, fits[:, None])) ** 2, axis=-1) + np.sum((fits * tight) ** 2, axis=-1)
        best = squares.argmin()
        slips = abs(fits[best, 1]) * tight[1] > MOST_MISFIT * sd
        if slips or squares[best] > MOST_MISFIT**2 * (sd**2 + late**2) * len(t):
            return None
        cost = squares / sd**2 + (np.log(RAMPS_S / USUAL_S) / SPREAD) ** 2
        weight = np.exp((cost.min() - cost) / 2)
        weight /= weight.sum()
        value, final, change = fits.T
        return cls(float(start + value @ weight), float(setpoint + final @ weight), age, change, weight)

    def ahead(self, after_s: Array) -> tuple[Array, Array, Array]:
        """Return value, speed and acceleration, each (m,), that are expected in some seconds (m,)."""
        s = self.age_s + after_s[:, None]
        value = self.value + self.final * after_s + (self.change * _lacking(s, self.age_s)) @ self.weight
        speed = self.final - (self.change * np.clip(1 - s / RAMPS_S, 0, 1)) @ self.weight
        return value, speed, (self.change / RAMPS_S * (s < RAMPS_S)) @ self.weight

    def stopped(self, after_s: Array) -> tuple[Array, Array, Array]:
        """Return the same, each (m + 1, m), if the drive is stopped at each of these times, and last if it is not."""
        value, speed, acceleration = self.ahead(after_s)
        u = (after_s - after_s[:, None]) / STOPPING_S
        braking = np.where(u < 1, -speed[:, None] / STOPPING_S, 0.0)
        return (
            np.tile(value, (len(u) + 1, 1)),
            np.vstack([np.where(u < 0, speed, speed[:, None] * np.clip(1 - u, 0, 1)), speed]),
            np.vstack([np.where(u < 0, acceleration, braking), acceleration]),
        )


def _lacking(s: Array, until: float) -> Array:
    """Integral (m, 32) of what ramps from 0 to 1 lack to 1, from times s (m, 1) since they began to another one, s."""
    ends = (np.minimum(t, 0) - np.clip(1 - t / RAMPS_S, 0, 1) ** 2 * RAMPS_S / 2 for t in (until, s))
    return np.asarray(next(ends) - next(ends))


def motion(slew: tuple[Array, Array, Array], radius: tuple[Array, Array, Array]) -> Array:
    """Acceleration of O outward and counter-clockwise, m/s², and slewing rate, rad/s, shape (…, 3).

    Parameters
    ----------
    slew, radius : tuple of 3 ndarray
        Value, speed and acceleration.
    """
    (_, turn, turning), (r, out, outward) = slew, radius
    return np.stack(np.broadcast_arrays(outward - r * turn**2, r * turning + 2 * out * turn, turn), axis=-1)
