"""Fit attitude, sensor and pendulum to one record: Gauss–Newton to the posterior mode, from loose to stiff.

A grab that digs in the cargo is not a pendulum. While the pendulum is loose, the path follows the pixels, and stretches
whose motion needs more force than wind can give become visible; they lose their weight for the rest of the fit. A fit
that starts stiff would take the pixels there for outliers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simgrab.instrument.estimate.chain import Minimum, Quadratic, linear, prior
from simgrab.instrument.estimate.inertial.model import (
    ACCELEROMETER,
    ATTITUDE,
    DAMPING,
    GYROSCOPE,
    LEAN,
    LONGER,
    REACH,
    STATE,
    SWING,
    VELOCITY,
    ImuLinks,
    derivatives_of_advance,
    derivatives_of_place,
)
from simgrab.instrument.estimate.inertial.preintegration import rotation, rotation_vector
from simgrab.instrument.estimate.pendulum import DEGREES, Nodes, of_axes
from simgrab.instrument.estimate.strengths import LEAST_FAST, LEAST_SLOW, NOISE, WINDOW_S, Weighed, excess
from simgrab.model.geometry import Array

LOOSE, STIFFER, START_FAST = 0.1, 0.3, 1e-3  # m²/s³, of the first round; factor of each of the next, down to the last
LOOSE_ROUNDS, FIRST_WEIGHED, FIRST_SEARCH = 9, 5, 9
NATURAL_FAST, NATURAL_SLOW = 1e-4, 0.005  # forces as wind has them; at the end those of the record itself count
LEAST_FORCING = 3e-5  # m²/s³: no pendulum of two numbers describes a grab better
CONVERGED_RAD = 5e-5
SEARCHES, ROUNDS = 6, 40  # at most so many linearisations search for the strengths, and so many there are
SPEED, SPEED_S = 2.0, 10.0  # of the jib head, m/s per axis, and how long it takes to become another one, s
REST_SPEED = 0.03  # m/s per axis, of a jib that stands


@dataclass(frozen=True)
class InertialPriors:
    """Means and standard deviations.

    Attributes
    ----------
    mean, sd : ndarray, shape (11,)
        Mean and standard deviation of the parameters.
    first_sd : ndarray, shape (16,)
        Standard deviation of the first state about the first guess; infinite for unknown components.
    walk : ndarray, shape (16,)
        Random walk of the state by the sensor's noise in a second.
    """

    mean: Array
    sd: Array
    first_sd: Array
    walk: Array


@dataclass(frozen=True, eq=False)
class NodeData(Nodes):
    """Data of a record at k nodes.

    Attributes
    ----------
    resting : ndarray of bool, shape (k,)
        Whether the jib is not slewing.
    links : ImuLinks
    focal_px : float
    """

    resting: NDArray[np.bool_]
    links: ImuLinks
    focal_px: float


@dataclass(frozen=True, eq=False)
class Path:
    """Attitudes (k, 3, 3), states (k, 16) without error of the attitude, parameters (11,), and strengths (3,).

    ``weight`` (k − 1,) is the weight of the pendulum in each step; below 1 where the grab does not swing freely.
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
class InertialFit:
    """A path, its covariance, the number of rounds, and whether it converged."""

    path: Path
    minimum: Minimum
    rounds: int
    converged: bool


def fit(data: NodeData, first: Path, start: Path, priors: InertialPriors, searches: int = SEARCHES) -> InertialFit:
    """Fit from a rough path.

    Parameters
    ----------
    data : NodeData
    first : Path
        Path whose first attitude and biases are the prior means.
    start : Path
        Path to start from. If ``searches`` is 0, its strengths and weights are kept.
    priors : InertialPriors
    searches : int

    Raises
    ------
    numpy.linalg.LinAlgError
        If the record determines no path.
    """
    path, converged, loose, last = start, False, searches > 0, 0
    for done in range(ROUNDS):
        last = done
        bound = priors
        if loose and done < LOOSE_ROUNDS:
            fast = max(START_FAST, LOOSE * STIFFER**done)
            path = replace(path, strengths=np.array([np.log(fast), *path.strengths[1:]]))
            bound = _without_frequency(priors)
        weigh = "" if not loose or done < FIRST_WEIGHED else "natural" if done < FIRST_SEARCH else "own"
        posterior, weight = _linearised(data, path, first, bound, weigh if searches else "")
        path = replace(path, weight=weight)
        if searches and done >= FIRST_SEARCH:
            before = path.strengths
            path = replace(path, strengths=posterior.search(before, wide=done == FIRST_SEARCH))
            still = np.abs(path.strengths - before) < (np.inf, 0.05, 0.3)
            searches = 0 if still.all() else searches - 1
        best = _hanging(posterior.at(path.strengths).minimise(), path)
        change = best.states.reshape(-1, STATE)
        path = path.moved(change, best.parameters)
        if not np.isfinite(path.state).all() or np.abs(path.state[:, SWING]).max() > 1:
            raise np.linalg.LinAlgError("diverged")
        converged = float(np.abs(change[:, SWING]).max()) < CONVERGED_RAD
        if converged and not searches and (not loose or done > FIRST_SEARCH):
            break
    posterior, _ = _linearised(data, path, first, priors, "")
    return InertialFit(path, posterior.at(path.strengths).minimise(), last + 1, converged)


