"""A spherical pendulum of changing length: its motion, and its place in the picture. The smoothers use it.

s is the horizontal part of the unit vector n from O to A. p is the angular momentum per mass about O, turned so that
p = l²ṡ for small swings, over a fixed length squared. Since gravity's moment about O is n × g⃗ l for any motion of the
rope, ``ṗ = −g l s`` holds at every amplitude. The rate of l, which a display in centimetres does not give, is not
needed. a is the slow part of the forcing, gusts and unknown acceleration of O over g: the place where the pendulum
would come to rest. Its correlation decays exponentially.

`PendulumSmoother` has states ``(s_x, s_y, p_x, p_y, a_x, a_y)``, whose model is in this module, in a level frame that
does not turn with the jib. `JibMotion` gives the jib's heading in it, the acceleration of O, and how the camera leans;
all are 0 where neither a controller nor an inertial sensor reports them. An inertial sensor's lean is wrong by the tilt
and by a drift, which are two more numbers of the state. A detector's errors that last for seconds look the same,
and are two more again. With a controller four are the errors of O's velocity, which move the grab and tilt a camera.

The lever, times the lean of the ropes, is the displacement of the grab. It is shorter than the rope where the grab
leans less than its ropes do, as on four ropes. Forces and gravity act on the lean of the ropes; s is the lean of OA.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from simgrab.instrument.estimate.chain import jacobian
from simgrab.instrument.estimate.frames import Frames
from simgrab.instrument.estimate.jib import JibMotion
from simgrab.model.geometry import Array, lean, on_ropes, rotation_z

Complex = NDArray[np.complex128]

NODE_S = 0.35  # longer steps between frames are divided
THIN_S = 0.3  # strengths are searched for on frames that are this far apart
MEMORY_S = 10.0  # correlation time of the slow forcing: gusts, and the jib's own motion
DEGREES = 4.0  # of Student's t distribution of pixel errors, so that an outlier has little weight
GRAVITY = 9.81  # m/s²; the frequency parameter takes up what is wrong with it

# Static parameters, in order: tilt (β cos azimuth, β sin azimuth), offset (3), damping ratio, relative stiffness.
TILT, OFFSET, DAMPING, STIFFNESS = slice(0, 2), slice(2, 5), 5, 6
# With a controller also: the pendulum's length minus |OA| (m), steady lean by wind (2, level frame), the controller's
# clock minus the pictures' (s), and of the camera the share of apparent gravity that it follows, logarithms of its
# frequency (rad/s) and of its damping ratio, and its pitch by luffing (rad/m).
LONGER, WIND, CLOCK, FOLLOWS, FREQUENCY, LEVELLING, LUFFING = 7, slice(8, 10), 10, 11, 12, 13, 14
# With an inertial sensor, the lever minus the rope's length (m), and of the sensor's lean (row by row) the scale error
# and misalignment, by which a change of lean is measured wrongly.
REACH, SCALE = 15, slice(16, 20)
ROLL = 20  # of the camera, beyond the stated one, with a controller (rad)
PARAMETERS = 21
STATE = 6  # numbers of a state, and two for each kind of drifting error of the direction of sight (rad, jib frame)


@dataclass(frozen=True, eq=False)
class Links:
    """Steps between consecutive nodes."""

    step: Array  # (k,), seconds
    before: Array  # (k,), rope length at the step's beginning, m
    after: Array  # (k,), and at its end
    length: float  # the fixed length that scales p, m
    # (d/2 − 3,), correlation times of pairs of states beyond the sixth
    memory_s: Array = field(default_factory=lambda: np.empty(0))
    carried: Complex | float = 0.0  # (k, d/2 − 3), displacement of O in the step by 1 rad of such a pair, x + iy, m

    @property
    def fast(self) -> Array:
        """Covariance (k, 2, 2) that white acceleration of 1 m²/s³ adds to s and p of an axis in each step."""
        h, rope = self.step, (self.before + self.after) / 2
        both = h**2 / (2 * self.length**2)
        return np.moveaxis(np.array([[h**3 / (3 * rope**2), both], [both, h * rope**2 / self.length**4]]), -1, 0)

    @property
    def slow(self) -> Array:
        """Variance (k, 1, 1) that slow forcing of unit variance adds to a of an axis in each step."""
        return np.asarray(-np.expm1(-2 * self.step / MEMORY_S))[:, None, None]


@dataclass(frozen=True, eq=False)
class Nodes:
    """The k moments with a state: the frames of a record, and moments inserted into longer steps."""

    time: Array  # (k,)
    rope: Array  # (k,)
    place: Array  # (k, 2), x and y of the grab over its depth, mount frame; 0 where nothing was seen
    seen: NDArray[np.bool_]  # (k,)
    frame: NDArray[np.int64]  # (n,), index of each frame's node
    first: NDArray[np.bool_]  # (k,), whether the step to the node is not bridged

    @classmethod
    def of(cls, record: Frames, some: slice, cut: float = np.inf) -> Nodes:
        """Make nodes of some frames of a single record; steps from `NODE_S` to ``cut``, s, are divided."""
        assert record.time is not None
        assert record.rope_length is not None
        time, rope = record.time[some], record.rope_length[0, some]
        step = np.diff(time)
        parts = np.where(step > cut, 1, np.maximum(np.ceil(step / NODE_S - 1e-9), 1)).astype(np.int64)
        frame = np.concatenate([[0], np.cumsum(parts)])
        at = np.interp(np.arange(frame[-1] + 1), frame, time)
        places, sees, first = np.zeros((len(at), 2)), np.zeros(len(at), bool), np.zeros(len(at), bool)
        places[frame], sees[frame] = record.places()[some], record.present[0, some]
        first[frame] = np.diff(time, prepend=-np.inf) > cut
        first[0] = True
        return cls(at, np.interp(at, time, rope), places, sees, frame, first)


def of_axes(block: Array, first: int, size: int) -> Array:
    """Expand a matrix (k, m, m) of one horizontal axis to both axes of states whose x and y alternate."""
    result = np.zeros((len(block), size, size))
    for axis in (0, 1):
        at = first + axis + 2 * np.arange(block.shape[-1])
        result[:, at[:, None], at] = block
    return result


def seen_from(turn: Array, s: Array, rope: Array, offset: Array) -> Array:
    """Position of the grab in a picture of unit focal length, (k, 2): x and y of the mount frame over the depth.

    ``turn`` (..., 3, 3) is the rotation from the mount frame to the frame of s (k, 2) and of the camera's offset (...,
    3).
    """
    nz = -np.sqrt(np.maximum(1 - np.sum(s * s, axis=-1, keepdims=True), 1e-6))
    local = np.einsum("...ji,...j->...i", turn, np.concatenate([s, nz], axis=-1) * rope[:, None] - offset)
    return np.asarray(local[:, :2] / -local[:, 2:])


def looked_along(turn: Array, place: Array, rope: Array, offset: Array) -> Array:
    """Horizontal part s (k, 2) of the direction to what is seen at a place (k, 2): inverse of `seen_from`."""
    ray = np.einsum("...ij,...j->...i", turn, np.concatenate([place, -np.ones((len(place), 1))], axis=-1))
    return np.asarray(on_ropes(offset, ray, rope)[:, :2] / rope[:, None])


def paired(x: Array) -> Complex:
    """Put horizontal axes that alternate (..., d) together as x + iy (..., d/2)."""
    return np.asarray(np.ascontiguousarray(x).view(np.complex128))


def advance(
    x: Array,
    parameters: Array,
    links: Links,
    acceleration: Array | float = 0.0,
    lightness: Array | float = 1.0,
    wind: Array | float = 0.0,
) -> Array:
    """Advance states (k, d) by one step of the fourth-order Runge-Kutta method.

    The angular momentum per mass is L = (p_y, −p_x, L_z), whose last component follows from n·L = 0, and ṅ = L × n / l²
    with the direction n of OA.

    Parameters
    ----------
    x : ndarray, shape (k, d)
    parameters : ndarray, shape (21,)
    acceleration : ndarray, shape (k, 2) or (2,), or 0.0
        Of O, m/s².
    lightness : ndarray, shape (k,), or float
        One over the hoisted mass, over its mean.
    wind : ndarray, shape (k, 2) or (2,), or 0.0
        Lean by a steady wind, rad.
    """
    h, z = links.step, paired(x)
    levers = links.before + parameters[REACH], links.after + parameters[REACH]
    before, after = (lever + parameters[LONGER] for lever in levers)
    pull, blown = (paired(one)[..., 0] if isinstance(one, np.ndarray) else one for one in (acceleration, wind))
    rest = lightness * (z[:, 2] + blown)

    def rates(s: Complex, p: Complex, rope: Array) -> tuple[Complex, Complex]:
        nz = -np.sqrt(np.maximum(1 - (s.real**2 + s.imag**2), 1e-6))
        lz = (s.imag * p.real - s.real * p.imag) / nz
        gravity = GRAVITY * rope * (1 + parameters[STIFFNESS])
        drag = 2 * parameters[DAMPING] * np.sqrt(GRAVITY / rope)
        return (1j * lz * s - nz * p) / rope**2, gravity * (rest - s) + rope * nz * pull - drag * p

    s, p, middle = z[:, 0] * (links.before / levers[0]), z[:, 1] * links.length**2, (before + after) / 2
    s1, p1 = rates(s, p, before)
    s2, p2 = rates(s + h / 2 * s1, p + h / 2 * p1, middle)
    s3, p3 = rates(s + h / 2 * s2, p + h / 2 * p2, middle)
    s4, p4 = rates(s + h * s3, p + h * p3, after)
    fade = np.exp(-h[:, None] / np.append(MEMORY_S, links.memory_s))
    moved = (s + h / 6 * (s1 + 2 * s2 + 2 * s3 + s4)) * (levers[1] / links.after)
    moved += np.sum(z[:, 3:] * links.carried, axis=-1) / links.after
    pushed = (p + h / 6 * (p1 + 2 * p2 + 2 * p3 + p4)) / links.length**2
    return np.column_stack([moved, pushed, z[:, 2:] * fade]).view(np.float64)


def sensed_lean(parameters: Array, course: Array) -> Array:
    """Lean (…, 2) of the camera that a sensor reports in a course (…, 6), without the error of its scale."""
    return np.asarray(course[..., 4:] @ (np.eye(2) + parameters[SCALE].reshape(2, 2)).T)


def of_tilt(lean: Array) -> Array:
    """Differentiate by the parameters, (2, 21), the camera's lean where a sensor reports a lean (2,)."""
    by = np.zeros((2, PARAMETERS))
    by[:, TILT], by[:, SCALE] = np.eye(2), np.kron(np.eye(2), lean)
    return by


