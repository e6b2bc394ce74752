"""Grab and ropes as one rigid body, integrated by MuJoCo."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from simgrab.model import geometry
from simgrab.model.geometry import Array
from simgrab.model.scenario import Scenario
from simgrab.world.scenery.grabs.weight import Mass
from simgrab.world.trajectory.moment import GrabState
from simgrab.world.trajectory.plant import Drive, Forces, Plant, Vector, leaning, turned

_HOIST_INERTIA_KG = 1e14  # the hoist moves as commanded whatever the grab pulls


class OneBodyPlant(Plant):
    """A ball joint at O, a slide along the rope, and the grab."""

    def __init__(self, scenario: Scenario, drive: Drive) -> None:
        super().__init__(scenario, drive)
        self._model = _compile(self.mass)
        self._data, self._probe = mujoco.MjData(self._model), mujoco.MjData(self._model)
        lean, azimuth, yaw, around = self._start(drive.rope)
        up = geometry.grab_rotation(lean, azimuth, yaw)[2]  # the vertical, grab frame
        self._data.qpos[:4], self._data.qpos[4] = leaning(lean, azimuth, yaw), -drive.rope
        self._data.qvel[:2] = around * up[:2]

    def grab_state(self, slew: float, jaw: float, load: float) -> GrabState:  # noqa: D102
        w, x, y, z, slide = self._data.qpos.tolist()
        down = turned(np.array([-2 * (x * z + w * y), -2 * (y * z - w * x), 2 * (x * x + y * y) - 1]), -slew)
        alpha, azimuth, _ = geometry.swing_of(down)
        yaw = geometry.wrap(2 * math.atan2(z, w) - slew)
        return GrabState(float(alpha), float(azimuth), -slide, float(yaw), jaw, load)

    def _rates(self) -> Array:
        return np.array([self._data.qvel[:3]] * 2)

    def _paid_out(self) -> tuple[float, float]:
        return -float(self._data.qpos[4]), -float(self._data.qvel[3])

    def _velocity(self, rope: float) -> Vector:
        w, x, y, z, _ = self._data.qpos.tolist()
        p, q, _, out = self._data.qvel.tolist()
        arm = rope - self.mass.centre_z
        ahead = (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y))
        aside = (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x))
        up = (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y))
        vx, vy, vz = (-arm * (q * ahead[i] - p * aside[i]) + out * up[i] for i in range(3))
        return vx, vy, vz

    def _keep_momentum(self, before: Mass, after: Mass) -> None:
        rope, _ = self._paid_out()
        for axis, arms in enumerate((1, 1, 0)):
            old, new = (m.inertia[axis] + arms * m.mass * (rope - m.centre_z) ** 2 for m in (before, after))
            self._data.qvel[axis] *= old / new
        grab = self._model.body("grab").id
        self._model.body_mass[grab] = after.mass
        self._model.body_ipos[grab] = (0.0, 0.0, after.centre_z)
        self._model.body_inertia[grab] = after.inertia

    def _apply(self, forces: Forces, seconds: float, steps: int) -> None:
        model, data = self._model, self._data
        model.opt.timestep = seconds / steps
        model.opt.gravity[:] = forces.gravity
        model.dof_damping[:3] = forces.damping, forces.damping, forces.yaw_damping
        w, x, y, z, _ = data.qpos.tolist()
        p, q, r, _ = data.qvel.tolist()  # about the grab's own axes
        # By how much each of them turns the grab about its rope.
        by_p, by_q = (z * x - w * y) / (w * w + z * z), (w * x + z * y) / (w * w + z * z)
        # Half-way through the interval, or the spring would give energy.
        yaw = 2 * math.atan2(z, w) + (by_p * p + by_q * q + r) * seconds / 2 - forces.heading
        torque = -forces.twist * math.sin(yaw)
        data.qfrc_applied[:] = by_p * torque, by_q * torque, torque, -_HOIST_INERTIA_KG * forces.rope_acceleration
        data.xfrc_applied[2, :3] = forces.push

    def _advance(self, steps: int) -> None:
        if steps:
            mujoco.mj_step(self._model, self._data, steps)

    def _motion(self, seconds: float) -> Array:
        model, data, probe = self._model, self._data, self._probe
        probe.qpos, probe.qvel = data.qpos, data.qvel
        probe.qfrc_applied, probe.xfrc_applied = data.qfrc_applied, data.xfrc_applied
        step, model.opt.timestep = model.opt.timestep, seconds
        if seconds > 1e-12:  # none is left between instants that rounding set apart
            mujoco.mj_step(model, probe)
        mujoco.mj_forward(model, probe)
        model.opt.timestep = step
        body = (*probe.qpos[:4], *probe.qvel[:3], *probe.qacc[:3])
        return np.array([*body, *body, -probe.qpos[4], -probe.qvel[3], -probe.qacc[3]])


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
