"""Ropes and grab as two links: Kane's equations against MuJoCo, Lagrange's equations and closed forms."""

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from conftest import small_scene
from scipy import linalg
from scipy.spatial.transform import Rotation

from simgrab.errors import ScenarioError
from simgrab.model import geometry
from simgrab.model.geometry import STANDARD_GRAVITY
from simgrab.model.scenario import DoublePendulum, FourRopes, Jib, OneBody, Scenario, Start
from simgrab.world.scenery.grabs.four_rope import four_rope
from simgrab.world.scenery.meshes.ropes import Ropes
from simgrab.world.trajectory.clip import _begin
from simgrab.world.trajectory.hanging import hung, rope_lean
from simgrab.world.trajectory.iid import draw
from simgrab.world.trajectory.linked import LinkedPlant
from simgrab.world.trajectory.moment import GrabState, JibState, Moment, Tilt
from simgrab.world.trajectory.plant import Drive, Plant
from simgrab.world.trajectory.trajectory import Trajectory

GRAB, ROPES = four_rope(), Ropes.of(Jib(), 4)
HEIGHT = float(GRAB.terminations[0, 2])
BELOW = HEIGHT - GRAB.mass_of(0.0, 0.0).centre_z
ROUND = Start(alpha_deg=8.0, azimuth_deg=30.0, roundness=0.5, yaw_deg=5.0)
FREE = DoublePendulum(damping=0.0)


def still(rope=20.0, **changes):
    drive = Drive((0, 0, -STANDARD_GRAVITY), (0.0, 0.0), 0.0, rope, 0.0, 0.0, (0.0, 0.0), (0.0, 0.0), False)
    return replace(drive, **changes)


def linked(suspension, start=ROUND, rope=20.0, **shares):
    shares = {"damping": 0.0, "yaw_damping": 0.0, "drag_area": 0.0} | shares
    plant = LinkedPlant(GRAB, ROPES, rope, 0.0, 0.0, suspension=suspension, **shares)
    plant.begin(start)
    return plant


@pytest.mark.parametrize("suspension", [FourRopes(), FourRopes(tilt_ratio=0.2), FourRopes(tilt_ratio=-0.125), FREE])
def test_energy_stays(suspension):
    plant = linked(suspension)
    bottom = -plant.mass.mass * STANDARD_GRAVITY * (20.0 - plant.mass.centre_z)
    energy = []
    for _ in range(150):
        energy.append(plant.energy() - bottom)
        plant.run(still(), 0.02, 4)
    assert np.ptp(energy) < 1e-11 * energy[0]
    slower = linked(suspension, damping=0.005)
    for _ in range(60):
        slower.run(still(), 0.02, 4)
    assert slower.energy() - bottom < 0.995 * energy[0]


def test_friction_at_the_rope_ends_takes_what_it_rubs_away():
    """dE/dt is minus the friction times the square of the rate at which the grab turns out of the ropes' line."""
    plant, step = linked(DoublePendulum(damping=0.2)), 0.005
    for _ in range(5):
        plant.run(still(), 0.02, 4)
    energy, powers = [plant.energy()], []
    for _ in range(2):
        frame, forces = plant._frame(plant._at, plant._speed), plant._forces(still())
        direction, rate = frame.rope.direction, frame.rope.jacobian @ frame.rope_rate
        out = frame.rate - frame.attitude.T @ np.cross(direction, rate)
        powers.append(forces.joint_damping * (out[0] ** 2 + out[1] ** 2))
        plant.run(still(), step, 1)
        energy.append(plant.energy())
    assert (energy[1] - energy[0]) / step == pytest.approx(-np.mean(powers), rel=1e-3)
    assert powers[0] > 0.1


@pytest.mark.parametrize(("azimuth", "axis"), [(0.0, 1), (90.0, 0)])
@pytest.mark.parametrize("mode", [0, 1])
def test_a_double_pendulum_has_its_two_eigenfrequencies(azimuth, axis, mode):
    """Begun in one mode of the linear equations, a small swing stays in it and comes back after its period."""
    length, m = 20.0 - HEIGHT, GRAB.mass_of(0.0, 0.0)
    inertia = m.mass * np.array([[length**2, length * BELOW], [length * BELOW, BELOW**2 + m.inertia[axis] / m.mass]])
    stiffness = m.mass * STANDARD_GRAVITY * np.diag([length, BELOW])
    squares, shapes = linalg.eigh(stiffness, inertia)
    frequency, (rope, grab) = math.sqrt(squares[mode]), shapes[:, mode] / np.abs(shapes[:, mode]).max() * 1e-4
    plant = linked(FREE, Start(azimuth_deg=azimuth))
    out = np.array([math.cos(math.radians(azimuth)), math.sin(math.radians(azimuth))])
    plant._at[:2] = rope * out
    plant._at[2:6] = Rotation.from_rotvec(grab * np.array([out[1], -out[0], 0.0])).as_quat(scalar_first=True)
    for part in range(1, 5):
        plant.run(still(), math.pi / 2 / frequency, 400)
        lean = plant._at[:2] @ out, (2 * plant._at[3:5]) @ (out[1], -out[0])
        np.testing.assert_allclose(lean, math.cos(part * math.pi / 2) * np.array([rope, grab]), atol=1e-11)