def camera(parameters: Array, time: Array, jib: JibMotion, drift: Array | float = 0.0) -> tuple[Array, Array]:
    """Rotation (k, 3, 3) from the mount frame to the level frame, and the camera's offset (k, 3) in the latter."""
    time = time + parameters[CLOCK]
    course = jib.at(time)
    level_from_jib = rotation_z(course[:, 0])
    leans = sensed_lean(parameters, course) + parameters[TILT] + drift
    if not jib.sensed:
        leans += parameters[FOLLOWS] * jib.levelled(np.exp(parameters[FREQUENCY]), np.exp(parameters[LEVELLING]), time)
        leans[:, 0] += parameters[LUFFING] * course[:, 1]
    jib_from_rolled = lean(np.hypot(*leans.T), np.arctan2(leans[:, 1], leans[:, 0]))
    return level_from_jib @ jib_from_rolled @ rotation_z(-parameters[ROLL]), level_from_jib @ parameters[OFFSET]


def drifted(x: Array, shares: Array) -> Array:
    """Error (..., 2) of the direction of sight in states (..., d), jib frame, rad: the sum of shares of its kinds."""
    return np.stack([x[..., STATE::2] @ shares, x[..., STATE + 1 :: 2] @ shares], axis=-1)


def derivatives_of_advance(
    x: Array, parameters: Array, links: Links, time: Array, jib: JibMotion
) -> tuple[Array, Array, Array]:
    """States (k − 1, d) after the steps between times (k,), and derivatives by state (…, d) and parameters (…, 21)."""

    def led(e: Array) -> Array:
        p = parameters + e
        at = time + p[CLOCK]
        return advance(x, p, links, jib.acceleration(at), light, jib.by_wind(p[WIND], at))

    at = time + parameters[CLOCK]
    light = jib.lightness(at)
    known = jib.acceleration(at), light, jib.by_wind(parameters[WIND], at)
    by_state = jacobian(lambda e: advance(x + e, parameters, links, *known), x.shape[-1])
    of_jib = (*range(LONGER, CLOCK + 1), REACH) if jib.moves else ()
    by_parameter = jacobian(led, PARAMETERS, (*range(DAMPING, LONGER), *of_jib))
    return advance(x, parameters, links, *known), by_state, by_parameter


