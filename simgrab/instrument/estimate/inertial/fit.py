"""Fitting attitude, sensor and pendulum to one record: Gauss–Newton to the posterior mode, from loose to stiff.

A grab that digs in the cargo is no pendulum. While the pendulum is loose, the path follows the pixels, and stretches
whose motion takes forces that no wind has show up; they lose their weight for the rest of the fit. A fit that starts
stiff would rather take the pixels there for outliers.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from simgrab.instrument.estimate.chain import Minimum, Quadratic, linear
from simgrab.instrument.estimate.inertial.model import (
    ACCELEROMETER,
    ATTITUDE,
    DAMPING,
    GYROSCOPE,
    LEAN,
    LONGER,
    MOMENTUM,
    PARAMETERS,
    REACH,
    STATE,
    SWING,
    VELOCITY,
    Links,
    derivatives_of_advance,
    derivatives_of_place,
)
from simgrab.instrument.estimate.inertial.preintegration import rotation, rotation_vector
from simgrab.model.geometry import Array

# Strengths, as logarithms: white acceleration (m²/s³ per axis), pixel noise (over h), slow forcing (rad per axis).
FAST, NOISE, SLOW = 0, 1, 2
LOOSE, STIFFER, START_FAST = 0.1, 0.3, 1e-3  # m²/s³, of the first round; factor of each of the next, down to the last
LOOSE_ROUNDS, FIRST_WEIGHED, FIRST_SEARCH = 9, 5, 9
WINDOW_S = 2.0  # over which forces are averaged to find a grab that does not swing freely
NATURAL_FAST, NATURAL_SLOW, BEYOND = 1e-4, 0.005, 9.0  # forces as wind has them, and how many times them are too many
LEAST_FAST, LEAST_SLOW = 1e-5, 1e-3  # at the end those of the record itself count, but no less than these
START_SD = 0.3  # of the first s and p
HEADING_SD = 1e-3  # rad: the level frame's heading is the first node's
LEAST_FORCING = 3e-5  # m²/s³: no pendulum of two numbers describes a grab better
SETTLED_RAD = 5e-5


@dataclass(frozen=True)
class Priors:
    """Means and standard deviations.

    Attributes
    ----------
    mean, sd : ndarray, shape (11,)
        Of the parameters.
    tilt_sd : float
        Of the first attitude, rad per axis.
    gyroscope_sd : ndarray, shape (3,)
        Of the first bias, rad/s.
    accelerometer_sd : float
        Of the first bias, m/s².
    rate_density, rate_walk, force_density, force_walk : float
        Of the noise, as in `ImuReadings`, and what the model leaves out.
    speed, speed_s : float
        Standard deviation of the camera's velocity per axis, m/s, and how long it takes to become another one, s.
    rest_speed : float
        Standard deviation of the velocity of a jib that stands, m/s per axis.
    degrees : float
        Of Student's t distribution of pixel errors.
    """

    mean: Array
    sd: Array
    tilt_sd: float
    gyroscope_sd: Array
    accelerometer_sd: float
    rate_density: float
    rate_walk: float
    force_density: float
    force_walk: float
    speed: float
    speed_s: float
    rest_speed: float
    degrees: float


@dataclass(frozen=True, eq=False)
class Data:
    """What a record has at k nodes.

    Attributes
    ----------
    time, rope : ndarray, shape (k,)
    place : ndarray, shape (k, 2)
        0 where nothing was seen.
    seen, resting : ndarray of bool, shape (k,)
        Whether there is a pixel, and whether the jib does not slew.
    links : Links
    focal_px : float
    """

    time: Array
    rope: Array
    place: Array
    seen: NDArray[np.bool_]
    resting: NDArray[np.bool_]
    links: Links
    focal_px: float


@dataclass(frozen=True, eq=False)
class Path:
    """Attitudes (k, 3, 3), states (k, 16) without error of the attitude, parameters (11,), and strengths (3,).

    ``weight`` (k − 1,) is that of each step's pendulum; below 1 where the grab does not swing freely.
    """

    attitude: Array
    state: Array
    parameters: Array
    strengths: Array
    weight: Array

    def moved(self, states: Array, parameters: Array) -> Path:
        """Apply a change (k, 16) of the states and one (11,) of the parameters."""
        state = self.state + states
        state[:, ATTITUDE] = 0
        attitude = self.attitude @ rotation(states[:, ATTITUDE])
        return replace(self, attitude=attitude, state=state, parameters=self.parameters + parameters)


@dataclass(frozen=True, eq=False)
class Fit:
    """A path, what is known of it, how many rounds it took, and whether it settled."""

    path: Path
    minimum: Minimum
    rounds: int
    settled: bool


def fit(data: Data, first: Path, start: Path, priors: Priors, searches: int, rounds: int) -> Fit:
    """Fit from a rough path; at most so many rounds search for the strengths.

    Parameters
    ----------
    data : Data
    first : Path
        Whose first attitude and biases the priors are about.
    start : Path
        To begin with. Where ``searches`` is 0, its strengths and weights are kept.
    priors : Priors
    searches, rounds : int

    Raises
    ------
    numpy.linalg.LinAlgError
        If the record determines no path.
    """
    path, settled, loose, last = start, False, searches > 0, 0
    for done in range(rounds):
        last = done
        bound = priors
        if loose and done < LOOSE_ROUNDS:
            fast = max(START_FAST, LOOSE * STIFFER**done)
            path = replace(path, strengths=np.array([np.log(fast), *path.strengths[1:]]))
            bound = _without_frequency(priors)
        weigh = "" if not loose or done < FIRST_WEIGHED else "natural" if done < FIRST_SEARCH else "own"
        problem = _Problem(data, path, first, bound, weigh if searches else "")
        path = replace(path, weight=problem.weight)
        if searches and done >= FIRST_SEARCH:
            before = path.strengths
            path = replace(path, strengths=problem.search(before, wide=done == FIRST_SEARCH))
            still = np.abs(path.strengths - before) < (np.inf, 0.05, 0.3)
            searches = 0 if still.all() else searches - 1
        best = _hanging(problem.at(path.strengths).minimise(), path)
        change = best.states.reshape(-1, STATE)
        path = path.moved(change, best.parameters)
        if not np.isfinite(path.state).all() or np.abs(path.state[:, SWING]).max() > 1:
            raise np.linalg.LinAlgError("diverged")
        settled = float(np.abs(change[:, SWING]).max()) < SETTLED_RAD
        if settled and not searches and (not loose or done > FIRST_SEARCH):
            break
    problem = _Problem(data, path, first, priors, "")
    return Fit(path, problem.at(path.strengths).minimise(), last + 1, settled)


def _hanging(best: Minimum, path: Path) -> Minimum:
    """Move to the least point at which the reach is not positive: no head leans more than its ropes."""
    beyond = path.parameters[REACH] + best.parameters[REACH]
    if beyond <= 0:
        return best
    change = -beyond * best.covariance[REACH] / best.covariance[REACH, REACH]
    return replace(best, parameters=best.parameters + change, states=best.states - best.gain @ change)


def _without_frequency(priors: Priors) -> Priors:
    """Fix what sets the pendulum's frequency and its response: a loose path is not smooth enough to determine them."""
    sd = priors.sd.copy()
    sd[[DAMPING, LONGER, REACH]] = 1e-6
    return replace(priors, sd=sd)


