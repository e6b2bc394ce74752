"""The equations of motion of all suspensions: d'Alembert's principle, conserved quantities and closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest
from conftest import small_scene
from scipy import linalg
from scipy.spatial.transform import Rotation

from simgrab.model import geometry
from simgrab.model.geometry import STANDARD_GRAVITY
from simgrab.model.scenario import FourRopes, Jib
from simgrab.world.scenery.grabs.four_rope import four_rope
from simgrab.world.scenery.meshes.ropes import Ropes
from simgrab.world.trajectory.clip import ClipMotion
from simgrab.world.trajectory.hanging import hung, rope_lean
from simgrab.world.trajectory.iid import draw
from simgrab.world.trajectory.moment import GrabState, JibState, Moment, Tilt
from simgrab.world.trajectory.plant import AIR_KG_M3, Drive
from simgrab.world.trajectory.trajectory import Trajectory

DESIGN, EXITS = four_rope(), np.array(Ropes.of(Jib(), 4).exits)
HEIGHT = float(DESIGN.terminations[0, 2])
SPREAD_M2 = np.mean(np.sum(EXITS[:, :2] * DESIGN.terminations[:, :2], axis=1))
STILL = Drive((0, 0, -STANDARD_GRAVITY), (0.0, 0.0), 0.0, 20.0, 0.0, 0.0, (0.0, 0.0), (0.0, 0.0), False, 0.0, 0.0)
ROUND = {"alpha_deg": 8.0, "azimuth_deg": 30.0, "roundness": 0.5, "yaw_deg": 5.0}
ONE, DOUBLE = {"model": "one-body"}, {"model": "double-pendulum", "damping": 0.0}
ROPES = [{"model": "four-rope", "tilt_ratio": ratio} for ratio in (-0.3, 0.0, 0.2, 1.0)]
ALL = [ONE, *ROPES, DOUBLE]


def made(suspension, start=ROUND, drive=STILL, **swing):
    swing = {"model": "dynamic", "damping": 0.0, "yaw_damping": 0.0, "drag_area_m2": 0.0, "start": start} | swing
    return ClipMotion(small_scene(swing=swing, suspension=suspension), 0).plant(drive)


def played(plant, drive, seconds, count, steps=4):
    """Motion at the beginnings of so many intervals."""
    return np.concatenate([plant.run(drive, seconds, steps, [0.0]) for _ in range(count)])


def ratio_of(suspension):
    return suspension.get("tilt_ratio", 1.0)


def free(suspension):
    """(p of the ropes, p of the grab, turn) by those that are free."""
    if suspension["model"] == "double-pendulum":
        return np.eye(5)
    k = ratio_of(suspension)
    return np.array([[1, 0, 0], [0, 1, 0], [k, 0, 0], [0, k, 0], [0, 0, 1.0]])


class State:
    """A row of motion: attitudes, angular velocities and accelerations of ropes and grab, and the length to T."""

    def __init__(self, row, mass):
        self.ropes, self.grab = (Rotation.from_quat(row[k : k + 4], scalar_first=True) for k in (0, 10))
        self.spun, self.spin, self.rate, self.acceleration = row[4:7], row[7:10], row[14:17], row[17:20]
        self.length, self.hoist, self.haul = row[20] - HEIGHT, row[21], row[22]
        self.mass, self.lever = mass, np.array([0.0, 0.0, mass.centre_z - HEIGHT])
        turns = [2 * math.atan2(row[k + 3], row[k]) for k in (0, 10)]  # one body's ropes turn with the grab
        bodies = zip((self.ropes, self.grab), turns, strict=True)
        self.level, lean = (body * Rotation.from_euler("z", -turn) for body, turn in bodies)
        leans = (self.level.as_rotvec(), lean.as_rotvec())
        self.x = np.array([*(part for lean in leans for part in (-lean[1], lean[0])), turns[1]])
        self.swept = Rotation.from_euler("z", turns[0]).apply(self.spun * (1.0, 1.0, 0.0))

    @property
    def velocity(self):
        rod = np.array([0.0, 0.0, -self.length])
        along = self.ropes.apply(np.cross(self.spun, rod) - (0.0, 0.0, self.hoist))
        return along + self.grab.apply(np.cross(self.rate, self.lever))

    @property
    def pull(self):
        """Acceleration of the centre of mass."""
        rod, up = np.array([0.0, 0.0, -self.length]), np.array([0.0, 0.0, 1.0])
        along = np.cross(self.spin, rod) + np.cross(self.spun, np.cross(self.spun, rod))
        along -= 2 * self.hoist * np.cross(self.spun, up) + self.haul * up
        own = np.cross(self.acceleration, self.lever) + np.cross(self.rate, np.cross(self.rate, self.lever))
        return self.ropes.apply(along) + self.grab.apply(own)

    def place(self, x):
        ropes, lean = (Rotation.from_rotvec([p[1], -p[0], 0.0]) for p in (x[:2], x[2:4]))
        grab = lean * Rotation.from_euler("z", x[4])
        return ropes.apply([0.0, 0.0, -self.length]) + grab.apply(self.lever), ropes, grab

    def virtual(self):
        """Displacements of the centre of mass, of the ropes' and the grab's rotation by x, shape (5, 3) each."""
        moves = []
        for way in 1e-6 * np.eye(5):
            (c0, r0, g0), (c1, r1, g1) = self.place(self.x - way), self.place(self.x + way)
            moves.append([c1 - c0, (r0.inv() * r1).as_rotvec(), (g0.inv() * g1).as_rotvec()])
        return np.moveaxis(np.array(moves) / 2e-6, 1, 0)

    def bent(self, swept, rate):
        """Turn of the grab out of its ropes' line, about its own x and y."""
        return (rate - (self.grab.inv() * self.level).apply(swept * (1.0, 1.0, 0.0)))[..., :2]

    @property
    def energy(self):
        m, weight = self.mass, self.mass.mass * STANDARD_GRAVITY
        moving = m.mass * self.velocity @ self.velocity + self.rate @ (m.inertia * self.rate)
        twist = weight * SPREAD_M2 / self.length * (1 - math.cos(self.x[4]))
        return moving / 2 + weight * (self.place(self.x)[0][2] + self.length - self.lever[2]) + twist


