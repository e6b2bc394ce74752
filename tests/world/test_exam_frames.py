"""Exam scenes are drawn, small: frames with the grab, and frames without."""

import cv2
import numpy as np
import pytest
from conftest import slow_but

from simgrab.dataset import stored
from simgrab.model import scenes
from simgrab.world.frames import FrameGenerator

# Of those left out, calm is the base of all, and windy and known differ from it in numbers alone.
EXAMS = ("heavy-snow", "night-snow", "rain", "fog-dust", "glare", "family-scissors", "family-large")


@pytest.mark.parametrize("name", slow_but([f"exam-{name}" for name in EXAMS], "exam-heavy-snow"))
def test_an_exam_shows_the_grab_or_none(name):
    fast = {"image.samples": 0, "image.shadow_map_px": 1024}
    with FrameGenerator(scenes.load(name, fast, size=(480, 270))) as generator:
        first = [generator.project(frame).moment for frame in range(15)]
        there = next(m.frame for m in first if m.present)
        assert not all(m.present for m in first)
        full = stored.make(generator, there)
    shown = full.record.truth
    picture = cv2.imdecode(np.frombuffer(full.files[shown.file], np.uint8), cv2.IMREAD_COLOR)
    assert shown.present
    assert shown.visible_fraction >= 0.5
    assert 10 < picture.mean() < 245  # neither black nor burnt out
    assert picture.std() > 5
    assert (shown.split, shown.variant) == ("test", 0)