@dataclass(eq=False)
class _Problem:
    """The record's posterior about one path, each part to be scaled by its strength."""

    data: Data
    path: Path
    first: Path
    priors: Priors
    weigh: str
    weight: Array = field(init=False)

    def __post_init__(self) -> None:
        data, path = self.data, self.path
        residual, by_state, by_parameter = derivatives_of_advance(
            path.attitude, path.state, path.parameters, data.links
        )
        k, step = len(path.state), data.links.imu.step
        ahead = np.broadcast_to(np.eye(STATE), (k - 1, STATE, STATE))
        fast, slow = _fast_precision(data.links), _slow_precision(data.links)
        self.weight = path.weight
        if self.weigh:
            across = max(int(WINDOW_S / np.median(step)), 1)
            beyond = np.ones(k - 1)
            for precision, freedom, natural, least in (
                (fast, 4, NATURAL_FAST, LEAST_FAST), (slow, 2, NATURAL_SLOW**2, LEAST_SLOW**2),
            ):  # fmt: skip
                force = np.einsum("ni,nij,nj->n", residual, precision, residual) / freedom
                force = scipy.ndimage.uniform_filter1d(force, across)
                usual = natural if self.weigh == "natural" else max(2 * float(np.median(force)), least)
                beyond = np.maximum(beyond, force / (BEYOND * usual))
            self.weight = np.minimum(path.weight, beyond**-2.0) if self.weigh == "natural" else beyond**-2.0

        def steps(precision: Array) -> Quadratic:
            return linear(-by_state, -by_parameter, residual, precision, ahead)

        self._sensor = steps(_sensor_precision(self.priors, step)) + self._prior()
        self._fast, self._slow = (steps(of * self.weight[:, None, None]) for of in (fast, slow))
        self._slow = self._slow + _about(self.path.state, LEAN, [0], 1.0)
        self._places = self._see()
        f = data.focal_px
        self._low, self._high = np.log([LEAST_FORCING, 0.05 / f, 1e-5]), np.log([1.0, 50 / f, 0.1])

    def _see(self) -> Quadratic:
        data, path, priors = self.data, self.path, self.priors
        at, by_state, by_parameter = derivatives_of_place(path.attitude, path.state, path.parameters, data.rope)
        error = data.place - at
        square = np.sum(error**2, axis=-1) * np.exp(-2 * path.strengths[NOISE])
        weight = data.seen * (priors.degrees + 2) / (priors.degrees + square)
        return linear(by_state, by_parameter, error, weight[:, None, None] * np.eye(2))

    def _prior(self) -> Quadratic:
        """Collect what is known of the first node, of the velocity at all of them, and of the parameters."""
        path, first, priors = self.path, self.first, self.priors
        k, step = len(path.state), self.data.links.imu.step
        off = path.state.copy()
        off[0, ATTITUDE] = rotation_vector(first.attitude[0].T @ path.attitude[0])
        off[0, GYROSCOPE] -= first.state[0, GYROSCOPE]
        off[0, ACCELEROMETER] -= first.state[0, ACCELEROMETER]
        precision = np.zeros((k, STATE))
        precision[0, ATTITUDE] = np.array([priors.tilt_sd, priors.tilt_sd, HEADING_SD]) ** -2.0
        precision[0, GYROSCOPE] = priors.gyroscope_sd**-2.0
        precision[0, ACCELEROMETER] = priors.accelerometer_sd**-2.0
        precision[0, SWING] = precision[0, MOMENTUM] = START_SD**-2.0
        steps = np.concatenate([step[:1], step])
        precision[:, VELOCITY] = velocity_precision(path.state[:, VELOCITY], self.data.resting, steps, priors)[:, None]
        away = (priors.mean - path.parameters) / priors.sd
        band = np.zeros((2 * STATE, k * STATE))
        band[0] = precision.ravel()
        return Quadratic(
            band, np.zeros((k * STATE, PARAMETERS)), np.diag(priors.sd**-2.0), -(precision * off).ravel(),
            away / priors.sd, float(away @ away + np.sum(precision * off**2)),
        )  # fmt: skip

    def at(self, strengths: Array) -> Quadratic:
        """Twice the negative log posterior, but for a constant."""
        fast, noise, slow = np.exp(-strengths[FAST]), np.exp(-2 * strengths[NOISE]), np.exp(-2 * strengths[SLOW])
        return self._sensor + self._fast * fast + self._places * noise + self._slow * slow

    def search(self, strengths: Array, wide: bool) -> Array:
        """Strengths that make the record likeliest (Laplace), with a prior as the fourth root of the slow one."""
        links, seen = len(self.weight), int(self.data.seen.sum())

        def minus_log(v: Array) -> float:
            inside = np.clip(v, self._low, self._high)
            try:
                best = self.at(inside).minimise()
            except np.linalg.LinAlgError:
                return 1e30
            spread = 2 * links * inside[FAST] + 2 * seen * inside[NOISE] + (2 * links - 0.25) * inside[SLOW]
            return float(0.5 * (best.value + best.log_det) + spread + 10 * np.sum((v - inside) ** 2))

        size = np.array([3.0, 0.7, 1.5]) if wide else np.array([0.7, 0.15, 0.5])
        start = np.clip(strengths, self._low, self._high)
        options = {"xatol": 0.05, "fatol": 0.01, "initial_simplex": np.vstack([start, start + np.diag(size)])}
        best = scipy.optimize.minimize(minus_log, start, method="Nelder-Mead", options=options)
        return np.clip(best.x, self._low, self._high)


