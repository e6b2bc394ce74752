"""What the controller reports of slewing and luffing drives the pendulum and tilts the camera."""

import tomllib
from dataclasses import replace

import msgspec
import numpy as np
import pytest
import swinging
from scipy.interpolate import CubicSpline

import simgrab
from simgrab.errors import CalibrationError
from simgrab.instrument.controller import Controller, Radii
from simgrab.instrument.estimate import PendulumSmoother
from simgrab.instrument.estimate.doubts import follows
from simgrab.instrument.estimate.follow import Known, follow, known
from simgrab.instrument.estimate.intervals import IntervalSettings
from simgrab.instrument.estimate.jib import STEP_S, SWAY_S, JibMotion
from simgrab.instrument.estimate.pendulum import PARAMETERS, Links, advance
from simgrab.instrument.estimate.pendulum_fit import _digging
from simgrab.io.strict import convert
from simgrab.model.scenario import Camera, LevelledMount
from simgrab.world.trajectory.mount import Mount

G = 9.80665


def controller(time, jib, rate_hz=20.0, slew_deg=0.044, radius_m=0.01, lag_s=0.0):
    """Read a jib (n, 2) at times (n,), as a controller with coarse steps does."""
    at, steps = np.arange(time[0], time[-1], 1 / rate_hz), np.array([np.radians(slew_deg), radius_m])
    slew, radius = (np.round(CubicSpline(time, jib)(at) / steps) * steps).T
    return Controller(at + lag_s, slew, radius, None, steps[0] / np.sqrt(12), steps[1] / np.sqrt(12), 0.3)


def test_below_a_pivot_that_accelerates_the_pendulum_hangs_along_apparent_gravity():
    pull = np.array([0.8, -0.5])
    lean = -pull / np.hypot(9.81, np.hypot(*pull))
    links = Links(np.full(1, 0.1), np.full(1, 15.0), np.full(1, 15.0), 15.0)
    x = np.concatenate([lean, np.zeros(4)])[None]
    np.testing.assert_allclose(advance(x, np.zeros(PARAMETERS), links, pull), x, atol=1e-9)


def test_in_a_wind_a_light_grab_leans_more():
    still, wind = np.zeros(PARAMETERS), np.array([0.004, -0.002])
    links = Links(np.full(2, 0.1), np.full(2, 15.0), np.full(2, 15.0), 15.0)
    x = np.concatenate([np.outer((0.5, 2.0), wind), np.zeros((2, 4))], axis=1)
    np.testing.assert_allclose(advance(x, still, links, 0.0, np.array([0.5, 2.0]), wind), x, atol=1e-12)


def course(seconds=80.0):
    """Slew and luff with ramps, at 50 Hz: times, jib (n, 2), velocity of O (n, 2) over the ground."""
    time = np.arange(0, seconds, 0.02)
    ramps = np.interp(time, [5, 9, 14, 18, 40, 46, 50, 56], [0, 0.07, 0.07, 0, 0, -0.06, -0.06, 0])
    out = np.interp(time, [8, 11, 13, 16], [0, 0.7, 0.7, 0])
    slew, radius = 0.3 + np.cumsum(ramps) * 0.02, 25 + np.cumsum(out) * 0.02
    c, s = np.cos(slew), np.sin(slew)
    across = radius * ramps
    return time, np.stack([slew, radius], -1), np.stack([out * c - across * s, out * s + across * c], -1)


def test_coarse_readings_give_the_acceleration():
    time, jib, velocity = course()
    at = np.arange(1.0, 78.0, 0.11)
    truth = np.diff([np.interp(at, time, v) for v in velocity.T]).T / 0.11
    found = JibMotion.of(controller(time, jib)).acceleration(at)
    assert np.sqrt(np.mean(truth**2)) > 0.1
    assert np.sqrt(np.mean((found - truth) ** 2)) < 0.03
    late = JibMotion.of(controller(time, jib, lag_s=0.5)).acceleration(at + 0.5)
    np.testing.assert_allclose(late, found, atol=0.01)


