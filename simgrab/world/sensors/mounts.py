"""Specific force, angular rate and attitude of a sensor at its mount, without errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simgrab.model import geometry
from simgrab.model.geometry import Array
from simgrab.model.scenario import Scenario
from simgrab.model.scenario.sensors import Mounting
from simgrab.world.scenery.grabs import design_of
from simgrab.world.sensors.motion import Motion
from simgrab.world.trajectory.moment import Tilt

ROPE_M = 1.0
"""How far below O the sensor on the rope is."""
_DOWN = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True, eq=False)
class Kinematics:
    """Attitude, angular rate and specific force of a sensor at n instants."""

    attitude: Array  # (n, 3, 3), rotation of the sensor's frame in the pivot frame; see `Motion`
    rate: Array  # (n, 3), angular velocity over the ground, sensor frame, rad/s
    force: Array  # (n, 3), specific force, acceleration less gravity, sensor frame, m/s²


def kinematics(mounting: Mounting, motion: Motion, scenario: Scenario) -> Kinematics:
    """Compute the kinematics of a sensor; the scenario is that of the camera and the grab."""
    match mounting:
        case "jib-head":
            return _on_jib(motion, np.eye(3), motion.shake, motion.shake_rate, np.zeros(3))
        case "camera":
            rest, offset = Tilt.at_rest(scenario.camera).jib_from_camera, np.array(scenario.camera.offset_m)
            return _on_jib(motion, rest, motion.lean, motion.lean_rate, offset)
        case "platform":
            return _on_platform(motion)
        case "rope":
            return _on_rope(motion)
        case "grab":
            return _on_grab(motion)


def body_from_sensor(mounting: Mounting, scenario: Scenario) -> Array:
    """Pose of a sensor in its body's frame, shape (4, 4), m.

    The body's frame is the jib frame, the camera frame, the grab's frame, for the rope that of the jib leaned with the
    rope, origin O, and for the platform the jib's axes on the slewing axis, origin at the height of the quay.
    """
    pose = np.eye(4)
    if mounting == "rope":
        pose[2, 3] = -ROPE_M
    elif mounting == "grab":
        pose[2, 3] = design_of(scenario.grab).terminations[0, 2]
    return pose


def _on_jib(motion: Motion, rest: Array, lean: Array, lean_rate: Array, offset: Array) -> Kinematics:
    """Kinematics of a housing at an offset from O, which leans by a vector about its attitude ``rest`` on the jib."""
    turn, ones = geometry.rotation_z(motion.slew), np.ones((len(lean), 1))
    leaned, leaned_rate = _leaned(np.hstack([lean, -ones]), np.hstack([lean_rate, 0 * ones]))
    attitude = turn @ leaned @ rest
    rate = _into(attitude, _about_z(motion.slew_rate)) + leaned_rate @ rest
    arm = np.einsum("nij,j->ni", turn, offset)
    spin, spin_up = _about_z(motion.slew_rate), _about_z(motion.slew_acceleration)
    acceleration = np.cross(spin_up, arm) + np.cross(spin, np.cross(spin, arm))
    return Kinematics(attitude, rate, _into(attitude, acceleration - motion.gravity))


def _on_platform(motion: Motion) -> Kinematics:
    """Kinematics on the slewing axis, which turns and does not move."""
    attitude, rate = geometry.rotation_z(motion.slew), _about_z(motion.slew_rate)
    return Kinematics(attitude, rate, _about_z(np.full_like(motion.slew, geometry.STANDARD_GRAVITY)))


def _on_rope(motion: Motion) -> Kinematics:
    """Kinematics on the rope: with its direction, but without turning about it as the grab does."""
    turn = geometry.rotation_z(motion.slew)
    direction, direction_rate, bend = motion.direction, motion.direction_rate, motion.direction_acceleration
    if motion.waves is not None:
        acceleration, slope, slope_rate = motion.waves.at(ROPE_M)
        direction, direction_rate, bend = direction + slope, direction_rate + slope_rate, bend + acceleration / ROPE_M
    spin = _about_z(motion.slew_rate)
    leaned, leaned_rate = _leaned(_into(turn, direction), _into(turn, direction_rate - np.cross(spin, direction)))
    attitude = turn @ leaned
    force = _into(attitude, ROPE_M * bend - motion.gravity)
    return Kinematics(attitude, _into(attitude, spin) + leaned_rate, force)


def _on_grab(motion: Motion) -> Kinematics:
    """Kinematics at T, where the ropes end: of the vector l d along them, l̈ d + 2 l̇ ḋ + l d̈."""
    length, rate, acceleration = (v[:, None] for v in (motion.length, motion.rope_rate, motion.rope_acceleration))
    force = acceleration * motion.direction + 2 * rate * motion.direction_rate + length * motion.direction_acceleration
    return Kinematics(motion.attitude, motion.rate, _into(motion.attitude, force - motion.gravity))


def _leaned(down: Array, down_rate: Array) -> tuple[Array, Array]:
    """Shortest rotation (n, 3, 3) from straight down to a direction (n, 3), and its angular velocity, leaned frame."""
    # Rate: 2 vec(Q* Q̇)/|Q|² of the quaternion Q = (1 + e·d, e × d), of any length.
    length = np.linalg.norm(down, axis=1, keepdims=True)
    unit = down / length
    unit_rate = (down_rate - unit * np.sum(unit * down_rate, axis=1, keepdims=True)) / length
    scalar, vector = 1 + unit @ _DOWN, np.cross(_DOWN, unit)
    scalar_rate, vector_rate = unit_rate @ _DOWN, np.cross(_DOWN, unit_rate)
    norm = scalar**2 + np.sum(vector**2, axis=1)
    turned = scalar[:, None] * vector_rate - scalar_rate[:, None] * vector - np.cross(vector, vector_rate)
    across = np.hypot(unit[:, 0], unit[:, 1])
    rotation = geometry.lean(np.arctan2(across, -unit[:, 2]), np.arctan2(unit[:, 1], unit[:, 0]))
    return rotation, 2 * turned / norm[:, None]


def _about_z(speed: Array) -> Array:
    """Vectors along z, shape (n, 3)."""
    return np.stack([np.zeros_like(speed), np.zeros_like(speed), speed], axis=1)


def _into(attitude: Array, vector: Array) -> Array:
    """Express vectors (n, 3) in frames of these attitudes (n, 3, 3)."""
    return np.asarray(np.einsum("nji,nj->ni", attitude, vector))
