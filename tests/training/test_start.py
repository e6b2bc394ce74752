"""Nets that begin with an exported net's weights."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnx")

from simgrab.errors import TrainingError  # noqa: E402
from simgrab.instrument.detect import WEIGHTS  # noqa: E402
from simgrab.instrument.detect.patches import FIND_HEIGHT, FIND_WIDTH, REFINE_SIZE  # noqa: E402
from simgrab.instrument.net import open_net  # noqa: E402
from simgrab.training.detector import settings  # noqa: E402
from simgrab.training.detector.nets import Find, Refine  # noqa: E402
from simgrab.training.detector.start import begun  # noqa: E402
from simgrab.training.detector.train import NETS, train  # noqa: E402

pytestmark = pytest.mark.skipif(not (WEIGHTS / "find.onnx").exists(), reason="no detector's weights are bundled")
SHAPES = {"find": (FIND_HEIGHT, FIND_WIDTH, 3), "refine": (REFINE_SIZE, REFINE_SIZE, 4)}


def smooth(count, shape, seed=0):
    """Pictures of blotches, bytes."""
    rng = np.random.default_rng(seed)
    coarse = torch.from_numpy(rng.uniform(0, 255, (count, shape[2], shape[0] // 16, shape[1] // 16)))
    fine = torch.nn.functional.interpolate(coarse, size=shape[:2], mode="bilinear")
    return fine.permute(0, 2, 3, 1).contiguous().to(torch.uint8)


@pytest.mark.parametrize(("name", "build"), [("find", Find), ("refine", Refine), ("settle", Refine)])
def test_a_net_begins_as_the_file_it_was_written_to(name, build):
    shape = SHAPES.get(name, SHAPES["refine"])
    net = begun(build, WEIGHTS / f"{name}.onnx", smooth(24, shape))
    fresh = smooth(4, shape, seed=1)  # of which the statistics were not taken
    with torch.no_grad():
        out = net(fresh)
    expected = open_net(WEIGHTS / f"{name}.onnx")(fresh.numpy())
    for ours, theirs in zip(out if isinstance(out, tuple) else (out,), expected, strict=True):
        np.testing.assert_allclose(ours.numpy(), theirs, atol=2e-3 * np.abs(theirs).max())


def test_what_it_learns_from_has_the_same_statistics_as_what_it_began_with():
    some = smooth(24, SHAPES["find"])
    net = begun(Find, WEIGHTS / "find.onnx", some)
    with torch.no_grad():
        still = net(some)[0]
        moving = net.train()(some)[0]
    assert float((still - moving).abs().max()) < 0.02 * float(still.abs().max())


def test_another_network_is_refused(tmp_path):
    with pytest.raises(TrainingError, match="another network"):
        begun(Find, WEIGHTS / "refine.onnx", smooth(2, SHAPES["find"]))
    with pytest.raises(TrainingError, match="No such file"):
        begun(Find, tmp_path / "find.onnx", smooth(2, SHAPES["find"]))


def tiny(frames):
    return settings.recipes(frames, started=True, epochs=1, half=False, threads=1)


def test_a_training_begins_with_a_detector_and_its_card_names_it(dataset, tmp_path):
    found = train([dataset], tmp_path / "out", tiny, start=WEIGHTS)
    assert found.metrics["recall"] > 0.5  # which random weights would not reach in a step
    for name in NETS:
        card = json.loads((tmp_path / "out" / f"{name}.json").read_text())
        assert card["started_from"] == json.loads((WEIGHTS / f"{name}.json").read_text())["model_sha256"]
        assert card["started_from"][:16] in (tmp_path / "out" / f"{name}.md").read_text()
    shutil.copytree(WEIGHTS, tmp_path / "part")
    (tmp_path / "part" / "settle.onnx").unlink()
    with pytest.raises(TrainingError, match=r"settle\.onnx"):
        train([dataset], tmp_path / "other", tiny, start=tmp_path / "part")
    assert not (tmp_path / "other").exists()
    with pytest.raises(TrainingError, match="another"):
        train([dataset], tmp_path / "out", tiny, resume=True)
