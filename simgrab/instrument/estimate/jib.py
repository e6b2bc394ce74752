"""The jib head's motion over the ground, as a controller reports it, and how it tilts a camera.

The controller gives positions, with coarse steps. A smoother gives rates and accelerations: position, rate and
acceleration of slewing and of luffing are the states of a chain (`simgrab.instrument.estimate.chain`), driven by jerk
whose strength maximises the likelihood of the readings.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from simgrab.instrument.controller import RADIUS_M, Controller
from simgrab.instrument.estimate.chain import Quadratic, linear, prior, state_covariances
from simgrab.model.geometry import STANDARD_GRAVITY, Array

STEP_S = 0.05  # of the grid on which the motion is described; of several readings in a step the last counts
REST_S = 10.0  # in which a jib without readings comes to rest
SPEED = 2.0  # m/s, of luffing and of the jib head as it slews
ROUNDS = 7
AVERAGED_S = 1.0  # over which a speed is averaged for the effect of jitter
CALM = 2e-4  # rad, of a lean by wind, below which its direction counts as unknown
SHARES = 0.02, 1.0  # of the stated jitter
LEVEL_SD = 1e-6  # rad, of the first error of a sensor's lean: its mean is the tilt
# Errors of O's velocity, and with them those of the lean of a camera that levels itself, are low-passes of second order
# with these times, s, of noise. With the noise `SWAY`, 1/√s, they have the standard deviation 1.
SWAY_S = (0.5, 0.3)
SWAY = (sum(SWAY_S) / 2 - 2 / sum(1 / t for t in SWAY_S)) ** -0.5


@dataclass(frozen=True, eq=False)
class JibMotion:
    """Motion of O over the ground in a level frame that does not turn, and the jib's heading in it."""

    time: Array  # (m,), a grid
    # (m, 6), heading, rad; radius minus its mean, m; velocity of O, m/s (2); lean of the camera that a sensor
    # reports, rad (2, jib frame)
    course: Array
    # Of each kind of error of the direction of sight the noise that drives it, rad/√s per axis, and the time after
    # which it is forgotten, s: inf for that of the sensor's lean, which is a random walk and the first. With a
    # controller the first two, of one noise and over `unsure`, are errors of O's velocity and so of the lean.
    drifts: tuple[tuple[float, float], ...] = ()
    controller: Controller | None = None  # what reports the hoisted mass
    wind_m_s: float = 0.0  # mean wind, m/s; 0 where it is not known
    radius_m: float = 0.0  # mean radius; 0 where none is reported
    # (m,), standard deviation of apparent gravity per axis, from errors of the controller's readings, rad
    unsure: Array | None = None

    @classmethod
    def at_rest(cls) -> JibMotion:
        """Make the motion of a jib that rests, or of which nothing is known."""
        return cls(np.array([0.0, STEP_S]), np.zeros((2, 6)))

    @classmethod
    def of(cls, controller: Controller) -> JibMotion:
        """Smooth the readings of a controller."""
        first, last = controller.time[[0, -1]]
        time = first + STEP_S * np.arange(int(np.ceil((last - first) / STEP_S)) + 1)
        radius, slew = np.full((len(time), 4), (RADIUS_M, 0.0, 0.0, 0.0)), np.zeros((len(time), 4))
        if controller.radius is not None:
            sds = controller.radius_sd, controller.radius_still_sd or controller.radius_sd
            radius = smoothed(time, controller.time, controller.radius, *sds)
        reach = radius[:, 0]
        if controller.slew is not None:
            lever = float(reach.mean())
            sds = controller.slew_sd * lever, lever * (controller.slew_still_sd or controller.slew_sd)
            slew = smoothed(time, controller.time, controller.slew * lever, *sds) / lever
        out = np.stack([np.cos(slew[:, 0]), np.sin(slew[:, 0])], axis=-1)
        across = np.stack([-out[:, 1], out[:, 0]], axis=-1)
        velocity = radius[:, 1:2] * out + (reach * slew[:, 1])[:, None] * across
        course = np.column_stack([slew[:, 0], reach - reach.mean(), velocity, np.zeros_like(velocity)])
        radius_m = 0.0 if controller.radius is None else float(reach.mean())
        unsure = np.hypot(radius[:, 3], reach * slew[:, 3]) / (np.sqrt(2) * STANDARD_GRAVITY)
        return cls(time, course, ((SWAY, SWAY_S[0]), (-SWAY, SWAY_S[1])), radius_m=radius_m, unsure=unsure)

    @property
    def sensed(self) -> bool:
        """Whether a sensor reports the camera's lean."""
        return any(memory_s == np.inf for _, memory_s in self.drifts)

    def wandering(self, sd: float, memory_s: float) -> JibMotion:
        """Return a copy with a further error of the direction of sight of this standard deviation, rad per axis."""
        return replace(self, drifts=(*self.drifts, (sd * np.sqrt(2 / memory_s), memory_s)))

    def drifted(self, time: Array) -> tuple[Array, Array]:
        """Variances per axis (m,), rad², of these errors at first, and the covariance they gain between moments (k,).

        The latter has shape (k − 1, m, m). The first two are taken as independent at first, which is wider.
        """
        (noise, memory_s), step = np.array(self.drifts).T, np.diff(time)[:, None, None]
        fading, alike = np.add.outer(1 / memory_s, 1 / memory_s), np.eye(len(noise))
        scale = np.ones((len(time), *fading.shape))
        if self.unsure is not None:
            alike[:2, :2] = 1.0
            scale[:, :2, :2] = np.interp(time, self.time, self.unsure**2)[:, None, None]
        walks, noise2 = fading == 0, alike * np.outer(noise, noise)
        fading = np.where(walks, 1.0, fading)
        begun = np.diag(np.where(walks, LEVEL_SD**2, scale[0] * noise2 / fading))
        return begun, scale[1:] * noise2 * np.where(walks, step, -np.expm1(-step * fading) / fading)

    def shares(self, follows: float) -> Array:
        """Share of each of these errors (m,) in the direction of sight of a camera that follows apparent gravity."""
        shares = np.ones(len(self.drifts))
        if self.unsure is not None:
            shares[:2] = follows
        return shares

    def carried(self, time: Array) -> NDArray[np.complex128]:
        """Displacement of O (k − 1, m) between moments (k,) by 1 rad of each of these errors, level frame, x + iy, m.

        Over √(τ₁τ₂) the acceleration's error in g, summed up, is as large as itself: it is that of a lean.
        """
        way = np.zeros((len(time) - 1, len(self.drifts)), complex)
        if self.unsure is not None:
            lasting = -np.expm1(np.diff(time)[:, None] / -np.array(SWAY_S)) * SWAY_S
            way[:, :2] = STANDARD_GRAVITY * np.sqrt(np.prod(SWAY_S)) * lasting
        return way * np.exp(1j * self.at(time[:-1])[:, :1])

    @property
    def moves(self) -> bool:
        """Whether the jib moves at all."""
        return bool(self.course.any())

    @cached_property
    def _spline(self) -> CubicSpline:
        return CubicSpline(self.time, self.course)

    def at(self, time: Array) -> Array:
        """Course (k, 6) at moments (k,); beyond the readings it does not change."""
        return np.asarray(self._spline(np.clip(time, *self.time[[0, -1]])))

    def acceleration(self, time: Array) -> Array:
        """Mean acceleration (k − 1, 2) between moments (k,), level frame, m/s²."""
        return np.diff(self.at(time)[:, 2:4], axis=0) / np.diff(time)[:, None]

    def lightness(self, time: Array) -> Array:
        """`Controller.lightness` between moments (k,): shape (k − 1,)."""
        middle = (time[1:] + time[:-1]) / 2
        return np.ones(len(middle)) if self.controller is None else self.controller.lightness(middle)

    def by_wind(self, lean: Array, time: Array) -> Array:
        """Lean by a steady wind (2,) between moments (k,), level frame, rad, shape (k − 1, 2).

        It grows with the square of the air's speed past O, which moves. About no lean, `CALM`, it is smooth.
        """
        if not self.wind_m_s:
            return np.tile(lean, (len(time) - 1, 1))
        moved = self.at((time[1:] + time[:-1]) / 2)[:, 2:4] / self.wind_m_s
        along = lean / np.hypot(CALM, np.hypot(*lean))
        past = np.sqrt(1 - 2 * moved @ along + np.sum(moved**2, axis=-1))
        return np.asarray(past[:, None] * (lean - along @ lean * moved))

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
        kept, key = self._leans, (frequency, damping)
        if key not in kept:  # asked for once for each derivative
            kept.clear()
            kept[key] = self._levelled(frequency, damping)
        return np.asarray(kept[key](np.clip(time, *self.time[[0, -2]])))

    @cached_property
    def _leans(self) -> dict[tuple[float, float], CubicSpline]:
        return {}

    def _levelled(self, frequency: float, damping: float) -> CubicSpline:
        from scipy.signal import lfilter  # slow to import, and needed with a controller alone

        heading = (self.course[1:, 0] + self.course[:-1, 0]) / 2
        x, y = -np.diff(self.course[:, 2:4], axis=0).T / (STEP_S * STANDARD_GRAVITY)
        c, s = np.cos(heading), np.sin(heading)
        plumb = np.stack([c * x + s * y, c * y - s * x], axis=-1)
        step = scipy.linalg.expm(STEP_S * np.array([[0.0, 1.0], [-(frequency**2), -2 * damping * frequency]]))
        trace, det, rise = step.trace(), np.linalg.det(step), 1 - step[0, 0]
        leans = plumb[0] + lfilter([0.0, rise, 1 - trace + det - rise], [1.0, -trace, det], plumb - plumb[0], axis=0)
        return CubicSpline(self.time[:-1], leans)


