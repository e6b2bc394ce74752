"""The ropes' waves against a string of many pieces, its sag, and what a sensor on the rope feels of them."""

import numpy as np
import pytest
from scipy.linalg import eigvalsh_tridiagonal

import simgrab
from simgrab.lab.sensors.waves import KG_M_MM2, Strings, WaveAmplitudes
from simgrab.model.geometry import STANDARD_GRAVITY

LENGTH, KG, KG_M = 18.0, 10_500.0, 4 * KG_M_MM2 * 32.0**2
SPEED = np.sqrt(KG * STANDARD_GRAVITY / KG_M)
DOWN, STILL = np.array([0.0, 0.0, -1.0]), np.zeros(2)


def stepped(strings, seconds, instants=(), shaken=STILL, direction=DOWN, bend=(0.0, 0.0, 0.0)):
    return strings.step(
        seconds, list(instants), length=LENGTH, kg=KG, direction=direction, bend=np.array(bend),
        gravity=STANDARD_GRAVITY * DOWN, shaken=np.asarray(shaken),
    )  # fmt: skip


def test_modes_swing_at_the_frequencies_of_a_string_in_a_thousand_pieces():
    pieces = 1000
    stiffness = np.full(pieces - 1, 2.0), np.full(pieces - 2, -1.0)
    squares = eigvalsh_tridiagonal(*stiffness, select="i", select_range=(0, 3))
    frequencies = np.sqrt(squares) * SPEED * pieces / LENGTH
    strings = Strings(4, 1e-9, KG_M)
    begun = stepped(strings, 1e-9, [0.0], shaken=(0.3, 0.0))[0, 0]
    for mode, frequency in enumerate(frequencies):
        there = stepped(Strings(4, 1e-9, KG_M), 0.01, [0.0])  # settled without load: it hangs straight
        assert not there.any()
        released = Strings(4, 1e-9, KG_M)
        stepped(released, 1e-9, shaken=(0.3, 0.0))
        period = 2 * np.pi / frequency
        quarter, half, whole = stepped(released, 2 * period, [period / 4, period / 2, period])[:, 0, mode, 0]
        assert half == pytest.approx(-begun[mode, 0], rel=1e-4)
        assert whole == pytest.approx(begun[mode, 0], rel=1e-4)
        assert abs(quarter) < 1e-3 * abs(begun[mode, 0])


def test_a_leaning_rope_sags_as_a_parabola():
    lean = np.radians(5.0)
    direction = np.array([np.sin(lean), 0.0, -np.cos(lean)])
    amplitude = stepped(Strings(400, 0.01, KG_M), 0.01, [0.0], direction=direction)[0, 0]
    s, number = 7.0, np.arange(1, 401)
    found = np.sin(number * np.pi * s / LENGTH) @ amplitude[:, 0]
    across = STANDARD_GRAVITY * np.sin(lean) * -np.cos(lean)  # horizontal part of the weight across the rope
    pull = SPEED**2 * np.cos(lean)
    assert found == pytest.approx(across * s * (LENGTH - s) / (2 * pull), rel=1e-5)


def test_a_rope_that_turns_about_its_upper_end_bends_by_what_a_growing_load_does():
    """For w = -θ̈ s, the sag is -θ̈ s (l² - s²)/(6 c²)."""
    amplitude = stepped(Strings(2000, 0.01, KG_M), 0.01, [0.0], bend=(0.2, 0.0, 0.0))[0, 0]
    s, number = 5.0, np.arange(1, 2001)
    found = np.sin(number * np.pi * s / LENGTH) @ amplitude[:, 0]
    assert found == pytest.approx(-0.2 * s * (LENGTH**2 - s**2) / (6 * SPEED**2), rel=1e-4)


def test_a_cut_interval_is_the_whole_one_and_damping_is_a_share_of_the_critical_one():
    whole, cut = (Strings(2, 0.03, KG_M) for _ in range(2))
    for strings in (whole, cut):
        stepped(strings, 0.02, shaken=(0.3, -0.1))
    stepped(cut, 0.013)
    np.testing.assert_allclose(stepped(cut, 0.017, [0.017]), stepped(whole, 0.03, [0.03]), atol=1e-15)
    frequency = np.pi * SPEED / LENGTH
    damped = 2 * np.pi / (frequency * np.sqrt(1 - 0.03**2))
    first, second = stepped(whole, 2.0, [0.0, damped])[:, 0, 0, 0]
    assert np.log(first / second) == pytest.approx(2 * np.pi * 0.03 / np.sqrt(1 - 0.03**2), rel=1e-9)


def test_hauled_in_ropes_move_as_differences_have_it():
    time, h = 0.4, 1e-3
    t = time + h * np.arange(-2, 3)
    length, ones = 18.0 - 0.8 * t + 0.1 * t * t, np.ones(5)
    amplitude = np.stack([0.01 * np.sin(9 * t), 0.004 * np.cos(17 * t)], axis=1)[:, :, None] * (1.0, 0.5)
    rate = np.stack([0.09 * np.cos(9 * t), -0.068 * np.sin(17 * t)], axis=1)[:, :, None] * (1.0, 0.5)
    waves = WaveAmplitudes(
        amplitude, rate, -amplitude * np.array([81.0, 289.0])[:, None], length, 0.2 * t - 0.8, 0.2 * ones
    )

    def displaced(s):
        k = np.arange(1, 3) * np.pi / length[:, None]
        return np.pad(np.einsum("nm,nmi->ni", np.sin(k * s), amplitude), ((0, 0), (0, 1)))

    second = np.array([-1, 16, -30, 16, -1]) / (12 * h * h)
    first = np.array([1, -8, 0, 8, -1]) / (12 * h)
    acceleration, slope, slope_rate = waves.at(1.3)
    slopes = np.stack([displaced(1.3 + h * j) for j in (-2, -1, 0, 1, 2)])
    np.testing.assert_allclose(acceleration[2], second @ displaced(1.3), atol=1e-7)
    np.testing.assert_allclose(slope, np.einsum("j,jni->ni", first, slopes), atol=1e-9)
    np.testing.assert_allclose(slope_rate[2], first @ slope, atol=1e-8)


def test_a_gyroscope_on_the_rope_feels_them_and_no_other_sensor_does():
    imus = {name: {"model": "imu", "mount": name, "noise": "none"} for name in ("rope", "grab")}
    still = {"swing.work": {"model": "hang"}, "swing.start.alpha_deg": 0.0, "frames": 90, "sensors": imus}
    waves = {"model": "one-body", "waves": {"modes": 2, "exit_rms_m_s2": 0.1, "damping": 0.02}}
    straight = simgrab.sensors(simgrab.load("free-swing", still))
    waving = simgrab.sensors(simgrab.load("free-swing", still | {"suspension": waves}))
    np.testing.assert_array_equal(straight["grab"].values, waving["grab"].values)
    rates = waving["rope"].values[:, :2]
    assert np.abs(straight["rope"].values[:, :2]).max() < 1e-6
    assert 1e-4 < rates.std() < 0.1
    spectrum = np.abs(np.fft.rfft(rates[:, 0])) ** 2
    expected = SPEED / (2 * (20.0 - 1.64))
    assert np.fft.rfftfreq(len(rates), 1 / 200)[spectrum.argmax()] == pytest.approx(expected, abs=0.2)