@pytest.mark.parametrize("ratio", [0.0, 0.3, 1.0])
def test_the_period_on_four_ropes_is_that_of_its_kinematics(ratio):
    """A pendulum of inertia m(l + κb)² + κ²I and stiffness m g (l + κ²b), with κ the ratio and b from T to the mass."""
    plant, length, m = linked(FourRopes(tilt_ratio=ratio), Start(alpha_deg=0.01)), 20.0 - HEIGHT, GRAB.mass_of(0.0, 0.0)
    inertia = m.mass * (length + ratio * BELOW) ** 2 + ratio**2 * m.inertia[1]
    frequency = math.sqrt(m.mass * STANDARD_GRAVITY * (length + ratio**2 * BELOW) / inertia)
    first = plant._at[0]
    plant.run(still(), 2 * math.pi / frequency, 1000)
    assert plant._at[0] == pytest.approx(first, rel=1e-9)
    assert plant._speed[0] == pytest.approx(0.0, abs=1e-7 * first)
    plant.run(still(), math.pi / 2 / frequency, 250)
    assert plant._at[0] == pytest.approx(0.0, abs=1e-7 * first)


def test_a_ratio_of_one_is_grab_and_ropes_as_one_body():
    shares = {"damping": 0.01, "yaw_damping": 0.05, "drag_area": 10.0}
    one = Plant(GRAB, ROPES, 20.0, 0.0, 0.0, **shares)
    one.start(*_begin(ROUND, one.mass, 20.0))
    other = linked(FourRopes(tilt_ratio=1.0), **shares)
    np.testing.assert_allclose(other.rates()[2:], one.rates(), atol=1e-15)
    for i in range(200):
        # Slow wind, push, hoist and turn at once, and a load and jaws that change.
        t = 0.02 * i
        rate = -0.5 if i >= 50 else -0.01 * i
        rope = 20.0 - 0.25 * min(t, 1.0) ** 2 - 0.5 * max(t - 1.0, 0.0)
        drive = still(
            rope, rope_rate=rate, rope_acceleration=-0.5 if i < 50 else 0.0, wind=(5.0, 3.0), push=(0.02, -0.01),
            velocity=(0.3, 0.0), heading=0.001 * i, gravity=(0.1, -0.2, -STANDARD_GRAVITY),
        )  # fmt: skip
        for plant in (one, other):
            plant.hold(0.2 + 0.001 * i, 0.0)
            plant.run(drive, 0.02, 4)
    ours, theirs = other.hung(0.1), one.hung(0.1)
    # Its ropes turn the grab back continuously, the one body's in steps of 20 ms.
    np.testing.assert_allclose(ours[:4], theirs[:4], atol=2e-6)
    np.testing.assert_allclose(ours.head, ours[:2], atol=1e-12)


