"""The bundled weights are small, what their cards say, and find the grab of a scene unseen in training."""

import hashlib
import json

import numpy as np
import pytest

from simgrab import frames as frames_of
from simgrab.instrument.detect import WEIGHTS, detector, located
from simgrab.instrument.detect.boxes import iou
from simgrab.model import label_arrays as labels
from simgrab.model import scenes
from simgrab.world.frames import FrameGenerator

NETS = ("coarse", "pose")


@pytest.mark.parametrize("name", [*NETS, "reader"])
def test_weights_are_those_that_their_card_is_of(name):
    card = json.loads((WEIGHTS / f"{name}.json").read_text(encoding="utf-8"))
    assert hashlib.sha256((WEIGHTS / f"{name}.onnx").read_bytes()).hexdigest() == card["model_sha256"]


def test_all_weights_together_are_small():
    assert sum(path.stat().st_size for path in WEIGHTS.rglob("*")) < 20e6


@pytest.mark.parametrize("name", NETS)
def test_cards_say_what_the_weights_were_made_of(name):
    card = json.loads((WEIGHTS / f"{name}.json").read_text(encoding="utf-8"))
    assert card["name"] == name
    assert not any(one["scenario"].startswith("exam") for one in card["data"])
    assert card["started_from"].startswith("EfficientNet-Lite0, trained on ImageNet (Apache-2.0)")
    assert card["metrics"]["recall"] > 0.75  # of random shapes, and of shapes by other hands that no net learned


@pytest.mark.slow
def test_a_kind_that_it_was_not_trained_on_is_found():
    """Scissors grabs with unseen paint, cargo and places, at half the size."""
    scene = scenes.load(
        "exam-family-scissors", {"frames": 4, "clip.clip_frames": 2, "swing.absent": 0.0}, size=(960, 540)
    )
    looks = detector()
    found = [(looks(frame.rgb), labels.box(frame.truth)) for frame in frames_of(scene, buffers=False)]
    assert sum(one.found and iou(one.box, box) > 0.5 for one, box in found) >= 3


def test_the_grab_is_found_where_it_is_and_nowhere_else():
    looks, found, empty = detector(), 0, 0
    with FrameGenerator(scenes.load("exam-windy", {"clip.clip_frames": 2, "frames": 12})) as generator:
        for frame in (10, 11):
            drawn = generator.frame(frame)
            row, told = drawn.truth, looks(np.ascontiguousarray(drawn.rgb))
            box = labels.box(row)
            if box is None:
                assert not told.found
                empty += 1
            elif row.visible_fraction > 0.5:
                assert told.found
                assert iou(told.box, box) > 0.85
                assert np.linalg.norm(told.centre - labels.centre(row)) < 0.08 * (box[2:] - box[:2]).max()
                found += 1
    assert found
    assert empty


def test_commands_written_for_two_detectors_open_the_bundled_one():
    assert located("any-grab") == located("bundled") == WEIGHTS
