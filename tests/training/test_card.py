import hashlib
import json

from simgrab.datasets import Data
from simgrab.training.card import Card


def test_a_card_says_what_it_is_of(tmp_path):
    model = tmp_path / "find.onnx"
    model.write_bytes(b"weights")
    card = Card(
        name="find", task="Finds.", data=(Data("training", "d1", "d2", 0, 800),), examples=640,
        recipe={"epochs": 3}, epochs=3, seconds=90.0,
        judged_by=(Data("training", "d3", "d4", 3, 64),),
        metrics={"recall": 0.99, "by_weather": {"fog": {"recall": 0.9, "frames": 10}, "rain": {"recall": 1.0}}},
    )  # fmt: skip
    content = json.loads(card.save(model).read_text())
    assert content["model_sha256"] == hashlib.sha256(b"weights").hexdigest()
    assert content["data"][0]["labels_sha256"] == "d2"
    assert content["licence"] == "Apache-2.0"
    assert content["versions"]["simgrab"]
    text = model.with_suffix(".md").read_text()
    assert "800 frames of `training`, seed 0 in 1.5 minutes (3 epochs)" in text
    assert "Judged by 64 frames of `training`, seed 3 too." in text
    assert "| fog | 0.9 | 10 |" in text
    assert "| rain | 1 |  |" in text
