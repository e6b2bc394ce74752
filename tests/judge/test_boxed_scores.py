"""Scores of boxes in frames of which nothing else is known."""

from types import SimpleNamespace

import numpy as np
import pytest

from simgrab.judge.evaluate import boxed
from simgrab.judge.evaluate.detection import average_precision
from simgrab.judge.evaluate.intervals import clopper_pearson
from simgrab.model.records.observations import Detection
from simgrab.model.truth import Boxed

EDGES = ("box_x0_px", "box_y0_px", "box_x1_px", "box_y1_px")
BOX = np.array([10.0, 20.0, 70.0, 60.0])
NONE = Detection("none", "nothing found", 0.1)


def frame(number, video, *, empty=False):
    edges = {} if empty else dict(zip(EDGES, BOX.tolist(), strict=True))
    return Boxed(frame=number, split="test", file="", image_sha256="", video=video, width_px=100, height_px=80, **edges)


def found(box=BOX, score=0.9):
    return Detection("found", "", score, box=np.asarray(box, float))


def test_boxes_are_counted_by_video():
    rows = [frame(i, video) for i, video in enumerate("aaab")] + [frame(4, "b", empty=True), frame(5, "c", empty=True)]
    f = boxed.score(rows, [found(), found(), NONE, found(), found(), NONE])
    assert (f["frames"], f["videos"], f["labelled"], f["empty"]) == (6, 3, 4, 2)
    assert (f["recall"], f["recall_interval"]) == (0.75, clopper_pearson(3, 4))
    assert (f["false_boxes"], f["false_share"], f["false_interval"]) == (1, 0.5, clopper_pearson(1, 2))
    assert (f["missed_videos"], f["false_videos"]) == (1, 1)
    assert f["by_video"]["a"] == {"frames": 3, "labelled": 3, "hits": 2, "empty": 0, "false_boxes": 0}
    assert f["by_video"]["b"] == {"frames": 2, "labelled": 1, "hits": 1, "empty": 1, "false_boxes": 1}


def test_a_box_beside_the_grab_is_no_hit():
    f = boxed.score([frame(0, "a")], [found(BOX + 30)])
    assert f["recall"] == f["map50_95"] == 0.0


def test_precision_is_resampled_by_whole_videos():
    rows = [frame(i, f"seen {i % 3}") for i in range(42)] + [frame(42 + i, f"missed {i % 3}") for i in range(42)]
    f = boxed.score(rows, [found()] * 42 + [NONE] * 42, resamples=200)
    low, high = f["map50_95_interval"]
    assert low < 0.2 < 0.8 < high  # of frames alone it would be about (0.4, 0.6)
    assert 0.4 < f["map50_95"] < 0.6
    assert f == boxed.score(rows, [found()] * 42 + [NONE] * 42, resamples=200)
    same = boxed.score(rows, [found()] * 84, resamples=200)
    assert same["map50_95_interval"] == pytest.approx((1.0, 1.0))
    few = boxed.score(rows[:42], [found()] * 42, resamples=200)
    assert few["map50_95_interval"] is None


def test_a_resample_has_the_precision_of_its_frames(monkeypatch):
    rng, picks = np.random.default_rng(3), np.array([[0, 2, 2], [1, 1, 1], [2, 2, 2]])  # the last shows no grab
    rows = [frame(i, "abc"[i // 12], empty=i // 12 == 2 or i % 5 == 0) for i in range(36)]
    seen_boxes = [NONE if i % 7 == 0 else found(BOX + rng.normal(0, 3, 4), rng.random()) for i in range(36)]
    some = [boxed.Boxes(row, row.box_x0_px is not None, one) for row, one in zip(rows, seen_boxes, strict=True)]
    videos = [some[:12], some[12:24], some[24:]]
    wanted = [average_precision([case for i in pick for case in videos[i]])["map50_95"] for pick in picks]
    monkeypatch.setattr(boxed, "stream", lambda *_: SimpleNamespace(integers=lambda *_, **__: picks))
    values = boxed.resampled_precision(videos, 3)
    assert wanted[2] is None
    assert np.isnan(values[2])
    assert values[:2].tolist() == pytest.approx(wanted[:2])


def test_nothing_is_counted_of_nothing():
    f = boxed.score([frame(0, "a", empty=True), frame(1, "b", empty=True)], [NONE, NONE])
    assert f["recall"] is f["recall_interval"] is f["map50_95"] is f["map50_95_interval"] is None
    assert f["false_share"] == 0
    assert boxed.score([], [])["frames"] == 0
