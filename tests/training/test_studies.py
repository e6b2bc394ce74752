"""The recorded studies run to their end and make a page; that of digits is in `tests.training.test_reader`."""

import dataclasses
import json

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

torch = pytest.importorskip("torch")
pytest.importorskip("onnx")

from scripts import training_page, training_studies  # noqa: E402
from simgrab.errors import TrainingError  # noqa: E402
from simgrab.labels import datasets  # noqa: E402
from simgrab.training import folder  # noqa: E402
from simgrab.training.detector import settings  # noqa: E402


@pytest.fixture
def small(dataset, monkeypatch):
    """Studies of six frames, of which three are learned from, in one epoch."""

    def rendered(_scene, _changes, _settings):
        found, splits = datasets.read(dataset), ["train", "train", "train", "val", "val", "test"]
        rows = (msgspec.structs.replace(row, split=split) for row, split in zip(found.rows, splits, strict=True))
        return dataclasses.replace(found, rows=tuple(rows))

    def recipes(frames, **common):
        common.pop("quick", None)
        return settings.recipes(frames, epochs=1, half=False, **common)

    changes = {
        "rendered": rendered, "recipes": recipes, "LABELLED": 5, "LATER": 5, "COUNTS": (1, 3), "EPOCH": 3,
        "SHOWN": dict.fromkeys(settings.SHOWN, 3), "RATES": (0.01,), "FINALS": (0.1,), "EPOCHS": 1,
    }  # fmt: skip
    for name, value in changes.items():
        monkeypatch.setattr(training_studies, name, value)


def study(work, *arguments):
    result = CliRunner().invoke(
        training_studies.main, [*arguments, "--work", str(work), "--threads", "1"], catch_exceptions=False
    )
    assert result.exit_code == 0, result.output
    return json.loads((work / training_studies.RESULTS).read_text())


@pytest.mark.slow
@pytest.mark.usefixtures("small")
def test_studies_run_once_and_fill_a_page(tmp_path, monkeypatch):
    known = study(tmp_path / "work", "table", "leak", "counts")
    found = {name: one["found"] for name, one in known.items()}
    assert set(found["table"]) == {"sgd 0.01 0.1", "adam 0.01 0.1"}
    assert set(found["counts"]) == {"1", "3"}
    assert list(found["leak"]["leak"])[:2] == ["frames in between", "later in the same video"]
    for scores in [*found["leak"]["leak"].values(), *found["counts"].values()]:
        assert {"map50_95", "recall", "centre_median_px", "false_boxes", "empty_frames"} <= set(scores)
    assert not list(tmp_path.rglob("cache"))
    monkeypatch.setattr(training_studies, "fit", None)  # nothing is trained again
    assert study(tmp_path / "work", "leak", "counts") == known
    page = recorded(tmp_path, monkeypatch)
    assert all(title in page for title in ("Learning rates", "random split", "How many frames"))
    known["counts"]["found"].pop("3")  # broken off after the first
    assert "How many frames" in training_page.page(known)
    assert "## Digits" not in page


@pytest.mark.usefixtures("small")
def test_a_page_keeps_the_studies_that_are_not_made_anew(tmp_path, monkeypatch):
    study(tmp_path / "work", "table")
    recorded(tmp_path, monkeypatch)
    (tmp_path / "work" / training_studies.RESULTS).unlink()
    monkeypatch.setattr(training_studies, "LATER", 4)  # nothing that the table depends on
    study(tmp_path / "work", "leak")
    page = recorded(tmp_path, monkeypatch)
    assert "Learning rates" in page
    assert "random split" in page
    monkeypatch.setattr(training_studies, "EPOCHS", 2)
    with pytest.raises(TrainingError, match="table is of another seed or recipe"):
        recorded(tmp_path, monkeypatch)


def recorded(path, monkeypatch):
    monkeypatch.setattr(training_page, "PAGE", path / "page.md")
    monkeypatch.setattr(training_page, "RECORD", path / "page.json")
    arguments = ["--work", str(path / "work")]
    assert CliRunner().invoke(training_page.main, arguments, catch_exceptions=False).exit_code == 0
    return (path / "page.md").read_text(encoding="utf-8")


@pytest.mark.usefixtures("small")
def test_a_study_broken_off_takes_no_figures_away(tmp_path, monkeypatch):
    whole = study(tmp_path / "work", "table")["table"]["found"]
    recorded(tmp_path, monkeypatch)
    kept = tmp_path / "work" / training_studies.RESULTS
    some = json.loads(kept.read_text())
    some["table"]["found"] = {"sgd 0.01 0.1": 0.5}
    kept.write_text(json.dumps(some))
    recorded(tmp_path, monkeypatch)
    assert json.loads((tmp_path / "page.json").read_text())["table"]["found"] == whole | {"sgd 0.01 0.1": 0.5}


def test_two_do_not_study_in_one_folder(tmp_path):
    with folder.claim(tmp_path, resume=True), pytest.raises(TrainingError, match="another training"):
        study(tmp_path, "table")


@pytest.mark.usefixtures("small")
def test_results_of_another_seed_or_recipe_are_not_gone_on_with(tmp_path, monkeypatch):
    of = training_studies.identity("table", seed=1)
    (tmp_path / training_studies.RESULTS).write_text(json.dumps({"table": {"of": of, "found": {}}}))
    with pytest.raises(TrainingError, match="table is of another seed or recipe"):
        study(tmp_path, "table")
    assert study(tmp_path, "table", "--seed", "1")["table"]["found"]
    monkeypatch.setattr(training_studies, "EPOCHS", 2)
    with pytest.raises(TrainingError, match="table is of another seed or recipe"):
        study(tmp_path, "table", "--seed", "1")


def test_the_page_is_of_the_recorded_figures():
    known = training_studies.results(training_page.RECORD, seed=0)
    assert training_page.PAGE.read_text(encoding="utf-8") == training_page.page(known)


@pytest.mark.usefixtures("small")
def test_more_frames_than_there_are_cannot_be_learned_from(tmp_path, monkeypatch):
    monkeypatch.setattr(training_studies, "COUNTS", (4,))
    with pytest.raises(TrainingError, match="there are 3 frames"):
        study(tmp_path, "counts")


def test_the_papers_table_is_whole():
    assert np.shape(list(training_page.PAPER.values())) == (4, 6)
    assert tuple(training_page.PAPER) == training_studies.RATES
