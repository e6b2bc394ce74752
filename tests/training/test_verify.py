"""The fourth net: what it learns, and the detector that it completes."""

import hashlib
import json
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

torch = pytest.importorskip("torch")
pytest.importorskip("onnx")

from simgrab.cli import cli  # noqa: E402
from simgrab.dataset import datasets  # noqa: E402
from simgrab.errors import DetectorError, TrainingError  # noqa: E402
from simgrab.instrument.detect import GENERIC, SHIPPED, GrabDetector  # noqa: E402
from simgrab.instrument.detect.boxes import iou  # noqa: E402
from simgrab.instrument.net import open_net  # noqa: E402
from simgrab.model import label_arrays as labels  # noqa: E402
from simgrab.model.geometry import to_camera  # noqa: E402
from simgrab.training.detector import cache, export, refine, settings, verify  # noqa: E402
from simgrab.training.detector.augment import Orientation  # noqa: E402
from simgrab.training.detector.nets import Refine, Verify  # noqa: E402
from simgrab.training.detector.train import NETS, train  # noqa: E402

START = SHIPPED[GENERIC]
pytestmark = pytest.mark.skipif(not (START / "find.onnx").exists(), reason="no detector's weights are bundled")
TINY = verify.recipe(epochs=1, half=False, threads=1, batch=4)


@pytest.fixture(scope="module")
def four(dataset, tmp_path_factory):
    """A detector of four nets, the last trained for a moment."""
    out = tmp_path_factory.mktemp("verify") / "out"
    verify.train_verify([dataset], START, out, TINY)
    return out


def picture(dataset, frame=0):
    known = datasets.read(dataset)
    return cv2.imread(str(known.image(known.rows[frame])), cv2.IMREAD_COLOR_RGB)


def test_the_presence_is_of_settle_and_verify_and_the_rest_of_the_others(four, dataset):
    seen = picture(dataset)
    three, all_four = GrabDetector(START), GrabDetector(four)
    box = three.candidates(seen)[0].box
    refined = three.refine(seen, [box])
    alone, together = three.predict_pose(seen, refined), all_four.predict_pose(seen, refined)
    np.testing.assert_array_equal(together.centres, alone.centres)
    np.testing.assert_array_equal(together.yaw, alone.yaw)
    assert 0 < together.presence[0] < 1
    assert together.presence[0] != alone.presence[0]
    for logit, sense in ((40.0, 1), (-40.0, -1)):
        decided = four.parent / f"decided{sense}"
        shutil.copytree(four, decided, dirs_exist_ok=True)
        _constant(decided / "verify.onnx", logit)
        change = GrabDetector(decided).predict_pose(seen, refined).presence[0] - alone.presence[0]
        assert np.sign(change) == sense


def test_a_box_whose_edges_are_unsure_is_less_present(four, dataset, tmp_path):
    """The odds of the presence fall with the square of the standard deviation."""
    shutil.copytree(four, tmp_path / "even")
    _constant(tmp_path / "even" / "verify.onnx", 0.0)
    seen, looks = picture(dataset), GrabDetector(tmp_path / "even")
    refined = looks.refine(seen, [looks.candidates(seen)[0].box])
    side = (refined.boxes[0][2:] - refined.boxes[0][:2]).max()
    odds = []
    for share in (0.02, 0.04):
        presence = looks.predict_pose(seen, replace(refined, box_sd=np.full((1, 4), share * side))).presence[0]
        odds.append(presence / (1 - presence))
    assert odds[0] / odds[1] == pytest.approx(4, rel=1e-3)


def test_what_is_suspected_is_refined_and_listed_once(dataset):
    frames = cache.frames([datasets.read(dataset)], "train")[:3]
    for frame, boxes in zip(frames, verify.suspects(GrabDetector(START), frames), strict=True):
        apart = [iou(a, b) for i, a in enumerate(boxes) for b in boxes[:i]]
        assert max(apart, default=0) < verify._SAME
        if frame.labelled:
            assert max(iou(box, labels.box(frame.row)) for box in boxes) > 0.5


def test_a_cache_half_removed_is_built_from_what_the_detector_suspects(four, dataset, tmp_path):
    shutil.copytree(four, tmp_path / "out")
    whole, half = sorted((tmp_path / "out" / "cache").iterdir())
    (half / "bytes.npy").unlink()
    cut = {path.name: np.load(four / "cache" / path.name / "bytes.npy") for path in (whole, half)}
    verify.train_verify([dataset], START, tmp_path / "out", TINY, resume=True)
    for name, crops in cut.items():
        np.testing.assert_array_equal(np.load(tmp_path / "out" / "cache" / name / "bytes.npy"), crops)


def _constant(path, logit):
    net = Verify(Refine())
    last = net.head[-1]
    with torch.no_grad():
        last.weight.zero_()
        last.bias.copy_(torch.tensor([logit, 0.0, 0.0]))
    example = torch.zeros((1, verify.VERIFY_SIZE, verify.VERIFY_SIZE, 4), dtype=torch.uint8)
    export.export(net.eval(), example, ["verdict"], path, {"task": "verify-grab"})


def test_a_detector_that_says_it_has_four_nets_needs_four(four, tmp_path):
    shutil.copytree(four, tmp_path / "three")
    (tmp_path / "three" / "verify.onnx").unlink()
    with pytest.raises(DetectorError, match=r"verify\.onnx: No such file"):
        GrabDetector(tmp_path / "three")
    shutil.copyfile(four / "settle.onnx", tmp_path / "three" / "verify.onnx")
    with pytest.raises(DetectorError, match=r"verify\.onnx is not simgrab's verify-grab network"):
        GrabDetector(tmp_path / "three")


