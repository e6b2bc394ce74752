"""The physics of the swinging grab against closed forms and independent integrations."""

import itertools
import math

import numpy as np
import pytest
import trimesh
from conftest import slow_but, small_scene
from scipy import signal, stats
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from simgrab.model import scenes
from simgrab.model.geometry import swing_of
from simgrab.model.scenario import Jib
from simgrab.world.scenery.grabs.four_rope import four_rope
from simgrab.world.scenery.meshes.ropes import Ropes
from simgrab.world.trajectory.clip import ClipMotion, _begin
from simgrab.world.trajectory.moment import STANDARD_GRAVITY
from simgrab.world.trajectory.noise import noise, von_karman
from simgrab.world.trajectory.plant import AIR_KG_M3, Drive, Plant
from simgrab.world.trajectory.work import Work

STEP = 0.005

GRAB = four_rope()
ROPES = Ropes.of(Jib(), 4)
EXITS = np.array(ROPES.exits)


def dynamic(**changes):
    """A dynamic scene; keys with __ for dots, below ``swing`` unless they begin with another table."""
    tables = ("camera", "clip", "frames", "seed", "place")
    named = {(k if k.startswith(tables) else f"swing__{k}"): v for k, v in changes.items()}
    return small_scene(swing={"model": "dynamic"}, **({"frames": 10**6} | named))


def play(scene, seconds, clip=0):
    return list(itertools.islice(ClipMotion(scene, clip), math.ceil(seconds * scene.clip.frame_rate_hz)))


def drive(rope, *, wind=(0.0, 0.0), heading=0.0):
    return Drive((0, 0, -STANDARD_GRAVITY), (0.0, 0.0), heading, rope, 0.0, 0.0, wind, (0.0, 0.0), False)


def free(rope, alpha_deg, azimuth_deg=0.0, *, yaw_deg=0.0, jaw=0.0, load=0.0, drag_area=0.0):
    plant = Plant(GRAB, ROPES, rope, jaw, load, damping=0.0, yaw_damping=0.0, drag_area=drag_area)
    start = small_scene(
        swing={"model": "dynamic"},
        swing__start={"alpha_deg": alpha_deg, "azimuth_deg": azimuth_deg, "yaw_deg": yaw_deg},
    ).swing.start
    plant.start(*_begin(start, plant.mass, rope))
    return plant


def period_of(values, step):
    """Mean time between upward zero crossings."""
    up = np.flatnonzero((values[:-1] < 0) & (values[1:] >= 0))
    times = step * (up + values[up] / (values[up] - values[up + 1]))
    return np.diff(times).mean()


@pytest.mark.parametrize("rope", [8.0, 20.0, 40.0])
@pytest.mark.parametrize(("azimuth", "axis"), [(0.0, 1), (90.0, 0)])
def test_period_is_the_compound_pendulums(rope, azimuth, axis):
    theta = np.radians(5.0)
    plant = free(rope, 5.0, azimuth)
    rate = []
    for _ in range(int(60 / STEP)):
        plant.run(drive(rope), STEP, 1)
        rate.append(float(plant.data.qvel[axis]))
    m, arm = plant.mass, rope - plant.mass.centre_z
    expected = 2 * np.pi * np.sqrt((m.inertia[axis] + m.mass * arm**2) / (m.mass * STANDARD_GRAVITY * arm))
    assert period_of(np.array(rate), STEP) == pytest.approx(expected * (1 + theta**2 / 16), rel=1e-3)


def test_energy_stays():
    plant = free(20.0, 8.0, 30.0)
    plant.data.qvel[:3] += (0.02, -0.03, 0.0)

    def energy():
        arm = -float(plant.data.qpos[4]) - plant.mass.centre_z
        w, x, y, z = plant.data.qpos[:4]
        height = arm * (2 * (x * x + y * y))  # above the lowest point
        turning = np.array(plant.mass.inertia) + plant.mass.mass * arm**2 * np.array([1, 1, 0])
        weight = plant.mass.mass * STANDARD_GRAVITY
        spread_m2 = np.mean(np.sum(EXITS[:, :2] * GRAB.terminations[:, :2], axis=1))
        twist = weight * spread_m2 / (20.0 - GRAB.terminations[0, 2]) * (1 - np.cos(2 * np.arctan2(z, w)))
        return weight * height + twist + 0.5 * float(turning @ plant.data.qvel[:3] ** 2)

    first, worst = energy(), 0.0
    for _ in range(20_000):
        plant.run(drive(20.0), 4 * STEP, 4)
        worst = max(worst, abs(energy() / first - 1))
    assert worst < 1e-6


