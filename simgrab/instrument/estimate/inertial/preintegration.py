"""Rotations as vectors, and readings of an inertial sensor summed up between nodes in time (Forster et al. 2017)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simgrab.instrument.estimate.frames import interpolated
from simgrab.instrument.estimate.inertial.readings import ImuReadings
from simgrab.model.geometry import Array


def cross_matrix(vector: Array) -> Array:
    """Matrices (..., 3, 3) whose product with b is the cross product of vectors (..., 3) and b."""
    x, y, z = np.moveaxis(vector, -1, 0)
    o = np.zeros_like(x)
    return np.stack([o, -z, y, z, o, -x, -y, x, o], axis=-1).reshape(*x.shape, 3, 3)


def rotation(vector: Array) -> Array:
    """Rotations (..., 3, 3) about vectors (..., 3) by their lengths, rad (Rodrigues)."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    k = cross_matrix(vector)
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * k + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (k @ k))


def rotation_vector(turn: Array) -> Array:
    """Vectors (..., 3) of rotations (..., 3, 3) by less than π: inverse of `rotation`."""
    lower, upper = turn[..., (2, 0, 1), (1, 2, 0)], turn[..., (1, 2, 0), (2, 0, 1)]
    twice_sine = lower - upper
    sine, cosine = np.linalg.norm(twice_sine, axis=-1) / 2, (np.trace(turn, axis1=-2, axis2=-1) - 1) / 2
    angle = np.arctan2(sine, cosine)
    return np.asarray(twice_sine / (2 * np.sinc(angle / np.pi))[..., None])


@dataclass(frozen=True, eq=False)
class Preintegrated:
    """The sensor's readings between k consecutive nodes, in the mount frame of the earlier node."""

    step: Array  # (k − 1,), s
    turn: Array  # (k − 1, 3, 3), rotation from the later node's mount frame to the earlier one's
    force: Array  # (k − 1, 3), mean specific force, m/s²
    rate: Array  # (k − 1, 3), mean angular rate, rad/s


def preintegrate(time: Array, imu: ImuReadings, mount_from_camera: Array) -> Preintegrated:
    """Sum readings up between nodes at increasing times (k,); readings are interpolated linearly between samples."""
    mount_from_sensor = mount_from_camera @ imu.camera_from_sensor
    rates, forces = imu.rate @ mount_from_sensor.T, imu.force @ mount_from_sensor.T
    cuts = np.unique(np.concatenate([time, imu.time[(imu.time > time[0]) & (imu.time < time[-1])]]))
    middle, piece = (cuts[1:] + cuts[:-1]) / 2, np.diff(cuts)
    rate, force = (interpolated(middle, imu.time, values) for values in (rates, forces))
    owner = np.searchsorted(time, middle) - 1
    links = len(time) - 1
    first, count = np.searchsorted(owner, np.arange(links)), np.bincount(owner, minlength=links)
    turn, gained, turned = np.tile(np.eye(3), (links, 1, 1)), np.zeros((links, 3)), np.zeros((links, 3))
    for number in range(int(count.max())):
        on = count > number
        i = first[on] + number
        half = rotation(rate[i] * piece[i, None] / 2)
        gained[on] += np.einsum("nij,nj->ni", turn[on] @ half, force[i] * piece[i, None])
        turn[on] = turn[on] @ half @ half
        turned[on] += rate[i] * piece[i, None]
    step = np.diff(time)
    return Preintegrated(step, turn, gained / step[:, None], turned / step[:, None])
