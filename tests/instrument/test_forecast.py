"""Forecasts of the swing: exact where the motion is known, from no later frames, and as frequent as they state."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from swinging import record

from simgrab.instrument import forecast as fc
from simgrab.instrument.alarm import DANGER
from simgrab.instrument.estimate.follow import Known
from simgrab.instrument.estimate.pendulum import DAMPING, GRAVITY, MEMORY_S
from simgrab.instrument.forecast import Forecaster, forecast, joined
from simgrab.instrument.pipeline import Pipeline
from simgrab.instrument.read import Reader
from simgrab.instrument.run import runs

RATE = 9.0


@pytest.fixture
def undisturbed(monkeypatch):
    """No noise and no damping in the model."""
    for name in ("FAST", "SLOW", "TURNING"):
        monkeypatch.setattr(fc, name, 1e-9)
    monkeypatch.setattr(fc, "FIXED", np.zeros_like(fc.FIXED))


def still(*motion):
    """State of a grab that hangs still on 10 m of rope, which is known exactly."""
    state = Forecaster().step(0.0, np.zeros((1, 2)), 1e-6, np.array([10.0]), *motion)
    return replace(state, covariance=1e-12 * state.covariance)


@pytest.mark.usefixtures("undisturbed")
@pytest.mark.parametrize("degrees", [2.0, 12.0])
@pytest.mark.parametrize("turning", [0.0, 0.1])
def test_the_peak_of_an_undamped_pendulum_is_known(degrees, turning):
    """The axes may turn with the jib: the controller reports it."""
    peak, rope = np.radians(degrees), np.array([20.0])
    time = np.arange(100) / RATE
    swing = solve_ivp(
        lambda _, y: (y[1], -GRAVITY / 20 * np.sin(y[0])), (0, 12), (peak, 0), t_eval=time, rtol=1e-9, atol=1e-12
    ).y[0]
    places = np.sin(swing)[:, None] * np.stack([np.cos(-turning * time), np.sin(-turning * time)], axis=-1)
    forecaster = Forecaster()
    for t, place in zip(time, places, strict=True):
        state = forecaster.step(t, place[None], 1e-6, rope, np.array([[0.0, 0.0, turning]]))
    found = forecast(state, np.zeros(1))
    assert found.peak == pytest.approx([peak], rel=2e-3)
    assert found.warning == [float(peak > DANGER)]
    quarter = np.pi / 2 * np.sqrt(20 / GRAVITY) * (1 + peak**2 / 16)
    assert found.peak_in_s == pytest.approx([-time[-1] % (2 * quarter)], abs=0.05)


@pytest.mark.usefixtures("undisturbed")
def test_a_pivot_that_accelerates_as_the_controller_reports_is_foreseen():
    t, w = np.linspace(0, 4, 4001), np.sqrt(GRAVITY / 10)
    swing = np.exp(-t / MEMORY_S) - np.cos(w * t) + np.sin(w * t) / (w * MEMORY_S)
    swing *= 0.8 / GRAVITY / (1 + 1 / (w * MEMORY_S) ** 2)
    found = forecast(still(np.array([[0.0, -0.8, 0.0]])), np.zeros(1))
    assert forecast(still(np.full((1, 3), np.nan)), np.zeros(1)).peak < 1e-4
    assert found.peak == pytest.approx([swing.max()], rel=0.05)
    assert found.peak_in_s == pytest.approx([t[swing.argmax()]], rel=0.05)


@pytest.mark.usefixtures("undisturbed")
def test_planned_motion_is_foreseen(monkeypatch):
    """The jib turns at 0.1 rad/s, and speeds up in six of the next steps: equations in axes that do not turn."""
    rope, turn = 10.0, 0.1
    planned = np.zeros((1, 18, 17, 3))
    begin, end = 3 * fc.HORIZON_S / fc.STEPS, 9 * fc.HORIZON_S / fc.STEPS
    planned[..., 2], planned[..., 1] = turn, 0.8 * (np.abs(fc.MIDDLES_S - (begin + end) / 2) < (end - begin) / 2)
    monkeypatch.setattr(fc, "STOP_S", 1e9)

    def rates(t, y):
        push = 0.8 * (begin < t < end) * np.array([-np.sin(turn * t), np.cos(turn * t)])
        n = np.sqrt(1 - y[:2] @ y[:2])
        return [*y[2:], *(-GRAVITY / rope * y[:2] * n - push / rope)]

    true = solve_ivp(rates, (0, 6), np.zeros(4), max_step=0.01, dense_output=True).sol(np.linspace(0, 6, 601))
    found = forecast(still(np.array([[0.0, 0.0, turn]]), planned), np.zeros(1))
    alpha = np.arcsin(np.hypot(*true[:2]))
    top = np.flatnonzero((alpha[1:-1] > alpha[:-2]) & (alpha[1:-1] >= alpha[2:]))[0] + 1
    assert found.peak == pytest.approx([alpha[top]], rel=0.02)
    assert found.peak_in_s == pytest.approx([top / 100], abs=0.1)


@pytest.mark.usefixtures("undisturbed")
def test_the_warning_includes_that_drives_may_be_stopped():
    """Only a stop makes it swing beyond 10°; it comes within the first three seconds with probability 1 − e⁻⁰·³."""
    planned = np.zeros((1, 18, 17, 3))
    for k in np.flatnonzero(fc.MIDDLES_S < 3):
        planned[0, k, k:, 1] = -1.5
    found = forecast(still(np.zeros((1, 3)), planned), np.zeros(1))
    assert found.warning == pytest.approx([-np.expm1(-0.3)], abs=0.04)


@pytest.mark.usefixtures("undisturbed")
def test_reported_forcing_turns_with_the_jib():
    """O goes around a circle: a grab that hangs outward stays so, and what is left unknown stays nothing."""
    turn, out = 0.15, 25 * 0.15**2
    reported, hangs = np.array([[-out, 0.0, turn]]), np.array([[out / GRAVITY, 0.0]])
    forecaster = Forecaster()
    for i in range(300):
        state = forecaster.step(i / RATE, hangs, 1e-4, np.array([15.0]), reported)
    np.testing.assert_allclose(state.mean[0, 4:6], 0, atol=2e-3)


@pytest.mark.parametrize("begins", [True, False])
def test_the_forcing_is_continuous_where_a_controller_begins_or_ceases_to_report(begins):
    """Of three records that accelerate alike one is reported throughout, one for a while, and one never."""
    said, nothing = np.array([0.4, -0.5, 0.05]), np.full(3, np.nan)
    hanging, forecaster, found = -said[:2] / GRAVITY, Forecaster(3), []
    for i in range(91):
        reported = np.array([said, said if (i > 60) == begins else nothing, nothing])
        state = forecaster.step(i / RATE, np.tile(hanging, (3, 1)), 1e-3, np.full(3, 15.0), reported)
        found.append(state.mean[:, 4:6] + np.nan_to_num(state.reported[:, :2]))
    found = np.array(found)
    np.testing.assert_allclose(found[55:], np.broadcast_to(hanging, found[55:].shape), atol=0.012)
    np.testing.assert_allclose(found[61, 1], found[60, 1], atol=2e-3)


def records(rng, count, seconds, rope):
    """Small swings of the model's own process in one dimension each way, (count, frames, 2), rad."""
    h, w = 1 / (RATE * 4), np.sqrt(GRAVITY / rope)
    rates = np.array([[0, 1, 0], [-(w**2), -2 * fc.FIXED[DAMPING] * w, w**2], [0, 0, -1 / MEMORY_S]])
    carry = expm(h * rates)
    drive = np.array([0, np.sqrt(fc.FAST * h) / rope, fc.SLOW * np.sqrt(2 * h / MEMORY_S)])
    x = rng.normal(size=(count, 2, 3)) * (0.06, 0.06 * w, fc.SLOW)
    found = []
    for i in range(round(seconds * RATE) * 4):
        if i % 4 == 0:
            found.append(x[..., 0])
        x = x @ carry.T + rng.normal(size=x.shape) * drive
    return np.stack(found, axis=1)