def smoothed(at: Array, time: Array, position: Array, sd: float, still_sd: float) -> Array:
    """Smooth a position: itself, rate, acceleration and the latter's standard deviation, shape (m, 4).

    A drive starts and brakes with jumps of the acceleration: jerk is rare and then large, which iterated weights allow.
    Jitter of time stamps is an error of a position in proportion to its speed, at most as large as stated: it maximises
    the likelihood of the readings, too.

    Parameters
    ----------
    at : ndarray, shape (m,)
        Moments of a grid with steps of `STEP_S`.
    time, position : ndarray, shape (n,)
        Readings, m; NaN where one got lost.
    sd, still_sd : float
        Standard deviation of a reading, m: the greatest, and that at rest.
    """
    known = np.isfinite(position)
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
    precision, off = np.linalg.inv(noise), np.where(seen, position[place] - start[:, 0], 0.0)
    rest = np.array([0.0, SPEED**-2.0, (SPEED / 5) ** -2.0]) * (STEP_S / REST_S)
    speed = scipy.ndimage.uniform_filter1d(np.abs(np.gradient(start[:, 0])), int(AVERAGED_S / h))
    jitter2 = (sd**2 - still_sd**2) * (speed / max(float(speed.max()), 1e-9)) ** 2

    def readings(share: float) -> Quadratic:
        weight = seen / (still_sd**2 + share**2 * jitter2)
        return linear(row, np.zeros((k, 1, 0)), off[:, None], weight[:, None, None]) + prior(
            start, every(rest, (k, 3)), none, none
        )

    def steps(weight: Array) -> Quadratic:
        return linear(
            -every(ahead, (k - 1, 3, 3)), np.zeros((k - 1, 3, 0)), start[:-1] @ ahead.T - start[1:],
            precision * weight[:, None, None], every(np.eye(3), (k - 1, 3, 3)),
        )  # fmt: skip

    alike = steps(np.ones(k - 1))

    def minus_log(logs: Array) -> float:
        share, jerk2 = np.exp(logs)
        spread = float(np.sum(np.log(still_sd**2 + share**2 * jitter2[seen])))
        return (readings(share) + alike * (1 / jerk2)).marginal() + 3 * (k - 1) * logs[1] + spread

    bounds = np.log([SHARES, (1e-6, 1.0)])
    start_at = bounds.mean(axis=1)
    options = {"xatol": 0.1, "fatol": 0.1, "initial_simplex": start_at + 2 * np.eye(3, 2)}
    best = scipy.optimize.minimize(minus_log, start_at, bounds=bounds, method="Nelder-Mead", options=options)
    share, jerk2 = np.exp(best.x)
    read, weight = readings(share), np.ones(k - 1)
    for _ in range(ROUNDS):
        minimum = (read + steps(weight) * (1 / jerk2)).minimise()
        found = start + minimum.states.reshape(-1, 3)
        weight = 4 / (1 + 30 * (np.diff(found[:, 2]) ** 2 / (STEP_S * jerk2)))
    return np.column_stack([found, np.sqrt(state_covariances(minimum, 3)[:, 2, 2])])