def unsure_of_stamps(reports, jitter_s):
    """State a jitter: at the greatest speeds it puts readings off by as much as a controller's file would say."""
    (of_slew, of_radius), still = (jitter_s * np.array([0.07, 0.7])), (reports.slew_sd, reports.radius_sd)
    return replace(
        reports, slew_sd=np.hypot(of_slew, still[0]), radius_sd=np.hypot(of_radius, still[1]), slew_still_sd=still[0],
        radius_still_sd=still[1],
    )  # fmt: skip


@pytest.mark.parametrize("stale", [False, True])
def test_readings_show_how_much_their_time_stamps_jitter(stale):
    time, jib, velocity = course()
    at, ages = np.arange(2.0, 76.0, 0.11), np.random.default_rng(1).uniform(0, 0.5 * stale, 160)
    exact = controller(time, jib, 2.0, 0.1)
    slew, radius = (CubicSpline(time, one)(exact.time - ages[: len(exact.time)]) for one in jib.T)
    exact = replace(exact, slew=slew, radius=radius) if stale else exact
    jitter_s = 0.5 / np.sqrt(12)
    truth = np.diff([np.interp(at - 0.25 * stale, time, v) for v in velocity.T]).T / 0.11

    def error(reports):
        return np.sqrt(np.mean((JibMotion.of(reports).acceleration(at) - truth) ** 2))

    stated = unsure_of_stamps(exact, jitter_s)
    assert error(stated) < (0.06 if stale else 0.025)
    blunt = exact if stale else replace(stated, slew_still_sd=None, radius_still_sd=None)
    assert error(blunt) > 1.3 * error(stated)  # with no jitter, or all readings off by as much as the fastest


def test_the_camera_levels_itself_as_the_worlds_does():
    time, jib, velocity = course()
    motion = JibMotion(time[::5], np.column_stack([jib[::5, 0], jib[::5, 1] - 25, velocity[::5]]))
    assert motion.time[1] == pytest.approx(2 * STEP_S)
    motion = JibMotion.of(controller(time, jib, slew_deg=1e-4, radius_m=1e-5))
    felt = np.diff(velocity, axis=0) / -0.02
    c, s = np.cos(jib[:-1, 0]), np.sin(jib[:-1, 0])
    gravity = np.stack([c * felt[:, 0] + s * felt[:, 1], c * felt[:, 1] - s * felt[:, 0], np.full(len(c), -G)], -1)
    mount = LevelledMount(frequency_hz=0.4, damping=0.6)
    truth = Mount(Camera(mount=mount), 0.02).advance(gravity, np.zeros(len(time)))[:, 0]
    found = motion.levelled(2 * np.pi * 0.4, 0.6, time)
    assert np.abs(truth).max() > 0.02
    assert np.abs(found - truth)[:-10].max() < 1e-3


def test_an_error_of_the_velocity_moves_the_grab_as_one_of_the_acceleration():
    time, heading, (t1, t2), rope = np.arange(0, 4, 0.01), 0.7, SWAY_S, 12.0
    course = np.tile([heading, 0, 0, 0, 0, 0], (len(time), 1))
    jib = replace(JibMotion.of(controller(time, course[:, :2] + [0, 25])), time=time, course=course)
    links = Links(np.full(1, 0.01), np.full(1, rope), np.full(1, rope), rope, np.array(SWAY_S), jib.carried(time[:2]))
    lean, still = np.array([0.003, -0.002]), np.zeros(PARAMETERS)  # of the camera; it fades
    level = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]]) @ lean
    x = np.concatenate([np.zeros(6), 2 * lean, -lean])[None]
    speed = G * np.sqrt(t1 * t2) * level / rope  # of the grab over the rope's length
    y, plain = (
        np.concatenate([np.zeros(2), speed, np.zeros(2)])[None],
        replace(links, memory_s=np.empty(0), carried=0.0),
    )
    for at in time + 0.005:
        x = advance(x, still, links)
        gained = 2 * np.exp(-at / t1) / t1 - np.exp(-at / t2) / t2  # the lean's rate, with opposite sign
        y = advance(y, still, plain, rope * speed * gained)
    assert np.hypot(*y[0, :2]) > 2e-4
    np.testing.assert_allclose(x[0, :4], y[0, :4], atol=5e-6)