def velocity_precision(velocity: Array, resting: NDArray[np.bool_], step: Array, priors: Priors) -> Array:
    """Inverse variance per axis (n,) of what is known of velocities (n, 2): that they are small, and 0 while resting.

    Velocities within `Priors.speed_s` are one measurement, and those of a standing jib within a second. The weight is
    Geman and McClure's: a jib that luffs without slewing has none.
    """
    square = np.sum(velocity**2, axis=-1) / priors.rest_speed**2
    stands = resting * (1 + square) ** -2.0 * np.minimum(step, 1)
    return np.asarray(np.minimum(step / priors.speed_s, 1) * priors.speed**-2.0 + stands * priors.rest_speed**-2.0)


def sensor_variance(priors: Priors, step: Array) -> Array:
    """Variances (n, 16) of what the sensor's noise adds in steps (n,); 0 for the pendulum."""
    variance = np.zeros((len(step), STATE))
    for some, density in (
        (ATTITUDE, priors.rate_density), (VELOCITY, priors.force_density),
        (GYROSCOPE, priors.rate_walk), (ACCELEROMETER, priors.force_walk),
    ):  # fmt: skip
        variance[:, some] = density**2 * step[:, None]
    return variance


def fast_covariance(links: Links) -> tuple[Array, Array, Array]:
    """Sum up what unit white acceleration (1 m²/s³ per axis) adds in a step: var(s), cov(s, p) and var(p), (k − 1,)."""
    h, rope = links.imu.step, (links.before + links.after) / 2
    return h**3 / (3 * rope**2), h**2 / (2 * links.length**2), h * rope**2 / links.length**4


