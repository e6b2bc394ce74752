import numpy as np
import pendulum_simulator as simulator
import pytest
import studies

from simgrab.instrument.estimate import PendulumSmoother
from simgrab.instrument.estimate.chain import linear, state_covariances
from simgrab.instrument.estimate.pendulum import PARAMETERS, Links, advance
from simgrab.instrument.estimate.pendulum_fit import Priors, nodes_of
from simgrab.model.geometry import camera_rotation

TILTED = camera_rotation(np.deg2rad(5.0), 0.7, 0.0)


def test_the_momentum_form_moves_as_the_simulators_vector_form():
    """Ten degrees, hoisting, damped: two formulations, one path."""
    rope = simulator.Hoist(24.0, 16.0, 0.0, 10.0)
    record = simulator.free(np.random.default_rng(3), 1, 12.0, rope, np.deg2rad(8), 0.01, fps=200.0)
    n, time, length = record.direction[0], record.time, rope.length(record.time)
    momentum = np.cross(n, np.gradient(n, time, axis=0)) * (length**2)[:, None]
    links = Links(np.diff(time), length[:-1], length[1:], 20.0, 10.0)
    k = 100  # away from the ends, where the gradient is one-sided
    x = np.array([n[k, 0], n[k, 1], -momentum[k, 1] / 400, momentum[k, 0] / 400, 0.0, 0.0])
    parameters = np.zeros((1, PARAMETERS))
    parameters[0, 5] = 0.01
    for i in range(k, len(time) - k):
        one = Links(links.step[i : i + 1], links.before[i : i + 1], links.after[i : i + 1], 20.0, 10.0)
        x = advance(x[None], parameters, one)[0]
        if i % 200 == 0:
            np.testing.assert_allclose(x[:2], n[i + 1, :2], atol=2e-4)  # the start's gradient errs by 1e-4


def test_one_step_is_a_kalman_filter_and_a_rauch_tung_striebel_pass():
    """The factorised chain against the textbook recursions, on a linear model with one static parameter."""
    rng = np.random.default_rng(0)
    k, d = 30, 6
    f = np.eye(d) + 0.1 * rng.normal(size=(k - 1, d, d))
    g = 0.2 * rng.normal(size=(k - 1, d, 1))
    h, c = rng.normal(size=(k, 2, d)), rng.normal(size=(k, 2, 1))
    q, r = np.diag(rng.uniform(0.1, 1, d)), np.diag([0.3, 0.2])
    y = rng.normal(size=(k, 2))

    # Textbook: the parameter is a seventh state that stays. Start N(0, I).
    big_f = np.zeros((k - 1, d + 1, d + 1))
    big_f[:, :d, :d], big_f[:, :d, d:], big_f[:, d, d] = f, g, 1
    big_q = np.zeros((d + 1, d + 1))
    big_q[:d, :d] = q
    mean, cov = np.zeros(d + 1), np.eye(d + 1)
    filtered, predicted = [], []
    for i in range(k):
        predicted.append((mean, cov))
        big_h = np.concatenate([h[i], c[i]], axis=1)
        gain = cov @ big_h.T @ np.linalg.inv(big_h @ cov @ big_h.T + r)
        mean, cov = mean + gain @ (y[i] - big_h @ mean), cov - gain @ big_h @ cov
        filtered.append((mean, cov))
        if i < k - 1:
            mean, cov = big_f[i] @ mean, big_f[i] @ cov @ big_f[i].T + big_q
    smooth = [filtered[-1]]
    for i in range(k - 2, -1, -1):
        back = filtered[i][1] @ big_f[i].T @ np.linalg.inv(predicted[i + 1][1])
        smooth.insert(
            0,
            (
                filtered[i][0] + back @ (smooth[0][0] - predicted[i + 1][0]),
                filtered[i][1] + back @ (smooth[0][1] - predicted[i + 1][1]) @ back.T,
            ),
        )

    ahead = np.broadcast_to(np.eye(d), (k - 1, d, d))
    zero = np.zeros((k - 1, d))
    motion = linear(-f, -g, zero, np.broadcast_to(np.linalg.inv(q), (k - 1, d, d)), ahead)
    sight = linear(h, c, y, np.broadcast_to(np.linalg.inv(r), (k, 2, 2)))
    first = np.zeros((k, d, d))
    first[0] = np.eye(d)
    start = linear(first, np.zeros((k, d, 1)), np.zeros((k, d)), np.broadcast_to(np.eye(d), (k, d, d)))
    static = linear(
        np.zeros((k, 1, d)), np.eye(1)[None].repeat(k, 0) / np.sqrt(k), np.zeros((k, 1)), np.ones((k, 1, 1))
    )
    best = (motion + sight + start + static).minimise()
    np.testing.assert_allclose(best.states.reshape(k, d), [m[:d] for m, _ in smooth], atol=1e-9)
    np.testing.assert_allclose(best.parameters, smooth[-1][0][d:], atol=1e-9)
    np.testing.assert_allclose(state_covariances(best, d), [p[:d, :d] for _, p in smooth], atol=1e-9)