def test_a_working_crane_swings_the_grab_as_eulers_equations_say():
    """Slewing, luffing, hoisting, jaws and load at once, against SciPy's integration in axes fixed in the grab."""
    scene = dynamic(
        damping=0.0, yaw_damping=0.0, drag_area_m2=0.0, start__alpha_deg=1.0, start__azimuth_deg=50.0,
        work={"model": "cycles", "operator": 1.0, "dig_s": 1e-3, "hoist_m_min": 25.0,
              "pause_s": 35.0, "slew_deg": 90.0},
    )  # fmt: skip
    shown = play(scene, 120.0)
    course = Work(scene, 0)
    t = np.linspace(0.0, 121.0, 121_001)
    h = t[1] - t[0]
    c = course.sample(t)
    radius = scene.swing.radius_m + c.luffed
    pivot = np.stack([radius * np.cos(c.slew), radius * np.sin(c.slew), np.zeros_like(t)])
    pull = -np.gradient(np.gradient(pivot, h, axis=1), h, axis=1)
    mass = [GRAB.mass_of(j, q) for j, q in zip(c.jaw[::20], c.load[::20], strict=True)]

    def at(values, when):
        i = min(when / h, len(t) - 2)
        k = int(i)
        return values[..., k] + (i - k) * (values[..., k + 1] - values[..., k])

    heavy = np.repeat([m.mass for m in mass], 20)[: len(t)]
    centre = np.interp(t, t[::20], [m.centre_z for m in mass])
    own = np.stack([np.interp(t, t[::20], [m.inertia[a] for m in mass]) for a in range(3)])
    arm = c.rope - centre
    # What the jaws alone add to the inertia: cargo that leaves takes its momentum along.
    jaw_rate = np.gradient(c.jaw, h)
    spread = float(np.mean(np.sum(EXITS[:, :2] * GRAB.terminations[:, :2], axis=1)))

    def slope(j, q, length):
        e = 1e-4
        lo, hi = GRAB.mass_of(max(j - e, 0.0), q), GRAB.mass_of(min(j + e, GRAB.max_jaw), q)
        wide = min(j + e, GRAB.max_jaw) - max(j - e, 0.0)
        a = np.array(hi.inertia) + hi.mass * (length - hi.centre_z) ** 2 * np.array([1, 1, 0])
        b = np.array(lo.inertia) + lo.mass * (length - lo.centre_z) ** 2 * np.array([1, 1, 0])
        return (a - b) / wide

    def rhs(when, y):
        turn = Rotation.from_quat(y[:4] / np.linalg.norm(y[:4]))
        w = y[4:]
        m, length, lever = at(heavy, when), at(c.rope, when), at(arm, when)
        inertia = at(own, when) + m * lever**2 * np.array([1, 1, 0])
        change = 2 * m * lever * at(c.rope_rate, when) * np.array([1, 1, 0])
        change = change + slope(at(c.jaw, when), at(c.load, when), length) * at(jaw_rate, when)
        gravity = turn.inv().apply(at(pull, when) - (0, 0, STANDARD_GRAVITY))
        torque = np.cross((0, 0, -lever), m * gravity)
        q = turn.as_quat()
        yaw = 2 * np.arctan2(q[2], q[3]) - at(c.slew, when)
        torque[2] -= m * STANDARD_GRAVITY * spread / (length - GRAB.terminations[0, 2]) * np.sin(yaw)
        rate = (torque - change * w - np.cross(w, inertia * w)) / inertia
        dq = 0.5 * (
            Rotation.from_quat(y[:4]).as_quat()[3] * np.append(w, 0) + np.append(np.cross(q[:3], w), -q[:3] @ w)
        )
        return np.concatenate([dq, rate])

    q0, w0 = _begin(scene.swing.start, mass[0], c.rope[0])
    times = [m.time for m in shown]
    found = solve_ivp(
        rhs, (0, times[-1]), np.concatenate([np.roll(q0, -1), w0]), t_eval=times, max_step=0.05, rtol=1e-7
    )
    rotation = Rotation.from_euler("z", -np.interp(times, t, c.slew)[:, None]) * Rotation.from_quat(found.y[:4].T)
    expected = -rotation.as_matrix()[:, :, 2]
    measured = np.array([m.grab.jib_from_grab[:3, 3] / m.grab.rope_length for m in shown])
    apart = np.degrees(np.linalg.norm(expected - measured, axis=1))
    assert swing_of(measured)[0].max() > np.radians(4)  # it swings
    assert apart.max() < 0.05
    rope = np.interp(times, t, c.rope)
    np.testing.assert_allclose([m.grab.rope_length for m in shown], rope, atol=1e-3)


