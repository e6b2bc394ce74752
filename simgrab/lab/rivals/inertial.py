"""Rivals that measure with inertial sensors alone, after Helma, Gao, Kim and Schaper."""

from __future__ import annotations

from types import MappingProxyType
from typing import Any

import numpy as np

from simgrab.errors import RecordError
from simgrab.instrument.estimate.frames import interpolated
from simgrab.instrument.estimate.inertial.readings import ImuReadings
from simgrab.lab.rivals.contract import Method, Sensors, Swing, refusing
from simgrab.lab.rivals.kalman import START_SD, STEP_S, Pendulum, advance, averaged, filled, grid, kalman, silent, swing
from simgrab.model.geometry import STANDARD_GRAVITY, Array

BIAS_SD, BIAS_WALK = 0.15, 2e-5  # of a gyroscope: rad/s at turn-on, rad/s²/√Hz
LEVEL_SD = np.radians(2.0)  # of an accelerometer's first lean
TARGET_SD = np.radians(0.1)  # of a target's angle in a picture
MOUNT = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # jib frame from an untilted camera's
REST_S = 2.0  # in which the jib stands, when a record begins
ROPE_M = 1.0  # how far below the pivot sensors on the rope are
RATE_SD = 2e-3  # rad/s, of the mean rate of a step: noise, and what a pendulum leaves out
INCLINOMETER_SD, INCLINOMETER_LAG_S = np.radians(0.1), 0.16  # behind a low-pass filter of 1 Hz


def accelerometer(mount: str) -> Method:
    """Lean of the specific force in the sensor's frame: atan2 of its part across the z axis and along it.

    After Helma (2021), who uses raw inertial data. Known: that. Filled in: the formula, which every data sheet has, and
    a mean over 20 ms. On the grab the specific force lies along the rope, whatever the swing.
    """

    @refusing
    def method(sensors: Sensors, time: Array) -> Swing:
        imu = sensors.imu(mount)
        steps = grid(imu)
        force = filled(averaged(imu.time, imu.force, steps))
        lean = np.arctan2(force[:, :2], force[:, 2:])
        return Swing.of(interpolated(time, steps, lean), reason=silent(imu.time, time))

    return method


def ahrs(mount: str, reference: str = "") -> Method:
    """Lean of an attitude and heading reference system (imufusion, its defaults), less that of one on the jib head.

    On the grab alone it is the naive reading of Helma (2021). With ``reference`` it is after Gao et al. (2014), who
    have one on the hook and one on the jib. Known: the places, and that a Kalman filter joins the two. Filled in: the
    filter of each (Madgwick's, revised), and the difference of the two leans instead of the joint filter.
    """

    @refusing
    def method(sensors: Sensors, time: Array) -> Swing:
        imu = sensors.imu(mount)
        lean, reason = _attitude(imu, time), silent(imu.time, time)
        if reference:
            other = sensors.imu(reference)
            lean, reason = lean - _attitude(other, time), np.where(reason == "", silent(other.time, time), reason)
        return Swing.of(lean, reason=reason)

    return method


def _attitude(imu: ImuReadings, time: Array) -> Array:
    """Lean (n, 2) of the vertical in the sensor's frame, by imufusion."""
    try:
        import imufusion
    except ImportError:
        raise RecordError("this method needs imufusion: pip install 'simgrab[rivals]'") from None
    rate = 1 / float(np.median(np.diff(imu.time)))
    filter_: Any = imufusion.Ahrs()
    filter_.set_settings(imufusion.AhrsSettings(sample_rate=rate))
    lean = np.empty((len(imu.time), 2))
    for i, (turn, force) in enumerate(zip(np.degrees(imu.rate), imu.force / STANDARD_GRAVITY, strict=True)):
        filter_.update_no_magnetometer(turn, force)
        up = filter_.get_gravity()
        lean[i] = np.arctan2(up[:2], up[2])
    return interpolated(time, imu.time, lean)


