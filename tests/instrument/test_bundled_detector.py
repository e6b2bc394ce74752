"""The bundled weights are small, what their cards say, and find the grab of a scene unseen in training."""

import hashlib
import json

import numpy as np
import pytest

from simgrab import frames as frames_of
from simgrab.instrument.detect import FOUR_ROPE, GENERIC, detector
from simgrab.instrument.detect.boxes import iou
from simgrab.io.resources import ASSETS
from simgrab.model import label_arrays as labels
from simgrab.model import scenes
from simgrab.world.frames import FrameGenerator

WEIGHTS = ASSETS / "weights"


NETS = ("find", "refine", "settle")
ALL_NETS = [*NETS, "reader", *(f"{GENERIC}/{name}" for name in (*NETS, "verify"))]


@pytest.mark.parametrize("name", ALL_NETS)
def test_weights_are_those_that_their_card_is_of(name):
    card = json.loads((WEIGHTS / f"{name}.json").read_text(encoding="utf-8"))
    assert hashlib.sha256((WEIGHTS / f"{name}.onnx").read_bytes()).hexdigest() == card["model_sha256"]


def test_all_weights_together_are_small():
    assert sum(path.stat().st_size for path in WEIGHTS.rglob("*")) < 20e6


@pytest.mark.parametrize("name", NETS)
def test_cards_say_what_the_weights_were_made_of(name):
    card = json.loads((WEIGHTS / f"{name}.json").read_text(encoding="utf-8"))
    assert card["name"] == name
    assert {one["scenario"] for one in card["data"]} == {"training"}  # and so of no exam
    assert card["metrics"]["recall"] > 0.98


@pytest.mark.parametrize("name", NETS)
def test_weights_for_any_grab_were_made_of_random_shapes_and_of_no_exam(name):
    card = json.loads((WEIGHTS / GENERIC / f"{name}.json").read_text(encoding="utf-8"))
    assert {one["scenario"] for one in card["data"]} == {"training", "training-shapes", "training-photo"}
    together = json.loads((WEIGHTS / GENERIC / "verify.json").read_text(encoding="utf-8"))
    assert {key: card["metrics"][key] for key in ("frames", "recall", "false_boxes")} == {
        key: together["metrics"][key] for key in ("frames", "recall", "false_boxes")
    }  # of all nets together
    assert card["judged_by"] == together["judged_by"]
    seeds = [{(one["scenario"], one["seed"]) for one in some} for some in (card["data"], together["data"])]
    judged = {(one["scenario"], one["seed"]) for one in card["judged_by"]}
    assert judged - seeds[1] == {("training-shapes", 49)}  # worlds of which no net has learned
    assert ("training-shapes", 49) not in seeds[0]


@pytest.mark.slow
def test_a_kind_that_no_detector_was_trained_on_is_found_by_any_grab_alone():
    """Scissors grabs with unseen paint, cargo and places, at half the size."""
    scene = scenes.load(
        "exam-family-scissors", {"frames": 4, "clip.clip_frames": 1, "swing.absent": 0.0}, size=(960, 540)
    )
    overlaps = {name: [] for name in (FOUR_ROPE, GENERIC)}
    looks = {name: detector(name) for name in overlaps}
    assert [one.name for one in looks.values()] == [FOUR_ROPE, GENERIC]
    for frame in frames_of(scene, buffers=False):
        box = labels.box(frame.truth)
        for name, one in looks.items():
            found = one(frame.rgb)
            overlaps[name].append(float(iou(found.box, box)) if found.found else 0.0)
    assert sum(overlap > 0.5 for overlap in overlaps[GENERIC]) >= 3
    assert sum(overlaps[GENERIC]) > 1.0 + sum(overlaps[FOUR_ROPE])


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
