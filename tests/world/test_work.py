"""What the crane is commanded to do."""

import itertools
import math
import re

import numpy as np
import pytest
from conftest import slow_but, small_scene
from hypothesis import given
from hypothesis import strategies as st

from simgrab.dataset.pool import Workers, vetted
from simgrab.errors import ScenarioError
from simgrab.model import scenes
from simgrab.world.extensions import Recipe
from simgrab.world.frames import FrameGenerator
from simgrab.world.scenery.grabs.four_rope import four_rope
from simgrab.world.trajectory.axis import CommandedAxis, Move
from simgrab.world.trajectory.clip import ClipMotion
from simgrab.world.trajectory.trajectory import Trajectory
from simgrab.world.trajectory.work import OPEN, Work


@given(st.floats(-50, 50), st.floats(0.1, 5), st.floats(0.1, 10), st.floats(0.1, 10))
def test_a_move_goes_its_distance_at_its_speed_from_rest_to_rest(distance, speed, ramp, brake):
    move = Move.at_speed(3.0, distance, speed, ramp, brake)
    time = np.linspace(0.0, move.end + 5.0, 4001)
    gone, velocity = move.progress(time)
    assert gone[0] == velocity[0] == 0.0
    assert gone[-1] == pytest.approx(distance, abs=1e-9)
    assert abs(velocity).max() <= speed * (1 + 1e-9)
    step = time[1] - time[0]
    summed = np.cumsum((velocity[1:] + velocity[:-1]) / 2) * step
    np.testing.assert_allclose(summed, gone[1:], atol=speed * step + 1e-9)
    assert abs(np.diff(velocity)).max() <= speed / min(ramp, brake) * step * (1 + 1e-6)


def test_forgetting_changes_nothing_that_follows():
    moves = [Move.at_speed(10.0 * k, (-1) ** k * 3.0, 1.0, 2.0) for k in range(8)]
    whole, short = CommandedAxis(5.0, list(moves)), CommandedAxis(5.0, list(moves))
    short.forget(45.0)
    assert len(short.moves) < 5
    later = np.linspace(45.0, 90.0, 200)
    for a, b in zip(whole.sample(later), short.sample(later), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)


def test_a_cycle_digs_hoists_slews_dumps_and_returns():
    scene = scenes.load("work-cycles", {"swing.work.variation": 0.0, "swing.work.operator": 0.0})
    work = scene.swing.work
    course = Work(scene, 0).sample(np.arange(0.0, 150.0, 0.02))
    assert course.rope.max() == work.dig_rope_m
    assert course.rope.min() == pytest.approx(work.carry_rope_m)
    assert np.degrees(course.slew.min()) == pytest.approx(work.dig_slew_deg + work.slew_deg)
    assert course.luffed.max() == pytest.approx(work.luff_m)
    assert np.ptp(course.jaw) == pytest.approx(OPEN * four_rope().max_jaw)
    digging = course.held
    assert digging[: int(work.dig_s / 0.02)].all()
    assert (course.rope[digging] == work.dig_rope_m).all()
    slewing = np.abs(course.slew_rate) > 0
    np.testing.assert_allclose(course.rope[slewing], work.carry_rope_m)  # a smooth operator does one thing at a time
    assert np.degrees(np.abs(course.slew_rate)).max() == pytest.approx(6 * work.slew_rpm, rel=0.3)
    assert (course.load[course.jaw > 0.5 * OPEN * four_rope().max_jaw] < 0.6).all()


def test_a_rough_operator_is_quicker():
    def cycles(operator):
        course = Work(scenes.load("work-cycles", {"swing.work.operator": operator}), 0).sample(np.arange(0, 900, 0.1))
        return np.count_nonzero(np.diff(course.held.astype(int)) == 1)

    assert cycles(1.0) > cycles(0.0)


