import hashlib
import json

import pytest

from simgrab.dataset.datasets import DatasetIdentity
from simgrab.instrument.detect.grab import WEIGHTS
from simgrab.training import card as cards
from simgrab.training.card import Card, markdown


def test_a_card_says_what_it_is_of(tmp_path):
    model = tmp_path / "pose.onnx"
    model.write_bytes(b"weights")
    card = Card(
        name="pose", task="Finds.", data=(DatasetIdentity("training", "d1", "d2", 0, 800),), examples=640,
        recipe={"epochs": 3}, epochs=3, seconds=90.0, started_from="some trunk",
        metrics={"recall": 0.99, "by_weather": {"fog": {"recall": 0.9, "frames": 10}, "rain": {"recall": 1.0}}},
    )  # fmt: skip
    content = json.loads(card.save(model).read_text())
    assert content["model_sha256"] == hashlib.sha256(b"weights").hexdigest()
    assert content["data"][0]["labels_sha256"] == "d2"
    assert content["licence"] == "Apache-2.0"
    assert content["versions"]["simgrab"]
    text = model.with_suffix(".md").read_text()
    assert "640 examples, the split `train` of 800 frames of `training`, seed 0, for 1.5 minutes (3 epochs)" in text
    assert "Judged by the split `val` of these. It began with the weights of `some trunk`.\n" in text
    assert "| fog | 0.9 | 10 |" in text
    assert "| rain | 1 |  |" in text
    content["metrics"]["alone"] = {"recall": 0.98}
    assert "“alone” is of this net" in markdown(content)


@pytest.mark.parametrize("card", sorted(WEIGHTS.rglob("*.json")), ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_the_bundled_cards_are_both_of_one_training(card):
    digest = hashlib.sha256(card.with_suffix(".onnx").read_bytes()).hexdigest()
    assert json.loads(card.read_text(encoding="utf-8"))["model_sha256"] == digest
    assert digest in card.with_suffix(".md").read_text(encoding="utf-8")


def test_the_machine_names_variables_by_which_torch_computes_otherwise(monkeypatch):
    for name in cards.CHANGING:
        monkeypatch.delenv(name, raising=False)
    assert "environment" not in cards.machine()
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert cards.machine()["environment"] == {"OMP_NUM_THREADS": "1"}