def derivatives_of_place(
    x: Array, parameters: Array, rope: Array, time: Array, jib: JibMotion
) -> tuple[Array, Array, Array]:
    """Places (k, 2), and their derivatives by the state (k, 2, d) and the parameters (k, 2, 21)."""
    # The share that a camera follows is not estimated from errors: at their joint mode it is large and they are small.
    shares = jib.shares(parameters[FOLLOWS])
    off = drifted(x, shares)
    turn, offset = camera(parameters, time, jib, off)

    def seen(e: Array, drift: Array | float = 0.0) -> Array:
        changed, at = camera(parameters + e, time, jib, off + drift)
        return seen_from(changed, x[:, :2], rope, at)

    size, still = x.shape[-1], np.zeros(PARAMETERS)
    by_state = jacobian(lambda e: seen_from(turn, (x + e)[:, :2], rope, offset), size, (0, 1))
    if jib.drifts:
        by_state[..., STATE:] = np.kron(shares, jacobian(lambda e: seen(still, e), 2))
    by_controller = (*range(CLOCK, REACH), ROLL) if jib.moves else ()
    of_jib = (CLOCK, *range(SCALE.start, SCALE.stop)) if jib.sensed else by_controller
    by_parameter = jacobian(seen, PARAMETERS, (*range(OFFSET.stop), *of_jib))
    return seen_from(turn, x[:, :2], rope, offset), by_state, by_parameter