def test_probabilities_and_intervals_are_those_of_the_model(monkeypatch):
    monkeypatch.setattr(fc, "TURNING", 1e-9)
    rng, rope, seen = np.random.default_rng(1), 12.0, round(20 * RATE)
    s = records(rng, 400, 26.2, rope)
    measured = s[:, : seen + 1] + rng.normal(0, 8e-4, (400, seen + 1, 2))
    forecaster = Forecaster(400)
    for i in range(seen + 1):
        state = forecaster.step(i / RATE, measured[:, i], 8e-4, np.full(400, rope))
    found = forecast(state, np.zeros(400))
    alpha = np.arcsin(np.hypot(*np.moveaxis(s[:, seen:], -1, 0)))
    happened = alpha[:, : round(6 * RATE) + 1].max(axis=1) > DANGER
    for low, high in ((0.0, 1.0), (0.1, 0.5), (0.5, 0.9)):
        some = (found.warning >= low) & (found.warning <= high)
        chance = found.warning[some]
        assert some.sum() > 30
        assert abs(np.mean(happened[some] - chance)) < 3 * np.sqrt(np.mean(chance * (1 - chance)) / some.sum())
    top = (alpha[:, 1:-1] > alpha[:, :-2]) & (alpha[:, 1:-1] >= alpha[:, 2:])
    peak = np.take_along_axis(alpha, np.argmax(top, axis=1)[:, None] + 1, axis=1)[:, 0]
    inside = (found.peak_low <= peak) & (peak <= found.peak_high)
    assert 0.9 < inside.mean() < 0.99


