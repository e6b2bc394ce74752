"""Rates and forces at the mounts: against differences of positions, and closed forms."""

import functools
import math
import subprocess
import sys
from importlib.util import find_spec

import numpy as np
import pytest
from scipy import signal

import simgrab
from simgrab.errors import ScenarioError
from simgrab.model import geometry, scenes
from simgrab.model.geometry import STANDARD_GRAVITY
from simgrab.world.scenery.grabs import design_of
from simgrab.world.sensors import table
from simgrab.world.sensors.motion import motions
from simgrab.world.sensors.mounts import ROPE_M, body_from_sensor, kinematics
from simgrab.world.trajectory.clip import ClipMotion
from simgrab.world.trajectory.trajectory import Trajectory
from simgrab.world.trajectory.work import Work

near = functools.partial(np.testing.assert_allclose, rtol=0)
MOUNTS = ("jib-head", "camera", "rope", "grab")
# Slewing, luffing, hoisting, jaws, load, wind, forcing, yaw and a trembling jib at once.
BUSY = {
    "swing.work": {"model": "cycles", "operator": 1.0, "dig_s": 1.0},
    "swing.start": {"alpha_deg": 3.0, "azimuth_deg": 50.0, "roundness": 0.5, "yaw_deg": 8.0},
    "swing.wind.mean_m_s": 9.0,
    "swing.forcing.rms_m_s2": 0.05,
    "camera.mount.vibration.rms_deg": 0.1,
    "camera.offset_x_m": 0.7,
    "camera.roll_deg": 20.0,
    "camera.tilt_azimuth_deg": 75.0,
}
STILL = {
    "swing.work": {"model": "hang", "rope_length_m": 20.0},
    "swing.start.alpha_deg": 0.0,
    "swing.drag_area_m2": 0.0,
    "swing.damping": 0.0,
    "camera.beta_deg": 4.0,
}
WAVED = {"suspension": {"model": "one-body", "waves": {"modes": 3, "exit_rms_m_s2": 0.2}}}
# Derivatives from values at -4h ... 4h, of eighth order: the first, and the second.
ROPED = {"suspension": {"model": "four-rope", "tilt_ratio": 0.2}}
DOUBLE = {"suspension": {"model": "double-pendulum", "damping": 0.02}}
FIRST = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
SECOND = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560])


def scene(changes, frames=45, **sensors):
    base = {"swing": {"model": "dynamic"}, "frames": frames, "display.layout": "none"}
    return scenes.load("quay-day", base | changes | {f"sensors.{name}": table for name, table in sensors.items()})


def imus(noise="none", mounts=MOUNTS):
    return {mount: {"model": "imu", "mount": mount, "noise": noise} for mount in mounts}


def at(scenario, times, clip=0):
    """Motion at given instants."""
    times = np.asarray(times, float)
    parts = list(motions(scenario, clip, lambda begin, end: times[(times >= begin) & (times < end)]))
    return joined(parts)


def joined(parts):
    """Motion, or a part of one, of several stretches of time."""
    if parts[0] is None:
        return None
    if isinstance(parts[0], np.ndarray):
        return np.concatenate(parts)
    return type(parts[0])(**{name: joined([vars(p)[name] for p in parts]) for name in vars(parts[0])})


def within_intervals(scenario, numbers, step):
    """Nine instants about the middle of each of the plant's intervals, ``step`` apart."""
    interval = ClipMotion(scenario, 0).interval
    assert 8 * step < interval
    return ((np.array(numbers) + 0.5) * interval)[:, None] + step * np.arange(-4, 5)


def offset_from_o(mount, motion, scenario):
    """Where a sensor is, from O, in axes that do not turn: by plain geometry."""
    down = -motion.attitude[:, :, 2]
    match mount:
        case "jib-head":
            return np.zeros_like(down)
        case "camera":
            return np.einsum("nij,j->ni", geometry.rotation_z(motion.slew), np.array(scenario.camera.offset_m))
        case "rope":
            straight = ROPE_M * motion.direction
            return straight if motion.waves is None else straight + displaced(motion.waves, ROPE_M)
        case "grab":
            return motion.centre - body_from_sensor(mount, scenario)[2, 3] * down


def displaced(waves, distance):
    """Displacement of the ropes, by the sum of the string's modes."""
    number = np.arange(1, waves.amplitude.shape[1] + 1)
    shape = np.sin(number * np.pi * distance / waves.length[:, None])
    return np.pad(np.einsum("nm,nmi->ni", shape, waves.amplitude), ((0, 0), (0, 1)))