def test_every_nth_cycle_brakes_hard():
    changes = {"swing.work.abrupt_every": 3, "swing.work.abrupt_s": 1.5, "swing.work.variation": 0.0}
    time = np.arange(0.0, 500.0, 0.02)
    course = Work(scenes.load("work-cycles", changes), 0).sample(time)
    hard = time[1:][np.abs(np.diff(course.slew_rate)) / 0.02 > 0.6 * np.abs(course.slew_rate).max() / 1.5]
    starts = time[1:][np.diff(course.held.astype(int)) == 1]
    assert len(np.unique(np.searchsorted(starts, hard))) == len(starts) // 3


@pytest.mark.parametrize("lag", [0.0, 0.5, 2.0])
def test_the_display_shows_what_was_true_a_lag_ago(lag):
    scene = small_scene(
        "work-cycles", frames=400, clip__frame_rate_hz=9.0, camera__width_px=960, camera__height_px=540,
        display={"layout": "two-by-four", "lag_s": lag, "refresh_hz": 4.0, "readout_s": 0.0, "constant_m": 2.5},
    )  # fmt: skip
    moments = list(itertools.islice(ClipMotion(scene, 0), 400))
    time = np.array([m.time for m in moments])
    rope = np.interp(
        np.maximum(np.floor(time * 4.0 + 1e-9) / 4.0 - lag, 0.0), time, [m.grab.rope_length for m in moments]
    )
    closing = [four_rope().closing_rope_m(m.grab.jaw) for m in moments]
    assert np.ptp(rope) > 5
    for moment, length in zip(moments, rope, strict=True):
        hoist, _ = scene.display.layout_in(960, 540).lengths(moment.shown.rope_text)
        assert hoist == pytest.approx(length - 2.5, abs=0.02)
    shut = [k for k, extra in enumerate(closing) if extra == 0 and k > 30]
    assert {len(set(moments[k].shown.rope_text.split())) for k in shut[20:40]} == {1}


def test_jaws_that_the_grab_does_not_have_are_refused_whenever_a_frame_is_asked_for():
    trajectory = Trajectory(scenes.load("free-swing", {"swing.work.jaw_deg": 80.0}))
    for frame in (0, 1):
        with pytest.raises(ScenarioError, match="this grab opens by 55°, got 80°"):
            trajectory.at(frame)


def test_hoisting_through_the_ground_is_refused():
    scene = small_scene("work-cycles", frames=3, swing__work__dig_rope_m=31.0)
    with pytest.raises(
        ScenarioError, match=r"swing\.work.*lowers the grab into the ground or the cargo; at most 2\d\.\d\d"
    ):
        vetted(Workers(Recipe(scene)))


def test_a_refusal_names_a_rope_that_is_short_enough():
    def refused(rope):
        swing = {"swing__alpha__sigma_deg": 0.0, "swing__rope_length_m": rope, "swing__jaw_deg": 0.0}
        scene = small_scene(frames=1, place={"model": "plain"}, **swing)
        try:
            vetted(Workers(Recipe(scene)))
        except ScenarioError as problem:
            return [float(number) for number in re.findall(r"(\d+\.\d\d) m", problem.problem)]
        return []

    _, most = refused(28.0)
    assert not refused(most)
    for beyond in (0.0101, 0.0149):
        assert refused(most + beyond) == [round(most + 0.02, 2), most]


def test_large_swings_of_the_papers_scene_shorten_their_rope():
    with FrameGenerator(scenes.load("paper-ideal", {"frames": 300, "swing.alpha.sigma_deg": 15.0})) as generator:
        clamped = [generator.project(frame).moment.clamped for frame in range(300)]
    assert set(clamped) == {(), ("rope_length_m",)}


def test_slewing_goes_on_at_its_speed():
    course = Work(scenes.load("slew-alarm"), 0).sample(np.arange(0.0, 40.0, 0.1))
    assert course.slew_rate[-1] == pytest.approx(1.2 * 2 * math.pi / 60)
    assert (course.slew_rate[:50] == 0).all()


RECORDS = ["work-cycles", "qingdao-twin", "qingdao-night-snow", "qingdao-heavy-snow"]


@pytest.mark.parametrize("name", slow_but(RECORDS, "work-cycles"))
def test_no_frame_of_a_bundled_record_runs_the_grab_into_something(name):
    vetted(Workers(Recipe(scenes.load(name))))
