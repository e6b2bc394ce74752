"""The physics of the swinging grab against closed forms and independent integrations."""

import itertools
import math

import numpy as np
import pytest
from conftest import small_scene
from scipy import signal, stats

from simgrab.model import scenes
from simgrab.world.trajectory.clip import ClipMotion
from simgrab.world.trajectory.moment import STANDARD_GRAVITY
from simgrab.world.trajectory.noise import noise, von_karman
from simgrab.world.trajectory.plant import AIR_KG_M3
from simgrab.world.trajectory.work import Work


def dynamic(**changes):
    """A dynamic scene; keys with __ for dots, below ``swing`` unless they begin with another table."""
    tables = ("camera", "clip", "frames", "seed", "place")
    named = {(k if k.startswith(tables) else f"swing__{k}"): v for k, v in changes.items()}
    return small_scene(swing={"model": "dynamic"}, **({"frames": 10**6} | named))


def play(scene, seconds, clip=0):
    return list(itertools.islice(ClipMotion(scene, clip), math.ceil(seconds * scene.clip.frame_rate_hz)))


def test_the_grab_is_driven_by_what_the_crane_is_commanded():
    """Interval by interval, from positions of O and of the hoist; `test_plant` has the equations of motion."""
    scene = dynamic(work={"model": "cycles", "operator": 1.0, "dig_s": 1.0}, forcing__rms_m_s2=0.1, wind__mean_m_s=9.0)
    clip = ClipMotion(scene, 0)
    block = next(clip.blocks(Work(scene, 0)))
    drives, h = list(block.drives()), clip.interval
    c = Work(scene, 0).sample(h / 100 * np.arange(100 * len(drives) + 1))
    radius = scene.swing.radius_m + c.luffed
    o = np.stack([radius * np.cos(c.slew), radius * np.sin(c.slew)], axis=1)
    velocity = np.gradient(o, h / 100, axis=0, edge_order=2)[::100]
    np.testing.assert_allclose([d.velocity for d in drives], velocity[:-1], atol=1e-4)
    np.testing.assert_allclose([d.gravity[:2] for d in drives], -np.diff(velocity, axis=0) / h, atol=1e-2)
    assert {d.gravity[2] for d in drives} == {-STANDARD_GRAVITY}
    np.testing.assert_allclose([d.heading for d in drives], c.slew[50::100], atol=1e-4)
    for name in ("rope", "jaw", "load", "held"):
        np.testing.assert_allclose([getattr(d, name) for d in drives], getattr(c, name)[:-1:100], atol=1e-12)
    hoisted = np.cumsum([d.rope_rate * h + d.rope_acceleration * h * h / 2 for d in drives])
    np.testing.assert_allclose(hoisted, c.rope[100::100] - c.rope[0], atol=1e-3)
    assert min(np.ptp(each) for each in (c.slew, c.luffed, c.rope, c.jaw, c.load)) > 0.1
    np.testing.assert_array_equal([d.push for d in drives], block.push)
    np.testing.assert_array_equal([d.wind for d in drives], block.wind)


def test_a_steady_wind_leans_the_grab_as_drag_over_weight():
    scene = dynamic(
        work={"model": "hang", "rope_length_m": 20.0}, damping=0.3, wind={"mean_m_s": 18.0, "intensity": 0.0},
        clip__frame_rate_hz=1.0,
    )  # fmt: skip
    moment = play(scene, 150.0)[-1]
    lean = np.arctan(0.5 * AIR_KG_M3 * 10.0 * 18.0**2 / (10_500 * STANDARD_GRAVITY))
    assert moment.grab.alpha == pytest.approx(lean, rel=0.01)
    assert moment.grab.azimuth == pytest.approx(np.radians(90.0), abs=1e-3)


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


@pytest.mark.long
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


@pytest.mark.parametrize("seed", [2, 6])
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