def slow_variance(links: Links) -> Array:
    """Sum up what slow forcing of unit variance per axis adds in each step, shape (k − 1,)."""
    return np.asarray(-np.expm1(-2 * links.imu.step / links.memory_s))


def _about(state: Array, some: slice, nodes: list[int], precision: float) -> Quadratic:
    """Prior about 0 for some numbers of some nodes."""
    k = len(state)
    on = np.zeros((k, STATE))
    on[nodes, some] = precision
    band = np.zeros((2 * STATE, k * STATE))
    band[0] = on.ravel()
    return Quadratic(
        band, np.zeros((k * STATE, PARAMETERS)), np.zeros((PARAMETERS, PARAMETERS)), -(on * state).ravel(),
        np.zeros(PARAMETERS), float(np.sum(on * state**2)),
    )  # fmt: skip


def _sensor_precision(priors: Priors, step: Array) -> Array:
    """Inverse covariance (k − 1, 16, 16) of what the sensor's noise adds in a step."""
    variance = sensor_variance(priors, step)
    noisy = variance > 0
    return np.where(noisy, 1 / np.where(noisy, variance, 1), 0)[:, :, None] * np.eye(STATE)


def _fast_precision(links: Links) -> Array:
    """Inverse covariance (k − 1, 16, 16) of what unit white acceleration (1 m²/s³ per axis) adds to s and p."""
    ss, sp, pp = fast_covariance(links)
    det = ss * pp - sp**2
    inverse = np.zeros((len(ss), STATE, STATE))
    for s, p in zip(range(SWING.start, SWING.stop), range(MOMENTUM.start, MOMENTUM.stop), strict=True):
        inverse[:, s, s], inverse[:, p, p] = pp / det, ss / det
        inverse[:, s, p] = inverse[:, p, s] = -sp / det
    return inverse


def _slow_precision(links: Links) -> Array:
    """Inverse covariance (k − 1, 16, 16) of what slow forcing of unit variance per axis adds in a step."""
    inverse = np.zeros((len(links.imu.step), STATE, STATE))
    for i in range(LEAN.start, LEAN.stop):
        inverse[:, i, i] = 1 / slow_variance(links)
    return inverse