@pytest.mark.parametrize("suspension", [{}, ROPED, DOUBLE])
def test_sensors_and_frames_show_one_motion(suspension):
    scenario = scene(BUSY | suspension | {"clip.clip_frames": 30, "swing.settle_s": 2.0}, frames=60)
    trajectory = Trajectory(scenario)
    shown = [trajectory.at(frame) for frame in range(30, 60)]
    motion = at(scenario, np.arange(30) / scenario.clip.frame_rate_hz, clip=1)
    poses = np.array([m.grab.jib_from_grab for m in shown])
    down = poses[:, :3, 3]
    turn = geometry.rotation_z(motion.slew)
    near(motion.slew, [m.jib.slew for m in shown], atol=1e-14)
    near(motion.radius, [m.jib.radius for m in shown], atol=1e-13)
    near(turn.transpose(0, 2, 1) @ motion.attitude, poses[:, :3, :3], atol=1e-12)
    near(np.einsum("nji,nj->ni", turn, motion.centre), down, atol=1e-12)
    camera = np.einsum("nji,njk->nik", turn, kinematics("camera", motion, scenario).attitude)
    near(camera, [m.tilt.jib_from_camera for m in shown], atol=1e-13)
    assert np.ptp(motion.lean, axis=0).min() > 1e-3


@pytest.mark.parametrize(
    ("changes", "mounts", "intervals", "bounds"),
    [
        ({}, MOUNTS, range(60, 2300, 40), (1e-11, 3e-8)),
        ({"camera.mount.model": "rigid"}, ["camera"], range(60, 2300, 40), (1e-11, 3e-8)),
        (ROPED, ["rope", "grab"], range(60, 560, 10), (1e-11, 3e-8)),
        pytest.param(
            *(WAVED, ["rope", "grab"], range(60, 560, 10), (1e-11, 3e-8)),
            marks=pytest.mark.skipif(not find_spec("simgrab.lab"), reason="rope waves are the laboratory's"),
        ),
        # Its second swing is five times as fast as the first, and is integrated in the same steps.
        (DOUBLE, ["rope", "grab"], range(60, 560, 10), (3e-10, 1e-6)),
    ],
)
def test_rates_and_forces_are_derivatives_of_where_the_sensor_is(changes, mounts, intervals, bounds):
    """As well as it goes within an interval: 20 m are rounded to 4e-15 m, and instants are 2 ms apart."""
    frames, step, middle = 400 if len(intervals) > 50 else 100, 0.002, slice(4, None, 9)
    scenario = scene(BUSY | changes, frames=frames)
    times = within_intervals(scenario, intervals, step)
    motion = at(scenario, times.ravel())
    # No ramp of the slewing gear may begin or end within the nine instants.
    steady = np.ptp(motion.slew_acceleration.reshape(-1, 9), axis=1) == 0
    # Where jaws move, the plant's angular velocity jumps at the interval's beginning: another test.
    quiet = steady & _jaws_rest(scenario, times)
    assert quiet.sum() > 30
    for mount in mounts:
        felt = kinematics(mount, motion, scenario)
        attitude = felt.attitude.reshape(-1, 9, 3, 3)
        spin = np.einsum("nji,k,nkjl->nil", attitude[:, 4], FIRST / step, attitude)
        rate = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
        near(felt.rate[middle][steady], rate[steady], atol=bounds[0])
        place = offset_from_o(mount, motion, scenario).reshape(-1, 9, 3)
        acceleration = np.einsum("k,nki->ni", SECOND / step**2, place) - motion.gravity[middle]
        force = np.einsum("nji,nj->ni", attitude[:, 4], acceleration)
        near(felt.force[middle][quiet], force[quiet], atol=bounds[1])
        assert np.ptp(felt.rate, axis=0).max() > 0.01
        assert np.ptp(felt.force, axis=0).max() > 0.1


def _jaws_rest(scenario, times):
    """Whether the jaws stand still from before the first to after the last of each row of instants."""
    ends = np.column_stack([times[:, 0] - 0.03, times[:, -1] + 0.03])
    jaw = Work(scenario, 0).sample(ends.ravel()).jaw.reshape(-1, 2)
    return jaw[:, 0] == jaw[:, 1]


def test_what_moving_jaws_do_is_felt_as_the_velocity_that_they_change():
    """Specific force and gravity, integrated by Gauss and Legendre over a digging, against the grab's own velocity."""
    work = {"model": "cycles", "dig_s": 2.0, "variation": 0.0}
    scenario = scene(BUSY | {"swing.work": work, "swing.start.alpha_deg": 8.0}, frames=27)
    interval, count = ClipMotion(scenario, 0).interval, 100
    nodes, weights = np.polynomial.legendre.leggauss(4)
    inner = (np.arange(count)[:, None] + (nodes + 1) / 2) * interval
    motion, ends = at(scenario, inner.ravel()), at(scenario, [0.0, count * interval - 1e-9])
    felt = kinematics("grab", motion, scenario)
    acceleration = np.einsum("nij,nj->ni", felt.attitude, felt.force) + motion.gravity
    gained = np.einsum("k,nki->i", weights * interval / 2, acceleration.reshape(count, 4, 3))
    first, last = ends.rope_rate[:, None] * ends.direction + ends.length[:, None] * ends.direction_rate
    assert np.linalg.norm(last - first) > 0.3
    near(gained, last - first, atol=1e-5)


