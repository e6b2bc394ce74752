"""The grab on ropes that lean otherwise than it does: a double pendulum, or one whose head the ropes hold.

The ropes are a massless link from O to T, the middle of their ends; the grab is a rigid body about T. Kane's equations
are integrated in the frame of `simgrab.world.trajectory.plant`, which moves with O but does not turn. On four ropes the
grab's angular velocity is bound to that of the ropes, and the same equations are projected on what is left free.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from simgrab.model import geometry
from simgrab.model.geometry import STANDARD_GRAVITY, Array
from simgrab.model.scenario import DoublePendulum, FourRopes, Start
from simgrab.world.scenery.grabs.design import Design
from simgrab.world.scenery.grabs.weight import Mass
from simgrab.world.scenery.meshes.ropes import Ropes
from simgrab.world.trajectory.hanging import rope_lean
from simgrab.world.trajectory.plant import AIR_KG_M3, HELD_DAMPING, RETURN_1_S, Drive, Hung, spread_m2, turned

_UP, _FREE = np.array([0.0, 0.0, 1.0]), np.eye(5)
# Power series in x = θ² of sin θ/θ, (1 − cos θ)/θ², (θ − sin θ)/θ³: exact to the last digits up to θ = 2.
_TERMS = 14
_SINC, _COSC, _REST = (
    [(-1) ** k / math.factorial(2 * k + first) for k in range(_TERMS)] for first in (1, 2, 3)
)  # fmt: skip


def _slope(series: list[float]) -> list[float]:
    return [k * term for k, term in enumerate(series)][1:]


_SINC_1, _COSC_1, _REST_1 = (_slope(series) for series in (_SINC, _COSC, _REST))
_SINC_2 = _slope(_SINC_1)


def _sum(series: list[float], x: float) -> float:
    total = 0.0
    for term in reversed(series):
        total = total * x + term
    return total


@dataclass(frozen=True, eq=False)
class _Rope:
    """Direction of the ropes, and what its derivatives take.

    The ropes' lean p is a vector (2) along the horizontal part of their direction, its length the angle from straight
    down.

    Attributes
    ----------
    direction : ndarray, shape (3,)
        Unit vector from O to T.
    jacobian : ndarray, shape (3, 2)
        Its derivative by p.
    bend : ndarray, shape (3,)
        Second derivative of the direction where p changes at a constant rate, 1/s².
    """

    direction: Array
    jacobian: Array
    bend: Array

    @classmethod
    def at(cls, p: Array, p_rate: Array) -> _Rope:
        px, py, vx, vy = float(p[0]), float(p[1]), float(p_rate[0]), float(p_rate[1])
        x, a, b = px * px + py * py, px * vx + py * vy, vx * vx + vy * vy
        s, s1, s2 = _sum(_SINC, x), _sum(_SINC_1, x), _sum(_SINC_2, x)
        along, across = 4 * a * s1, 4 * a * a * s2 + 2 * b * s1
        return cls(
            np.array([s * px, s * py, x * _sum(_COSC, x) - 1]),
            np.array([[s + 2 * s1 * px * px, 2 * s1 * px * py], [2 * s1 * px * py, s + 2 * s1 * py * py],
                      [s * px, s * py]]),
            np.array([along * vx + across * px, along * vy + across * py, 2 * a * a * s1 + b * s]),
        )  # fmt: skip


def directions(p: Array, p_rate: Array, p_acceleration: Array) -> tuple[Array, Array, Array]:
    """Give the unit vector (3,) of ropes that lean by p (2,), and its two derivatives by time."""
    rope = _Rope.at(p, p_rate)
    return rope.direction, rope.jacobian @ p_rate, rope.jacobian @ p_acceleration + rope.bend


def _leaned(p: Array, turn: float) -> Array:
    """Rotation, shape (3, 3), that leans straight down by p after a turn about it."""
    x = float(p @ p)
    s, c, rx, ry = _sum(_SINC, x), _sum(_COSC, x), float(p[1]), -float(p[0])
    lean = np.array([[1 - c * ry * ry, c * rx * ry, s * ry], [c * rx * ry, 1 - c * rx * rx, -s * rx],
                     [-s * ry, s * rx, 1 - c * x]])  # fmt: skip
    return np.asarray(lean @ _about_z(turn))


def _bound(p: Array, turn: float, p_rate: Array, turn_rate: float) -> tuple[Array, Array]:
    """How the angular velocity of a body at `_leaned` follows from the rates of p and of its turn.

    Returns
    -------
    jacobian : ndarray, shape (3, 3)
        Angular velocity in the body's frame by (ṗ, turn rate): the right Jacobian of the rotation vector.
    drift : ndarray, shape (3,)
        Angular acceleration at constant rates, body frame, rad/s².
    """
    (px, py), (ux, uy) = p.tolist(), p_rate.tolist()
    rx, ry, vx, vy = py, -px, uy, -ux  # rotation vector, and its rate
    x, m, b = rx * rx + ry * ry, rx * vx + ry * vy, vx * vx + vy * vy
    c, d, c1, d1 = _sum(_COSC, x), _sum(_REST, x), _sum(_COSC_1, x), _sum(_REST_1, x)
    e, skewed = 1 - d * x, d * rx * ry
    lean = np.array([[-skewed, e + d * rx * rx], [-e - d * ry * ry, skewed], [c * rx, c * ry]])
    along, across = 2 * m * m * d1 + d * b, d * m - 2 * m * (d1 * x + d)
    drift = np.array([along * rx + across * vx, along * ry + across * vy, -2 * m * c1 * (rx * vy - ry * vx)])
    back = _about_z(-turn)
    jacobian = np.empty((3, 3))
    jacobian[:, :2], jacobian[:, 2] = back @ lean, _UP
    sx, sy, _ = (jacobian[:, :2] @ p_rate).tolist()
    return jacobian, back @ drift + np.array([turn_rate * sy, -turn_rate * sx, 0.0])


def _about_z(turn: float) -> Array:
    c, s = math.cos(turn), math.sin(turn)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class _Frame:
    """Where ropes and grab are, how fast, and what the grab's freedom is.

    Attributes
    ----------
    rope : _Rope
    rope_rate : ndarray, shape (2,)
        ṗ.
    attitude : ndarray, shape (3, 3)
        Of the grab.
    rate : ndarray, shape (3,)
        Its angular velocity, grab frame, rad/s.
    yaw : float
        Twist of the attitude about the vertical, rad.
    free : ndarray, shape (5, n)
        (ṗ, angular velocity) by the speeds that are free.
    drift : ndarray, shape (3,)
        Angular acceleration at constant free speeds.
    """

    rope: _Rope
    rope_rate: Array
    attitude: Array
    rate: Array
    yaw: float
    free: Array
    drift: Array


class LinkedPlant:
    """Ropes and grab as two links; it does what `simgrab.world.trajectory.plant.Plant` does.

    Parameters
    ----------
    grab : Design
    ropes : Ropes
    rope : float
        |OA| with everything in line, m.
    jaw, load : float
        Opening, rad, and fill.
    suspension : FourRopes or DoublePendulum
    damping, yaw_damping : float
        Shares of the critical ones.
    drag_area : float
        Cd·A, m².
    """

    WIDTH = 19
    """Columns of `watch`: p, quaternion, |OT|; their rates p (2), angular velocity (3), |OT|; and accelerations."""
    ACCELERATIONS = slice(13, 18)

    def __init__(
        self, grab: Design, ropes: Ropes, rope: float, jaw: float, load: float, *,
        suspension: FourRopes | DoublePendulum, damping: float, yaw_damping: float, drag_area: float,
    ) -> None:  # fmt: skip
        self._grab, self._spread_m2 = grab, spread_m2(grab, ropes)
        self.end_height = float(grab.terminations[0, 2])
        self._ratio = suspension.tilt_ratio if isinstance(suspension, FourRopes) else None
        self._joint_damping = suspension.damping if isinstance(suspension, DoublePendulum) else 0.0
        self._damping, self._yaw_damping, self._drag = damping, yaw_damping, drag_area
        self._jaw, self._load = jaw, load
        self.mass = grab.mass_of(jaw, load)
        # p, then the quaternion or the turn, then |OT|; and their speeds.
        turned = [0.0] if self._ratio is not None else [1.0, 0.0, 0.0, 0.0]
        self._at = np.array([0.0, 0.0, *turned, rope - self.end_height])
        self._speed = np.zeros(4 if self._ratio is not None else 6)

    def begin(self, start: Start) -> None:
        """Set swing and yaw with which a clip begins; the grab of a double pendulum begins in line with its ropes."""
        alpha, azimuth, yaw = np.radians((start.alpha_deg, start.azimuth_deg, start.yaw_deg))
        length, ratio = float(self._at[-1]), 1.0 if self._ratio is None else self._ratio
        lean = rope_lean(float(alpha), self.end_height / length, ratio, of_ropes=True)
        out, aside = np.array([np.cos(azimuth), np.sin(azimuth)]), np.array([-np.sin(azimuth), np.cos(azimuth)])
        p = lean * out
        stiffness, inertia = self._swing(length, ratio)
        # Across the swing, the lean changes by the direction's speed over sin(lean)/lean.
        p_rate = start.roundness * lean * math.sqrt(stiffness / inertia) * aside / _sum(_SINC, lean**2)
        self._at[:2], self._speed[:2] = p, p_rate
        jacobian, _ = _bound(ratio * p, yaw, ratio * p_rate, 0.0)
        swung = ratio * jacobian[:, :2] @ p_rate
        if self._ratio is not None:
            self._at[2], self._speed[2] = yaw, -swung[2]  # no turn about its own axis
            return
        half = lean / 2
        w, x, y = math.cos(half), math.sin(half) * math.sin(azimuth), -math.sin(half) * math.cos(azimuth)
        c, s = math.cos(yaw / 2), math.sin(yaw / 2)
        self._at[2:6] = w * c, x * c + y * s, y * c - x * s, w * s
        self._speed[2:5] = swung * (1.0, 1.0, 0.0)

    def hold(self, jaw: float, load: float) -> None:
        """Move the jaws and change the load: cargo leaves with its own speed, moving jaws keep the momentum."""
        if (jaw, load) == (self._jaw, self._load):
            return
        before, after = self._grab.mass_of(self._jaw, load), self._grab.mass_of(jaw, load)
        frame = self._frame(self._at, self._speed)
        length, rope_rate = float(self._at[-1]), float(self._speed[-1])
        (old, old_arm), (new, new_arm) = (self._inertia(frame, mass, length) for mass in (before, after))
        push = before.mass * (old_arm - new_arm).T @ frame.rope.direction * rope_rate
        free = frame.free
        momentum = free.T @ (old @ free @ self._speed[:-1] + push)
        self._speed[:-1] = np.linalg.solve(free.T @ new @ free, momentum)
        self._jaw, self._load, self.mass = jaw, load, self._grab.mass_of(jaw, load)

    def rates(self) -> Array:
        """Rates of the ropes' lean, 1/s, and angular velocity of the grab, grab frame, rad/s; shape (5,)."""
        return self._frame(self._at, self._speed).free @ self._speed[:-1]

    def hung(self, slew: float) -> Hung:
        """Give the grab's state in the jib frame, as `Plant.hung` does."""
        frame = self._frame(self._at, self._speed)
        up = frame.attitude[:, 2]
        centre = turned(self._at[-1] * frame.rope.direction - self.end_height * up, -slew)
        alpha, azimuth, rope = geometry.swing_of(centre)
        lean, leaning, _ = geometry.swing_of(turned(-up, -slew))
        return Hung(float(alpha), float(azimuth), float(rope), frame.yaw - slew, (float(lean), float(leaning)))

    def run(self, drive: Drive, seconds: float, steps: int) -> None:
        """Integrate one interval."""
        forces = self._forces(drive)
        for _ in range(steps):
            self._at, self._speed = self._stepped(self._at, self._speed, seconds / steps, forces)

    def watch(self, drive: Drive, seconds: float, steps: int, instants: Sequence[float]) -> Array:
        """Integrate one interval as `run` does, and give the motion at instants within it, shape (n, `WIDTH`).

        Between two steps the motion is that of a shorter step from the first of them, by the same integrator.
        """
        forces, step, taken = self._forces(drive), seconds / steps, 0
        rows = np.empty((len(instants), self.WIDTH))
        for row, instant in zip(rows, instants, strict=True):
            number = min(int(instant / step), steps - 1)
            while taken < number:
                self._at, self._speed = self._stepped(self._at, self._speed, step, forces)
                taken += 1
            at, speed = self._stepped(self._at, self._speed, instant - number * step, forces)
            _, change = self._derivative(at, speed, forces)
            frame = self._frame(at, speed)
            spin = frame.free[2:] @ change[:-1] + frame.drift
            row[:7] = *at[:2], *_quaternion(frame.attitude), at[-1]
            row[7:13] = *speed[:2], *frame.rate, speed[-1]
            row[13:] = *change[:2], *spin, change[-1]
        for _ in range(steps - taken):
            self._at, self._speed = self._stepped(self._at, self._speed, step, forces)
        return rows

    def energy(self) -> float:
        """Energy in a frame in which O rests, of swing, turn and height, J; heights are from O."""
        frame, mass, length = self._frame(self._at, self._speed), self.mass, float(self._at[-1])
        down = length * frame.rope.direction[2] + (mass.centre_z - self.end_height) * frame.attitude[2, 2]
        speeds, (inertia, arm) = frame.free @ self._speed[:-1], self._inertia(frame, mass, length)
        along = float(self._speed[-1])
        moving = speeds @ inertia @ speeds / 2 + mass.mass * along * (frame.rope.direction @ (arm @ speeds) + along / 2)
        twist = self._twist(length + self.end_height) * (1 - math.cos(frame.yaw))
        return float(moving + mass.mass * STANDARD_GRAVITY * down + twist)

    def _frame(self, at: Array, speed: Array) -> _Frame:
        p, p_rate = at[:2], speed[:2]
        rope = _Rope.at(p, p_rate)
        if self._ratio is None:
            yaw = 2 * math.atan2(at[5], at[2])
            return _Frame(rope, p_rate, _matrix(at[2:6]), speed[2:5], yaw, _FREE, np.zeros(3))
        k, turn, turn_rate = self._ratio, float(at[2]), float(speed[2])
        jacobian, drift = _bound(k * p, turn, k * p_rate, turn_rate)
        free = np.zeros((5, 3))
        free[0, 0] = free[1, 1] = 1.0
        free[2:] = jacobian * (k, k, 1.0)
        return _Frame(rope, p_rate, _leaned(k * p, turn), free[2:] @ speed[:3], turn, free, drift)

    def _inertia(self, frame: _Frame, mass: Mass, length: float) -> tuple[Array, Array]:
        """Mass matrix of (ṗ, angular velocity), shape (5, 5), and velocity of the centre of mass by these (3, 5)."""
        r, lever = frame.attitude, mass.centre_z - self.end_height
        arm = np.zeros((3, 5))
        arm[:, :2], arm[:, 2], arm[:, 3] = length * frame.rope.jacobian, -lever * r[:, 1], lever * r[:, 0]
        inertia = mass.mass * (arm.T @ arm)
        inertia[2, 2] += mass.inertia[0]
        inertia[3, 3] += mass.inertia[1]
        inertia[4, 4] += mass.inertia[2]
        return inertia, arm

    def _swing(self, length: float, ratio: float) -> tuple[float, float]:
        """Stiffness, N m, and inertia, kg m², of small swings whose grab leans by a share of the ropes' lean."""
        mass, below = self.mass, self.end_height - self.mass.centre_z
        stiffness = mass.mass * STANDARD_GRAVITY * (length + ratio**2 * below)
        return stiffness, mass.mass * (length + ratio * below) ** 2 + ratio**2 * mass.inertia[0]

    def _twist(self, rope: float) -> float:
        """Stiffness of the ropes against yaw, N m/rad."""
        return self.mass.mass * STANDARD_GRAVITY * self._spread_m2 / (rope - self.end_height)

    def _forces(self, drive: Drive) -> _Forces:
        mass, at, speed = self.mass, self._at, self._speed
        frame, length = self._frame(at, speed), float(at[-1])
        lag = drive.rope - self.end_height - length
        slip = drive.rope_rate - float(speed[-1])
        _, arm = self._inertia(frame, mass, length)
        own = speed[-1] * frame.rope.direction + arm @ (frame.free @ speed[:-1])
        wind = np.array([*drive.wind, 0.0]) - (*drive.velocity, 0.0) - own
        push = 0.5 * AIR_KG_M3 * self._drag * float(np.linalg.norm(wind)) * wind
        push[:2] += mass.mass * np.array(drive.push)
        stiffness, inertia = self._swing(drive.rope - self.end_height, 1.0 if self._ratio is None else self._ratio)
        twist = self._twist(drive.rope)
        below = self.end_height - mass.centre_z
        tilting = math.sqrt(mass.mass * STANDARD_GRAVITY * below * (mass.inertia[0] + mass.mass * below**2))
        held = drive.held
        return _Forces(
            force=mass.mass * np.array(drive.gravity) + push,
            rope_acceleration=drive.rope_acceleration + RETURN_1_S**2 * lag + 2 * RETURN_1_S * slip,
            twist=twist, heading=drive.heading,
            damping=2 * (HELD_DAMPING if held else self._damping) * math.sqrt(stiffness * inertia),
            yaw_damping=2 * (1.0 if held else self._yaw_damping) * math.sqrt(twist * mass.inertia[2]),
            joint_damping=2 * (HELD_DAMPING if held else self._joint_damping) * tilting if self._ratio is None else 0.0,
        )  # fmt: skip

    def _stepped(self, at: Array, speed: Array, step: float, forces: _Forces) -> tuple[Array, Array]:
        """Take one step of the classical Runge–Kutta method."""
        a, da = self._derivative(at, speed, forces)
        b, db = self._derivative(at + step / 2 * a, speed + step / 2 * da, forces)
        c, dc = self._derivative(at + step / 2 * b, speed + step / 2 * db, forces)
        d, dd = self._derivative(at + step * c, speed + step * dc, forces)
        at = at + step / 6 * (a + 2 * b + 2 * c + d)
        if self._ratio is None:
            at[2:6] /= math.sqrt(float(at[2:6] @ at[2:6]))
        return at, speed + step / 6 * (da + 2 * db + 2 * dc + dd)

    def _derivative(self, at: Array, speed: Array, forces: _Forces) -> tuple[Array, Array]:
        """Kane's equations: derivatives of positions and speeds."""
        mass, length, along = self.mass, float(at[-1]), float(speed[-1])
        frame = self._frame(at, speed)
        r, rate, rope, free = frame.attitude, frame.rate, frame.rope, frame.free
        inertia, arm = self._inertia(frame, mass, length)
        lever, square = mass.centre_z - self.end_height, float(rate @ rate)
        inward = lever * (rate[2] * rate - square * _UP)  # of the centre of mass about T, grab frame
        swept = rope.jacobian @ frame.rope_rate
        drift = forces.rope_acceleration * rope.direction + 2 * along * swept + length * rope.bend + r @ inward
        push = arm.T @ (forces.force - mass.mass * drift)
        push[:2] -= forces.damping * rope.jacobian.T @ swept
        push[2:] -= _cross(rate, np.array(mass.inertia) * rate)
        push[4] -= forces.yaw_damping * rate[2]
        torque = -forces.twist * math.sin(frame.yaw - forces.heading)
        if self._ratio is not None:
            whole = free.T @ (push - inertia[:, 2:] @ frame.drift)
            whole[2] += torque
            change = np.linalg.solve(free.T @ inertia @ free, whole)
            moved = np.array([speed[0], speed[1], speed[2], along])
            return moved, np.array([*change, forces.rope_acceleration])
        w, x, y, z = at[2:6].tolist()
        push[2:] += torque * np.array([z * x - w * y, w * x + z * y, w * w + z * z]) / (w * w + z * z)
        # Friction where the ropes end, against the turn of the grab out of the ropes' line.
        turning = r.T @ _skew(rope.direction) @ rope.jacobian
        bent = (rate - turning @ frame.rope_rate) * (1.0, 1.0, 0.0)
        push[2:] -= forces.joint_damping * bent
        push[:2] += forces.joint_damping * turning.T @ bent
        change = np.linalg.solve(inertia, push)
        p, q, s = rate.tolist()
        turn = (-x * p - y * q - z * s, w * p + y * s - z * q, w * q - x * s + z * p, w * s + x * q - y * p)
        moved = np.array([speed[0], speed[1], *(t / 2 for t in turn), along])
        return moved, np.array([*change, forces.rope_acceleration])


@dataclass(frozen=True, eq=False)
class _Forces:
    """What acts during one interval.

    Attributes
    ----------
    force : ndarray, shape (3,)
        On the centre of mass, weight included, N.
    rope_acceleration : float
        Of |OT|, m/s².
    twist, heading : float
        Stiffness against yaw, N m/rad, and the yaw without torque, rad.
    damping, yaw_damping, joint_damping : float
        N m s.
    """

    force: Array
    rope_acceleration: float
    twist: float
    heading: float
    damping: float
    yaw_damping: float
    joint_damping: float


def _matrix(quaternion: Array) -> Array:
    w, x, y, z = (quaternion / math.sqrt(float(quaternion @ quaternion))).tolist()
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def _quaternion(matrix: Array) -> Array:
    """Quaternion (4,), scalar first, of a rotation matrix."""
    return np.asarray(Rotation.from_matrix(matrix).as_quat(scalar_first=True))


def _skew(v: Array) -> Array:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(_skew(a) @ b)
