"""A spherical pendulum of changing length, as the smoother sees it: its motion, and its place in the picture.

State of a node in time: ``(s_x, s_y, p_x, p_y, a_x, a_y)``. s is the horizontal part of the unit vector n from O to
A, in the jib frame. p is the angular momentum per mass about O, turned so that p = l²ṡ for small swings, over a
fixed length squared. Since gravity's moment about O is n × g⃗ l whatever the rope does, ``ṗ = −g l s`` holds at
every amplitude, and the rate of l, which a display in centimetres does not give, appears nowhere. a is the slow part
of the forcing, wind and the jib's own acceleration over g: where the pendulum would come to rest. It forgets itself
exponentially.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simgrab.model.geometry import Array, lean

GRAVITY = 9.81  # m/s²; the frequency parameter takes up what is wrong with it

# Static parameters, in order: tilt (β cos azimuth, β sin azimuth), offset (3), damping ratio, relative stiffness.
TILT, OFFSET, DAMPING, STIFFNESS = slice(0, 2), slice(2, 5), 5, 6
PARAMETERS = 7
STATE = 6


@dataclass(frozen=True)
class Links:
    """Steps between consecutive nodes.

    Attributes
    ----------
    step : ndarray, shape (k,)
        Seconds.
    before, after : ndarray, shape (k,)
        Rope length at both ends, m.
    length : float
        The fixed length that scales p, m.
    memory_s : float
        Correlation time of the slow forcing, s.
    """

    step: Array
    before: Array
    after: Array
    length: float
    memory_s: float


def _rates(x: Array, parameters: Array, rope: Array, length: float) -> Array:
    s, p, lean_ = x[..., :2], x[..., 2:4] * length**2, x[..., 4:]
    nz = -np.sqrt(np.maximum(1 - np.sum(s * s, axis=-1), 1e-6))
    # Angular momentum L = (p_y, −p_x, L_z), of which n·L = 0 gives the last; ṅ = L × n / l².
    lz = -(s[..., 0] * p[..., 1] - s[..., 1] * p[..., 0]) / nz
    turn = np.stack([-p[..., 0] * nz - lz * s[..., 1], lz * s[..., 0] - p[..., 1] * nz], axis=-1) / rope[..., None] ** 2
    omega = np.sqrt(GRAVITY / rope)
    gravity = GRAVITY * rope * (1 + parameters[..., STIFFNESS])
    drag = 2 * parameters[..., DAMPING] * omega
    torque = gravity[..., None] * (lean_ - s) - drag[..., None] * p
    return np.concatenate([turn, torque / length**2, np.zeros_like(lean_)], axis=-1)


def advance(x: Array, parameters: Array, links: Links) -> Array:
    """States (..., k, 6) one step on, by Runge and Kutta's fourth-order rule; parameters (..., 1, 7)."""
    h = links.step[:, None]
    middle = (links.before + links.after) / 2
    a = _rates(x, parameters, links.before, links.length)
    b = _rates(x + h / 2 * a, parameters, middle, links.length)
    c = _rates(x + h / 2 * b, parameters, middle, links.length)
    d = _rates(x + h * c, parameters, links.after, links.length)
    result = x + h / 6 * (a + 2 * b + 2 * c + d)
    result[..., 4:] *= np.exp(-h / links.memory_s)
    return np.asarray(result)


def fast_precision(links: Links) -> Array:
    """Inverse covariance (k, 6, 6) of what unit white acceleration (1 m²/s³ per axis) adds in a step to s and p."""
    h, rope = links.step, (links.before + links.after) / 2
    ss, sp, pp = h**3 / (3 * rope**2), h**2 / (2 * links.length**2), h * rope**2 / links.length**4
    det = ss * pp - sp**2
    inverse = np.zeros((len(h), STATE, STATE))
    for axis in (0, 1):
        inverse[:, axis, axis] = pp / det
        inverse[:, axis, axis + 2] = inverse[:, axis + 2, axis] = -sp / det
        inverse[:, axis + 2, axis + 2] = ss / det
    return inverse


def slow_precision(links: Links) -> Array:
    """Inverse covariance (k, 6, 6) of what slow forcing of unit variance per axis adds in a step."""
    inverse = np.zeros((len(links.step), STATE, STATE))
    inverse[:, 4, 4] = inverse[:, 5, 5] = 1 / -np.expm1(-2 * links.step / links.memory_s)
    return inverse


def place(s: Array, parameters: Array, rope: Array) -> Array:
    """Where a picture of unit focal length has the grab, (..., k, 2): x and y of the mount frame over the depth."""
    tilt, offset = parameters[..., TILT], parameters[..., OFFSET]
    nz = -np.sqrt(np.maximum(1 - np.sum(s * s, axis=-1, keepdims=True), 1e-6))
    grab = np.concatenate([s, nz], axis=-1) * rope[:, None] - offset
    turn = lean(np.hypot(tilt[..., 0], tilt[..., 1]), np.arctan2(tilt[..., 1], tilt[..., 0]))
    local = np.einsum("...ji,...j->...i", turn, grab)
    return np.asarray(local[..., :2] / -local[..., 2:])


def derivatives_of_advance(x: Array, parameters: Array, links: Links) -> tuple[Array, Array, Array]:
    """States one step on (k, 6), and their derivatives by the state (k, 6, 6) and the parameters (k, 6, 7)."""
    step = 1e-6
    moved = np.concatenate([np.eye(STATE), -np.eye(STATE)]) * step
    by_state = advance(x + moved[:, None], parameters, links)
    changed = np.tile(parameters, (4, 1, 1))
    changed[[0, 1], 0, DAMPING] += (step, -step)
    changed[[2, 3], 0, STIFFNESS] += (step, -step)
    by_parameter = advance(np.broadcast_to(x, (4, *x.shape)), changed, links)
    g = np.zeros((len(x), STATE, PARAMETERS))
    g[:, :, DAMPING] = (by_parameter[0] - by_parameter[1]) / (2 * step)
    g[:, :, STIFFNESS] = (by_parameter[2] - by_parameter[3]) / (2 * step)
    f = np.moveaxis(by_state[:STATE] - by_state[STATE:], 0, -1) / (2 * step)
    return advance(x, parameters, links), f, g


def derivatives_of_place(s: Array, parameters: Array, rope: Array) -> tuple[Array, Array, Array]:
    """Places (k, 2), and their derivatives by s (k, 2, 2) and the parameters (k, 2, 7)."""
    step = 1e-6
    moved = np.concatenate([np.eye(2), -np.eye(2)]) * step
    by_s = place(s + moved[:, None], parameters, rope)
    changed = np.tile(parameters, (10, 1, 1))
    changed[:5, 0, :5] += np.eye(5) * step
    changed[5:, 0, :5] -= np.eye(5) * step
    by_parameter = place(np.broadcast_to(s, (10, *s.shape)), changed, rope)
    d = np.zeros((len(s), 2, PARAMETERS))
    d[:, :, :5] = np.moveaxis(by_parameter[:5] - by_parameter[5:], 0, -1) / (2 * step)
    return place(s, parameters, rope), np.moveaxis(by_s[:2] - by_s[2:], 0, -1) / (2 * step), d
