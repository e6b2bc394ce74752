"""The chain and the filter end where dense least squares does, on a linear model with common parameters."""

import numpy as np

from simgrab.instrument.estimate.chain import jacobian, linear, prior, state_covariances, update

K, D, P = 12, 3, 3  # states, numbers of each, parameters; the last of them has a prior alone


def test_the_chain_and_the_filter_are_least_squares():
    rng = np.random.default_rng(0)
    f, g = np.eye(D) + 0.3 * rng.normal(size=(K - 1, D, D)), rng.normal(size=(K - 1, D, P))
    h, c, y = rng.normal(size=(K, 2, D)), rng.normal(size=(K, 2, P)), rng.normal(size=(K, 2))
    g[..., -1] = c[..., -1] = 0
    q, r, sd = np.array([0.3, 0.5, 0.9]), np.array([0.6, 0.4]), np.array([1.0, 2.0, 3.0, 0.5, 0.7, 0.9])
    mean = rng.normal(size=D + P)

    def residual(z):
        x, theta = z[: K * D].reshape(K, D), z[K * D :]
        steps = (x[1:] - np.einsum("nij,nj->ni", f, x[:-1]) - g @ theta) / q
        readings = (y - np.einsum("nij,nj->ni", h, x) - c @ theta) / r
        return np.concatenate([steps.ravel(), readings.ravel(), (np.concatenate([x[0], theta]) - mean) / sd])

    dense, nothing = jacobian(residual, K * D + P), np.zeros(K * D + P)
    covariance = np.linalg.inv(dense.T @ dense)
    expected = -covariance @ dense.T @ residual(nothing)

    ahead, of_first = np.broadcast_to(np.eye(D), (K - 1, D, D)), np.zeros((K, D))
    of_first[0] = sd[:D] ** -2
    whole = (
        linear(-f, -g, np.zeros((K - 1, D)), np.tile(np.diag(q**-2), (K - 1, 1, 1)), ahead)
        + linear(h, c, y, np.tile(np.diag(r**-2), (K, 1, 1)))
        + prior(np.tile(-mean[:D], (K, 1)), of_first, -mean[D:], sd[D:] ** -2)
    )
    best = whole.minimise()
    np.testing.assert_allclose(np.concatenate([best.states, best.parameters]), expected, atol=1e-7)
    np.testing.assert_allclose(best.covariance, covariance[K * D :, K * D :], atol=1e-7)
    np.testing.assert_allclose(best.value, np.sum(residual(expected) ** 2), rtol=1e-7)
    np.testing.assert_allclose(whole.marginal() - best.value, np.linalg.slogdet(dense.T @ dense)[1], rtol=1e-7)
    own = [covariance[i : i + D, i : i + D] for i in range(0, K * D, D)]
    np.testing.assert_allclose(state_covariances(best, D), own, atol=1e-7)

    state, spread = mean, np.diag(sd**2)  # a filter carries the parameters along
    for i in range(K):
        if i:
            carry = np.block([[f[i - 1], g[i - 1]], [np.zeros((P, D)), np.eye(P)]])
            state, spread = carry @ state, carry @ spread @ carry.T + np.diag([*q**2, 0, 0, 0])
        reading = np.concatenate([h[i], c[i]], axis=1)
        change, spread = update(spread, reading, y[i] - reading @ state, np.diag(r**2))
        state = state + change
    np.testing.assert_allclose(state, expected[-D - P :], atol=1e-7)
    np.testing.assert_allclose(spread, covariance[-D - P :, -D - P :], atol=1e-7)