def test_the_pull_on_o_sums_up_to_its_commanded_velocity():
    scenario = scene(BUSY, frames=270)
    interval = ClipMotion(scenario, 0).interval
    motion = at(scenario, (np.arange(1500) + 0.5) * interval)
    felt = kinematics("jib-head", motion, scenario)
    gained = np.cumsum(np.einsum("nij,nj->ni", felt.attitude, felt.force) * interval, axis=0)
    course = Work(scenario, 0).sample(np.arange(1501) * interval)
    radius = scenario.swing.radius_m + course.luffed
    turn = np.stack([np.cos(course.slew), np.sin(course.slew)], axis=1)
    aside = turn[:, ::-1] * (-1, 1)
    velocity = course.luff_rate[:, None] * turn + (radius * course.slew_rate)[:, None] * aside
    near(gained[:, :2], velocity[1:] - velocity[0], atol=1e-12)
    np.testing.assert_allclose(gained[:, 2], STANDARD_GRAVITY * interval * np.arange(1, 1501), rtol=1e-12)
    assert np.linalg.norm(velocity, axis=1).max() > 1.0


def test_at_rest_a_sensor_reads_gravity_upwards():
    read = simgrab.sensors(scene(STILL, frames=9, **imus()))
    for mount in ("jib-head", "rope", "grab"):
        near(read[mount].values, np.tile([0, 0, 0, 0, 0, STANDARD_GRAVITY], (200, 1)), atol=2e-9)
    tilt = math.radians(4.0)  # of the optical axis, outboard, which is up in the picture: y down
    expected = STANDARD_GRAVITY * np.array([0.0, -math.sin(tilt), -math.cos(tilt)])
    near(read["camera"].values[:, 3:], np.tile(expected, (200, 1)), atol=1e-12)
    assert not read["camera"].values[:, :3].any()


def test_an_inclinometer_is_a_first_order_filter_of_apparent_gravity():
    table = {"model": "inclinometer", "mount": "jib-head", "bandwidth_hz": 0.2, "rate_hz": 7.0, "noise_deg": 0.0,
             "zero_error_deg": 0.0, "resolution_deg": 0.0, "clock_offset_ms": 0.0, "clock_drift_ppm": 0.0}  # fmt: skip
    fine = {"model": "imu", "mount": "jib-head", "noise": "none", "rate_hz": 7.0 * 29}
    read = simgrab.sensors(scene(BUSY, frames=180, tilt=table, fine=fine))
    force, omega = read["fine"].values[:, 3:], 2 * np.pi * 0.2
    time = read["fine"].true("time [s]")
    slow = np.column_stack([signal.lsim(((omega,), (1, omega)), f - f[0], time)[1] + f[0] for f in force.T])
    expected = np.degrees(np.arcsin(slow[::29, :2] / np.linalg.norm(slow[::29], axis=1, keepdims=True)))
    near(read["tilt"].values, expected[: len(read["tilt"].values)], atol=1e-9)
    apparent = read["tilt"].true("apparent_tilt_x [deg]")
    assert np.ptp(apparent) > 0.5
    assert np.abs(read["tilt"].values[:, 0] - apparent).max() > 0.1


def test_encoders_count_what_the_crane_does():
    tables = {
        "slew": {"model": "slew-encoder", "zero_error_deg": 0.0},
        "luff": {"model": "luff-encoder", "zero_error_m": 0.0},
        "hoist": {"model": "hoist-encoder", "zero_error_m": 0.0, "scale_error": 0.0},
        "off": {"model": "hoist-encoder", "zero_error_m": 0.5, "scale_error": 0.01},
    }
    scenario = scene(BUSY, frames=180, **tables)
    read = simgrab.sensors(scenario)
    known = {name: Work(scenario, 0).sample(read[name].true("time [s]")) for name in ("slew", "luff", "hoist")}
    near(read["slew"].true("slew [deg]"), np.degrees(known["slew"].slew), atol=1e-12)
    near(read["luff"].true("radius [m]"), scenario.swing.radius_m + known["luff"].luffed, atol=1e-12)
    near(read["hoist"].true("rope_length [m]"), known["hoist"].rope, atol=1e-3)  # the plant follows its command
    for name, column in (("slew", "slew [deg]"), ("luff", "radius [m]"), ("hoist", "rope_length [m]")):
        table = scenario.sensors[name]
        resolution = getattr(table, "resolution_deg" if name == "slew" else "resolution_m")
        counts = read[name].values[:, 0] / resolution
        near(counts, np.round(counts), atol=1e-6)
        assert np.abs(read[name].values[:, 0] - read[name].true(column)).max() <= resolution / 2 + 1e-9
        assert np.ptp(counts) > 20
    off, true = read["off"].values[:, 0], read["off"].true("rope_length [m]")
    slope, zero = np.polyfit(true, off, 1)
    assert 1e-4 < abs(slope - 1) < 0.04
    assert np.abs(off - slope * true - zero).max() < 0.005