def test_a_double_pendulum_moves_as_mujocos_does():
    """MuJoCo's tree of hinges, slide and ball joint, on a massless rope, while the ropes are hauled in."""
    m, rate, h = GRAB.mass_of(0.0, 0.0), -0.4, 0.002
    plant = linked(FREE, ROUND)
    plant._spread_m2, plant._speed[-1] = 0.0, rate
    spec = mujoco.MjSpec()
    spec.option.integrator, spec.option.timestep = mujoco.mjtIntegrator.mjINT_RK4, h
    spec.option.gravity = (0.3, -0.2, -STANDARD_GRAVITY)
    tiny = {"mass": 1e-9, "inertia": (1e-9,) * 3, "explicitinertial": True}
    first = spec.worldbody.add_body(**tiny)
    first.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, axis=(0, 1, 0))
    second = first.add_body(**tiny)
    second.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, axis=(1, 0, 0))
    end = second.add_body(**tiny)
    end.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=(0, 0, 1), armature=1e14)
    grab = end.add_body(mass=m.mass, ipos=(0, 0, -BELOW), inertia=m.inertia, explicitinertial=True)
    grab.add_joint(type=mujoco.mjtJoint.mjJNT_BALL)
    model = spec.compile()
    data = mujoco.MjData(model)
    direction = plant._frame(plant._at, plant._speed).rope.direction
    a, b = math.atan2(-direction[0], -direction[2]), math.asin(direction[1])
    data.qpos[:3] = a, b, -plant._at[-1]
    jacobian = plant._frame(plant._at, plant._speed).rope.jacobian
    dx, dy, dz = jacobian @ plant._speed[:2]
    away = direction[0] ** 2 + direction[2] ** 2
    data.qvel[:3] = (dx * direction[2] - dz * direction[0]) / away, dy / math.cos(b), -rate
    held = Rotation.from_euler("y", a) * Rotation.from_euler("x", b)
    attitude = Rotation.from_quat(plant._at[2:6], scalar_first=True)
    data.qpos[3:7] = (held.inv() * attitude).as_quat(scalar_first=True)
    link = np.array([0.0, data.qvel[0], 0.0]) + Rotation.from_euler("y", a).apply([data.qvel[1], 0.0, 0.0])
    data.qvel[3:6] = plant._speed[2:5] - attitude.inv().apply(link)
    drive = still(gravity=(0.3, -0.2, -STANDARD_GRAVITY))
    for i in range(800):
        plant.run(replace(drive, rope=20.0 + rate * h * i, rope_rate=rate), h, 1)
        mujoco.mj_step(model, data)
    mujoco.mj_kinematics(model, data)
    found = plant._frame(plant._at, plant._speed)
    np.testing.assert_allclose(plant._at[-1] * found.rope.direction, data.xpos[grab.id], atol=2e-7)
    np.testing.assert_allclose(found.attitude, data.xmat[grab.id].reshape(3, 3), atol=2e-7)
    assert abs(found.attitude[2, 0]) + abs(found.attitude[2, 1]) > 0.01


def slope(function, at, step):
    """Derivative of a function of one number, of fourth order."""
    near, far = (function(at + d * step) - function(at - d * step) for d in (1, 2))
    return (8 * near - far) / (12 * step)


def moved(values, i, by):
    values = np.array(values, float)
    values[i] += by
    return values


@pytest.mark.parametrize("ratio", [-0.3, 0.2, 0.7])
def test_four_ropes_obey_lagranges_equations(ratio):
    """d/dt ∂L/∂q̇ = ∂L/∂q, from differences of a Lagrangian written with SciPy's rotations and no Jacobian."""
    m, rng, tick = GRAB.mass_of(0.0, 0.0), np.random.default_rng(3), 1e-4
    drive = still(19.0, rope_rate=-0.7, rope_acceleration=0.4, gravity=(0.4, -0.3, -9.0), heading=0.1)
    plant = linked(FourRopes(tilt_ratio=ratio))
    twist = m.mass * STANDARD_GRAVITY * plant._spread_m2 / (19.0 - HEIGHT)
    q, v = np.array([*rng.uniform(-0.4, 0.4, 2), 0.3]), rng.uniform(-0.3, 0.3, 3)
    plant._at, plant._speed = np.array([*q, 19.0 - HEIGHT]), np.array([*v, -0.7])
    _, change = plant._derivative(plant._at, plant._speed, plant._forces(drive))

    def place(q, t):
        lean, length = np.array([q[1], -q[0], 0.0]), 19.0 - HEIGHT - 0.7 * t + 0.2 * t * t
        grab = Rotation.from_rotvec(ratio * lean) * Rotation.from_euler("z", q[2])
        return Rotation.from_rotvec(lean).apply([0.0, 0.0, -length]) + grab.apply([0.0, 0.0, -BELOW]), grab

    def lagrangian(q, v, t):
        (before, first), (after, last) = place(q - tick * v, t - tick), place(q + tick * v, t + tick)
        speed, rate = (after - before) / (2 * tick), (first.inv() * last).as_rotvec() / (2 * tick)
        kinetic = m.mass * speed @ speed / 2 + rate @ (np.array(m.inertia) * rate) / 2
        return kinetic + m.mass * (before + after) / 2 @ drive.gravity + twist * math.cos(q[2] - 0.1)

    def momentum(t, i):
        here, speed = q + t * v + t * t / 2 * change[:3], v + t * change[:3]
        return slope(lambda by: lagrangian(here, moved(speed, i, by), t), 0.0, 1e-2)

    for i in range(3):
        force = slope(lambda by, i=i: lagrangian(moved(q, i, by), v, 0.0), 0.0, 1e-3)
        rate = slope(lambda t, i=i: momentum(t, i), 0.0, 1e-2)
        assert rate == pytest.approx(force, abs=0.3)  # N m, of 1e6