def test_the_lean_by_wind_follows_the_air_past_the_jib_head():
    """A jib head that moves with the wind feels none, and one that meets it at its speed feels four times the lean."""
    time, lean = np.arange(0, 40, 0.5), np.array([0.003, 0.004])
    speed = np.select([time < 20, time < 30], [0.0, 10.0], -10.0)
    course = np.zeros((len(time), 6))
    course[:, 2:4] = speed[:, None] * lean / 0.005
    jib = JibMotion(time, course, wind_m_s=10.0)
    found = jib.by_wind(lean, time)
    for some, times in ((slice(2, 36), 1), (slice(44, 56), 0), (slice(64, 76), 4)):
        np.testing.assert_allclose(found[some], np.tile(times * lean, (found[some].shape[0], 1)), atol=3e-5)
    assert (JibMotion(time, course).by_wind(lean, time) == lean).all()
    assert (jib.by_wind(0 * lean, time) == 0).all()
    about = [jib.by_wind(times * lean, time) for times in (-1e-4, 1e-4)]
    assert np.abs(sum(about)).max() < 1e-8, "steps of a fit about no wind go to and fro"


def test_a_grab_that_digs_does_so_until_it_is_hoisted_and_one_that_hangs_feels_a_gust():
    rests = np.repeat([False, True, False, True, False], [50, 130, 50, 450, 50])
    forces = np.zeros(len(rests))
    forces[[20, 45, 60, 400]] = 10.0  # as it is carried, touches down and closes, and in a rest too long for digging
    found = _digging(forces, rests, np.full(len(rests), 0.1), 10)
    assert (found[50:180] == 10).all()
    assert np.flatnonzero(np.delete(found, range(50, 180))).tolist() == [45, 400 - 130]


@pytest.mark.parametrize(
    ("mount", "lag_s", "seed"), [("levelled", 1.4, 101), ("levelled", -1.0, 105), ("rigid", 0.4, 101)]
)
def test_a_camera_that_moves_with_the_jib_needs_the_controller_alone(mount, lag_s, seed):
    crane = swinging.record(fixed=False, frames=900, seed=seed, camera__mount={"model": mount})
    noisy = crane.pixels + np.random.default_rng(3).normal(0, 1.3, crane.pixels.shape)
    given = {"rope_length": np.round(crane.rope, 2), "time": crane.time}
    reports = replace(controller(crane.time, crane.jib, lag_s=lag_s), clock_sd_s=1.0)
    blind, found = (PendulumSmoother(controller=c).estimate(noisy, crane.calibration, **given) for c in (None, reports))
    low, high = found.intervals[0].alpha.T
    assert crane.rms_deg(blind) > 0.5
    assert crane.rms_deg(found) < 0.25
    assert crane.covered(found) > 0.8
    assert np.degrees(np.median(high - low)) < 2
    assert found.diagnostics["clock_s"] == pytest.approx(-lag_s, abs=0.15)
    assert abs(found.diagnostics["clock_s"] + lag_s) < 3 * found.diagnostics["clock_sd_s"] < 0.6
    assert found.diagnostics["follows"] == pytest.approx(float(mount == "levelled"), abs=0.1)
    assert np.degrees(found.diagnostics["pitch_per_m"]) == pytest.approx(2.0 * (mount == "rigid"), abs=0.2)


@pytest.mark.parametrize(("mount", "seed"), [("levelled", 301), ("rigid", 303)])
def test_with_few_readings_what_they_do_not_show_of_hard_braking_widens_intervals(mount, seed):
    """It moves the grab and tilts a camera that levels itself, and is neither a shorter pendulum nor another force."""
    keys = {"frames": 900, "seed": seed, "camera.mount": {"model": mount}}
    crane = swinging.record(fixed=False, scene="alarm-cycles", **keys)
    noisy = crane.pixels + np.random.default_rng(3).normal(0, 1.3, crane.pixels.shape)
    reports = unsure_of_stamps(controller(crane.time, crane.jib, 2.0, 0.1), 0.5 / np.sqrt(12))
    found = PendulumSmoother(controller=reports, wander_px=1.3).estimate(
        noisy, crane.calibration, rope_length=np.round(crane.rope, 2), time=crane.time
    )
    assert follows(found)
    assert crane.rms_deg(found) < 0.12
    assert crane.covered(found) > 0.9