def test_a_column_that_the_truth_lacks_is_named_beside_those_that_it_has():
    hoist = simgrab.sensors(scene(BUSY, frames=2, hoist={"model": "hoist-encoder"}))["hoist"]
    with pytest.raises(KeyError, match=r"no column 'alpha \[deg\]'; there are: time \[s\], rope_length \[m\]"):
        hoist.true("alpha [deg]")


def test_a_controller_stamps_late_and_loses_stretches():
    exact = {"model": "controller", "jitter_s": 0.0, "clock_offset_ms": 0.0, "clock_drift_ppm": 0.0, "lag_s": 0.25}
    loses = {"model": "controller", "dropout": 0.3, "dropout_s": 0.7, "jitter_s": 0.2}
    scenario = scene(BUSY, frames=180, exact=exact, loses=loses)
    read = simgrab.sensors(scenario)
    late = read["exact"].stamp_ns / 1e9 - read["exact"].true("time [s]")
    near(late, np.full(len(late), 0.25), atol=1e-9)
    course = Work(scenario, 0).sample(read["exact"].true("time [s]"))
    near(read["exact"].true("slew [deg]"), np.degrees(course.slew), atol=1e-12)
    near(read["exact"].true("radius [m]"), scenario.swing.radius_m + course.luffed, atol=1e-12)
    wind = read["exact"].true("wind [m/s]")
    mean = scenario.swing.wind.mean_m_s
    assert 0.8 * mean < wind.mean() < 1.2 * mean
    assert 0 < np.std(read["exact"].values[:, 3] / wind) < 0.05
    load, grab = read["exact"].true("load [t]"), design_of(scenario.grab)
    hangs = [grab.mass_of(0.0, fill).mass / 1000 for fill in course.load.tolist()]
    near(load, np.where(course.held, 0.3, 1.0) * hangs, atol=1e-9)
    assert 0 < np.std(read["exact"].values[:, 4] - load) < 0.5
    for axis, rate in (("slew [deg]", "slew_setpoint [deg/s]"), ("radius [m]", "radius_setpoint [m/s]")):
        speed = np.gradient(read["exact"].true(axis), read["exact"].true("time [s]"))
        setpoint = read["exact"].true(rate)
        after = np.minimum(np.arange(len(speed)) + 100, len(speed) - 1)  # ten seconds, longer than any ramp
        steady = [np.ptp(setpoint[i : after[i] + 1]) == 0 for i in range(len(speed) - 100)]
        near(speed[100:-1][steady[:-1]], setpoint[100:-1][steady[:-1]], atol=1e-6)
        assert np.abs(setpoint).max() > 0.3
        assert np.ptp(speed - setpoint) > 0.3  # it anticipates
    near(read["exact"].values[:, 1] * 100, np.round(read["exact"].values[:, 1] * 100), atol=1e-6)
    time = read["loses"].true("time [s]")
    piece = (time / 0.7).astype(int)
    whole = np.bincount((np.arange(200) / 10 / 0.7 + 1e-9).astype(int))
    assert 0.1 < 1 - len(np.unique(piece)) / len(whole) < 0.6
    assert (np.diff(read["loses"].stamp_ns) > 0).all()
    assert np.std(read["loses"].stamp_ns / 1e9 - time) > 0.03


def test_a_scene_imports_no_sensor_that_it_has_not(monkeypatch):
    code = """
import sys, simgrab
imu = {"model": "imu", "mount": "rope"}
simgrab.sensors(simgrab.load("free-swing", {"frames": 2, "display.layout": "none", "sensors.imu0": imu}))
others = {f"simgrab.world.sensors.{name}" for name in ("encoders", "inclinometer")} | {"simgrab.lab"}
assert not others & set(sys.modules)
"""
    subprocess.run([sys.executable, "-c", code], check=True)
    monkeypatch.setitem(table.DEVICES, "lidar", "simgrab.nowhere.lidar:LidarDevice")
    with pytest.raises(ScenarioError, match=r"sensors\.far\.model: needs simgrab\.nowhere\.lidar, which is not"):
        simgrab.sensors(scene({}, far={"model": "lidar"}))
