"""Fit a pendulum to one record: nodes in time, linearisation, and the search for the strengths of the forcing."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from simgrab.instrument.estimate.chain import Minimum, linear, prior
from simgrab.instrument.estimate.frames import interpolated
from simgrab.instrument.estimate.jib import JibMotion
from simgrab.instrument.estimate.pendulum import (
    CLOCK,
    DEGREES,
    FREQUENCY,
    LEVELLING,
    LONGER,
    NODE_S,
    OFFSET,
    REACH,
    STATE,
    WIND,
    Links,
    Nodes,
    derivatives_of_advance,
    derivatives_of_place,
    of_axes,
)
from simgrab.instrument.estimate.strengths import LEAST_FAST, LEAST_SLOW, NOISE, WINDOW_S, Weighed, excess
from simgrab.model.geometry import Array

SEARCHES, ROUNDS = 10, 30  # at most so many linearisations search for the strengths, and so many there are
WHOLE_STEPS = 6  # after which steps are halved: frequency and damping of a camera that does not move are any
LEAST_SENSED = 3e-5  # m²/s³, of white acceleration beside what a sensor reports: no grab is a better pendulum
CLOSE = 0.02  # of the tilt's uncertainty, below which such a step changes nothing
FARTHEST = np.array([[-4.0], [4.0]])  # standard deviations that the camera's frequency and damping stay within
START_SD = 0.3  # rad, of the first s and p: a pendulum within its range
# Range of the slow forcing, rad: of the jib's own motion; where that is known, by gusts of a breeze or a storm.
ANY_FORCE, GUSTS = (1e-5, 0.1), (2e-4, 5e-3)
# Speeds below which hoist and jib rest, and the longest time for which a grab digs.
REST_M_S, JIB_RESTS_M_S, DIG_S = 0.1, 0.2, 30.0


@dataclass(frozen=True)
class PendulumPriors:
    """Mean and standard deviation of the static parameters, the focal length, and the jib's motion."""

    mean: Array  # (21,)
    sd: Array  # (21,)
    focal_px: float
    jib: JibMotion
    # precision of the steady lean by wind over that of the slow forcing by gusts; 0 where gusts do not tell it
    steady: float = 0.0
    gusts: float = 0.0  # least slow forcing of a jib whose motion is known, rad

    def locked(self) -> PendulumPriors:
        """Lock the offset's height at its mean.

        It scales the whole path, and the joint posterior mode of path and scale shrinks the path, because a smaller
        path needs less forcing. The marginal posterior has no such bias.
        """
        sd = self.sd.copy()
        sd[OFFSET.stop - 1] = 1e-6
        return replace(self, sd=sd)


@dataclass(frozen=True)
class PendulumFit:
    """A path (k, d), static parameters (21,), strengths (3,), weights of pixels (k,) and steps (k − 1,).

    The posterior is linearised about the path.
    """

    path: Array
    parameters: Array
    strengths: Array
    weight: Array
    minimum: Minimum
    free: Array
    rounds: int
    converged: bool
    posterior: Weighed

    @property
    def cost(self) -> float:
        """Minus the logarithm of the record's likelihood, without a constant."""
        return self.posterior.cost(self.strengths) - 3 * float(np.sum(np.log(self.free)))  # of 6 numbers in a step


def first_path(nodes: Nodes, swing: Array, size: int = STATE) -> Array:
    """Make a first path (k, size) from running medians of the seen swings (n, 2), with straight lines across gaps."""
    seen = nodes.seen[nodes.frame]
    middle = scipy.ndimage.median_filter(swing[seen], (5, 1), mode="nearest")
    s = interpolated(nodes.time, nodes.time[nodes.frame][seen], middle)
    p = np.gradient(s, nodes.time, axis=0) * (nodes.rope / nodes.rope.mean())[:, None] ** 2
    return np.concatenate([s, p, np.zeros((len(s), size - 4))], axis=-1)


