"""Camera, inertial sensor and pendulum as one chain of states.

The level frame has z up; its heading is the jib's at the first node. The camera's mount frame (see
`simgrab.instrument.estimate.frames`) turns in it as the gyroscope reports, and the accelerometer gives the acceleration
of O, which drives the pendulum. A camera that levels itself is no special case: its attitude is a state.

State of a node, `STATE` numbers: error of the attitude (3, rad, mount frame), horizontal velocity of the camera (2,
m/s), bias of the gyroscope (3, rad/s) and of the accelerometer across the optical axis (2, m/s²), both in the mount
frame, and the pendulum: s, p and slow forcing a (2 each) as in `simgrab.instrument.estimate.pendulum`, here in the
level frame, where wind keeps its direction while the jib slews.

Parameters of the whole record, `PARAMETERS` numbers: camera offset (3, m, jib frame), damping ratio, the pendulum's
length minus the lever (m), the gyroscope's response on each of its axes to the rate about the optical axis (3), the
steady lean by wind (2, rad, level frame), and the reach: the lever minus the rope's length (m).

The lever, times the lean of the ropes, is the displacement of the grab. It is shorter than the rope where the grab
leans less than its ropes do, as on four ropes. Forces and gravity act on the lean of the ropes; s is the lean of OA.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simgrab.instrument.estimate import pendulum
from simgrab.instrument.estimate.chain import jacobian
from simgrab.instrument.estimate.inertial.preintegration import Preintegrated, rotation, rotation_vector
from simgrab.instrument.estimate.pendulum import MEMORY_S, seen_from, turning
from simgrab.model.geometry import STANDARD_GRAVITY, Array, rotation_z

ATTITUDE, VELOCITY, GYROSCOPE, ACCELEROMETER = slice(0, 3), slice(3, 5), slice(5, 8), slice(8, 10)
SWING, MOMENTUM, LEAN = slice(10, 12), slice(12, 14), slice(14, 16)
STATE = 16
SEEN = (0, 1, 2, 10, 11)  # attitude and swing: what moves the grab in the picture
OFFSET, DAMPING, LONGER, CROSS, WIND, REACH = slice(0, 3), 3, 4, slice(5, 8), slice(8, 10), 10
PARAMETERS = 11


@dataclass(frozen=True, eq=False)
class ImuLinks(pendulum.Links):
    """Steps between k consecutive nodes, and what the sensor reported in them."""

    imu: Preintegrated

    @classmethod
    def of(cls, imu: Preintegrated, rope: Array, length: float) -> ImuLinks:
        """Make the steps of readings between nodes with rope lengths (k,)."""
        return cls(imu.step, rope[:-1], rope[1:], length, imu)


def heading(attitude: Array) -> Array:
    """Heading of the jib, from attitudes (..., 3, 3): the camera leans on the jib but does not turn."""
    return np.arctan2(attitude[..., 1, 0] - attitude[..., 0, 1], attitude[..., 0, 0] + attitude[..., 1, 1])


def _rates(x: Array, damping: float, rope: Array, length: float, acceleration: Array, lean: Array) -> Array:
    """Differentiate s and p by time, as in `simgrab.instrument.estimate.pendulum`, below a pivot that accelerates."""
    s, p = x[:, :2], x[:, 2:] * length**2
    turn, nz = turning(s, p, rope)
    pull = -nz[:, None] * (STANDARD_GRAVITY * lean - acceleration) - STANDARD_GRAVITY * s
    drag = 2 * damping * np.sqrt(STANDARD_GRAVITY / rope)
    return np.concatenate([turn, (rope[:, None] * pull - drag[:, None] * p) / length**2], axis=-1)


def advance(attitude: Array, x: Array, parameters: Array, links: ImuLinks) -> tuple[Array, Array]:
    """Advance attitudes and states by one step.

    Parameters
    ----------
    attitude : ndarray, shape (k − 1, 3, 3)
        Rotation from the mount frame to the level frame.
    x : ndarray, shape (k − 1, 16)
    parameters : ndarray, shape (11,)
    links : ImuLinks

    Returns
    -------
    attitude : ndarray, shape (k − 1, 3, 3)
    x : ndarray, shape (k − 1, 16)
        States; their error of the attitude is 0.
    """
    imu, h = links.imu, links.step[:, None]
    now = attitude @ rotation(x[:, ATTITUDE])
    wrong = -(x[:, GYROSCOPE] + parameters[CROSS] * imu.rate[:, 2:]) * h
    force = imu.force.copy()
    force[:, :2] -= x[:, ACCELEROMETER]
    acceleration = np.einsum("nij,nj->ni", now @ rotation(wrong / 2), force)[:, :2]
    spin = imu.rate[:, 2:] - x[:, GYROSCOPE][:, 2:]
    arm = np.einsum("nij,j->ni", rotation_z(heading(now))[:, :2, :2], parameters[OFFSET][:2])
    across = np.stack([-arm[:, 1], arm[:, 0]], axis=-1)
    of_pivot = acceleration - imu.rate_slope[:, None] * across + spin**2 * arm
    levers = links.before + parameters[REACH], links.after + parameters[REACH]
    of_ropes = x[:, SWING] * (links.before / levers[0])[:, None]
    a = np.concatenate([of_ropes, x[:, MOMENTUM]], axis=-1)
    before, after = (lever + parameters[LONGER] for lever in levers)
    fixed = (links.length, of_pivot, parameters[WIND] + x[:, LEAN])
    slopes = _rates(a, parameters[DAMPING], before, *fixed)
    total = slopes
    for share, weight, rope in ((h / 2, 2, (before + after) / 2), (h / 2, 2, (before + after) / 2), (h, 1, after)):
        slopes = _rates(a + share * slopes, parameters[DAMPING], rope, *fixed)
        total = total + weight * slopes
    swing = a + h / 6 * total
    swing[:, :2] *= (levers[1] / links.after)[:, None]
    velocity = x[:, VELOCITY] + acceleration * h
    lean = x[:, LEAN] * np.exp(-h / MEMORY_S)
    still = np.zeros_like(x[:, ATTITUDE])
    return now @ imu.turn @ rotation(wrong), np.concatenate(
        [still, velocity, x[:, GYROSCOPE], x[:, ACCELEROMETER], swing, lean], axis=-1
    )


def place(attitude: Array, x: Array, parameters: Array, rope: Array) -> Array:
    """Position of the grab in the picture, shape (k, 2), as `simgrab.instrument.estimate.pendulum.seen_from`."""
    now = attitude @ rotation(x[:, ATTITUDE])
    offset = np.einsum("nij,j->ni", rotation_z(heading(now)), parameters[OFFSET])
    return seen_from(now, x[:, SWING], rope, offset)


def derivatives_of_advance(attitude: Array, x: Array, parameters: Array, links: ImuLinks) -> tuple[Array, Array, Array]:
    """Difference of each step's end from the next node, and the derivatives of that end.

    Parameters
    ----------
    attitude : ndarray, shape (k, 3, 3)
    x : ndarray, shape (k, 16)
    parameters : ndarray, shape (11,)
    links : ImuLinks

    Returns
    -------
    residual : ndarray, shape (k − 1, 16)
    by_state : ndarray, shape (k − 1, 16, 16)
    by_parameter : ndarray, shape (k − 1, 16, 11)
    """
    back = attitude[1:].swapaxes(-1, -2)

    def led(dx: Array | float, dp: Array | float) -> Array:
        turned, state = advance(attitude[:-1], x[:-1] + dx, parameters + dp, links)
        state[:, ATTITUDE] = rotation_vector(back @ turned)
        return state

    goal = x[1:].copy()
    goal[:, ATTITUDE] = 0
    by_state, by_parameter = jacobian(lambda e: led(e, 0.0), STATE), jacobian(lambda e: led(0.0, e), PARAMETERS)
    return led(0.0, 0.0) - goal, by_state, by_parameter


def derivatives_of_place(attitude: Array, x: Array, parameters: Array, rope: Array) -> tuple[Array, Array, Array]:
    """Places (k, 2), and their derivatives by the state (k, 2, 16) and the parameters (k, 2, 11)."""
    by_state = jacobian(lambda e: place(attitude, x + e, parameters, rope), STATE, SEEN)
    by_parameter = jacobian(lambda e: place(attitude, x, parameters + e, rope), PARAMETERS, range(3))
    return place(attitude, x, parameters, rope), by_state, by_parameter
