"""Least squares over a chain of states with common parameters, for all readings at once or one by one.

A Gauss–Newton step over a whole path is one pass of the iterated extended Kalman filter followed by one of the
Rauch–Tung–Striebel smoother (Bell 1994). Here the two passes are the factorisation of the block-tridiagonal normal
matrix and its back substitution, and parameters that do not change in time form its border, so that states stay small.
A filter, which uses no later readings, keeps the last state alone and processes readings with `update`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.linalg.lapack import dtbtrs

from simgrab.model.geometry import Array


@dataclass(frozen=True)
class Quadratic:
    """c − 2 gᵀδ + δᵀHδ in changes δ of n states of d numbers each and of p parameters."""

    band: Array  # (2d, n·d), lower band of H's states: its diagonal blocks and those below
    border: Array  # (n·d, p)
    corner: Array  # (p, p)
    pull_states: Array  # (n·d,)
    pull_parameters: Array  # (p,)
    constant: float

    def __add__(self, other: Quadratic) -> Quadratic:
        return Quadratic(*(a + b for a, b in zip(vars(self).values(), vars(other).values(), strict=True)))

    def __mul__(self, factor: float) -> Quadratic:
        return Quadratic(*(a * factor for a in vars(self).values()))

    def _eliminated(self) -> tuple[Array, NDArray[np.bool_], Array, Array, Array]:
        """Eliminate the states.

        Returns their Cholesky factor L, the parameters that have a border, L⁻¹ (border, pull), and of what is left for
        the parameters the inverse of the Cholesky factor, and the pull.
        """
        factor = scipy.linalg.cholesky_banded(self.band, lower=True, check_finite=False)
        some = np.asarray(self.border.any(axis=0))
        half, _ = dtbtrs(factor, np.column_stack([self.border[:, some], self.pull_states]), uplo="L")
        pull = self.pull_parameters.copy()
        schur: Any = self.corner.copy()
        schur[np.ix_(some, some)] -= half[:, :-1].T @ half[:, :-1]
        pull[some] -= half[:, :-1].T @ half[:, -1]
        return factor, some, half, np.linalg.inv(np.linalg.cholesky(schur)), pull

    def marginal(self) -> float:
        """Minus twice the logarithm of ∫ exp(−½ this) dδ, without a constant: the minimum plus log det H.

        Raises numpy.linalg.LinAlgError where H is not positive definite.
        """
        factor, _, half, inverse, pull = self._eliminated()
        left = inverse @ pull
        log_det = 2 * np.sum(np.log(factor[0])) - 2 * np.sum(np.log(np.diag(inverse)))
        return float(self.constant - half[:, -1] @ half[:, -1] - left @ left + log_det)

    def minimise(self) -> Minimum:
        """Minimise; raises numpy.linalg.LinAlgError where H is not positive definite."""
        factor, some, half, inverse, pull = self._eliminated()
        both, _ = dtbtrs(factor, half, uplo="L", trans="T")
        gain = np.zeros_like(self.border)
        gain[:, some] = both[:, :-1]
        covariance = inverse.T @ inverse
        parameters = covariance @ pull
        states = both[:, -1] - gain @ parameters
        value = self.constant - self.pull_states @ states - self.pull_parameters @ parameters
        return Minimum(states, parameters, float(value), factor, gain, covariance)


@dataclass(frozen=True)
class Minimum:
    """Minimum of a `Quadratic`."""

    states: Array  # (n·d,)
    parameters: Array  # (p,)
    value: float
    factor: Array  # (2d, n·d), Cholesky factor of the states' block, in lower band form
    gain: Array  # (n·d, p), change of the states with the parameters, with opposite sign
    covariance: Array  # (p, p), covariance of the parameters, H being an inverse covariance


def linear(blocks: Array, parameters: Array, residual: Array, weight: Array, second: Array | None = None) -> Quadratic:
    """Σᵢ |rᵢ − Aᵢ δxᵢ − Bᵢ δxᵢ₊₁ − Cᵢ δθ|² in the metric Wᵢ, as a quadratic.

    Parameters
    ----------
    blocks : ndarray, shape (n, m, d)
        A. With ``second``, A of the first n − 1 states.
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
    band, diagonal = np.zeros((2 * d, n * d)), np.zeros((n, d, d))
    border, pull = np.zeros((n, d, parameters.shape[-1])), np.zeros((n, d))
    sides = [(slice(len(blocks)), blocks)] + ([(slice(1, None), second)] if second is not None else [])
    for some, side in sides:
        weighed = side.swapaxes(1, 2) @ weight
        diagonal[some] += weighed @ side
        border[some] += weighed @ parameters
        pull[some] += (weighed @ residual[..., None])[..., 0]
    for a in range(d):
        for b in range(a, d):
            band[b - a, a::d] = diagonal[:, b, a]
    if second is not None:
        below = weighed @ blocks
        for a in range(d):
            for b in range(d):
                band[d + b - a, a : (n - 1) * d : d] = below[:, b, a]
    weighed = parameters.swapaxes(1, 2) @ weight
    return Quadratic(
        band,
        border.reshape(n * d, -1),
        np.sum(weighed @ parameters, axis=0),
        pull.ravel(),
        np.sum((weighed @ residual[..., None])[..., 0], axis=0),
        float(np.einsum("ni,nij,nj->", residual, weight, residual)),
    )


def prior(states: Array, precision: Array, parameters: Array, parameter_precision: Array) -> Quadratic:
    """Σ pᵢ (xᵢ + δxᵢ)² over deviations of states (n, d) and parameters (p,) from their means; pᵢ: precisions."""
    band = np.zeros((2 * states.shape[1], states.size))
    band[0] = precision.ravel()
    return Quadratic(
        band,
        np.zeros((states.size, len(parameters))),
        np.diag(parameter_precision),
        -(precision * states).ravel(),
        -parameter_precision * parameters,
        float(np.sum(precision * states**2) + np.sum(parameter_precision * parameters**2)),
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


def update(covariance: Array, reading: Array, error: Array, noise: Array) -> tuple[Array, Array]:
    """Update a filter with a reading: K = PHᵀ(HPHᵀ + R)⁻¹, δ = K(y − Hx), P ← (I − KH)P(I − KH)ᵀ + KRKᵀ (Joseph).

    Parameters
    ----------
    covariance : ndarray, shape (..., d, d)
        P.
    reading : ndarray, shape (m, d)
        H.
    error : ndarray, shape (..., m)
        y − Hx.
    noise : ndarray, shape (..., m, m)
        R.

    Returns
    -------
    change : ndarray, shape (..., d)
    covariance : ndarray, shape (..., d, d)
    """
    both = reading @ covariance
    gain = np.linalg.solve(both @ reading.T + noise, both).mT
    kept = np.eye(covariance.shape[-1]) - gain @ reading
    return (gain @ error[..., None])[..., 0], kept @ covariance @ kept.mT + gain @ noise @ gain.mT


def jacobian(function: Callable[[Array], Array], size: int, only: Iterable[int] | None = None) -> Array:
    """Differentiate a function (...) of changes (size,) about 0: central differences (..., size).

    Where ``only`` is given, the function depends on no other changes.
    """
    steps = np.eye(size) * 1e-6
    columns = {i: (function(steps[i]) - function(-steps[i])) / 2e-6 for i in only or range(size)}
    zero = np.zeros_like(next(iter(columns.values())))
    return np.stack([columns.get(i, zero) for i in range(size)], axis=-1)
