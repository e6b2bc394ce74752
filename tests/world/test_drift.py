"""Dust along the ground: as much as was asked, below what stands out of it, in streamers that the wind carries."""

from dataclasses import replace

import numpy as np
import pytest
from test_weather import render_pass

from simgrab.model.geometry import Pose
from simgrab.world.camera.weather.drift import SCALE_HEIGHT_M, drift
from simgrab.world.camera.weather.render_pass import ray_maps
from simgrab.world.camera.weather.surface import surface

WIND = 15.0 * np.array([np.cos(0.6), np.sin(0.6), 0.0])
SEEN = render_pass(0.05)
GROUND = surface(SEEN)


def thickness(on=GROUND, wind=WIND, time_s=0.0, amount=0.4):
    """Of the dust, seen from straight above."""
    return -np.log(drift(SEEN, on, amount, wind, time_s, seed=4).keep) / ray_maps(SEEN.intrinsics).length


def test_the_mean_thickness_is_the_one_set():
    assert np.mean([thickness(time_s=t) for t in np.linspace(0, 16, 40)]) == pytest.approx(0.4, rel=0.1)


def test_half_of_it_lies_above_so_much_height():
    raised = replace(GROUND, height=GROUND.height + np.float32(SCALE_HEIGHT_M * np.log(2)))
    level = replace(GROUND, height=np.zeros_like(GROUND.height))
    assert thickness(raised).mean() == pytest.approx(
        thickness(level).mean() / 2, rel=0.04
    )  # between pixels light is interpolated


def shifted(x, y):
    return replace(GROUND, x=GROUND.x + np.float32(x), y=GROUND.y + np.float32(y))


def test_it_travels_with_the_wind():
    later = shifted(0.7 * WIND[0], 0.7 * WIND[1])
    np.testing.assert_allclose(thickness(later, time_s=0.7), thickness(), atol=0.02)
    assert np.abs(thickness(time_s=0.7) - thickness()).mean() > 0.05


def test_it_stays_on_the_ground_while_the_jib_slews():
    """The place turns by −slew before the jib, and with it the wind."""
    c, s = np.cos(0.4), np.sin(0.4)
    turn = np.array([[c, s, 0.0, 0.0], [-s, c, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    slewed = drift(replace(SEEN, jib_from_place=Pose.from_matrix(turn)), GROUND, 0.4, turn[:3, :3] @ WIND, 3.0, seed=4)
    np.testing.assert_allclose(slewed.keep, drift(SEEN, GROUND, 0.4, WIND, 3.0, seed=4).keep, atol=2e-3)


@pytest.mark.parametrize("azimuth", [0.0, 1.0, np.pi / 2])
def test_streamers_lie_along_the_wind(azimuth):
    along, across = (np.array([np.cos(a), np.sin(a)], np.float32) for a in (azimuth, azimuth + np.pi / 2))
    wind = np.array([*15.0 * along, 0.0])
    change = [np.abs(thickness(shifted(*step), wind) - thickness(wind=wind)) for step in (along, across)]
    assert change[1].mean() > 2 * change[0].mean()


def test_none_over_water_nor_down_in_a_hold():
    assert not thickness(replace(GROUND, solid=np.zeros_like(GROUND.solid))).any()
    assert not thickness(replace(GROUND, height=GROUND.height - 1.1)).any()


def test_without_wind_there_is_still_a_pattern():
    assert np.isfinite(thickness(wind=np.zeros(3))).all()