def fit(
    nodes: Nodes,
    path: Array,
    parameters: Array,
    strengths: Array,
    priors: PendulumPriors,
    searches: int = SEARCHES,
    free: Array | None = None,
    rounds: int = ROUNDS,
) -> PendulumFit:
    """Gauss–Newton to the posterior mode, with a search for the strengths before each of the first steps.

    Parameters
    ----------
    path : ndarray, shape (k, d)
    parameters : ndarray, shape (21,)
    strengths : ndarray, shape (3,)
    searches : int
        Greatest number of steps with a search.
    free : ndarray, shape (k − 1,), optional
        Weights of the steps between nodes. While strengths are searched for and a controller reports, they follow from
        the forces: a grab that digs does not swing freely.
    rounds : int
        Greatest number of steps.
    """
    some = [FREQUENCY, LEVELLING]
    converged, free = False, np.ones(len(nodes.time) - 1) if free is None else free
    for done in range(rounds):
        weigh = priors.jib.moves and searches > 0 and done > 0
        posterior, *_, free = _linearised(nodes, path, parameters, strengths, priors.locked(), free, weigh)
        if searches > 0 and done > 1:  # the first path is too rough to estimate strengths
            before, strengths = strengths, posterior.search(strengths, wide=done == 2)
            still = np.abs(strengths - before) < (np.inf, 0.03, 0.3)  # fast forcing may be anything once it is too weak
            searches = 0 if still.all() else searches - 1
        best = _hanging(posterior.at(strengths).minimise(), parameters)
        share, close = 1.0, 1e-6
        if priors.jib.moves and done > WHOLE_STEPS:
            share, close = 0.5, max(1e-5, CLOSE * float(np.sqrt(np.diag(best.covariance)[:2].min())))
        share /= max(1.0, float(np.abs(best.parameters[some]).max()))  # logarithms
        path = path + share * best.states.reshape(path.shape)
        parameters = parameters + share * best.parameters
        if not (np.isfinite(path).all() and np.isfinite(parameters).all()):
            raise np.linalg.LinAlgError("the steps diverge")
        near = [*some, LONGER]
        parameters[near] = np.clip(parameters[near], *(priors.mean[near] + FARTHEST * priors.sd[near]))
        converged = searches == 0 and float(np.abs(best.parameters[:2]).max()) < close
        if converged:
            break
    posterior, weight, error2, _ = _linearised(nodes, path, parameters, strengths, priors, free, False)
    honest = strengths.copy()
    honest[NOISE] -= 0.5 * np.log(_information(weight, error2))
    best = posterior.at(honest).minimise()
    return PendulumFit(path, parameters, strengths, weight, best, free, done + 1, converged, posterior)


def _hanging(best: Minimum, parameters: Array) -> Minimum:
    """Move to the minimum at which the reach is at most 0: no head leans more than its ropes."""
    beyond = parameters[REACH] + best.parameters[REACH]
    if beyond <= 1e-9:
        return best
    change = -beyond * best.covariance[REACH] / best.covariance[REACH, REACH]
    return replace(best, parameters=best.parameters + change, states=best.states - best.gain @ change)