def test_a_steady_wind_leans_the_grab_as_drag_over_weight():
    scene = dynamic(
        work={"model": "hang", "rope_length_m": 20.0}, damping=0.3, wind={"mean_m_s": 18.0, "intensity": 0.0},
        clip__frame_rate_hz=1.0,
    )  # fmt: skip
    moment = play(scene, 150.0)[-1]
    lean = np.arctan(0.5 * AIR_KG_M3 * 10.0 * 18.0**2 / (10_500 * STANDARD_GRAVITY))
    assert moment.grab.alpha == pytest.approx(lean, rel=0.01)
    assert moment.grab.azimuth == pytest.approx(np.radians(90.0), abs=1e-3)


def test_yaw_period_on_four_ropes():
    """Against the height to which inextensible ropes of this geometry lift the grab as it turns."""
    length = 20.0
    z = length - GRAB.terminations[0, 2]
    ends, exits = GRAB.terminations[:, :2], EXITS[:, :2]
    rope = np.hypot(z, np.linalg.norm(ends - exits, axis=1))

    def height(yaw):
        c, s = np.cos(yaw), np.sin(yaw)
        turned = ends @ np.array([[c, s], [-s, c]])
        return -np.mean(np.sqrt(rope**2 - np.sum((turned - exits) ** 2, axis=1)))

    angles = np.radians(np.linspace(-10, 10, 201))
    curvature = 2 * np.polyfit(angles, [height(a) for a in angles], 2)[0]
    mass = GRAB.mass_of(0.0, 0.0)
    expected = 2 * np.pi * np.sqrt(mass.inertia[2] / (mass.mass * STANDARD_GRAVITY * curvature))
    plant = free(length, 0.0, yaw_deg=5.0)
    rate = []
    for _ in range(6000):
        plant.run(drive(length), 0.02, 4)
        rate.append(float(plant.data.qvel[2]))
    assert period_of(np.array(rate), 0.02) == pytest.approx(expected, rel=0.03)
    assert 14 < expected < 23


def test_damping_is_a_share_of_the_critical_one():
    scene = dynamic(work={"model": "hang", "rope_length_m": 12.0}, damping=0.02, drag_area_m2=0.0, start__alpha_deg=5.0)
    alpha = np.array([m.grab.alpha for m in play(scene, 120.0)])
    tops = alpha[signal.find_peaks(alpha)[0]]
    decrement = -np.polyfit(np.arange(len(tops)), np.log(tops), 1)[0]
    assert decrement == pytest.approx(np.pi * 0.02, rel=0.02)  # a half swing a peak


def test_turbulence_has_von_karmans_spectrum_and_the_stated_intensity():
    step, scale, mean = 0.05, 100.0, 10.0
    blocks = noise(von_karman(scale, mean), step, seed=0, clip=0, name="test")
    u = np.concatenate(list(itertools.islice(blocks, 800)))
    f, density = signal.welch(u, 1 / step, nperseg=16384)
    reduced = f * scale / mean
    karman = 4 * (scale / mean) / (1 + 70.8 * reduced**2) ** (5 / 6)
    for low, high in itertools.pairwise(np.geomspace(0.02, 5, 12)):
        band = (reduced >= low) & (reduced < high)
        error = 1 / np.sqrt(band.sum() * len(u) / 16384)
        assert density[band].mean() == pytest.approx(karman[band].mean(), rel=0.03 + 4 * error)
    assert u.std() == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("jaw", [0.0, 0.3, 0.96])
