"""The grab on its ropes, in a frame that moves with O but does not turn.

In that frame the pivot rests and the grab feels gravity less O's acceleration, which is the effect of slewing and
luffing; the hoist follows its command; the ropes turn the grab back as a spring does. `Plant` holds what all
suspensions share; the equations of motion are in `simgrab.world.trajectory.one_body` and
`simgrab.world.trajectory.linked`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from simgrab.model.geometry import STANDARD_GRAVITY, Array
from simgrab.model.scenario import DoublePendulum, Dynamic, FourRopes, Scenario
from simgrab.world.scenery.grabs import design_of
from simgrab.world.scenery.grabs.weight import Mass
from simgrab.world.scenery.meshes.ropes import Ropes
from simgrab.world.trajectory.hanging import rope_lean
from simgrab.world.trajectory.moment import GrabState

MOST_STEP_S = 0.005
AIR_KG_M3 = 1.225
HELD_DAMPING = 2.0  # of critical: jaws in the cargo hold the grab
_RETURN_1_S = 0.5  # what the rope differs from its command is taken back within seconds

WIDTH = 23
"""Columns of the motion that `Plant.run` gives: those of the ropes and of the grab, and three of the length."""
ROPES, GRAB = slice(0, 10), slice(10, 20)
"""Of a body: attitude as a quaternion (4), scalar first; angular velocity (3), rad/s, and acceleration (3), rad/s²,
in its own frame, whose z axis points up along it."""
LENGTH = slice(20, 23)
"""Rope paid out, |OT| + |TA|, m; its rate, m/s, and acceleration, m/s². T is the middle of the rope ends."""

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Drive:
    """Inputs that act on the grab during one interval."""

    gravity: Vector  # gravity less O's mean acceleration, m/s²
    velocity: tuple[float, float]  # velocity of O over the ground, m/s, horizontal
    heading: float  # heading of the jib, rad, half-way through the interval
    # rope, rope_rate, rope_acceleration: commanded |OA| at the interval's start, and its rate; mean acceleration over
    # the interval
    rope: float
    rope_rate: float
    rope_acceleration: float
    # wind, push: wind over the ground, m/s; further horizontal acceleration of the grab, m/s²
    wind: tuple[float, float]
    push: tuple[float, float]
    held: bool  # the cargo holds the grab
    # jaw, load: opening, rad, and fill
    jaw: float
    load: float


class Forces(NamedTuple):
    """Forces during one interval, as input of the equations of motion."""

    gravity: Vector  # m/s²
    push: Vector  # force on the centre of mass without weight, N
    rope_acceleration: float  # acceleration of the rope paid out, m/s²
    # twist, heading: stiffness against yaw, N m/rad, and the yaw without torque, rad
    twist: float
    heading: float
    # damping, yaw_damping, joint_damping: damping of the swing, of the yaw, and of the grab against its ropes, N m s
    damping: float
    yaw_damping: float
    joint_damping: float


def turned(vector: Array, angle: float | Array) -> Array:
    """Turn vectors (..., 3) about z, counter-clockwise."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = np.moveaxis(vector, -1, 0)
    return np.stack([c * x - s * y, s * x + c * y, z], axis=-1)


