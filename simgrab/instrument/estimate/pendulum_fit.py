"""Fitting a pendulum to one record: nodes in time, linearisation, and the search for how strongly it is pushed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from simgrab.instrument.estimate.chain import Minimum, Quadratic, linear
from simgrab.instrument.estimate.pendulum import (
    OFFSET,
    PARAMETERS,
    STATE,
    Links,
    derivatives_of_advance,
    derivatives_of_place,
    fast_precision,
    slow_precision,
)  # fmt: skip
from simgrab.model.geometry import Array

# Strengths, as logarithms: white acceleration (m²/s³ per axis), pixel noise (over h), slow forcing (rad per axis).
FAST, NOISE, SLOW = 0, 1, 2
START_SD = 0.3  # rad, of the first s and p: a pendulum within its range


@dataclass(frozen=True)
class Priors:
    """Mean and standard deviation of the static parameters, both (7,), and what is not searched for.

    Attributes
    ----------
    mean, sd : ndarray, shape (7,)
    degrees : float
        Of Student's t distribution of pixel errors.
    memory_s : float
        Correlation time of the slow forcing.
    node_s, cut_s : float
        Longer steps than the first are divided; gaps longer than the second are not bridged.
    """

    mean: Array
    sd: Array
    degrees: float
    memory_s: float
    node_s: float
    cut_s: float

    def held(self) -> Priors:
        """Hold the offset's height at its mean.

        It scales the whole path, and a posterior mode over path and scale together shrinks the path: that is cheaper in
        forcing, as no marginal posterior is.
        """
        sd = self.sd.copy()
        sd[OFFSET.stop - 1] = 1e-6
        return replace(self, sd=sd)


@dataclass(frozen=True)
class Nodes:
    """Moments at which there is a state: the frames, and those put into longer steps; k in all."""

    time: Array  # (k,)
    rope: Array  # (k,)
    place: Array  # (k, 2), 0 where nothing was seen
    seen: NDArray[np.bool_]  # (k,)
    frame: NDArray[np.int64]  # (n,), node of each frame
    first: NDArray[np.bool_]  # (k,), whether the step to the node is not bridged


@dataclass(frozen=True)
class Fit:
    """A path (k, 6), the static parameters (7,), the strengths (3,), and what is known of them."""

    path: Array
    parameters: Array
    strengths: Array
    weight: Array
    minimum: Minimum
    rounds: int
    settled: bool


def nodes_of(time: Array, rope: Array, place: Array, seen: NDArray[np.bool_], priors: Priors) -> Nodes:
    """Divide long steps, up to those that are not bridged."""
    step = np.diff(time)
    parts = np.where(step > priors.cut_s, 1, np.ceil(step / priors.node_s - 1e-9)).astype(np.int64)
    frame = np.concatenate([[0], np.cumsum(parts)])
    k = int(frame[-1]) + 1
    at = np.interp(np.arange(k), frame, time)
    places, sees, first = np.zeros((k, 2)), np.zeros(k, bool), np.zeros(k, bool)
    places[frame], sees[frame] = np.where(seen[:, None], place, 0.0), seen
    first[0] = True
    first[frame[1:]] |= step > priors.cut_s
    return Nodes(at, np.interp(at, time, rope), places, sees, frame, first)


def first_path(nodes: Nodes, swing: Array) -> Array:
    """Start from running medians of the swings (k, 2) of the nodes seen, bridged in straight lines: a path (k, 6)."""
    seen = nodes.seen
    middle = np.stack([scipy.ndimage.median_filter(swing[seen, i], 5, mode="nearest") for i in (0, 1)], axis=-1)
    s = np.stack([np.interp(nodes.time, nodes.time[seen], middle[:, i]) for i in (0, 1)], axis=-1)
    p = np.gradient(s, nodes.time, axis=0) * (nodes.rope / nodes.rope.mean())[:, None] ** 2
    return np.concatenate([s, p, np.zeros_like(s)], axis=-1)


def fit(
    nodes: Nodes, path: Array, parameters: Array, strengths: Array, priors: Priors, f: float, searches: int, rounds: int
) -> Fit:
    """Gauss–Newton to the posterior mode, with a search for the strengths before each of the first steps.

    Parameters
    ----------
    nodes : Nodes
    path : ndarray, shape (k, 6)
    parameters : ndarray, shape (7,)
    strengths : ndarray, shape (3,)
    priors : Priors
    f : float
        Focal length, pixels.
    searches, rounds : int
        How many steps search, and how many steps there are at most.
    """
    settled = False
    for done in range(rounds):
        problem = _Problem(nodes, path, parameters, strengths, priors.held(), f)
        if searches > 0 and done > 1:  # the first path is too rough to estimate strengths
            before, strengths = strengths, problem.search(strengths, wide=done == 2)
            still = np.abs(strengths - before) < (np.inf, 0.03, 0.3)  # fast forcing may be anything once it is too weak
            searches = 0 if still.all() else searches - 1
        best = problem.at(strengths).minimise()
        path = path + best.states.reshape(path.shape)
        parameters = parameters + best.parameters
        settled = searches == 0 and float(np.abs(best.parameters[:2]).max()) < 1e-6
        if settled:
            break
    problem = _Problem(nodes, path, parameters, strengths, priors, f)
    honest = strengths - np.array([0.0, 0.5 * np.log(problem.information()), 0.0])
    return Fit(path, parameters, strengths, problem.weight, problem.at(honest).minimise(), done + 1, settled)


class _Problem:
    """The record's posterior about one path, each part to be scaled by its strength."""

    def __init__(
        self, nodes: Nodes, path: Array, parameters: Array, strengths: Array, priors: Priors, f: float
    ) -> None:
        k = len(path)
        step = np.where(nodes.first[1:], priors.node_s, np.diff(nodes.time))
        links = Links(step, nodes.rope[:-1], nodes.rope[1:], float(nodes.rope.mean()), priors.memory_s)
        joined = ~nodes.first[1:]
        predicted, by_state, by_parameter = derivatives_of_advance(path[:-1], parameters[None], links)
        ahead = np.broadcast_to(np.eye(STATE), (k - 1, STATE, STATE))
        chain = (-by_state, -by_parameter, predicted - path[1:])
        self.fast = linear(*chain, fast_precision(links) * joined[:, None, None], ahead)
        self.slow = linear(*chain, slow_precision(links) * joined[:, None, None], ahead) + _at_start(
            nodes, path, 4, 6, 1.0
        )
        self.links, self.starts, self.seen = int(joined.sum()), int(nodes.first.sum()), int(nodes.seen.sum())

        seen_at, by_swing, by_static = derivatives_of_place(path[:, :2], parameters[None], nodes.rope)
        self.noise, self.degrees = float(np.exp(strengths[NOISE])), priors.degrees
        self.error2 = np.sum((nodes.place - seen_at) ** 2, axis=-1) * nodes.seen / self.noise**2
        self.weight = nodes.seen * (self.degrees + 2) / (self.degrees + self.error2)
        block = np.concatenate([by_swing, np.zeros((k, 2, STATE - 2))], axis=-1)
        self.places = linear(block, by_static, nodes.place - seen_at, self.weight[:, None, None] * np.eye(2))
        away = (priors.mean - parameters) / priors.sd
        static = Quadratic(
            np.zeros((2 * STATE, k * STATE)), np.zeros((k * STATE, PARAMETERS)), np.diag(priors.sd**-2.0),
            np.zeros(k * STATE), away / priors.sd, float(away @ away),
        )  # fmt: skip
        self.prior = static + _at_start(nodes, path, 0, 4, START_SD**-2)
        self.low = np.log([1e-9, 0.05 / f, 1e-5])
        self.high = np.log([1.0, 50 / f, 0.1])

    def at(self, strengths: Array) -> Quadratic:
        """Twice the negative log posterior, but for a constant."""
        fast, noise, slow = np.exp(-strengths[FAST]), np.exp(-2 * strengths[NOISE]), np.exp(-2 * strengths[SLOW])
        return self.fast * fast + self.places * noise + self.slow * slow + self.prior

    def search(self, strengths: Array, wide: bool) -> Array:
        """Strengths that make the record likeliest (Laplace), with a prior as the fourth root of the slow one.

        Without it a short record would set slow forcing to nothing and then be sure of its tilt.
        """

        def minus_log(v: Array) -> float:
            inside = np.clip(v, self.low, self.high)
            try:
                best = self.at(inside).minimise()
            except np.linalg.LinAlgError:
                return 1e30
            spread = 2 * self.links * inside[FAST] + 2 * self.seen * inside[NOISE]
            spread += (2 * (self.links + self.starts) - 0.25) * inside[SLOW]
            return float(0.5 * (best.value + best.log_det) + spread + 10 * np.sum((v - inside) ** 2))

        size = np.array([3.0, 0.7, 1.5]) if wide else np.array([0.7, 0.15, 0.5])
        start = np.clip(strengths, self.low, self.high)
        simplex = np.vstack([start, start + np.diag(size)])
        options = {"xatol": 0.05, "fatol": 0.01, "initial_simplex": simplex}
        best = scipy.optimize.minimize(minus_log, start, method="Nelder-Mead", options=options)
        return np.clip(best.x, self.low, self.high)

    def information(self) -> float:
        """Ratio of the pixels' information to that of their weights: (mean ψ′)²/mean ψ², as Huber (1967)."""
        slope = np.sum(self.weight - self.weight**2 * self.error2 / (self.degrees + 2))
        score = np.sum(self.weight**2 * self.error2) / 2
        return float(np.clip(slope**2 / max(score * self.weight.sum(), 1e-300), 0.1, 1.0))


def _at_start(nodes: Nodes, path: Array, begin: int, end: int, precision: float) -> Quadratic:
    """Prior about 0 for some numbers of each node that starts a stretch."""
    k = len(path)
    on = np.zeros((k, STATE))
    on[nodes.first, begin:end] = precision
    band = np.zeros((2 * STATE, k * STATE))
    band[0] = on.ravel()
    corner = np.zeros((PARAMETERS, PARAMETERS))
    border = np.zeros((k * STATE, PARAMETERS))
    return Quadratic(band, border, corner, -(on * path).ravel(), np.zeros(PARAMETERS), float(np.sum(on * path**2)))