def test_moving_jaws_keep_the_momentum_of_a_grab_that_its_ropes_lower():
    plant = linked(FREE)
    plant._speed[-1] = 0.5
    for i in range(50):  # out of line
        plant.run(still(20.0 + 0.5 * 0.02 * i, rope_rate=0.5), 0.02, 1)
    frame = plant._frame(plant._at, plant._speed)

    def momentum(mass):
        inertia, arm = plant._inertia(frame, mass, plant._at[-1])
        return inertia @ plant._speed[:-1] + mass.mass * arm.T @ frame.rope.direction * 0.5

    before = momentum(plant.mass)
    plant.hold(0.5, 0.0)
    np.testing.assert_allclose(momentum(plant.mass), before, rtol=1e-12, atol=1e-6)
    speeds = plant._speed.copy()
    plant.hold(0.5, 0.8)  # cargo takes its own speed along
    np.testing.assert_allclose(plant._speed, speeds, atol=1e-12)


@pytest.mark.parametrize("ratio", [-0.2, 0.0, 0.2, 1.0])
def test_the_head_leans_by_its_ratio_and_a_stays_where_alpha_has_it(ratio):
    for alpha in np.radians((0.0, 1e-6, 3.0, 20.0, 60.0)):
        grab = hung(GrabState(alpha, 0.7, 12.0, 0.1, 0.0, 0.0), FourRopes(tilt_ratio=ratio), HEIGHT)
        pose = grab.jib_from_grab
        np.testing.assert_allclose(pose[:3, 3], geometry.grab_centre(alpha, 0.7, 12.0), atol=1e-12)
        top = pose[:3, 3] + HEIGHT * pose[:3, 2]
        lean = math.atan2(math.hypot(top[0], top[1]), -top[2])
        assert grab.head[0] == pytest.approx(ratio * lean, abs=1e-13)
        assert lean == pytest.approx(rope_lean(alpha, HEIGHT / 12.0, ratio), abs=1e-13)
        if ratio == 0.0:
            np.testing.assert_allclose(pose[:3, 2], [0, 0, 1], atol=1e-15)
        if ratio == 1.0:
            rigid = GrabState(alpha, 0.7, 12.0, 0.1, 0.0, 0.0).jib_from_grab
            np.testing.assert_allclose(pose, rigid, atol=1e-13)


def test_physics_and_independent_frames_have_the_same_kinematics():
    suspension = {"model": "four-rope", "tilt_ratio": 0.2}
    moving = small_scene(
        swing={"model": "dynamic"}, swing__start={"alpha_deg": 6.0, "roundness": 0.4}, suspension=suspension
    )
    shown = [Trajectory(moving).at(frame).grab for frame in (0, 3)]
    for grab in shown:
        assert grab.head == pytest.approx(hung(replace(grab, head=None), moving.suspension, HEIGHT).head, abs=1e-13)
    assert shown[0].alpha == pytest.approx(math.radians(6.0), abs=1e-14)
    still_one = draw(small_scene(suspension=suspension), 2).grab
    assert still_one.head[0] == pytest.approx(0.2 * still_one.alpha, rel=0.2)
    assert draw(small_scene(), 2).grab == replace(still_one, head=None)


def test_between_two_moments_the_head_leans_between():
    one, other = (GrabState(a, 0.0, 20.0, 0.0, 0.0, 0.0, head=(0.2 * a, 0.0)) for a in (-0.0, 0.1))
    moments = [Moment.still(0, grab, Tilt(0.0, 0.0, 0.0)) for grab in (one, other)]
    jib = JibState(0.0, 25.0, 0.0)
    ahead = replace(moments[1], time=0.02, jib=jib)
    middle = replace(moments[0], time=0.0, jib=jib, ahead=ahead).shifted(0.01)
    assert middle.grab.head == pytest.approx((0.01, 0.0))


def test_a_scenario_on_the_usual_suspension_is_written_as_ever():
    assert "suspension" not in Scenario().to_dict()
    assert Scenario(suspension=OneBody()).digest() == Scenario().digest()
    assert Scenario(suspension=FourRopes()).digest() != Scenario().digest()
    with pytest.raises(ScenarioError, match="independent frames have no second swing"):
        Scenario(suspension=DoublePendulum())
