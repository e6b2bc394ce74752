"""The grab on its ropes, integrated by MuJoCo in a frame that moves with O but does not turn.

In that frame the pivot rests and the grab feels gravity less O's acceleration, which is what slewing and luffing do to
it; the hoist is a slide that follows its command; the four ropes turn the grab back as a spring does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np

from simgrab.model import geometry
from simgrab.model.geometry import STANDARD_GRAVITY, Array
from simgrab.world.scenery.grabs.design import Design
from simgrab.world.scenery.grabs.weight import Mass
from simgrab.world.scenery.meshes.ropes import Ropes

MOST_STEP_S = 0.005
AIR_KG_M3 = 1.225
HELD_DAMPING = 2.0  # of critical: jaws in the cargo hold the grab
# Moves as commanded whatever the grab pulls; what that adds up to is taken back within seconds.
_HOIST_INERTIA_KG, RETURN_1_S = 1e14, 0.5

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Drive:
    """What acts on the grab during one interval.

    Attributes
    ----------
    gravity : tuple of 3 floats
        Gravity less O's mean acceleration, m/s².
    velocity : tuple of 2 floats
        Of O over the ground, m/s, horizontal.
    heading : float
        Of the jib, rad, half-way through the interval.
    rope, rope_rate, rope_acceleration : float
        Commanded |OA| at the interval's start, and its rate; mean acceleration over the interval.
    wind, push : tuple of 2 floats
        Wind over the ground, m/s; further horizontal acceleration of the grab, m/s².
    held : bool
        The cargo holds the grab.
    """

    gravity: Vector
    velocity: tuple[float, float]
    heading: float
    rope: float
    rope_rate: float
    rope_acceleration: float
    wind: tuple[float, float]
    push: tuple[float, float]
    held: bool


class Hung(NamedTuple):
    """How the grab hangs in the jib frame, rad and m: swing and |OA|, twist about the vertical, and lean of its head.

    ``head`` is angle and azimuth of the grab's own axis; None where it is along OA.
    """

    alpha: float
    azimuth: float
    rope_length: float
    yaw: float
    head: tuple[float, float] | None


def turned(vector: Array, angle: float | Array) -> Array:
    """Turn vectors (..., 3) about z, counter-clockwise."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = np.moveaxis(vector, -1, 0)
    return np.stack([c * x - s * y, s * x + c * y, z], axis=-1)


def spread_m2(grab: Design, ropes: Ropes) -> float:
    """Mean over the ropes of the product of the exit's and the termination's distance from the axis, m²."""
    return float(np.mean(np.sum(np.array(ropes.exits)[:, :2] * grab.terminations[:, :2], axis=1)))