def gyro_pendulum(mount: str) -> Method:
    """Kalman filter of a pendulum whose rates a gyroscope reads, with its bias: [θ, θ̇, b] along x and y.

    The strong form of Helma (2021): what raw inertial data allow. Known: the sensor. Filled in: all of the filter.
    """
    return _gyroscope(mount, waves_m_s=None)


def schaper() -> Method:
    """Kalman filter of a pendulum and of the ropes' first vibration, from a gyroscope on the rope.

    After Schaper et al. (2014). Known: the gyroscope is on the rope, the filter does not know the pivot's acceleration,
    and it filters the oscillation of the string. Filled in: every number, one mode per axis at c/(2l) with a speed of
    waves c of 70 m/s (25 kN on 5 kg/m) and 2 % damping, and the bias as a state.
    """
    return _gyroscope("rope", waves_m_s=70.0)


def _gyroscope(mount: str, waves_m_s: float | None) -> Method:
    @refusing
    def method(sensors: Sensors, time: Array) -> Swing:
        imu, rope = sensors.imu(mount), sensors.lengths
        steps = grid(imu, rope)
        rate = averaged(imu.time, imu.rate, steps)
        pendulum = Pendulum(rope.at(steps)[:, 0], filled(rate)[:, 2])
        d = 6 if waves_m_s is None else 10
        a, noise = pendulum.rates(d), pendulum.noise(d)
        noise[:, 4:6] = BIAS_WALK**2 * STEP_S
        start_sd = np.concatenate([START_SD, [BIAS_SD] * 2])
        # A rope that leans by θ along x turns about −y: the gyroscope reads (θ̇y, −θ̇x).
        reading = np.zeros((2, d))
        reading[0, 3], reading[1, 2] = 1, -1
        reading[0, 4] = reading[1, 5] = 1
        if waves_m_s is not None:
            frequency = np.pi * waves_m_s / pendulum.length
            for i in (6, 8):  # rate of the mode's angle, and that angle
                a[:, i, i], a[:, i, i + 1], a[:, i + 1, i] = -0.04 * frequency, -(frequency**2), 1
                noise[:, i] = 1e-4 * STEP_S
            reading[0, 6] = reading[1, 8] = 1
            start_sd = np.concatenate([start_sd, [0.02, 0.002, 0.02, 0.002]])
        filtered = kalman(rate[:, :2], start_sd, advance(a), noise, reading, np.full(2, RATE_SD))
        return swing(time, steps, *filtered, imu.time)

    return method


@refusing
def kim(sensors: Sensors, time: Array) -> Swing:
    """Kalman filter of a pendulum from an inclinometer on the rope and the acceleration of its pivot.

    After Kim et al. (2001, 2004). Known: accelerometers on the trolley, an inclinometer on the rope, and observers of
    the load's rate and the trolley's velocity. Filled in: a Kalman filter for the observers, [θ, θ̇] along x and y; the
    inclinometer's lag as a delay; the jib's turning from the sensor's gyroscope. An error of the pivot's acceleration
    looks like a lean, so the sensor's first two seconds count as zero: the jib must stand then.
    """
    imu, rope, tilt = sensors.imu("jib-head"), sensors.lengths, sensors.inclinometer
    if tilt is None or tilt.values.shape[1] != 2:
        raise RecordError("an inclinometer with two axes is needed on the rope")
    steps = grid(imu, rope, tilt)
    force, rate = (filled(averaged(imu.time, values, steps)) for values in (imu.force, imu.rate))
    still = steps < steps[0] + REST_S
    force, rate = force[:, :2] - force[still, :2].mean(axis=0), rate[:, 2] - rate[still, 2].mean()
    pendulum = Pendulum(rope.at(steps)[:, 0], rate)
    # The inclinometer's own acceleration takes its share of apparent gravity: (θ + a/g)(1 − r/l).
    share = (1 - ROPE_M / pendulum.equivalent)[:, None]
    filtered = pendulum.filtered(
        averaged(tilt.time - INCLINOMETER_LAG_S, tilt.values, steps), share[..., None] * np.eye(2, 4),
        np.full(2, INCLINOMETER_SD), drive=pendulum.drive(force), known=share * force / STANDARD_GRAVITY,
    )  # fmt: skip
    found = swing(time, steps, *filtered, imu.time)
    outside = (time < tilt.time[0]) | (time > tilt.time[-1])
    return found.without(outside, "the inclinometer does not last so long")


