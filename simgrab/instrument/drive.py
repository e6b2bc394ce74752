"""How the crane's drives follow the speeds that are demanded of them, from which the jib's next seconds follow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simgrab.model.geometry import Array

# A ramp begins by so much after the setpoint changed, and takes so long: pairs that are considered.
DELAY_STEP_S = 0.1
_DELAYS_S, _RAMPS_S = np.meshgrid(np.arange(7) * DELAY_STEP_S, np.geomspace(0.7, 10.0, 24))
DELAY_S, RAMP_S = _DELAYS_S.ravel(), _RAMPS_S.ravel()
USUAL_S, SPREAD = 6.0, 0.5  # median of a ramp's duration before it is seen, and its logarithm's standard deviation
STOPPING_S = 4.5  # of a stop that is still to come
BEFORE_S, REST_S = 0.5, 2.0  # readings are used from so long before the setpoint's change on, and of so long at least
LEAST_READINGS = 5
LEAST_STEP = 0.05  # of the greatest setpoint: smaller changes are noise
SLIP, CREEP = 0.1, 1e-4  # standard deviation of the final speed: share of the setpoint, and rad/s or m/s
SPEED_SD = 1.0  # rad/s or m/s, of the speed before
EXACT = 1e-6  # rad or m: no reading is better
MOST_MISFIT = 3.0  # standard deviations of readings (root mean square) and of the final speed


@dataclass(frozen=True, eq=False)
class Drive:
    """An axis whose speed goes to the setpoint in a ramp, of which begin and duration are not known."""

    value: float  # now, rad or m
    final: float  # speed after the ramp, per second
    age_s: Array  # (168,), time since the ramp began, of each of the pairs of `DELAY_S` and `RAMP_S`
    change: Array  # (168,), final speed less that before the ramp
    weight: Array  # (168,), probability

    @classmethod
    def of(cls, time: Array, values: Array, setpoints: Array, sd: float) -> Drive | None:
        """Fit the readings; None if the axis does not follow the setpoint, or if there are too few of them.

        Without a change of the setpoint among the readings the ramp is over.

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
        if len(time) < LEAST_READINGS:
            return None
        sd = max(sd, EXACT)
        changes = np.flatnonzero(np.abs(np.diff(setpoints)) > LEAST_STEP * np.abs(setpoints).max())
        age, first, timing_sd = np.full(len(RAMP_S), RAMP_S.max() - time[0]), -REST_S, 0.0
        if len(changes):
            before = float(time[changes[-1]])
            age, first = -before - DELAY_S, before - BEFORE_S
            if len(changes) == 1:  # so that the speed before did not change
                first = min(first, -REST_S)
            timing_sd = float(abs(setpoints[-1] - setpoints[changes[-1]])) * DELAY_STEP_S / np.sqrt(12)
        some, setpoint = time >= first, float(setpoints[-1])
        t = time[some]
        if len(t) < LEAST_READINGS:
            return None
        # Linear in value now, final speed and change of speed; the latter two have normal prior distributions.
        by = np.stack(np.broadcast_arrays(1.0, t[:, None], _shortfall(age) - _shortfall(t[:, None] + age)))
        by = by.transpose(2, 1, 0)
        prior_sd = np.array([np.inf, SLIP * abs(setpoint) + CREEP, SPEED_SD])
        precision = (sd / prior_sd) ** 2
        left = values[some] - values[some][-1] - setpoint * t
        fits = np.linalg.solve(by.mT @ by + np.diag(precision), by.mT @ left[:, None])[..., 0]
        squares = np.sum((left - np.vecdot(by, fits[:, None])) ** 2, axis=-1) + fits**2 @ precision
        best = squares.argmin()
        slips = abs(fits[best, 1]) > MOST_MISFIT * prior_sd[1]
        if slips or squares[best] > MOST_MISFIT**2 * (sd**2 + timing_sd**2) * len(t):
            return None
        cost = squares / sd**2 + (np.log(RAMP_S / USUAL_S) / SPREAD) ** 2
        weight = np.exp((cost.min() - cost) / 2)
        weight /= weight.sum()
        value, final, change = fits.T
        now = values[some][-1] + value @ weight
        return cls(float(now), float(setpoint + final @ weight), age, change, weight)

    def ahead(self, after_s: Array) -> tuple[Array, Array, Array]:
        """Return value, speed and acceleration, each (m,), that are expected in some seconds (m,)."""
        age = self.age_s + after_s[:, None]
        gone = self.change * (_shortfall(age) - _shortfall(self.age_s))
        speed = self.final - (self.change * np.clip(1 - age / RAMP_S, 0, 1)) @ self.weight
        acceleration = (self.change / RAMP_S * ((age >= 0) & (age < RAMP_S))) @ self.weight
        return self.value + self.final * after_s - gone @ self.weight, speed, acceleration

    def stopped(self, after_s: Array) -> tuple[Array, Array, Array]:
        """Return the same, each (m + 1, m), if the drive is stopped at each of these times, and last if it is not.

        A drive that stops sooner anyway is not changed.
        """
        value, speed, acceleration = self.ahead(after_s)
        share = 1 - (after_s - after_s[:, None]) / STOPPING_S
        stopping = speed[:, None] * np.clip(share, 0, 1)
        begins = (share == 1) & (acceleration * speed > -(speed**2) / STOPPING_S)
        slower = (share < 1) & (np.abs(stopping) < np.abs(speed)) | begins
        speeds = np.vstack([np.where(slower, stopping, speed), speed])
        accelerations = np.where(slower, np.where(share > 0, -speed[:, None] / STOPPING_S, 0.0), acceleration)
        steps = (speeds[:, 1:] + speeds[:, :-1]) / 2 * np.diff(after_s)
        values = value[:1] + np.cumsum(np.pad(steps, ((0, 0), (1, 0))), axis=1)
        return values, speeds, np.vstack([accelerations, acceleration])


def _shortfall(age: Array) -> Array:
    """Integral over time of what a ramp from 0 to 1, of each of `RAMP_S`, lacks to 1, up to ages (..., 168), s."""
    return np.asarray(np.minimum(age, 0) - np.clip(1 - age / RAMP_S, 0, 1) ** 2 * RAMP_S / 2)


def of_point(slew: tuple[Array, Array, Array], radius: tuple[Array, Array, Array]) -> Array:
    """Acceleration of O outward and counter-clockwise, m/s², and slewing rate, rad/s, shape (…, 3).

    Parameters
    ----------
    slew, radius : tuple of 3 ndarray
        Value, speed and acceleration.
    """
    (_, turn, turning), (r, out, outward) = slew, radius
    return np.stack(np.broadcast_arrays(outward - r * turn**2, r * turning + 2 * out * turn, turn), axis=-1)
