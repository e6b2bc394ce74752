"""The grab on ropes that lean differently from it: a double pendulum, or a grab whose head the ropes hold.

The ropes are a massless link from O to T, the middle of their ends; the grab is a rigid body about T. Each leans from
straight down by a vector p (2) along the horizontal part of its direction, whose length is the angle. Coordinates are
x = (p of the ropes, p of the grab, turn of the grab about its own axis); those that are free are y, with x = S y: all
five in a double pendulum, and without the grab's p on four ropes, where it is a ratio of the ropes'. Kane's equations
are integrated by the classical Runge-Kutta method.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from simgrab.model import geometry
from simgrab.model.geometry import Array
from simgrab.model.scenario import Scenario
from simgrab.world.scenery.grabs.weight import Mass
from simgrab.world.trajectory.moment import GrabState
from simgrab.world.trajectory.plant import Drive, Forces, Plant, Vector, leaning, turned

# Power series in x = θ² of sin θ/θ, (1 − cos θ)/θ², (θ − sin θ)/θ³: exact to the last digits up to θ = 2.
_TERMS = 14
_SINC, _COSC, _REST = (
    [(-1) ** k / math.factorial(2 * k + first) for k in range(_TERMS)] for first in (1, 2, 3)
)  # fmt: skip
_COSC_1, _REST_1 = ([k * term for k, term in enumerate(series)][1:] for series in (_COSC, _REST))  # by x


def _sum(series: list[float], x: float) -> float:
    total = 0.0
    for term in reversed(series):
        total = total * x + term
    return total


@dataclass(frozen=True, eq=False)
class _Body:
    """A body that leans by p and turns about its own axis, and its motion where p and turn change at constant rates."""

    attitude: Array  # shape (3, 3)
    jacobian: Array  # (3, 3): rate by the rates of (p, turn), the right Jacobian of the rotation vector
    rate: Array  # (3,): angular velocity in its own frame, rad/s
    drift: Array  # (3,): acceleration there at constant rates, rad/s²

    @classmethod
    def at(cls, px: float, py: float, turn: float, ux: float, uy: float, turn_rate: float) -> _Body:
        """Return the body at (p, turn), with their rates."""
        rx, ry, vx, vy = py, -px, uy, -ux  # rotation vector, and its rate
        t, m, b = rx * rx + ry * ry, rx * vx + ry * vy, vx * vx + vy * vy
        s, c, d = _sum(_SINC, t), _sum(_COSC, t), _sum(_REST, t)
        c1, d1 = _sum(_COSC_1, t), _sum(_REST_1, t)
        co, si = math.cos(turn), math.sin(turn)
        about = np.array([[co, -si, 0.0], [si, co, 0.0], [0.0, 0.0, 1.0]])
        lean = np.array([[1 - c * ry * ry, c * rx * ry, s * ry], [c * rx * ry, 1 - c * rx * rx, -s * rx],
                         [-s * ry, s * rx, 1 - c * t]])  # fmt: skip
        e, skewed = 1 - d * t, d * rx * ry
        jacobian = about.T @ [[-skewed, e + d * rx * rx, 0.0], [-e - d * ry * ry, skewed, 0.0], [c * rx, c * ry, 1.0]]
        rate = jacobian @ (ux, uy, turn_rate)
        wx, wy, _ = rate.tolist()
        along, across = 2 * m * m * d1 + d * b, d * m - 2 * m * (d1 * t + d)
        drift = about.T @ (along * rx + across * vx, along * ry + across * vy, -2 * m * c1 * (rx * vy - ry * vx))
        return cls(lean @ about, jacobian, rate, drift + (turn_rate * wy, -turn_rate * wx, 0.0))

    def swept(self, length: float) -> Array:
        """Velocity of the end of a rod along the body's axis by the rates of (p, turn), shape (3, 3)."""
        return np.asarray(length * self.attitude[:, :2] @ (self.jacobian[1], -self.jacobian[0]))

    def drifted(self, length: float) -> Array:
        """Acceleration of the end of that rod at constant rates, shape (3,)."""
        p, q, r = self.rate.tolist()
        up, uq, _ = self.drift.tolist()
        return np.asarray(length * self.attitude @ (uq + p * r, q * r - up, -p * p - q * q))


