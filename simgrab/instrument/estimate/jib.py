"""The jib head's motion over the ground, as a controller reports it, and how it tilts a camera.

The controller gives positions, with coarse steps. A smoother gives rates and accelerations: position, rate and
acceleration of slewing and of luffing are the states of a chain (`simgrab.instrument.estimate.chain`), driven by white
jerk whose strength maximises the likelihood of the readings.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from simgrab.instrument.controller import Controller
from simgrab.instrument.estimate.chain import Minimum, linear, prior
from simgrab.instrument.estimate.frames import interpolated
from simgrab.model.geometry import STANDARD_GRAVITY, Array

STEP_S = 0.05  # of the grid on which the motion is described; of several readings in a step the last counts
REST_S = 10.0  # in which a jib without readings comes to rest
SPEED = 2.0  # m/s, of luffing and of the jib head as it slews
JERK_M_S3 = 0.1, 1e-3, 10.0  # first value, least and greatest of the search


@dataclass(frozen=True, eq=False)
class JibMotion:
    """Motion of O over the ground at m moments of a grid, in a level frame that does not turn.

    Attributes
    ----------
    time : ndarray, shape (m,)
    heading : ndarray, shape (m,)
        Of the jib in the level frame, rad.
    luffed : ndarray, shape (m,)
        Radius minus its mean, m.
    velocity : ndarray, shape (m, 2)
        m/s.
    """

    time: Array
    heading: Array
    luffed: Array
    velocity: Array

    @classmethod
    def at_rest(cls) -> JibMotion:
        """Make the motion of a jib that rests, or of which nothing is known."""
        return cls(np.array([0.0, STEP_S]), np.zeros(2), np.zeros(2), np.zeros((2, 2)))

    @classmethod
    def of(cls, controller: Controller) -> JibMotion:
        """Smooth the readings of a controller."""
        first, last = controller.time[[0, -1]]
        time = first + STEP_S * np.arange(int(np.ceil((last - first) / STEP_S)) + 1)
        still = np.zeros((len(time), 3))
        luffing = still if controller.radius is None else smoothed(time, controller.time, controller.radius, controller.radius_sd)
        reach = luffing[:, 0] if controller.radius is not None else 25.0 + still[:, 0]
        slewing = still
        if controller.slew is not None:
            lever = float(np.mean(reach))
            slewing = smoothed(time, controller.time, controller.slew * lever, controller.slew_sd * lever) / lever
        heading = slewing[:, 0]
        out = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
        across = np.stack([-out[:, 1], out[:, 0]], axis=-1)
        velocity = luffing[:, 1:2] * out + (reach * slewing[:, 1])[:, None] * across
        return cls(time, heading, reach - reach.mean(), velocity)

    @property
    def moves(self) -> bool:
        """Whether the jib moves at all."""
        return bool(self.velocity.any())

    def acceleration(self, time: Array) -> Array:
        """Mean acceleration (k − 1, 2) between moments (k,), level frame, m/s²."""
        return np.diff(interpolated(time, self.time, self.velocity), axis=0) / np.diff(time)[:, None]

    def levelled(self, frequency: float, damping: float, time: Array) -> Array:
        """Lean (k, 2) at moments (k,) of a camera that hangs by gravity: a damped pendulum in the jib frame.

        Parameters
        ----------
        frequency : float
            rad/s.
        damping : float
            Share of the critical one.
        time : ndarray, shape (k,)
        """
        if not self.moves:
            return np.zeros((len(time), 2))
        from scipy.signal import lfilter  # slow to import, and needed with a controller alone

        middle = (self.heading[1:] + self.heading[:-1]) / 2
        x, y = -np.diff(self.velocity, axis=0).T / (STEP_S * STANDARD_GRAVITY)
        c, s = np.cos(middle), np.sin(middle)
        plumb = np.stack([c * x + s * y, c * y - s * x], axis=-1)
        step = scipy.linalg.expm(STEP_S * np.array([[0.0, 1.0], [-(frequency**2), -2 * damping * frequency]]))
        trace, det, rise = step.trace(), np.linalg.det(step), 1 - step[0, 0]
        leans = plumb[0] + lfilter([0.0, rise, 1 - trace + det - rise], [1.0, -trace, det], plumb - plumb[0], axis=0)
        return interpolated(time, self.time[:-1], leans)


def smoothed(at: Array, time: Array, position: Array, sd: float) -> Array:
    """Position, rate and acceleration (m, 3) at moments (m,) of an even grid from readings (n,) of a position in m.

    NaN are no readings.
    """
    known = np.isfinite(position)
    place = np.zeros(len(at), int)
    nearest = np.clip(np.rint((time[known] - at[0]) / STEP_S).astype(int), 0, len(at) - 1)
    place = np.full(len(at), -1)
    place[nearest] = np.flatnonzero(known)
    seen = place >= 0
    late = np.where(seen, time[place] - at, 0.0)
    row = np.stack([np.ones_like(late), late, late**2 / 2], axis=-1)[:, None]
    start = np.zeros((len(at), 3))
    start[:, 0] = np.interp(at, time[known], position[known])
    h, k, none = STEP_S, len(at), np.zeros((0,))
    ahead = np.array([[1, h, h * h / 2], [0, 1, h], [0, 0, 1]])
    noise = np.array([[h**5 / 20, h**4 / 8, h**3 / 6], [h**4 / 8, h**3 / 3, h**2 / 2], [h**3 / 6, h**2 / 2, h]])
    every = np.broadcast_to
    steps = linear(
        -every(ahead, (k - 1, 3, 3)), np.zeros((k - 1, 3, 0)), start[:-1] @ ahead.T - start[1:],
        every(np.linalg.inv(noise), (k - 1, 3, 3)), every(np.eye(3), (k - 1, 3, 3)),
    )  # fmt: skip
    off = np.where(seen, position[place] - start[:, 0], 0.0)
    rest = np.array([0.0, SPEED**-2.0, (SPEED / 5)**-2.0]) * (STEP_S / REST_S)
    readings = linear(row, np.zeros((k, 1, 0)), off[:, None], (seen / sd**2)[:, None, None]) + prior(
        start, every(rest, (k, 3)), none, none
    )

    def best(jerk2: float) -> Minimum:
        return (readings + steps * (1 / jerk2)).minimise()

    def minus_log(log: float) -> float:
        found = best(float(np.exp(log)))
        return found.value + found.log_det + 3 * (k - 1) * log

    found = scipy.optimize.minimize_scalar(minus_log, bounds=(np.log(1e-6), np.log(1.0)), method="bounded", options={"xatol": 0.1})
    return start + best(float(np.exp(found.x))).states.reshape(-1, 3)