class Plant:
    """The pendulum: a ball joint at O, a slide along the rope, the grab as one rigid body.

    Parameters
    ----------
    grab : Design
    ropes : Ropes
    rope : float
        |OA|, m.
    jaw, load : float
        Opening, rad, and fill.
    damping, yaw_damping : float
        Shares of the critical ones.
    drag_area : float
        Cd·A, m².
    """

    WIDTH = 13
    """Columns of `watch`."""
    ACCELERATIONS = slice(9, 12)
    """Of these, those that belong to `rates`."""

    def __init__(
        self, grab: Design, ropes: Ropes, rope: float, jaw: float, load: float, *, damping: float, yaw_damping: float,
        drag_area: float,
    ) -> None:  # fmt: skip
        self._grab, ends = grab, grab.terminations
        self._spread_m2 = spread_m2(grab, ropes)
        self._termination_z = float(ends[0, 2])
        self._damping, self._yaw_damping, self._drag = damping, yaw_damping, drag_area
        self._jaw, self._load = jaw, load
        self.mass = grab.mass_of(jaw, load)
        self._model = _compile(self.mass)
        self.data, self._probe = mujoco.MjData(self._model), mujoco.MjData(self._model)
        self.data.qpos[4] = -rope

    def hold(self, jaw: float, load: float) -> None:
        """Move the jaws and change the load: cargo leaves with its own speed, moving jaws keep the angular momentum."""
        if (jaw, load) == (self._jaw, self._load):
            return
        before, after = self._grab.mass_of(self._jaw, load), self._grab.mass_of(jaw, load)
        rope = -float(self.data.qpos[4])
        for axis, arms in enumerate((1, 1, 0)):
            old, new = (m.inertia[axis] + arms * m.mass * (rope - m.centre_z) ** 2 for m in (before, after))
            self.data.qvel[axis] *= old / new
        self._jaw, self._load, self.mass = jaw, load, after
        grab = self._model.body("grab").id
        self._model.body_mass[grab] = after.mass
        self._model.body_ipos[grab] = (0.0, 0.0, after.centre_z)
        self._model.body_inertia[grab] = after.inertia

    def start(self, rotation: Array, rate: Array) -> None:
        """Set the attitude, a quaternion (4,) in MuJoCo's order, and the angular velocity (3,), grab frame, rad/s."""
        self.data.qpos[:4], self.data.qvel[:3] = rotation, rate

    def rates(self) -> Array:
        """Angular velocity (3,), grab frame, rad/s."""
        return np.array(self.data.qvel[:3])

    def hung(self, slew: float) -> Hung:
        """Give the grab's state in the jib frame, whose heading is ``slew``, rad."""
        w, x, y, z, slide = self.data.qpos.tolist()
        down = turned(np.array([-2 * (x * z + w * y), -2 * (y * z - w * x), 2 * (x * x + y * y) - 1]), -slew)
        alpha, azimuth, _ = geometry.swing_of(down)
        return Hung(float(alpha), float(azimuth), -slide, 2 * math.atan2(z, w) - slew, None)

    def run(self, drive: Drive, seconds: float, steps: int) -> None:
        """Integrate one interval."""
        self._set_forces(drive, seconds, steps)
        mujoco.mj_step(self._model, self.data, steps)

    def watch(self, drive: Drive, seconds: float, steps: int, instants: Sequence[float]) -> Array:
        """Integrate one interval as `run` does, and give the motion at instants within it.

        Between two steps the motion is that of a shorter step from the first of them, by the same integrator.

        Parameters
        ----------
        drive : Drive
        seconds : float
        steps : int
        instants : sequence of float
            Increasing, since the interval's beginning, s.

        Returns
        -------
        ndarray, shape (n, 13)
            Attitude as a quaternion (4) in MuJoCo's order and the slide, |OA| below O negative, m; angular velocity
            (3), grab frame, rad/s, and the slide's, m/s; angular acceleration (3) and the slide's, rad/s² and m/s².
        """
        self._set_forces(drive, seconds, steps)
        model, data, probe = self._model, self.data, self._probe
        probe.qfrc_applied, probe.xfrc_applied = data.qfrc_applied, data.xfrc_applied
        taken, rows, step = 0, np.empty((len(instants), 13)), seconds / steps
        which = [min(int(instant / step), steps - 1) for instant in instants]
        for row, number, instant in zip(rows, which, instants, strict=True):
            while taken < number:
                mujoco.mj_step(model, data)
                taken += 1
            probe.qpos, probe.qvel = data.qpos, data.qvel
            model.opt.timestep = instant - number * step
            if model.opt.timestep > 1e-12:  # s; none is left between instants that rounding set apart
                mujoco.mj_step(model, probe)
            mujoco.mj_forward(model, probe)
            model.opt.timestep = step
            row[:5], row[5:9], row[9:] = probe.qpos, probe.qvel, probe.qacc
        mujoco.mj_step(model, data, steps - taken)
        return rows

    def _set_forces(self, drive: Drive, seconds: float, steps: int) -> None:
        """Set what acts during an interval."""
        model, data = self._model, self.data
        mass = self.mass
        qpos, qvel = data.qpos, data.qvel
        model.opt.timestep = seconds / steps
        model.opt.gravity[:] = drive.gravity
        weight = mass.mass * STANDARD_GRAVITY
        arm = drive.rope - mass.centre_z  # from O to the centre of mass
        # Swing: critical damping of the compound pendulum, about either axis.
        inertia = mass.inertia[0] + mass.mass * arm * arm
        share = HELD_DAMPING if drive.held else self._damping
        model.dof_damping[0] = model.dof_damping[1] = 2 * share * math.sqrt(weight * arm * inertia)
        # Yaw: the ropes' terminations rise as they turn away from under their exits.
        w, x, y, z = (float(v) for v in qpos[:4])
        p, q, r = (float(v) for v in qvel[:3])  # about the grab's own axes
        # By how much each of them turns the grab about its rope.
        by_p, by_q = (z * x - w * y) / (w * w + z * z), (w * x + z * y) / (w * w + z * z)
        # Half-way through the interval, or the spring would give energy.
        yaw = 2 * math.atan2(z, w) + (by_p * p + by_q * q + r) * seconds / 2 - drive.heading
        stiffness = weight * self._spread_m2 / (drive.rope - self._termination_z)
        model.dof_damping[2] = 2 * (1.0 if drive.held else self._yaw_damping) * math.sqrt(stiffness * mass.inertia[2])
        torque = -stiffness * math.sin(yaw)
        data.qfrc_applied[0], data.qfrc_applied[1], data.qfrc_applied[2] = by_p * torque, by_q * torque, torque
        lag, slip = -drive.rope - float(qpos[4]), -drive.rope_rate - float(qvel[3])
        follow = -drive.rope_acceleration + RETURN_1_S**2 * lag + 2 * RETURN_1_S * slip
        data.qfrc_applied[3] = _HOIST_INERTIA_KG * follow
        # Wind on the grab's own velocity over the ground: O's plus what the swing and the hoist add.
        down = (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y))  # the rope's axis, up
        ahead = (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y))
        aside = (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x))
        out = float(qvel[3])
        own = [-arm * (q * ahead[i] - p * aside[i]) + out * down[i] for i in range(3)]
        rel = (drive.wind[0] - drive.velocity[0] - own[0], drive.wind[1] - drive.velocity[1] - own[1], -own[2])
        force = 0.5 * AIR_KG_M3 * self._drag * math.sqrt(rel[0] ** 2 + rel[1] ** 2 + rel[2] ** 2)
        applied = data.xfrc_applied[2]
        applied[0] = force * rel[0] + mass.mass * drive.push[0]
        applied[1] = force * rel[1] + mass.mass * drive.push[1]
        applied[2] = force * rel[2]


def _compile(mass: Mass) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    option = spec.option
    option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_CONTACT
    rope = spec.worldbody.add_body(name="rope", mass=1e-3, inertia=(1e-3,) * 3, explicitinertial=True)
    rope.add_joint(name="swing", type=mujoco.mjtJoint.mjJNT_BALL)
    grab = rope.add_body(
        name="grab", mass=mass.mass, ipos=(0.0, 0.0, mass.centre_z), inertia=mass.inertia, explicitinertial=True
    )
    grab.add_joint(name="hoist", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=(0, 0, 1), armature=_HOIST_INERTIA_KG)
    return spec.compile()