@pytest.mark.parametrize("suspension", ALL)
def test_inertial_forces_balance_in_every_direction_that_is_free(suspension):
    """d'Alembert's principle, with virtual displacements from differences of SciPy's rotations."""
    changes = {"damping": 0.02} if suspension is DOUBLE else {}
    plant = made(suspension | changes, damping=0.03, yaw_damping=0.2, drag_area_m2=12.0)
    hauled = replace(STILL, rope_acceleration=-0.7, gravity=(0.4, -0.3, -9.0), push=(0.5, -0.2))
    played(plant, hauled, 0.02, 40)
    row = plant.run(hauled, 1e-9, 1, [0.0])[0]
    drive = replace(
        hauled,
        rope=row[20],
        rope_rate=row[21],
        rope_acceleration=0.4,
        heading=0.1,
        wind=(9.0, -5.0),
        velocity=(1.0, 2.0),
    )
    now = State(plant.run(drive, 1e-6, 1, [0.0])[0], plant.mass)
    m, ratio, below = now.mass, ratio_of(suspension), -now.lever[2]
    stiffness = m.mass * STANDARD_GRAVITY * (now.length + ratio**2 * below)
    inertia = m.mass * (now.length + ratio * below) ** 2 + ratio**2 * m.inertia[0]
    twist = m.mass * STANDARD_GRAVITY * SPREAD_M2 / now.length
    tilting = m.mass * STANDARD_GRAVITY * below, m.inertia[0] + m.mass * below**2
    rel = np.array([*drive.wind, 0.0]) - (*drive.velocity, 0.0) - now.velocity
    force = m.mass * np.array(drive.gravity) + AIR_KG_M3 / 2 * 12.0 * np.linalg.norm(rel) * rel
    force[:2] += m.mass * np.array(drive.push)
    torque = m.inertia * now.acceleration + np.cross(now.rate, m.inertia * now.rate)
    torque[2] += 2 * 0.2 * math.sqrt(twist * m.inertia[2]) * now.rate[2]
    centre, spun, turned = now.virtual()
    balance = centre @ (m.mass * now.pull - force) + turned @ torque
    balance += spun[:, :2] @ (2 * 0.03 * math.sqrt(stiffness * inertia) * now.swept[:2])
    balance[4] += twist * math.sin(now.x[4] - 0.1)
    if changes:
        rubbing = 2 * 0.02 * math.sqrt(math.prod(tilting)) * now.bent(now.swept, now.rate)
        balance += np.array([now.bent(*way) for way in zip(spun, turned, strict=True)]) @ rubbing
    np.testing.assert_allclose(free(suspension).T @ balance, 0.0, atol=2e-3)  # N m, of 1e6
    assert now.haul == pytest.approx(0.4, abs=1e-7)
    assert abs(free(suspension).T @ centre @ force)[:2].min() > 500