def test_mass_properties_are_those_of_the_meshes(jaw):
    placed = []
    frames = GRAB.frames(min(jaw, GRAB.max_jaw))
    for body in GRAB.bodies:
        mesh = trimesh.util.concatenate([p.mesh for p in body.parts])
        mesh.density = body.mass_kg / mesh.volume
        mesh.apply_transform(frames[body.name])
        placed.append(mesh)
    total = sum(m.mass for m in placed)
    centre = sum(m.mass * m.center_mass for m in placed) / total
    inertia = sum(
        m.moment_inertia + m.mass * (np.dot(d, d) * np.eye(3) - np.outer(d, d))
        for m in placed
        for d in [m.center_mass - centre]
    )
    found = GRAB.mass_of(jaw, 0.0)
    assert found.mass == pytest.approx(total)
    assert found.centre_z == pytest.approx(centre[2], abs=0.01)
    assert found.inertia == pytest.approx(tuple(np.diag(inertia)), rel=0.01)


def test_a_full_grab_weighs_24_tonnes_and_hangs_lower():
    full, empty = GRAB.mass_of(0.0, 1.0), GRAB.mass_of(0.0, 0.0)
    assert full.mass == 24_000.0
    assert full.centre_z < empty.centre_z


@pytest.mark.slow
def test_isotropic_forcing_gives_rayleighs_law_and_not_the_papers():
    samples = []
    for seed in range(6):
        scene = dynamic(
            seed=seed, work={"model": "hang", "rope_length_m": 12.0}, damping=0.06, drag_area_m2=0.0,
            forcing={"rms_m_s2": 0.08, "bandwidth_hz": 0.5}, settle_s=60.0, clip__frame_rate_hz=0.05,
        )  # fmt: skip
        alpha = np.array([m.grab.alpha for m in play(scene, 800.0)])
        samples.append(alpha / np.sqrt(np.mean(alpha**2)))
    pooled = np.concatenate(samples)  # frames 20 s apart, 3 times the memory of the swing's size
    assert len(pooled) == 240
    assert stats.kstest(pooled, stats.rayleigh(scale=np.sqrt(0.5)).cdf).pvalue > 0.01
    assert stats.kstest(pooled, stats.halfnorm(scale=1.0).cdf).pvalue < 1e-6


@pytest.mark.parametrize("seed", slow_but((0, 2, 6, 8), 2, 6))
def test_fast_slewing_is_a_true_alarm_and_a_gale_alone_is_none(seed):
    alarm = scenes.load("slew-alarm", {"seed": seed, "clip.frame_rate_hz": 2.0})
    assert max(m.grab.alpha for m in play(alarm, 24.0)) > np.radians(10.0)
    gale = scenes.load("wind-only", {"seed": seed, "clip.frame_rate_hz": 2.0, "swing.wind.mean_m_s": 18.0})
    assert max(m.grab.alpha for m in play(gale, 600.0)) < np.radians(10.0)


@pytest.mark.parametrize("clip", [0, 1])
def test_a_clip_can_be_made_alone_and_begins_the_longer_one(clip):
    from simgrab.world.trajectory.trajectory import Trajectory

    scene = dynamic(frames=40, clip__clip_frames=20, wind__mean_m_s=8.0, forcing__rms_m_s2=0.02)
    story, alone = Trajectory(scene), Trajectory(scene)
    whole = [story.at(frame) for frame in range(40)]
    first = 20 * clip
    assert [alone.at(first + k) for k in (7, 3, 19)] == [whole[first + k] for k in (7, 3, 19)]
    assert whole[20].grab != whole[0].grab
    longer = Trajectory(dynamic(frames=4000, clip__clip_frames=20, wind__mean_m_s=8.0, forcing__rms_m_s2=0.02))
    assert longer.at(first + 3) == whole[first + 3]