def test_a_reported_load_separates_the_lean_in_a_wind_from_tilt():
    keys = {"frames": 1200, "clip.clip_frames": 1200, "seed": 120, "swing.wind": {"mean_m_s": 12.0}}
    crane = swinging.record(**{key.replace(".", "__"): value for key, value in keys.items()})
    plc = simgrab.sensors(simgrab.load("work-cycles", keys | {"sensors.plc": {"model": "controller"}}))["plc"]
    noisy = crane.pixels + np.random.default_rng(3).normal(0, 1.3, crane.pixels.shape)
    given = {"rope_length": np.round(crane.rope, 2), "time": crane.time}
    load = np.column_stack([plc.true("time [s]"), 1000 * plc.values[:, 4]])
    silent = controller(crane.time, crane.jib)
    errors = []
    for one in (silent, replace(silent, load=load, grab_kg=10_500.0)):
        smoother = PendulumSmoother(controller=one, intervals=IntervalSettings(wind_m_s=12.0))
        found = smoother.estimate(noisy, crane.calibration, **given)
        errors.append(crane.rms_deg(found))
    assert errors[1] < errors[0] / 1.5
    assert errors[1] < 0.12

    few = slice(200)  # the wind may be the controller's
    windy = replace(silent, wind=np.array([[crane.time[0], 12.0], [crane.time[-1], 12.0]]))
    part = {name: values[few] for name, values in given.items()}
    ends = []
    for one, wind in ((windy, 0.0), (silent, 12.0), (silent, 0.0)):
        smoother = PendulumSmoother(controller=one, intervals=IntervalSettings(wind_m_s=wind))
        ends.append(smoother.estimate(noisy[few], crane.calibration, **part).interval("posterior").alpha)
    reported, stated, unknown = ends
    np.testing.assert_allclose(reported, stated, atol=1e-12)
    assert np.abs(reported - unknown).max() > 1e-4


@pytest.mark.parametrize("off_deg", [-12.0, 35.0])
@pytest.mark.parametrize("mount", ["levelled", "rigid"])
def test_a_roll_that_is_a_guess_follows_from_slewing(mount, off_deg):
    crane = swinging.record(fixed=False, frames=500, seed=130, camera__roll_deg=6.0, camera__mount={"model": mount})
    noisy = crane.pixels + np.random.default_rng(3).normal(0, 1.3, crane.pixels.shape)
    guess = msgspec.structs.replace(crane.calibration, roll_deg=6.0 + off_deg, assumed=("roll_deg",))
    smoother, given = PendulumSmoother(controller=controller(crane.time, crane.jib)), {"rope_length": crane.rope}
    known, found = (smoother.estimate(noisy, c, time=crane.time, **given) for c in (crane.calibration, guess))
    assert "roll" not in known.diagnostics
    off, sd = np.degrees([found.diagnostics["roll"], found.diagnostics["roll_sd"]]) - (6.0, 0.0)
    assert abs(off) < 3 * sd < 3
    np.testing.assert_allclose(found.alpha, known.alpha, atol=np.radians(0.1))
    np.testing.assert_allclose(found.swing, known.swing, atol=np.radians(0.2))


def test_a_detector_whose_errors_last_for_seconds_needs_their_deviation():
    crane = swinging.record(fixed=False, frames=400, seed=107, camera__mount={"model": "levelled"})
    given = {"rope_length": np.round(crane.rope, 2), "time": crane.time}
    reports, pixels = controller(crane.time, crane.jib), crane.wandering()
    without, found = (
        PendulumSmoother(controller=reports, wander_px=wander).estimate(pixels, crane.calibration, **given)
        for wander in (0.0, 4.0)
    )
    assert crane.covered(found) > 0.9
    assert crane.rms_deg(found) < 0.1 < crane.rms_deg(without)