@pytest.mark.parametrize(
    ("suspension", "idle", "bound"), [(ONE, 20_000, 1e-6), *((each, 0, 1e-11) for each in (*ROPES, DOUBLE))]
)
def test_energy_stays(suspension, idle, bound):
    plant = made(suspension)
    rows = [*played(plant, STILL, 0.02, 75)]
    for _ in range(idle):  # minutes
        plant.run(STILL, 0.02, 4)
    energy = np.array([State(row, plant.mass).energy for row in (*rows, *played(plant, STILL, 0.02, 75))])
    assert np.ptp(energy) < bound * energy[0]


@pytest.mark.parametrize("suspension", ALL)
def test_moving_jaws_keep_the_momentum_and_cargo_takes_its_own_speed_along(suspension):
    plant = made(suspension)
    lowered = [replace(STILL, rope=20.0 + 0.01 * i, rope_rate=0.5, rope_acceleration=0.0) for i in range(51)]
    for drive in lowered[:50]:
        plant.run(drive, 0.02, 1)
    states = []
    for changes in ({}, {"jaw": 0.5}, {"jaw": 0.5, "load": 0.8}):
        row = plant.run(replace(lowered[50], **changes), 1e-9, 1, [0.0])[0]
        states.append(State(row, plant.mass))

    def momentum(state):
        centre, _, turned = state.virtual()
        return free(suspension).T @ (
            centre @ state.velocity * state.mass.mass + turned @ (state.mass.inertia * state.rate)
        )

    np.testing.assert_allclose(momentum(states[1]), momentum(states[0]), rtol=1e-7, atol=1e-3)
    assert abs(states[1].rate - states[0].rate).max() > 1e-4
    np.testing.assert_allclose(states[2].rate, states[1].rate, atol=1e-8)


@pytest.mark.parametrize(("azimuth", "axis"), [(0.0, 1), (90.0, 0)])
@pytest.mark.parametrize("suspension", [ONE, ROPES[0], ROPES[2], DOUBLE])
def test_small_swings_are_those_of_the_linear_equations(suspension, azimuth, axis):
    """Begun in line; of ropes and grab the masses are m l², m l b and m b² + I, the stiffnesses m g l and m g b."""
    plant, m = made(suspension, {"alpha_deg": 0.01, "azimuth_deg": azimuth}), DESIGN.mass_of(0.0, 0.0)
    length, below = 20.0 - HEIGHT, HEIGHT - m.centre_z
    way = np.array([[1, 0], [0, 1.0]]) if suspension is DOUBLE else np.array([[1.0], [ratio_of(suspension)]])
    inertia = m.mass * np.array([[length**2, length * below], [length * below, below**2 + m.inertia[axis] / m.mass]])
    stiffness = m.mass * STANDARD_GRAVITY * np.diag([length, below])
    squares, shapes = linalg.eigh(way.T @ stiffness @ way, way.T @ inertia @ way)
    rows = played(plant, STILL, 0.1, 100, 10)
    leans = np.array([State(row, m).x[1 - axis : 4 : 2] for row in rows])
    phases = np.cos(np.sqrt(squares) * 0.1 * np.arange(100)[:, None])
    begun = linalg.solve(shapes, way.T @ leans[0] / np.sum(way**2, axis=0))
    np.testing.assert_allclose(leans, phases * begun @ shapes.T @ way.T, atol=1e-9)
    if suspension is not DOUBLE:
        assert rows[0, 20] == pytest.approx(20.0)