def test_the_other_nets_and_their_cards_are_those_it_was_trained_for(four):
    for name in ("find", "refine"):
        assert (four / f"{name}.onnx").read_bytes() == (START / f"{name}.onnx").read_bytes()
        assert (four / f"{name}.md").read_text() == (START / f"{name}.md").read_text()
    facts, before = (open_net(folder / "settle.onnx").facts for folder in (four, START))
    assert facts["verified"] is True
    assert facts["trust"] == before["trust"]
    for name in (*NETS, "verify"):
        model = (four / f"{name}.onnx").read_bytes()
        assert json.loads((four / f"{name}.json").read_text())["model_sha256"] == hashlib.sha256(model).hexdigest()
    card = json.loads((four / "verify.json").read_text())
    assert card["recipe"]["epochs"] == 1
    assert set(card["metrics"]) >= {"alone", "recall", "false_boxes"}


@pytest.mark.slow
def test_it_is_trained_again_to_the_same_file(four, dataset, tmp_path):
    done = CliRunner().invoke(cli, [
        "train", "verify", str(dataset), "--out", str(tmp_path / "out"), "--epochs", "1", "--no-half", "--threads", "1",
        "--batch", "4", "--json",
    ])  # fmt: skip
    assert json.loads(done.output)["frames"] == json.loads((four / "verify.json").read_text())["metrics"]["frames"]
    assert (tmp_path / "out" / "verify.onnx").read_bytes() == (four / "verify.onnx").read_bytes()
    with pytest.raises(TrainingError, match="another"):
        verify.train_verify([dataset], START, tmp_path / "out", verify.recipe(epochs=2), resume=True)


def test_what_it_learns_shows_the_grab_in_the_middle_or_something_else(dataset, tmp_path):
    frames = cache.frames([datasets.read(dataset)], "train")
    crops = refine.crops(tmp_path / "crops", frames, [[] for _ in frames], seed=0)
    examples = verify._listed([crops])
    assert sum(example.there for example in examples) == sum(frame.labelled for frame in frames)
    rng = np.random.default_rng(0)
    for example in examples:
        learned = verify._learned(example, rng, None)
        assert learned["crops"].shape == (verify.VERIFY_SIZE, verify.VERIFY_SIZE, 4)
        assert learned["present"] == example.there
        if example.there:
            window, patch = verify._window(rng), crops.patches[example.frame][example.slot]
            middle = patch.to_picture((window.corner + window.size / 2) / refine.CROP)
            box = labels.box(frames[example.frame].row)
            longest = (box[2:] - box[:2]).max()
            assert np.abs(middle - (box[:2] + box[2:]) / 2).max() < 0.2 * longest
            side = window.size[0] / refine.CROP * patch.size[0]
            assert side == pytest.approx(verify.VERIFY_ROOM * longest, rel=0.25)


@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize("quarters", range(4))
def test_the_ropes_direction_turns_with_the_crop(dataset, tmp_path, monkeypatch, mirror, quarters):
    frames = cache.frames([datasets.read(dataset)], "train")
    crops = refine.crops(tmp_path / "crops", frames, [[] for _ in frames], seed=0)
    example = next(one for one in verify._listed([crops]) if one.there and verify._ropes(one).any())
    laid = Orientation(mirror, quarters)
    monkeypatch.setattr(verify, "turn", lambda *_, **__: laid)
    x, y = verify._ropes(example)
    turned = verify._learned(example, np.random.default_rng(0), lambda picture, _rng: picture)["ropes"]
    expected = laid.angle(np.arctan2(y, x))
    np.testing.assert_allclose(turned, [np.cos(expected), np.sin(expected)], atol=1e-6)


def test_the_ropes_leave_the_grab_for_the_rope_exit(dataset):
    """Where O is in front of the camera, the direction is that from A to it."""
    known = datasets.read(dataset)
    for row in known.rows:
        camera, centre = (np.reshape(pose, (3, 4)) for pose in (row.jib_from_camera, row.jib_from_grab))
        short = to_camera(np.stack([centre[:, 3], 0.5 * centre[:, 3]]), camera[:, :3], camera[:, 3])
        ends = labels.intrinsics(row).project(short)
        way = labels.up_the_ropes(row)
        if np.isfinite(ends).all() and np.linalg.norm(way) > 1:
            along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
            assert along @ way / np.linalg.norm(way) > np.cos(np.radians(5))  # the lens bends the line a little


def test_a_detector_that_begins_with_four_nets_keeps_the_fourth_and_the_threshold(four, dataset, tmp_path):
    out, start = tmp_path / "out", tmp_path / "start"
    shutil.copytree(four, start)
    facts = open_net(four / "settle.onnx").facts
    export.restated(start / "settle.onnx", facts | {"settings": facts["settings"] | {"least_presence": 0.95}})
    train([dataset], out, lambda frames: settings.recipes(frames, started=True, epochs=1, half=False, threads=1),
          start=start)  # fmt: skip
    assert (out / "verify.onnx").read_bytes() == (four / "verify.onnx").read_bytes()
    assert (out / "verify.md").exists()
    assert GrabDetector(out)._verify is not None
    assert GrabDetector(out).settings.least_presence == 0.95  # few frames show no grab
