"""The alarm: when it is raised, when it is over, and what it says of itself."""

import math

import numpy as np
import pytest

from simgrab.instrument import alarm
from simgrab.instrument.alarm import DANGER, events, probability, share
from simgrab.instrument.contract import Measurement
from simgrab.instrument.estimate import MeanRay
from simgrab.instrument.estimate.intervals import WORKING
from simgrab.instrument.estimate.measure import above
from simgrab.model.geometry import camera_rotation
from tests.instrument import pendulum_simulator as pendulum
from tests.instrument.studies import camera

RATE = 9.0


def record(degrees, *, sd=0.0):
    """Times and measurements of swings in degrees; NaN is a frame without one."""
    alpha = np.radians(np.asarray(degrees, float))
    half = math.radians(1.959964 * sd)
    danger = probability(alpha, alpha - half, alpha + half)
    measured = [
        Measurement(status="missed", reason="nothing found")
        if np.isnan(a)
        else Measurement(status="ok", alpha=a, alpha_low=max(a - half, 0), alpha_high=a + half, danger=p)
        for a, p in zip(alpha, danger, strict=True)
    ]
    return np.arange(len(alpha)) / RATE, measured


def swing(peak):
    """|α| of a swing of 9 s that dies away from its first turn for 40 s, degrees."""
    t = np.arange(round(40 * RATE)) / RATE
    return np.abs(peak * np.cos(2 * np.pi * t / 9)) * np.exp(-t / 60)


def test_a_swing_that_passes_10_degrees_on_both_sides_is_one_event():
    degrees = np.concatenate([np.full(45, 2.0), swing(12.0), np.full(90, 2.0)])
    times, measured = record(degrees)
    (event,) = events(times, measured)
    assert event.first == 45
    assert math.degrees(event.alpha) == pytest.approx(degrees.max())
    assert event.peak == int(degrees.argmax())
    high = np.flatnonzero(degrees >= 9)
    assert event.last == high.max()
    assert event.duration_s == pytest.approx((high.max() - 45) / RATE)
    assert not event.ongoing


def test_two_swings_apart_are_two_events():
    degrees = np.concatenate([[10.5], np.full(90, 2.0), [11.0], np.full(90, 2.0)])
    assert [event.first for event in events(*record(degrees))] == [0, 91]


def test_hysteresis_keeps_a_swing_about_10_degrees_from_fluttering(monkeypatch):
    degrees = 10 + 0.5 * np.where(np.arange(180) % 20 < 10, 1, -1)
    degrees = np.repeat(degrees, 10)  # above and below for 11 s each
    assert len(events(*record(degrees))) == 1
    monkeypatch.setattr(alarm, "RELEASED_AT", math.radians(10))
    assert len(events(*record(degrees))) == 9


def test_an_alarm_takes_confidence():
    degrees = np.full(30, 10.2)
    assert not events(*record(degrees, sd=1.0))  # P = 0.58
    assert events(*record(degrees, sd=0.2))  # P = 0.84
    assert events(*record(np.full(30, 11.0), sd=1.0))


def test_frames_without_an_angle_neither_raise_nor_end_an_alarm():
    degrees = np.concatenate([[2.0] * 9, [11.0], [np.nan] * 180, [11.0], [2.0] * 90])
    found = events(*record(degrees))
    assert [e.first for e in found] == [9, 190]  # 20 s later it is another one
    degrees[10:190] = 2.0
    degrees[12:14] = np.nan
    assert events(*record(degrees))[0].last == 9
    assert events(*record([np.nan] * 30)) == ()


def test_an_alarm_may_outlast_the_record():
    (event,) = events(*record([2.0] * 9 + [11.0] * 9))
    assert event.ongoing
    (event,) = events(*record([11.0] * 9 + [2.0] * 90))
    assert not event.ongoing


def test_the_probability_is_a_half_at_10_degrees_and_grows():
    alpha = np.radians([9.0, 10.0, 11.0, np.nan])
    sd = math.radians(1.0)
    p = probability(alpha, alpha - 1.959964 * sd, alpha + 1.959964 * sd)
    assert p[:3] == pytest.approx([0.158655, 0.5, 0.841345], abs=1e-5)
    assert np.isnan(p[3])
    bare = np.full(4, np.nan)
    assert probability(alpha, bare, bare)[:3].tolist() == [0, 0, 1]


def test_a_share_counts_frames_with_an_angle_alone():
    alpha = np.radians([np.nan, 5, 9, 11, 20])
    found = share(alpha, alpha - np.radians(2), alpha + np.radians(2))
    assert (found["low"], found["high"]) == (1 / 4, 3 / 4)
    assert found["share"] == pytest.approx(np.nanmean(probability(alpha, alpha - np.radians(2), alpha + np.radians(2))))
    of_some = np.where(alpha < DANGER, np.radians(2), np.nan)  # no interval of those above
    partly = share(alpha, alpha - of_some, alpha + of_some)
    assert (partly["low"], partly["high"]) == (2 / 4, 3 / 4)
    nothing = np.full(5, np.nan)
    assert share(alpha, nothing, nothing) == {"share": 0.5, "low": None, "high": None}
    assert share(nothing, nothing, nothing) == dict.fromkeys(("share", "low", "high"))


def test_the_share_of_frames_above_10_degrees_holds_in_simulated_records():
    """Grabs that pass 10° in some swings; the tilt is found from a minute, to about a degree."""
    rng = np.random.default_rng(5)
    swings = pendulum.forced(rng, 80, 60.0, pendulum.Hoist(20.0, 20.0, 0.0, 1.0), np.radians(5.5), 0.01)
    turned = camera_rotation(np.radians(3.0), 0.7, 0.0)
    project, at = camera().intrinsics.project, np.zeros((80, 3))
    pixels = pendulum.seen(rng, swings, project, rotation=turned, offset=at, missing=0.1)
    found = MeanRay(intervals=WORKING).batch(pixels, camera(), time=swings.time)
    shares = np.array([list(above(found[i]).values()) for i in range(80)], float)
    true = np.mean(swings.alpha > DANGER, axis=1)
    assert np.ptp(true) > 0.1
    assert np.mean((shares[:, 1] <= true) & (true <= shares[:, 2])) >= 0.95
    assert np.mean(shares[:, 2] - shares[:, 1]) < 0.15
    assert 0 < np.mean(shares[:, 0] - true) < 0.005  # an error of the tilt adds more passings than it hides