def test_a_ratio_of_one_is_grab_and_ropes_as_one_body():
    shares = {"damping": 0.01, "yaw_damping": 0.05, "drag_area_m2": 10.0}
    plants = [made(suspension, drive=replace(STILL, jaw=0.2), **shares) for suspension in (ONE, ROPES[-1])]
    for i in range(200):
        # Slow wind, push, hoist and turn at once, and a load and jaws that change.
        t = 0.02 * i
        drive = replace(
            STILL, rope=20.0 - 0.25 * min(t, 1.0) ** 2 - 0.5 * max(t - 1.0, 0.0), rope_rate=max(-0.5, -0.01 * i),
            rope_acceleration=-0.5 if i < 50 else 0.0, wind=(5.0, 3.0), push=(0.02, -0.01), velocity=(0.3, 0.0),
            heading=0.001 * i, gravity=(0.1, -0.2, -STANDARD_GRAVITY), jaw=0.2 + 0.001 * i,
        )  # fmt: skip
        for plant in plants:
            plant.run(drive, 0.02, 4)
    one, linked = (plant.grab_state(0.1, 0.0, 0.0) for plant in plants)
    # Its ropes turn the grab back continuously, the one body's in steps of 20 ms.
    np.testing.assert_allclose(linked.jib_from_grab, one.jib_from_grab, atol=2e-5)
    np.testing.assert_allclose(linked.head, (linked.alpha, linked.azimuth), atol=1e-12)


def test_yaw_period_on_four_ropes():
    """Against the height to which inextensible ropes of this geometry lift the grab as it turns."""
    length, mass = 20.0, DESIGN.mass_of(0.0, 0.0)
    ends, exits = DESIGN.terminations[:, :2], EXITS[:, :2]
    rope = np.hypot(length - HEIGHT, np.linalg.norm(ends - exits, axis=1))

    def height(yaw):
        c, s = np.cos(yaw), np.sin(yaw)
        turned = ends @ np.array([[c, s], [-s, c]])
        return -np.mean(np.sqrt(rope**2 - np.sum((turned - exits) ** 2, axis=1)))

    angles = np.radians(np.linspace(-10, 10, 201))
    curvature = 2 * np.polyfit(angles, [height(a) for a in angles], 2)[0]
    expected = 2 * np.pi * np.sqrt(mass.inertia[2] / (mass.mass * STANDARD_GRAVITY * curvature))
    rate = played(made(ONE, {"yaw_deg": 5.0}), STILL, 0.02, 6000)[:, 16]
    up = np.flatnonzero((rate[:-1] < 0) & (rate[1:] >= 0))
    assert np.diff(0.02 * (up + rate[up] / (rate[up] - rate[up + 1]))).mean() == pytest.approx(expected, rel=0.03)
    assert 14 < expected < 23


@pytest.mark.parametrize("ratio", [-0.2, 0.0, 0.2, 1.0])
def test_the_head_leans_by_its_ratio_and_a_stays_where_alpha_has_it(ratio):
    for alpha in np.radians((0.0, 1e-6, 3.0, 20.0, 60.0)):
        grab = hung(GrabState(alpha, 0.7, 12.0, 0.1, 0.0, 0.0), FourRopes(tilt_ratio=ratio), HEIGHT)
        pose = grab.jib_from_grab
        np.testing.assert_allclose(pose.translation, geometry.grab_centre(alpha, 0.7, 12.0), atol=1e-12)
        top = pose.apply([0.0, 0.0, HEIGHT])
        lean = math.atan2(math.hypot(top[0], top[1]), -top[2])
        assert grab.head[0] == pytest.approx(ratio * lean, abs=1e-13)
        assert lean == pytest.approx(rope_lean(alpha, HEIGHT / 12.0, ratio), abs=1e-13)
        np.testing.assert_allclose(pose.rotation[2, 2], math.cos(ratio * lean), atol=1e-15)


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