class Plant(ABC):
    """The grab on its ropes, as a clip of a scenario with dynamic swing begins: by its first drive.

    Attributes
    ----------
    mass : Mass
    end_height : float
        Height of T, the middle of the rope ends, in the grab's frame, m.
    """

    def __init__(self, scenario: Scenario, drive: Drive) -> None:
        assert isinstance(scenario.swing, Dynamic)
        suspension = scenario.suspension
        self._swing, self._design = scenario.swing, design_of(scenario.grab)
        ends = self._design.terminations
        exits = np.array(Ropes.of(scenario.jib, len(ends)).exits)
        self._spread_m2 = float(np.mean(np.sum(exits[:, :2] * ends[:, :2], axis=1)))
        self.end_height = float(ends[0, 2])
        self._tilt_ratio = suspension.tilt_ratio if isinstance(suspension, FourRopes) else 1.0
        self._joint = suspension if isinstance(suspension, DoublePendulum) else None
        area = self._swing.drag_area_m2
        self._drag = self._design.cd_a_m2 if area is None else area
        self._jaw, self._load = drive.jaw, drive.load
        self.mass = self._design.mass_of(drive.jaw, drive.load)

    def run(self, drive: Drive, seconds: float, steps: int, instants: Sequence[float] = ()) -> Array:
        """Integrate one interval, and return the motion at instants within it.

        Cargo leaves with its own speed, and moving jaws keep the momentum: the resulting change of angular velocity at
        the interval's beginning counts as acceleration throughout the interval. Between two steps the motion is that of
        a shorter step from the first of them, by the same integrator.

        The instants, s, count from the interval's beginning and increase; the motion has the shape (n, `WIDTH`).
        """
        before = self._rates() if instants else np.zeros((2, 3))
        self._hold(drive.jaw, drive.load)
        jump = (self._rates() - before) / seconds if instants else before
        self._apply(self._forces(drive), seconds, steps)
        taken, rows, step = 0, [], seconds / steps
        for instant in instants:
            number = min(int(instant / step), steps - 1)
            self._advance(number - taken)
            taken = number
            rows.append(self._motion(instant - number * step))
            rows[-1][:20].reshape(2, 10)[:, 7:] += jump
        self._advance(steps - taken)
        return np.reshape(rows, (-1, WIDTH))

    def _hold(self, jaw: float, load: float) -> None:
        """Move the jaws and change the load."""
        if (jaw, load) == (self._jaw, self._load):
            return
        before, self.mass = self._design.mass_of(self._jaw, load), self._design.mass_of(jaw, load)
        self._jaw, self._load = jaw, load
        self._keep_momentum(before, self.mass)

    def _forces(self, drive: Drive) -> Forces:
        """Compute an interval's forces: aerodynamic drag ½ρ Cd·A |v|v, the ropes' spring against yaw, and frictions."""
        # Frictions are shares of the critical one, 2√(stiffness · inertia). The ropes' ends rise as they turn away from
        # under their exits: the stiffness is m g s²/z, s² being the mean product of distances of exits and ends from
        # the axis, and z the height between them.
        mass = self.mass
        paid_out, rate = self._paid_out()
        lag, slip = drive.rope - paid_out, drive.rope_rate - rate
        stiffness, inertia = self._pendulum(drive.rope)
        twist = mass.mass * STANDARD_GRAVITY * self._spread_m2 / (drive.rope - self.end_height)
        own = self._velocity(drive.rope)  # of the grab over the ground: O's plus what swing and hoist add
        rel = (drive.wind[0] - drive.velocity[0] - own[0], drive.wind[1] - drive.velocity[1] - own[1], -own[2])
        force = 0.5 * AIR_KG_M3 * self._drag * math.sqrt(rel[0] ** 2 + rel[1] ** 2 + rel[2] ** 2)
        damping, yaw_damping = (HELD_DAMPING, 1.0) if drive.held else (self._swing.damping, self._swing.yaw_damping)
        joint_damping = 0.0
        if self._joint is not None:
            below = self.end_height - mass.centre_z
            tilting = math.sqrt(mass.mass * STANDARD_GRAVITY * below * (mass.inertia[0] + mass.mass * below**2))
            joint_damping = 2 * (HELD_DAMPING if drive.held else self._joint.damping) * tilting
        return Forces(
            gravity=drive.gravity,
            push=(
                force * rel[0] + mass.mass * drive.push[0], force * rel[1] + mass.mass * drive.push[1], force * rel[2],
            ),
            rope_acceleration=drive.rope_acceleration + _RETURN_1_S**2 * lag + 2 * _RETURN_1_S * slip,
            twist=twist, heading=drive.heading,
            damping=2 * damping * math.sqrt(stiffness * inertia),
            yaw_damping=2 * yaw_damping * math.sqrt(twist * mass.inertia[2]),
            joint_damping=joint_damping,
        )  # fmt: skip

    def _pendulum(self, rope: float) -> tuple[float, float]:
        """Stiffness, N m, and inertia, kg m², of small swings, in which the grab leans by κ times its ropes' lean."""
        # m g (l + κ² b) and m (l + κ b)² + κ² I, with l = |OT| and b from T down to the centre of mass.
        mass, ratio = self.mass, self._tilt_ratio
        arm, below = rope - mass.centre_z, self.end_height - mass.centre_z
        lever = arm - (1 - ratio) * below
        stiffness = mass.mass * STANDARD_GRAVITY * (arm - (1 - ratio**2) * below)
        return stiffness, ratio**2 * mass.inertia[0] + mass.mass * lever * lever

    def _start(self, rope: float) -> tuple[float, float, float, float]:
        """Lean of the ropes, its azimuth and the yaw with which a clip begins, rad, and the azimuth's rate, rad/s."""
        start = self._swing.start
        alpha, azimuth, yaw = np.radians((start.alpha_deg, start.azimuth_deg, start.yaw_deg))
        lean = rope_lean(float(alpha), self.end_height / (rope - self.end_height), self._tilt_ratio, of_ropes=True)
        stiffness, inertia = self._pendulum(rope)
        around = start.roundness * math.sqrt(stiffness / inertia) * (lean / math.sin(lean) if lean else 1.0)
        return lean, azimuth, yaw, around

    @abstractmethod
    def grab_state(self, slew: float, jaw: float, load: float) -> GrabState:
        """Return the grab's state in the jib frame, whose heading is ``slew``, rad."""

    @abstractmethod
    def _rates(self) -> Array:
        """Angular velocities of ropes and grab, each in its own frame, rad/s, shape (2, 3)."""

    @abstractmethod
    def _paid_out(self) -> tuple[float, float]:
        """Rope paid out, m, and its rate, m/s."""

    @abstractmethod
    def _velocity(self, rope: float) -> Vector:
        """Velocity of the centre of mass in the plant's frame, m/s, for a length of rope paid out, m."""

    @abstractmethod
    def _keep_momentum(self, before: Mass, after: Mass) -> None:
        """Change the grab's mass distribution, and keep its momentum."""

    @abstractmethod
    def _apply(self, forces: Forces, seconds: float, steps: int) -> None:
        """Set the forces of an interval, and its steps."""

    @abstractmethod
    def _advance(self, steps: int) -> None:
        """Integrate some steps."""

    @abstractmethod
    def _motion(self, seconds: float) -> Array:
        """Return the motion a part of a step ahead, shape (`WIDTH`,), without changing the state."""


def leaning(lean: float, azimuth: float, yaw: float) -> Array:
    """Quaternion (4,), scalar first, of `simgrab.model.geometry.grab_rotation`."""
    half = lean / 2
    w, x, y = np.cos(half), np.sin(half) * np.sin(azimuth), -np.sin(half) * np.cos(azimuth)
    c, s = np.cos(yaw / 2), np.sin(yaw / 2)
    return np.array([w * c, x * c + y * s, y * c - x * s, w * s])
