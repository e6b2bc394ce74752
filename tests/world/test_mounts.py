"""The camera's mounts."""

import itertools
import math

import numpy as np
import pytest
from conftest import small_scene
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from simgrab.model import geometry
from simgrab.world.trajectory.clip import ClipMotion
from simgrab.world.trajectory.moment import STANDARD_GRAVITY, Tilt
from simgrab.world.trajectory.mount import Mount, tilted

STEP = 0.02


def scene(mount, **changes):
    return small_scene(
        swing={"model": "dynamic"}, camera__mount=mount, frames=10**6, **({"camera__beta_deg": 4.0} | changes)
    )


def betas(mount, seconds, **changes):
    made = scene(mount, **changes)
    return list(itertools.islice(ClipMotion(made, 0), math.ceil(seconds * made.clip.frame_rate_hz)))


@given(st.floats(1e-6, 0.5), st.floats(0, 6.28), st.floats(-3.1, 3.1))
def test_an_attitude_is_read_back(beta, azimuth, roll):
    tilt = Tilt.of(geometry.camera_rotation(beta, azimuth, roll), 0.0)
    np.testing.assert_allclose(tilt.jib_from_camera, geometry.camera_rotation(beta, azimuth, roll), atol=1e-12)
    assert tilt.beta == pytest.approx(beta, abs=1e-9)


def test_a_camera_that_hangs_straight_keeps_its_azimuth():
    tilt = Tilt.of(geometry.camera_rotation(0.0, 1.0, 0.3), 1.0)
    assert (tilt.beta, tilt.azimuth) == (0.0, pytest.approx(1.0))
    np.testing.assert_allclose(tilt.jib_from_camera, geometry.camera_rotation(0.0, 1.0, 0.3), atol=1e-14)


@pytest.mark.parametrize(("frequency", "damping"), [(0.5, 0.2), (0.25, 0.5), (1.0, 0.1)])
def test_a_levelled_mount_responds_as_a_second_order_system_and_converges_to_apparent_gravity(frequency, damping):
    """At the intervals' ends and within them, against SciPy's system of the stated frequency and damping."""
    camera = scene({"model": "levelled", "frequency_hz": frequency, "damping": damping}, camera__beta_deg=0.0).camera
    mount, w, count = Mount(camera, STEP), 2 * np.pi * frequency, 1000
    gravity = np.tile([0.3, -0.4, -STANDARD_GRAVITY], (count, 1))
    leans = np.concatenate(
        [mount.advance(gravity[:400], np.zeros(401)), mount.advance(gravity[400:], np.zeros(601))[1:]]
    )
    system, fine = ([w * w], [1, 2 * damping * w, w * w]), STEP / 4 * np.arange(4 * count + 1)
    way = np.array([0.3, -0.4]) / STANDARD_GRAVITY
    expected, rate = (answer(system, T=fine)[1][:, None] * way for answer in (signal.step, signal.impulse))
    np.testing.assert_allclose(leans[:, 0], expected[::4], atol=1e-6)
    within = mount.within(leans[:-1], np.full(count, STEP / 4), gravity, np.zeros(count), np.zeros(count))
    np.testing.assert_allclose(within, np.stack([expected, rate], axis=1)[1::4], atol=1e-6)
    tilt = tilted(camera, way)
    np.testing.assert_allclose(tilt.jib_from_camera[:2, 2], np.array([0.3, -0.4]) / math.hypot(0.5, STANDARD_GRAVITY))


def test_a_rigid_mount_pitches_with_luffing():
    moments = betas({"model": "rigid", "pitch_deg_per_m": 2.0}, 60.0)
    luffed = np.array([m.jib.luffed for m in moments])
    assert luffed.max() > 2.5
    np.testing.assert_allclose(np.degrees([m.tilt.beta for m in moments]), 4.0 + 2.0 * luffed, atol=1e-6)
    aside = betas({"model": "rigid"}, 40.0, camera__tilt_azimuth_deg=90.0)[-1]
    pitch = math.radians(2.0 * aside.jib.luffed)
    assert math.cos(aside.tilt.beta) == pytest.approx(math.cos(math.radians(4.0)) * math.cos(pitch))


def test_a_fixed_mount_stays_while_the_crane_works():
    assert {m.tilt.beta for m in betas({"model": "fixed"}, 60.0)} == {math.radians(4.0)}


def test_vibration_has_the_stated_size_and_frequency_in_every_mount():
    mount = {"model": "levelled", "vibration": {"rms_deg": 0.1, "frequency_hz": 0.6, "damping": 0.1}}
    still = {"swing__work": {"model": "hang"}, "clip__frame_rate_hz": 10.0}
    axis = np.degrees([m.tilt.jib_from_camera[:2, 2] for m in betas(mount, 500.0, **still)])
    for model in ("fixed", "rigid"):
        other = [m.tilt.jib_from_camera[:2, 2] for m in betas(mount | {"model": model}, 20.0, **still)]
        np.testing.assert_allclose(np.degrees(other), axis[:200], atol=1e-6)
    centred = axis - axis.mean(axis=0)
    assert centred.std(axis=0) == pytest.approx([0.1 * math.cos(math.radians(4.0)), 0.1], rel=0.2)
    f, density = signal.welch(centred[:, 1], 10.0, nperseg=2048)
    assert f[density.argmax()] == pytest.approx(0.6, rel=0.1)
