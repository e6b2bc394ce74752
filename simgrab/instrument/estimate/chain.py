"""Least squares over a chain of states with common parameters: the linear algebra of an extended Kalman smoother.

A Gauss–Newton step over a whole path is one pass of the iterated extended Kalman filter followed by one of the
Rauch–Tung–Striebel smoother (Bell 1994). Here the two passes are the factorisation of the block-tridiagonal normal
matrix and its back substitution, and parameters that do not change in time border it instead of swelling every state.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from simgrab.model.geometry import Array


@dataclass(frozen=True)
class Quadratic:
    """c − 2 gᵀδ + δᵀHδ in changes δ of n states of d numbers each and of p parameters.

    Attributes
    ----------
    band : ndarray, shape (2d, n·d)
        Lower band of H's states: its diagonal blocks and those below.
    border : ndarray, shape (n·d, p)
    corner : ndarray, shape (p, p)
    pull_states : ndarray, shape (n·d,)
    pull_parameters : ndarray, shape (p,)
    constant : float
    """

    band: Array
    border: Array
    corner: Array
    pull_states: Array
    pull_parameters: Array
    constant: float

    def __add__(self, other: Quadratic) -> Quadratic:
        return Quadratic(
            self.band + other.band,
            self.border + other.border,
            self.corner + other.corner,
            self.pull_states + other.pull_states,
            self.pull_parameters + other.pull_parameters,
            self.constant + other.constant,
        )

    def __mul__(self, factor: float) -> Quadratic:
        return Quadratic(
            self.band * factor,
            self.border * factor,
            self.corner * factor,
            self.pull_states * factor,
            self.pull_parameters * factor,
            self.constant * factor,
        )

    def minimise(self) -> Minimum:
        """Minimise; raises numpy.linalg.LinAlgError where H is not positive definite."""
        factor = scipy.linalg.cholesky_banded(self.band, lower=True, check_finite=False)
        both = scipy.linalg.cho_solve_banded(
            (factor, True), np.column_stack([self.border, self.pull_states]), check_finite=False
        )
        gain, free = both[:, :-1], both[:, -1]
        schur = self.corner - self.border.T @ gain
        root = np.linalg.cholesky(schur)
        parameters = np.linalg.solve(schur, self.pull_parameters - self.border.T @ free)
        states = free - gain @ parameters
        value = self.constant - self.pull_states @ states - self.pull_parameters @ parameters
        log_det = 2 * np.sum(np.log(factor[0])) + 2 * np.sum(np.log(np.diag(root)))
        return Minimum(states, parameters, float(value), float(log_det), factor, gain, np.linalg.inv(schur))


@dataclass(frozen=True)
class Minimum:
    """Where a `Quadratic` is least.

    Attributes
    ----------
    states : ndarray, shape (n·d,)
    parameters : ndarray, shape (p,)
    value : float
    log_det : float
        Of H.
    factor : ndarray, shape (2d, n·d)
        Cholesky factor of the states' block, in lower band form.
    gain : ndarray, shape (n·d, p)
        By how much the states follow the parameters, with opposite sign.
    covariance : ndarray, shape (p, p)
        Of the parameters, H being an inverse covariance.
    """

    states: Array
    parameters: Array
    value: float
    log_det: float
    factor: Array
    gain: Array
    covariance: Array


def linear(blocks: Array, parameters: Array, residual: Array, weight: Array, second: Array | None = None) -> Quadratic:
    """Σᵢ |rᵢ − Aᵢ δxᵢ − Bᵢ δxᵢ₊₁ − Cᵢ δθ|² in the metric Wᵢ, as a quadratic.

    Parameters
    ----------
    blocks : ndarray, shape (n, m, d)
        A. With ``second``, of the first n − 1 states.
    parameters : ndarray, shape (n, m, p)
        C.
    residual : ndarray, shape (n, m)
        r.
    weight : ndarray, shape (n, m, m)
        W.
    second : ndarray, shape (n, m, d), optional
        B.
    """
    d = blocks.shape[-1]
    n = len(blocks) + (second is not None)
    band = np.zeros((2 * d, n * d))
    border = np.zeros((n, d, parameters.shape[-1]))
    pull = np.zeros((n, d))
    wa = blocks.swapaxes(1, 2) @ weight
    diagonal = np.zeros((n, d, d))
    diagonal[: len(blocks)] += wa @ blocks
    border[: len(blocks)] += wa @ parameters
    pull[: len(blocks)] += (wa @ residual[..., None])[..., 0]
    if second is not None:
        wb = second.swapaxes(1, 2) @ weight
        diagonal[1:] += wb @ second
        border[1:] += wb @ parameters
        pull[1:] += (wb @ residual[..., None])[..., 0]
        below = wb @ blocks
    for a in range(d):
        for b in range(a, d):
            band[b - a, a::d] = diagonal[:, b, a]
        for b in range(d) if second is not None else ():
            band[d + b - a, a : (n - 1) * d : d] = below[:, b, a]
    wc = parameters.swapaxes(1, 2) @ weight
    return Quadratic(
        band,
        border.reshape(n * d, -1),
        np.sum(wc @ parameters, axis=0),
        pull.ravel(),
        np.sum((wc @ residual[..., None])[..., 0], axis=0),
        float(np.einsum("ni,nij,nj->", residual, weight, residual)),
    )


def state_covariances(minimum: Minimum, d: int) -> Array:
    """Covariance (n, d, d) of each state, the parameters' part included: Rauch, Tung and Striebel's backward pass."""
    n = minimum.factor.shape[1] // d
    lower, below = np.zeros((n, d, d)), np.zeros((n, d, d))
    for a in range(d):
        for b in range(a, d):
            lower[:, b, a] = minimum.factor[b - a, a::d]
        for b in range(d):
            below[:-1, b, a] = minimum.factor[d + b - a, a : (n - 1) * d : d]
    inverse = np.linalg.inv(lower)
    back = below @ inverse  # minus the smoother's gain, transposed
    own = inverse.swapaxes(1, 2) @ inverse
    result = np.empty((n, d, d))
    result[-1] = own[-1]
    for i in range(n - 2, -1, -1):
        result[i] = own[i] + back[i].T @ result[i + 1] @ back[i]
    gain = minimum.gain.reshape(n, d, -1)
    return np.asarray(result + gain @ minimum.covariance @ gain.swapaxes(1, 2))
