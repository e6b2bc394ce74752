"""Weights between those of two detectors."""

import json

import numpy as np
import pytest

pytest.importorskip("torch")
onnx = pytest.importorskip("onnx")
from onnx import numpy_helper  # noqa: E402

from simgrab.dataset import datasets  # noqa: E402
from simgrab.errors import TrainingError  # noqa: E402
from simgrab.instrument.detect import ANY_GRAB, SHIPPED, Bundled  # noqa: E402
from simgrab.instrument.detect.bundled import PASSES, WEIGHTS  # noqa: E402
from simgrab.instrument.net import open_net  # noqa: E402
from simgrab.training.detector import evaluate  # noqa: E402
from simgrab.training.detector.blend import between, blend  # noqa: E402
from simgrab.training.detector.train import NETS  # noqa: E402

ANY = SHIPPED[ANY_GRAB]
pytestmark = pytest.mark.skipif(
    not all((folder / "find.onnx").exists() for folder in (WEIGHTS, ANY)), reason="no detector's weights are bundled"
)


def numbers(model):
    return [numpy_helper.to_array(tensor).astype(float) for tensor in model.graph.initializer]


def test_numbers_lie_between_those_of_two_models():
    first, second = (onnx.load(folder / "refine.onnx") for folder in (WEIGHTS, ANY))
    for kept in (0.0, 0.25, 1.0):
        for a, b, c in zip(numbers(first), numbers(second), numbers(between(first, second, kept)), strict=True):
            np.testing.assert_allclose(c, kept * a + (1 - kept) * b, rtol=1e-3, atol=1e-6)  # halves
    assert any((a != b).any() for a, b in zip(numbers(first), numbers(second), strict=True))


def test_other_architectures_are_refused():
    with pytest.raises(TrainingError, match="different architectures"):
        between(onnx.load(ANY / "find.onnx"), onnx.load(ANY / "refine.onnx"), 0.5)


def test_a_blended_detector_states_its_own_settings_and_figures(dataset, tmp_path):
    out = tmp_path / "out"
    kept = {"find": 0.5, "refine": 0.5, "settle": 1.0}
    figures = blend(WEIGHTS, ANY, out, kept=kept, paths=[dataset], easy=[dataset])
    for name in NETS:
        card = json.loads((out / f"{name}.json").read_text())
        assert card.get("kept", 1.0) == kept[name]
        assert figures["frames"] > 0
        assert card["metrics"]["frames"] == figures["frames"]
        assert card["metrics"]["recall"] == figures["recall"]
        assert not {"alone", "before"} & set(card["metrics"])  # of other weights
        assert [one["seed"] for one in card["judged_by"]] == [datasets.read(dataset).data.seed]
        assert f"of {card['judged_by'][0]['frames']} frames of" in (out / f"{name}.md").read_text()
        assert ("50% of these" in (out / f"{name}.md").read_text()) == (name != "settle")
        assert card["model_sha256"] in (out / f"{name}.md").read_text()
    first, stayed = (json.loads((folder / "settle.json").read_text()) for folder in (WEIGHTS, out))
    assert (stayed["examples"], stayed["data"]) == (first["examples"], first["data"])
    assert (out / "verify.onnx").read_bytes() == (ANY / "verify.onnx").read_bytes()
    facts = open_net(out / "settle.onnx").facts
    assert facts["verified"] is True
    assert facts["settings"]["least_presence"] > 0
    assert Bundled(out).settings.passes == PASSES
    with pytest.raises(TrainingError, match="not empty"):
        blend(WEIGHTS, ANY, out, kept=kept, paths=[dataset])


def test_the_threshold_falls_below_neither_the_fitted_one_nor_that_of_before(dataset, tmp_path, monkeypatch):
    stayed = dict.fromkeys(NETS, 1.0)
    for fitted in (0.3, 0.97):
        monkeypatch.setattr(evaluate, "least_presence", lambda _seen, fitted=fitted: fitted)
        blend(WEIGHTS, ANY, tmp_path / str(fitted), kept=stayed, paths=[dataset])
        expected = max(fitted, Bundled(WEIGHTS).settings.least_presence)
        assert Bundled(tmp_path / str(fitted)).settings.least_presence == expected


@pytest.mark.parametrize("kept", [-0.1, 1.1, np.nan])
def test_shares_that_are_none_are_refused(dataset, tmp_path, kept):
    with pytest.raises(TrainingError, match=r"^kept of refine must lie between 0 and 1"):
        blend(WEIGHTS, ANY, tmp_path / "out", kept={"find": 0.0, "refine": kept, "settle": 1.0}, paths=[dataset])