def _hanging(best: Minimum, path: Path) -> Minimum:
    """Move to the minimum at which the reach is at most 0: no head leans more than its ropes."""
    beyond = path.parameters[REACH] + best.parameters[REACH]
    if beyond <= 0:
        return best
    change = -beyond * best.covariance[REACH] / best.covariance[REACH, REACH]
    return replace(best, parameters=best.parameters + change, states=best.states - best.gain @ change)


def _without_frequency(priors: InertialPriors) -> InertialPriors:
    """Fix the pendulum's parameters of frequency and response: a loose path is not smooth enough to determine them."""
    sd = priors.sd.copy()
    sd[[DAMPING, LONGER, REACH]] = 1e-6
    return replace(priors, sd=sd)


def _linearised(data: NodeData, path: Path, first: Path, priors: InertialPriors, weigh: str) -> tuple[Weighed, Array]:
    """Linearise the posterior about a path; also return the weights of its steps, recomputed if ``weigh`` is given."""
    links, k = data.links, len(path.state)
    residual, by_state, by_parameter = derivatives_of_advance(path.attitude, path.state, path.parameters, links)
    ahead = np.broadcast_to(np.eye(STATE), (k - 1, STATE, STATE))
    fast = of_axes(np.asarray(np.linalg.inv(links.fast)), SWING.start, STATE)
    slow = of_axes(1 / links.slow, LEAN.start, STATE)
    weight = path.weight
    if weigh:
        across = max(int(WINDOW_S / np.median(links.step)), 1)
        beyond = np.ones(k - 1)
        for precision, freedom, natural, least in (
            (fast, 4, NATURAL_FAST, LEAST_FAST), (slow, 2, NATURAL_SLOW**2, LEAST_SLOW**2),
        ):  # fmt: skip
            usual = natural if weigh == "natural" else None
            beyond = np.maximum(beyond, excess(residual, precision, freedom, least, across, usual))
        weight = np.minimum(path.weight, beyond**-2.0) if weigh == "natural" else beyond**-2.0

    def steps(precision: Array) -> Quadratic:
        return linear(-by_state, -by_parameter, residual, precision, ahead)

    noise = np.broadcast_to(priors.walk**2, (k - 1, STATE)) * links.step[:, None]
    of_sensor = np.divide(1, noise, where=noise > 0, out=np.zeros_like(noise))[:, :, None] * np.eye(STATE)
    of_lean, nothing = np.zeros((k, STATE)), np.zeros_like(path.parameters)
    of_lean[0, LEAN] = 1
    posterior = Weighed(
        steps(of_sensor) + _prior(data, path, first, priors),
        steps(fast * weight[:, None, None]),
        _places(data, path),
        steps(slow * weight[:, None, None]) + prior(path.state, of_lean, nothing, nothing),
        k - 1, int(data.seen.sum()), k - 1, data.focal_px, LEAST_FORCING,
    )  # fmt: skip
    return posterior, weight


def _places(data: NodeData, path: Path) -> Quadratic:
    at, by_state, by_parameter = derivatives_of_place(path.attitude, path.state, path.parameters, data.rope)
    error = data.place - at
    square = np.sum(error**2, axis=-1) * np.exp(-2 * path.strengths[NOISE])
    weight = data.seen * (DEGREES + 2) / (DEGREES + square)
    return linear(by_state, by_parameter, error, weight[:, None, None] * np.eye(2))


def _prior(data: NodeData, path: Path, first: Path, priors: InertialPriors) -> Quadratic:
    """Collect the priors of the first node, of the velocity at all nodes, and of the parameters."""
    off = path.state.copy()
    off[0, ATTITUDE] = rotation_vector(first.attitude[0].T @ path.attitude[0])
    for some in (GYROSCOPE, ACCELEROMETER):
        off[0, some] -= first.state[0, some]
    precision = np.zeros_like(off)
    precision[0] = priors.first_sd**-2.0
    steps = np.concatenate([data.links.step[:1], data.links.step])
    precision[:, VELOCITY] = velocity_precision(path.state[:, VELOCITY], data.resting, steps)[:, None]
    return prior(off, precision, path.parameters - priors.mean, priors.sd**-2.0)


def velocity_precision(velocity: Array, resting: NDArray[np.bool_], step: Array) -> Array:
    """Inverse variance per axis (n,) of the prior of velocities (n, 2): they are small, and 0 while resting.

    Velocities within `SPEED_S` count as one measurement, and so do those of a standing jib within a second. The weight
    is Geman and McClure's: a jib that luffs without slewing gets almost no weight.
    """
    square = np.sum(velocity**2, axis=-1) / REST_SPEED**2
    stands = resting * (1 + square) ** -2.0 * np.minimum(step, 1)
    return np.asarray(np.minimum(step / SPEED_S, 1) * SPEED**-2.0 + stands * REST_SPEED**-2.0)
