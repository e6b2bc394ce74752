import numpy as np
import pytest

from simgrab.instrument.estimate import PendulumSmoother
from simgrab.instrument.estimate.frames import groups
from simgrab.instrument.estimate.pendulum import PARAMETERS, Links, Nodes, advance
from simgrab.model.geometry import camera_rotation
from tests.instrument import pendulum_simulator as simulator
from tests.instrument import studies

TILTED = camera_rotation(np.deg2rad(5.0), 0.7, 0.0)
STEADY = simulator.Cycles(20.0, 20.0, 60.0)


def free_swing(rng, seconds, rope, offset_sd_m):
    """A record of a free swing of 3 degrees, the camera that sees it, and the pixels."""
    record = simulator.free(rng, 1, seconds, rope, np.deg2rad(3), 0.005)
    camera = studies.camera((0.0, 0.0, 0.0), offset_sd_m)
    pixels = simulator.seen(rng, record, camera.intrinsics.project, rotation=TILTED, offset=np.zeros((1, 3)))[0]
    return record, camera, pixels


def test_the_momentum_form_moves_as_the_simulators_vector_form():
    """Ten degrees, hoisting, damped: two formulations, one path."""
    rope = simulator.Hoist(24.0, 16.0, 0.0, 10.0)
    record = simulator.free(np.random.default_rng(3), 1, 12.0, rope, np.deg2rad(8), 0.01, fps=200.0)
    n, time, length = record.direction[0], record.time, rope.length(record.time)
    momentum = np.cross(n, np.gradient(n, time, axis=0)) * (length**2)[:, None]
    links = Links(np.diff(time), length[:-1], length[1:], 20.0)
    k = 100  # away from the ends, where the gradient is one-sided
    x = np.array([n[k, 0], n[k, 1], -momentum[k, 1] / 400, momentum[k, 0] / 400, 0.0, 0.0])
    parameters = np.zeros(PARAMETERS)
    parameters[5] = 0.01
    for i in range(k, len(time) - k):
        one = Links(links.step[i : i + 1], links.before[i : i + 1], links.after[i : i + 1], 20.0)
        x = advance(x[None], parameters, one)[0]
        if i % 200 == 0:
            np.testing.assert_allclose(x[:2], n[i + 1, :2], atol=2e-4)  # the start's gradient errs by 1e-4


@pytest.mark.long
def test_less_than_two_periods_of_free_swing_give_the_tilt():
    found = studies.swinging("free", 40, 15.0, damping=0.005, size_deg=3.0)
    assert found.refused == 0
    assert found.rmse <= 0.05
    assert found.others["mean-ray"] > 0.3
    assert found.beta_cover >= 0.88
    assert 0.90 <= found.alpha_cover <= 0.995


@pytest.mark.long
def test_on_forced_records_it_is_no_worse_than_the_memoryless():
    found = studies.swinging("forced", 4, 300.0)
    assert found.refused == 0
    assert found.rmse <= 1.1 * min(found.others.values())
    assert found.beta_cover >= 0.8


def test_gaps_are_bridged_and_long_ones_are_not():
    record, camera, pixels = free_swing(np.random.default_rng(5), 60.0, STEADY, 0.01)
    keep = (record.time < 10) | ((record.time > 13) & (record.time < 25)) | (record.time > 55)  # 3 s, and 30 s
    found = PendulumSmoother().estimate(pixels[keep], camera, rope_length=record.rope[keep], time=record.time[keep])
    assert found.ok
    assert np.rad2deg(abs(found.beta - np.deg2rad(5.0))) < 0.05
    np.testing.assert_allclose(found.alpha, record.alpha[0][keep], atol=np.deg2rad(0.15))


def test_long_steps_are_divided_and_the_longest_are_not_bridged():
    time = np.array([0.0, 0.1, 1.1, 1.2, 31.2, 31.3])
    record = next(groups(np.full((1, 6, 2), 500.0), np.full((1, 6), 20.0), time, studies.camera()))
    nodes = Nodes.of(record, slice(None), 20.0)
    np.testing.assert_allclose(nodes.time[nodes.frame], time)
    assert np.flatnonzero(nodes.first).tolist() == [0, nodes.frame[4]]
    assert np.all(np.diff(nodes.time)[~nodes.first[1:]] <= 0.35)
    assert nodes.seen.sum() == 6
    assert len(nodes.time) == 8


def test_an_outlier_is_outvoted():
    record, camera, clean = free_swing(np.random.default_rng(6), 15.0, simulator.Hoist(24.0, 16.0, 1.0, 12.0), 0.05)
    wild = clean.copy()
    wild[[10, 50, 51, 100]] += [[400.0, -200.0], [-300.0, 100.0], [250.0, 250.0], [0.0, 90.0]]
    given = {"rope_length": record.rope, "time": record.time}
    one, other = (PendulumSmoother().estimate(p, camera, **given) for p in (clean, wild))
    assert other.diagnostics["outliers"] == 4
    assert abs(one.beta - other.beta) < np.deg2rad(0.03)
    assert np.rad2deg(np.abs(other.alpha - record.alpha[0])).max() < 0.15
    assert other.diagnostics["noise_px"] == pytest.approx(one.diagnostics["noise_px"], rel=0.15)


def test_frames_in_no_order_of_time_are_refused():
    rng = np.random.default_rng(7)
    record, camera, pixels = free_swing(rng, 60.0, STEADY, 0.01)
    found = PendulumSmoother().estimate(rng.permutation(pixels), camera, rope_length=record.rope, time=record.time)
    assert "does not move like a pendulum" in found.reason
