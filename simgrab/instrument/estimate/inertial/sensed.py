"""The camera's motion over the ground from an inertial sensor in its housing: attitude, and velocity of O.

A chain (`simgrab.instrument.estimate.chain`) of attitude, horizontal velocity and biases, driven by the sensor's noise.
The jib's speed is bounded, and is 0 while the jib stands, so attitude and velocity do not drift. A bias of the
accelerometer looks like a tilt of the camera: its first value is taken as 0, so that the attitude is wrong by a
constant tilt, a parameter of the pendulum's model that the pictures determine.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgrab.instrument.estimate.chain import linear, prior, state_covariances
from simgrab.instrument.estimate.frames import mount_from_camera
from simgrab.instrument.estimate.inertial.preintegration import (
    Preintegrated,
    cross_matrix,
    preintegrate,
    rotation,
    rotation_vector,
)
from simgrab.instrument.estimate.inertial.readings import ImuReadings
from simgrab.instrument.estimate.jib import JibMotion
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import STANDARD_GRAVITY, Array, lean, rotation_z

# State of a node: error of the attitude (rad, mount frame), velocity of the camera (m/s, level frame), biases of the
# gyroscope (rad/s) and of the accelerometer across the optical axis (m/s²), both in the mount frame.
ATTITUDE, VELOCITY, GYROSCOPE, ACCELEROMETER = slice(0, 3), slice(3, 5), slice(5, 8), slice(8, 10)
STATE = 10
STEP_S = 0.1  # of the grid on which the motion is described
ROUNDS, CONVERGED_RAD = 12, 1e-5
LEVELLING_S = 30.0  # in which the first guess of the attitude follows the accelerometer
TILT_SD, HEADING_SD = 0.35, 1e-3  # rad, of the first attitude about its guess; the first heading is 0
# Prior of the gyroscope's bias about its mean over the record and, about the vertical, about its most frequent reading,
# which is that of a jib at rest, rad/s; and of its response to slewing by misalignment and a wrong attitude.
GYROSCOPE_SD, VERTICAL_SD, CROSS_SD = 0.02, 0.003, 0.05
SPEED, SPEED_S = 2.0, 10.0  # of the jib head, m/s per axis, and how long it takes to become another one, s
REST_SPEED = 0.03  # m/s per axis, of a jib that stands
SLEWING = 4e-3  # rad/s: a jib that turns faster slews
REST_S = 0.2  # readings about the vertical are averaged over so long before their most frequent value is sought
LEAST_DRIFT = 5e-6  # rad/√s, of the attitude
GAP_S = 0.1  # a sensor that is silent for longer is refused
MOST_EXCESS, REST_SPAN_S = 1.0, 5.0  # m/s², of the mean specific force over g, and s, over which it is judged


def unfit(time: Array, imu: ImuReadings) -> str:
    """Return why readings do not cover frames at times (n,); empty if they do."""
    if imu.time[0] > time[0] + GAP_S or imu.time[-1] < time[-1] - GAP_S:
        return (
            f"the sensor's readings last from {imu.time[0]:.2f} to {imu.time[-1]:.2f} s, and the frames from "
            f"{time[0]:.2f} to {time[-1]:.2f} s"
        )
    inside = imu.between(time[0], time[-1])
    silent = np.diff(inside.time)
    if silent.max() > GAP_S:
        return f"the sensor is silent for {silent.max():.2f} s at {inside.time[silent.argmax()]:.2f} s"
    if time[-1] - time[0] > REST_SPAN_S and abs(inside.excess) > MOST_EXCESS:
        force = inside.excess + STANDARD_GRAVITY
        return f"the mean specific force is {force:.2f} m/s²; at rest it is 9.81: is the accelerometer in m/s²?"
    return ""


@dataclass(frozen=True, eq=False)
class Sensed:
    """Motion that a sensor measured, and what its later readings need."""

    motion: JibMotion
    # (m,), of the lean per axis, rad², by what turns the camera and the measured acceleration of O together: no
    # picture shows that; what the accelerometer's bias adds is the motion's drift
    variance: Array
    attitude: Array  # (3, 3), at the end, from the mount frame to the level frame
    bias: Array  # (3,), of the gyroscope at the end, rad/s
    response: Array  # (3,), of `bias` to a rate about the optical axis

    def later(self, imu: ImuReadings, time: float, calibration: Calibration) -> Sensed:
        """Turn the camera on to a later time, s, by the gyroscope; the velocity is not followed."""
        nodes = np.array([self.motion.time[-1], time])
        summed = preintegrate(nodes, imu.between(*nodes), mount_from_camera(calibration))
        wrong = (self.bias + self.response * summed.rate[0, 2]) * (nodes[1] - nodes[0])
        attitude = self.attitude @ summed.turn[0] @ rotation(-wrong)
        heading, leans = course_of(np.stack([self.attitude, attitude]))
        course = np.column_stack([heading, np.zeros((2, 3)), leans])
        motion = JibMotion(nodes, course, self.motion.drifts)
        return Sensed(motion, self.variance[[-1, -1]], attitude, self.bias, self.response)


def course_of(attitude: Array) -> tuple[Array, Array]:
    """Heading (k,) of the jib and lean (k, 2) of the camera, which leans on the jib but does not turn there."""
    heading = np.unwrap(np.arctan2(attitude[:, 1, 0] - attitude[:, 0, 1], attitude[:, 0, 0] + attitude[:, 1, 1]))
    axis = -(rotation_z(heading).swapaxes(1, 2) @ attitude)[:, :, 2]
    across = np.hypot(axis[:, 0], axis[:, 1])
    return heading, axis[:, :2] * (np.arctan2(across, -axis[:, 2]) / np.maximum(across, 1e-12))[:, None]


def sensed(imu: ImuReadings, calibration: Calibration) -> Sensed:
    """Smooth a sensor's readings into the motion of O and the camera's lean."""
    imu = imu.without_excess(imu.excess)
    first, last = imu.time[[0, -1]]
    time = np.linspace(first, last, int(np.ceil((last - first) / STEP_S)) + 1)
    turn = mount_from_camera(calibration)
    summed, rates = preintegrate(time, imu, turn), imu.rate @ (turn @ imu.camera_from_sensor).T
    rest = _at_rest(imu.time, rates[:, 2])
    turning = np.abs(summed.rate[:, 2] - rest)
    resting = np.maximum(np.append(turning, 0), np.append(0, turning)) < SLEWING
    attitude, state, response, variance = _smoothed(summed, imu, np.array([*rates[:, :2].mean(axis=0), rest]), resting)
    heading, leans = course_of(attitude)
    drift = LEAST_DRIFT + imu.accelerometer_random_walk / STANDARD_GRAVITY
    arm = rotation_z(heading)[:, :2, :2] @ calibration.offset_m[:2]
    of_arm = np.gradient(heading, time)[:, None] * np.stack([-arm[:, 1], arm[:, 0]], axis=-1)
    course = np.column_stack([heading, np.zeros_like(heading), state[:, VELOCITY] - of_arm, leans])
    return Sensed(JibMotion(time, course, ((drift, np.inf),)), variance, attitude[-1], state[-1, GYROSCOPE], response)


def _smoothed(
    summed: Preintegrated, imu: ImuReadings, bias: Array, resting: NDArray[np.bool_]
) -> tuple[Array, Array, Array, Array]:
    """Attitudes (k, 3, 3), states (k, 10), response (3,), and variance (k,) of the lean, at the posterior mode."""
    attitude = _first(summed, bias)
    k, h = len(attitude), summed.step[:, None]
    state, response, first = np.zeros((k, STATE)), np.zeros(3), attitude[0]
    state[:, GYROSCOPE] = bias
    # The densities are the maker's; aliasing, rounding and the model's own errors come on top.
    walk = np.repeat([
        1.2 * imu.gyroscope_noise_density + 5e-5, 1.2 * imu.accelerometer_noise_density + 2e-3,
        1.2 * imu.gyroscope_random_walk + 1e-6, 1.2 * imu.accelerometer_random_walk + 1e-5,
    ], (3, 2, 3, 2))  # fmt: skip
    noise = np.asarray((walk**-2.0 / h)[:, :, None] * np.eye(STATE))
    precision = np.zeros((k, STATE))
    precision[0, ATTITUDE] = [TILT_SD**-2.0, TILT_SD**-2.0, HEADING_SD**-2.0]
    precision[0, GYROSCOPE] = [GYROSCOPE_SD**-2.0, GYROSCOPE_SD**-2.0, VERTICAL_SD**-2.0]
    precision[0, ACCELEROMETER] = 1e12
    ahead = np.broadcast_to(np.eye(STATE), (k - 1, STATE, STATE))
    for _ in range(ROUNDS):
        wrong = -(state[:-1, GYROSCOPE] + response * summed.rate[:, 2:]) * h
        turns = summed.turn @ rotation(wrong)
        force = summed.force.copy()
        force[:, :2] -= state[:-1, ACCELEROMETER]
        now = attitude[:-1] @ rotation(wrong / 2)
        residual = state[:-1] - state[1:]
        residual[:, ATTITUDE] = rotation_vector(attitude[1:].swapaxes(1, 2) @ attitude[:-1] @ turns)
        residual[:, VELOCITY] += h * np.einsum("nij,nj->ni", now, force)[:, :2]
        by_state, by_response = np.tile(np.eye(STATE), (k - 1, 1, 1)), np.zeros((k - 1, STATE, 3))
        by_state[:, ATTITUDE, ATTITUDE] = turns.swapaxes(1, 2)
        by_state[:, ATTITUDE, GYROSCOPE] = -h[:, :, None] * np.eye(3)
        by_state[:, VELOCITY, ATTITUDE] = -h[:, :, None] * (now @ cross_matrix(force))[:, :2]
        by_state[:, VELOCITY, ACCELEROMETER] = -h[:, :, None] * now[:, :2, :2]
        by_response[:, ATTITUDE] = -(h * summed.rate[:, 2:])[:, :, None] * np.eye(3)
        steps = np.append(summed.step[:1], summed.step)
        precision[:, VELOCITY] = velocity_precision(state[:, VELOCITY], resting, steps)[:, None]
        off = state.copy()
        off[0, ATTITUDE] = rotation_vector(first.T @ attitude[0])
        off[0, GYROSCOPE] -= bias
        best = (
            linear(-by_state, -by_response, residual, noise, ahead)
            + prior(off, precision, response, np.full(3, CROSS_SD**-2.0))
        ).minimise()  # fmt: skip
        change = best.states.reshape(k, STATE)
        attitude = attitude @ rotation(change[:, ATTITUDE])
        state, response = state + change, response + best.parameters
        state[:, ATTITUDE] = 0
        if np.abs(change[:, ATTITUDE]).max() < CONVERGED_RAD:
            break
    # Error of the horizontal acceleration over g: the lean's, turned by 90°, and the accelerometer's bias.
    apparent = np.zeros((k, 2, STATE))
    apparent[:, 0, ATTITUDE], apparent[:, 1, ATTITUDE] = attitude[:, 1], -attitude[:, 0]
    apparent[:, :, ACCELEROMETER] = -attitude[:, :2, :2] / STANDARD_GRAVITY
    variance = np.einsum("nai,nij,naj->n", apparent, state_covariances(best, STATE), apparent) / 2
    return attitude, state, response, variance


def _first(summed: Preintegrated, bias: Array) -> Array:
    """Guess attitudes (k, 3, 3) from the gyroscope with a bias (3,), and from the mean direction of the force."""
    up = summed.force / np.linalg.norm(summed.force, axis=-1, keepdims=True)
    x, y, z = np.mean(up[: int(LEVELLING_S / STEP_S)], axis=0)
    attitude = np.empty((len(up) + 1, 3, 3))
    attitude[0] = lean(float(np.arctan2(np.hypot(x, y), z)), float(np.arctan2(y, x)))
    turns = summed.turn @ rotation(-bias * summed.step[:, None])
    for i in range(len(up)):
        towards = np.cross(up[i], attitude[i, 2])
        attitude[i + 1] = attitude[i] @ turns[i] @ rotation(towards * (summed.step[i] / LEVELLING_S))
    return attitude


def velocity_precision(velocity: Array, resting: NDArray[np.bool_], step: Array) -> Array:
    """Inverse variance per axis (n,) of the prior of velocities (n, 2): they are small, and 0 while resting.

    Velocities within `SPEED_S` count as one measurement, and so do those of a standing jib within a second. The weight
    is Geman and McClure's: a jib that luffs without slewing gets almost no weight.
    """
    square = np.sum(velocity**2, axis=-1) / REST_SPEED**2
    stands = resting * (1 + square) ** -2.0 * np.minimum(step, 1)
    return np.asarray(np.minimum(step / SPEED_S, 1) * SPEED**-2.0 + stands * REST_SPEED**-2.0)


def _at_rest(time: Array, rate: Array) -> float:
    """Most frequent of some readings, s and rad/s (half-sample mode: Robertson & Cryer 1974)."""
    many = max(int(REST_S / np.median(np.diff(time))), 1)
    values = np.sort(np.convolve(rate, np.full(many, 1 / many), "valid")[::many])
    while len(values) > 3:
        half = (len(values) + 1) // 2
        first = int(np.argmin(values[half - 1 :] - values[: len(values) - half + 1]))
        values = values[first : first + half]
    return float(values.mean())