@pytest.mark.parametrize("roll_deg", [0.0, 20.0])
def test_later_frames_follow_from_a_tilt_and_the_pitch_by_luffing(roll_deg):
    mount = {"model": "rigid"}
    crane = swinging.record(fixed=False, frames=1400, seed=101, camera__mount=mount, camera__roll_deg=roll_deg)
    camera = msgspec.structs.replace(crane.calibration, mount="rigid", roll_deg=roll_deg)
    first, later = slice(900), slice(900, None)
    smoother = PendulumSmoother(controller=controller(crane.time[first], crane.jib[first]))
    given = {"rope_length": crane.rope[first], "time": crane.time[first]}
    found = smoother.estimate(crane.pixels[first], camera, **given)
    tilt = known(found, camera)
    assert tilt == convert(tomllib.loads(tilt.to_toml()), Known, CalibrationError, "tilt.toml")
    radius = crane.jib[later, 1]
    assert np.ptp(radius) > 2
    exact = Radii(radius, np.zeros(500))

    def followed(tilt, camera, radii):
        given = {"rope_length": crane.rope[later], "time": crane.time[later], "pixel_sd": np.ones(500)}
        alpha, ends, _ = follow(tilt, crane.pixels[later], camera, **given, radii=radii)
        true, (low, high) = crane.alpha[later], ends.T
        error, inside = np.sqrt(np.mean((alpha - true) ** 2)), np.mean((low <= true) & (true <= high))
        return np.degrees(error), inside, np.degrees(np.median(high - low))

    error, inside, width = followed(tilt, camera, exact)
    assert error < 0.15
    assert inside > 0.9
    assert width < 1
    assert followed(tilt, camera, None)[0] > 1.0
    gone = Radii(np.where(np.arange(500) < 250, radius, np.nan), np.zeros(500))
    assert followed(tilt, camera, gone)[1] > 0.9
    assert followed(tilt, camera, Radii(radius, np.full(500, 0.2)))[2] > 2 * width
    assert followed(tilt, camera, Radii(radius, np.full(500, 50.0)))[2] < 7  # no more than such a camera leans
    # Of another stated roll, from which the pitch's direction follows too.
    other = msgspec.structs.replace(camera, roll_deg=roll_deg - 7.0)
    assert followed(tilt.rolled(other.roll_deg), other, exact)[0] == pytest.approx(error, abs=1e-9)


@pytest.mark.parametrize(
    ("mount", "pitch", "sd"), [("fixed", 0.03, 0.001), ("levelled", 0.03, 0.001), ("", 0.03, 0.01)]
)
def test_a_camera_that_cannot_pitch_or_may_not_is_not_taken_to(mount, pitch, sd):
    crane = swinging.record(frames=200)
    found = PendulumSmoother().estimate(crane.pixels, crane.calibration, rope_length=crane.rope, time=crane.time)
    shown = {"pitch_per_m": pitch, "pitch_sd_per_m": sd, "radius_m": 25.0}
    found = replace(found, diagnostics=found.diagnostics | shown)
    camera, radii = msgspec.structs.replace(crane.calibration, mount=mount), Radii(np.full(3, 20.0), np.zeros(3))
    assert known(found, camera).pitched(radii) is None
    clear = replace(found, diagnostics=found.diagnostics | shown | {"pitch_sd_per_m": 0.001})
    tilt = known(clear, msgspec.structs.replace(camera, mount="rigid"))
    assert tilt.pitched(radii).all()
    assert tilt.on("").pitched(radii).all()
    assert tilt.on("fixed").pitched(radii) is None
    for half in ({"radius_m": None}, {"pitch_deg_per_m": (0.0, 0.0)}):
        with pytest.raises(CalibrationError, match="radius_m: is of a camera whose pitch_deg_per_m is not 0"):
            msgspec.structs.replace(tilt, **half)