def test_no_later_frame_matters_and_gaps_are_bridged():
    rng = np.random.default_rng(2)
    s = records(rng, 1, 20, 12.0)[0]
    s[30:40] = np.nan
    rope = np.where(np.arange(len(s)) % 50 == 49, np.nan, 12.0)

    def states(swing):
        forecaster = Forecaster()
        return [forecaster.step(i / RATE, one[None], 1e-3, rope[i : i + 1]) for i, one in enumerate(swing)]

    first, other = states(s), states(np.concatenate([s[:100], -s[100:]]))
    together = forecast(joined(first), np.full(len(s), 2e-3))
    for i in (5, 35, 99):
        alone = forecast(other[i], np.full(1, 2e-3))
        for name, value in vars(alone).items():
            assert value == pytest.approx(getattr(together, name)[i : i + 1])
            assert np.isfinite(value)
    assert not np.allclose(other[110].mean, first[110].mean)


def test_a_run_states_forecasts_that_later_frames_do_not_change():
    truth = record("alarm-cycles", frames=120, seed=1)
    tilt = Known(
        "given", 100, np.degrees(truth.beta[0]), 0.0, truth.calibration.offset_m, tuple(map(tuple, np.zeros((4, 4))))
    )
    seen = truth.observations(1.3, 1)
    whole, first = (
        Pipeline(None, Reader(), tilt=tilt).conclude(some, truth.calibration).measurements for some in (seen, seen[:60])
    )
    for a, b in zip(whole, first, strict=False):
        for name in ("warning", "peak", "peak_low", "peak_high", "peak_in_s"):
            assert getattr(a, name) == pytest.approx(getattr(b, name))
    (stated,) = runs.measurements([runs.plain_row(first[-1])])
    assert stated.peak == pytest.approx(first[-1].peak)
    begun = seen[[m.status for m in whole].index("ok")].time_s
    stated = [m.peak is not None for m in whole if m.status == "ok"]
    settled = [s.time_s - begun >= fc.SETTLED_S for s, m in zip(seen, whole, strict=True) if m.status == "ok"]
    assert stated == settled
    assert not all(stated)


def test_silence_begins_the_filter_anew():
    forecaster = Forecaster()
    forecaster.step(0.0, np.array([[0.1, 0.0]]), 1e-3, np.array([12.0]))
    state = forecaster.step(fc.CUT_S + 1, np.full((1, 2), np.nan), 1e-3, np.array([12.0]))
    assert np.isnan(forecast(state, np.zeros(1)).warning)