@pytest.mark.slow
def test_less_than_two_periods_of_free_swing_give_the_tilt():
    found = studies.swinging("free", 40, 15.0, damping=0.005, size_deg=3.0)
    assert found.refused == 0
    assert found.rmse <= 0.05
    assert found.others["mean-ray"] > 0.3
    assert found.beta_cover >= 0.88
    assert 0.90 <= found.alpha_cover <= 0.995


@pytest.mark.slow
def test_on_forced_records_it_is_no_worse_than_the_memoryless():
    found = studies.swinging("forced", 8, 300.0)
    assert found.refused == 0
    assert found.rmse <= 1.1 * min(found.others.values())
    assert found.beta_cover >= 0.8


def test_gaps_are_bridged_and_long_ones_are_not():
    rng = np.random.default_rng(5)
    record = simulator.free(rng, 1, 60.0, simulator.Cycles(20.0, 20.0, 60.0), np.deg2rad(3), 0.005)
    camera = studies.camera((0.0, 0.0, 0.0), 0.01)
    pixels = simulator.seen(
        rng, record, camera.intrinsics.project, rotation=TILTED, offset=np.zeros((1, 3)), missing=0, outliers=0,
    )[0]  # fmt: skip
    keep = (record.time < 10) | ((record.time > 13) & (record.time < 25)) | (record.time > 55)  # 3 s, and 30 s
    found = PendulumSmoother().estimate(pixels[keep], camera, rope_length=record.rope[keep], time=record.time[keep])
    assert found.ok
    assert np.rad2deg(abs(found.beta - np.deg2rad(5.0))) < 0.05
    np.testing.assert_allclose(found.alpha, record.alpha[0][keep], atol=np.deg2rad(0.15))


def test_long_steps_are_divided_and_the_longest_are_not_bridged():
    time = np.array([0.0, 0.1, 1.1, 1.2, 31.2, 31.3])
    priors = Priors(np.zeros(7), np.ones(7), 4.0, 10.0, node_s=0.35, cut_s=20.0)
    nodes = nodes_of(time, np.full(6, 20.0), np.zeros((6, 2)), np.ones(6, bool), priors)
    np.testing.assert_allclose(nodes.time[nodes.frame], time)
    assert np.flatnonzero(nodes.first).tolist() == [0, nodes.frame[4]]
    assert np.all(np.diff(nodes.time)[~nodes.first[1:]] <= 0.35)
    assert nodes.seen.sum() == 6
    assert len(nodes.time) == 8


def test_an_outlier_is_outvoted():
    rng = np.random.default_rng(6)
    record = simulator.free(rng, 1, 15.0, simulator.Hoist(24.0, 16.0, 1.0, 12.0), np.deg2rad(3), 0.005)
    camera = studies.camera((0.0, 0.0, 0.0), 0.05)
    clean = simulator.seen(
        rng, record, camera.intrinsics.project, rotation=TILTED, offset=np.zeros((1, 3)), missing=0, outliers=0,
    )[0]  # fmt: skip
    wild = clean.copy()
    wild[[10, 50, 51, 100]] += [[400.0, -200.0], [-300.0, 100.0], [250.0, 250.0], [0.0, 90.0]]
    given = {"rope_length": record.rope, "time": record.time}
    one, other = (PendulumSmoother().estimate(p, camera, **given) for p in (clean, wild))
    assert other.diagnostics["outliers"] == 4
    assert abs(one.beta - other.beta) < np.deg2rad(0.03)
    assert np.rad2deg(np.abs(other.alpha - record.alpha[0])).max() < 0.15
    assert other.diagnostics["noise_px"] == pytest.approx(one.diagnostics["noise_px"], rel=0.15)