@refusing
def jung(sensors: Sensors, time: Array) -> Swing:
    """Kalman filter of a pendulum and of the camera's tilt, from a camera and two inertial sensors.

    After Jung et al. (2012). Known: a smart camera with an infrared filter, and two inertial sensors. Filled in: all of
    the filter, [θ, θ̇, b, τ, c] along x and y with τ where the camera sees the vertical, and b and c the gyroscopes'
    biases; one sensor on the rope, the other in the camera's housing, whose accelerometer gives the first τ. Its first
    two seconds give its gyroscope's bias too: the jib must stand then.
    """
    imu, housing, rope, target = sensors.imu("rope"), sensors.imu("camera"), sensors.lengths, sensors.target
    if target is None or target.values.shape[1] != 2:
        raise RecordError("the target's angles in the pictures are needed")
    steps = grid(imu, housing, rope)
    rate, turn, force = (
        averaged(one.time, values, steps)
        for one, values in ((imu, imu.rate), (housing, housing.rate @ MOUNT.T), (housing, housing.force @ MOUNT.T))
    )
    still = steps < steps[0] + REST_S
    turn, force = filled(turn), filled(force)[still].mean(axis=0)
    turn = turn - turn[still].mean(axis=0)
    pendulum, n = Pendulum(rope.at(steps)[:, 0], turn[:, 2]), len(steps)
    a, noise, drive = pendulum.rates(10), pendulum.noise(10), np.zeros((n, 10))
    # The camera turns: the vertical moves in its picture by (ω_y, −ω_x), less the bias.
    a[:, 6, 7], a[:, 7, 6] = turn[:, 2], -turn[:, 2]
    a[:, 6, 9], a[:, 7, 8] = -1, 1
    drive[:, 6], drive[:, 7] = turn[:, 1] * STEP_S, -turn[:, 0] * STEP_S
    noise[:, 4:6] = noise[:, 8:] = BIAS_WALK**2 * STEP_S
    noise[:, 6:8] = np.radians(0.02) ** 2 * STEP_S
    reading = np.zeros((4, 10))
    reading[0, 3], reading[1, 2], reading[0, 4], reading[1, 5] = 1, -1, 1, 1
    reading[2, 0] = reading[2, 6] = reading[3, 1] = reading[3, 7] = 1
    known = np.zeros((n, 4))
    known[:, 2:] = -np.array(sensors.offset_m[:2]) / pendulum.length[:, None]
    start = np.zeros(10)
    start[6:8] = -force[:2] / force[2]
    start_sd = np.concatenate([START_SD, np.repeat([BIAS_SD, LEVEL_SD, BIAS_SD], 2)])
    readings = np.hstack([rate[:, :2], averaged(target.time, target.values, steps)])
    reading_sd = np.repeat([RATE_SD, TARGET_SD], 2)
    filtered = kalman(readings, start_sd, advance(a), noise, reading, reading_sd, start, drive, known)
    found = swing(time, steps, *filtered, imu.time)
    outside = (time < target.time[0]) | (time > target.time[-1])
    return found.without(outside, "the pictures do not last so long")


INERTIAL = MappingProxyType(
    {
        "accelerometer-grab": accelerometer("grab"),
        "accelerometer-rope": accelerometer("rope"),
        "ahrs-grab": ahrs("grab"),
        "gao": ahrs("grab", "jib-head"),
        "gyro-pendulum": gyro_pendulum("grab"),
        "schaper": schaper(),
        "kim": kim,
        "jung": jung,
    }
)
"""Name → method."""