class LinkedPlant(Plant):
    """Ropes and grab as two links."""

    _acting: Forces
    _step: float  # s

    def __init__(self, scenario: Scenario, drive: Drive) -> None:
        super().__init__(scenario, drive)
        lean, azimuth, yaw, around = self._start(drive.rope)
        p = lean * np.array([np.cos(azimuth), np.sin(azimuth)])
        p_rate = around * np.array([-p[1], p[0]])
        # The grab does not turn about its own axis; a double pendulum begins in line with its ropes.
        turn_rate = around * (1 - math.cos(self._tilt_ratio * lean))
        self._free = np.eye(5)
        if self._joint is None:
            self._free = np.delete(self._free, (2, 3), axis=1)
            self._free[2, 0] = self._free[3, 1] = self._tilt_ratio
        links = 2 if self._joint else 1
        self._at = np.array([*np.tile(p, links), yaw, drive.rope - self.end_height])
        self._speed = np.array([*np.tile(p_rate, links), turn_rate, 0.0])

    def grab_state(self, slew: float, jaw: float, load: float) -> GrabState:  # noqa: D102
        ropes, grab = self._bodies(self._at, self._speed)
        up, along = grab.attitude[:, 2], ropes.attitude[:, 2]
        centre = turned(0.0 - self._at[-1] * along - self.end_height * up, -slew)
        alpha, azimuth, rope = (float(value) for value in geometry.swing_of(centre))
        lean, towards, _ = geometry.swing_of(turned(0.0 - up, -slew))
        yaw = float(geometry.wrap(self._at[-2] - slew))
        return GrabState(alpha, azimuth, rope, yaw, jaw, load, (float(lean), float(towards)))

    def _bodies(self, at: Array, speed: Array) -> tuple[_Body, _Body]:
        """Ropes and grab."""
        (px, py, *grab), (ux, uy, *rate) = (self._free @ at[:-1]).tolist(), (self._free @ speed[:-1]).tolist()
        return _Body.at(px, py, 0.0, ux, uy, 0.0), _Body.at(*grab, *rate)

    def _speeds(self, ropes: _Body, grab: _Body, mass: Mass, length: float) -> tuple[Array, Array]:
        """Speeds of the centre of mass (3), the grab's turn (3) and the ropes' (2) by those of y, and inertias."""
        by_x = np.zeros((8, 5))
        by_x[:3, :2], by_x[:3, 2:] = ropes.swept(-length)[:, :2], grab.swept(mass.centre_z - self.end_height)
        by_x[3:6, 2:], by_x[6:, :2] = grab.jacobian, ropes.jacobian[:2, :2]
        return by_x @ self._free, np.array([mass.mass] * 3 + [*mass.inertia, 0.0, 0.0])

    def _rates(self) -> Array:
        return np.array([body.rate for body in self._bodies(self._at, self._speed)])

    def _paid_out(self) -> tuple[float, float]:
        return float(self._at[-1]) + self.end_height, float(self._speed[-1])

    def _velocity(self, rope: float) -> Vector:
        ropes, grab = self._bodies(self._at, self._speed)
        speeds, _ = self._speeds(ropes, grab, self.mass, rope - self.end_height)
        vx, vy, vz = (speeds[:3] @ self._speed[:-1] - self._speed[-1] * ropes.attitude[:, 2]).tolist()
        return vx, vy, vz

    def _keep_momentum(self, before: Mass, after: Mass) -> None:
        ropes, grab = self._bodies(self._at, self._speed)
        (old, heavy), (new, inertia) = (
            self._speeds(ropes, grab, mass, float(self._at[-1])) for mass in (before, after)
        )
        hoisted = np.concatenate([-self._speed[-1] * ropes.attitude[:, 2], np.zeros(5)])
        momentum = old.T @ (heavy * (old @ self._speed[:-1] + hoisted)) - new.T @ (inertia * hoisted)
        self._speed[:-1] = np.linalg.solve(new.T * inertia @ new, momentum)

    def _apply(self, forces: Forces, seconds: float, steps: int) -> None:
        self._acting, self._step = forces, seconds / steps

    def _advance(self, steps: int) -> None:
        for _ in range(steps):
            self._at, self._speed = self._stepped(self._step)

    def _motion(self, seconds: float) -> Array:
        at, speed = self._stepped(seconds)
        _, change = self._derivative(at, speed)
        ropes, grab = self._bodies(at, speed)
        x, changed = self._free @ at[:-1], self._free @ change[:-1]
        leans = ((math.hypot(*p), math.atan2(p[1], p[0]), turn) for p, turn in ((x[:2], 0.0), (x[2:4], x[4])))
        spins = ropes.jacobian[:, :2] @ changed[:2] + ropes.drift, grab.jacobian @ changed[2:] + grab.drift
        parts = ((leaning(*lean), body.rate, spin)
                 for lean, body, spin in zip(leans, (ropes, grab), spins, strict=True))  # fmt: skip
        length = at[-1] + self.end_height, speed[-1], change[-1]
        return np.concatenate([*(value for part in parts for value in part), length])

    def _stepped(self, step: float) -> tuple[Array, Array]:
        """Take one step of the classical Runge-Kutta method."""
        at, speed = self._at, self._speed
        a, da = self._derivative(at, speed)
        b, db = self._derivative(at + step / 2 * a, speed + step / 2 * da)
        c, dc = self._derivative(at + step / 2 * b, speed + step / 2 * db)
        d, dd = self._derivative(at + step * c, speed + step * dc)
        return at + step / 6 * (a + 2 * b + 2 * c + d), speed + step / 6 * (da + 2 * db + 2 * dc + dd)

    def _derivative(self, at: Array, speed: Array) -> tuple[Array, Array]:
        """Kane's equations, Bᵀ I B ÿ = Bᵀ (F − I drift): derivatives of positions and speeds."""
        # B are the speeds of `_speeds` by ẏ, I their inertias, and drift their rates at constant ẏ.
        mass, acting, hoisting = self.mass, self._acting, float(speed[-1])
        ropes, grab = self._bodies(at, speed)
        speeds, inertia = self._speeds(ropes, grab, mass, float(at[-1]))
        drift = ropes.drifted(-float(at[-1])) + grab.drifted(mass.centre_z - self.end_height)
        sideways = 2 * hoisting * ropes.rate
        drift -= ropes.attitude @ (sideways[1], -sideways[0], acting.rope_acceleration)
        force = np.empty(8)
        force[:3] = acting.push + mass.mass * (acting.gravity - drift)
        p, q, r = grab.rate.tolist()
        ix, iy, iz = mass.inertia
        force[3:6] = ((iy - iz) * q * r, (iz - ix) * r * p, (ix - iy) * p * q - acting.yaw_damping * r)
        force[3:6] -= inertia[3:6] * grab.drift
        force[6:] = -acting.damping * ropes.rate[:2]
        if acting.joint_damping:
            # Friction where the ropes end, against the turn of the grab out of the ropes' line.
            grab_from_ropes = (grab.attitude.T @ ropes.attitude)[:2, :2]
            rubbed = acting.joint_damping * (grab.rate[:2] - grab_from_ropes @ ropes.rate[:2])
            force[3:5] -= rubbed
            force[6:] += grab_from_ropes.T @ rubbed
        push = speeds.T @ force
        push[-1] -= acting.twist * math.sin(at[-2] - acting.heading)
        change = np.linalg.solve(speeds.T * inertia @ speeds, push)
        return speed, np.concatenate([change, [acting.rope_acceleration]])