def _linearised(
    nodes: Nodes, path: Array, parameters: Array, strengths: Array, priors: PendulumPriors, free: Array, weigh: bool
) -> tuple[Weighed, Array, Array, Array]:
    """Linearise the posterior about a path.

    Also return the pixels' weights, their squared errors over the noise, and the steps' weights, new ones if ``weigh``.
    """
    k, d = path.shape
    step = np.where(nodes.first[1:], NODE_S, np.diff(nodes.time))
    memory_s = np.array([memory for _, memory in priors.jib.drifts])
    at = nodes.time + parameters[CLOCK]
    links = Links(step, nodes.rope[:-1], nodes.rope[1:], float(nodes.rope.mean()), memory_s, priors.jib.carried(at))
    joined = ~nodes.first[1:]
    predicted, by_state, by_parameter = derivatives_of_advance(path[:-1], parameters, links, nodes.time, priors.jib)
    ahead = np.broadcast_to(np.eye(d), (k - 1, d, d))
    residual = predicted - path[1:]
    precisions = [of_axes(np.asarray(np.linalg.inv(added)), at, d) for added, at in ((links.fast, 0), (links.slow, 4))]
    if weigh:
        across = max(int(WINDOW_S / np.median(step)), 1)
        beyond = np.maximum(
            excess(residual, precisions[0], 4, LEAST_FAST, across),
            excess(residual, precisions[1], 2, LEAST_SLOW**2, across),
        )
        jib = priors.jib.at(nodes.time[1:] + parameters[CLOCK])[:, 2:4]
        hoist = scipy.ndimage.uniform_filter1d(np.diff(nodes.rope) / step, across)
        rests = (np.abs(hoist) < REST_M_S) & (np.hypot(*jib.T) < JIB_RESTS_M_S)
        free = np.maximum(1, _digging(beyond, rests, step, across)) ** -2.0
    fast, slow = (
        linear(-by_state, -by_parameter, residual, one * (joined * free)[:, None, None], ahead) for one in precisions
    )
    first, loose = np.zeros(d), np.zeros(d)
    first[:4], loose[4:6] = START_SD**-2.0, 1.0
    starts, steady = nodes.first[:, None], np.zeros_like(parameters)
    steady[WIND] = priors.steady
    slow += prior(path, starts * loose, parameters, steady)
    fixed = prior(path, starts * first, parameters - priors.mean, np.asarray(priors.sd**-2.0))
    spread = 0.0
    if priors.jib.drifts:
        held, (begun, added) = np.zeros((k, d)), priors.jib.drifted(at)
        spread = float(np.sum(np.log(begun)) + np.sum(np.linalg.slogdet(added)[1]))
        held[0, STATE:] = np.repeat(1 / begun, 2)
        walk = of_axes(np.asarray(np.linalg.inv(added)), STATE, d)
        fixed += linear(-by_state, -by_parameter, residual, walk, ahead) + prior(
            path, held, parameters, np.zeros_like(parameters)
        )

    seen_at, by_state, by_parameter = derivatives_of_place(path, parameters, nodes.rope, nodes.time, priors.jib)
    error = nodes.place - seen_at
    error2 = np.sum(error**2, axis=-1) * nodes.seen * np.exp(-2 * strengths[NOISE])
    weight = nodes.seen * (DEGREES + 2) / (DEGREES + error2)
    places = linear(by_state, by_parameter, error, weight[:, None, None] * np.eye(2))
    leans = int(joined.sum()) + int(nodes.first.sum()) + int(priors.steady > 0)
    least_and_most = (max(GUSTS[0], priors.gusts), GUSTS[1]) if priors.jib.moves else ANY_FORCE
    posterior = Weighed(
        fixed, fast, places, slow, int(joined.sum()), int(nodes.seen.sum()), leans, priors.focal_px,
        LEAST_SENSED if priors.jib.sensed else 1e-9, least_and_most, spread,
    )  # fmt: skip
    return posterior, weight, error2, free


def _digging(beyond: Array, rests: NDArray[np.bool_], step: Array, across: int) -> Array:
    """Excess forces (k,) where a grab may dig: hoist and jib rest, or do so within ``across`` steps.

    For the whole rest it is the greatest one, because a grab that digs does so until it is hoisted. A longer rest than
    digging takes keeps its forces: there the grab hangs.
    """
    rest = np.cumsum(np.diff(rests, prepend=rests[0]))
    most = scipy.ndimage.maximum(beyond, rest, np.arange(rest[-1] + 1))
    found = np.where(rests & (np.bincount(rest, step)[rest] < DIG_S), most[rest], beyond)
    return np.where(scipy.ndimage.binary_dilation(rests, iterations=across), found, 0.0)


def _information(weight: Array, error2: Array) -> float:
    """Ratio of the pixels' information to the information of their weights: (mean ψ′)²/mean ψ² (Huber 1967)."""
    slope = np.sum(weight - weight**2 * error2 / (DEGREES + 2))
    score = np.sum(weight**2 * error2) / 2
    return float(np.clip(slope**2 / max(score * weight.sum(), 1e-300), 0.1, 1.0))
