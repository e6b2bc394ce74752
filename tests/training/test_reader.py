import dataclasses
import json
import shutil

import msgspec
import numpy as np
import pytest
from commands import run
from conftest import altered, small_scene

torch = pytest.importorskip("torch")
pytest.importorskip("onnx")

from simgrab.dataset import datasets  # noqa: E402
from simgrab.dataset.render import render  # noqa: E402
from simgrab.dataset.tables import table_of  # noqa: E402
from simgrab.errors import DatasetError, TrainingError  # noqa: E402
from simgrab.instrument.read import Reader  # noqa: E402
from simgrab.instrument.read.crops import around, crops, cut  # noqa: E402
from simgrab.instrument.read.reader import NO_DIGIT  # noqa: E402
from simgrab.model import layouts  # noqa: E402
from simgrab.model.truth import Row  # noqa: E402
from simgrab.training.reader import augment, cells, task  # noqa: E402
from simgrab.training.reader.lenet import LeNet5  # noqa: E402
from simgrab.training.reader.train import RECIPE, train_reader  # noqa: E402

FAST = dataclasses.replace(RECIPE, epochs=2, batch=32, warm_up=0.3)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Two clips before a plain yard, the layout one of two and every digit shown."""
    layout = {
        "width_px": 480, "height_px": 270, "digit_width_px": 20, "digit_height_px": 32, "decimals": 3,
        "hoist_px": [[200 + 24 * k, 20] for k in range(4)], "clock": {"x_px": 8, "y_px": 240, "size_px": 16},
    }  # fmt: skip
    values = [layout | {"closing_px": [[x + 24 * k, 80] for k in range(4)]} for x in (40, 300)]
    displays = [{"layout": layout, "constant_m": 7.6} for layout in values]
    scene = small_scene(
        seed=5, frames=24, clip__clip_frames=12, image__shadow_map_px=0,
        swing__rope_length_m={"dist": "uniform", "low": 8.0, "high": 17.0},
        vary={"display": {"dist": "one-of", "names": ["a", "b"], "values": displays}},
    )  # fmt: skip
    path = tmp_path_factory.mktemp("train") / "digits"
    render(scene, path)
    # Twenty frames to learn from and four to validate, whatever was drawn.
    altered(path, "split", lambda splits: ["val" if k % 6 == 5 else "train" for k in range(len(splits))])
    return path


def test_lenet_is_that_of_the_paper():
    net = LeNet5()
    sizes = {name: sum(p.numel() for p in getattr(net, name).parameters()) for name in ("c1", "c5", "f6")}
    assert sizes == {"c1": 156, "c5": 48_120, "f6": 10_164}  # section II.B
    assert net(torch.zeros(3, 1, 32, 32)).shape == (3, 11)


def test_cells_hold_what_the_display_shows(dataset):
    """Each digit's box is where the frame's own layout has it, as the bundled reader sees, and none elsewhere."""
    (found,) = datasets.read_all([dataset], "train")
    gathered = cells.gather([found], "train", 0)
    rows = [row for row in found.rows if row.split == "train"]
    for k, row in enumerate(rows):
        mine = np.flatnonzero(gathered.frames == k)
        digits = gathered.digits[mine]
        assert "".join(map(str, digits[:8])) == row.rope_text.replace(" ", "")
        assert (digits[8:] == NO_DIGIT).all()
        shown = np.stack([augment.plain(gathered.boxes[i]) for i in mine[:8]])[:, None]
        np.testing.assert_array_equal(Reader().probabilities(shown).argmax(1), digits[:8])
        assert len(digits) == 8 + cells.HALVES + cells.ELSEWHERE
    assert len({len(box) for box in gathered.boxes}) == 1


def test_training_crops_are_those_of_the_reader():
    picture = np.random.default_rng(0).integers(0, 256, (1080, 1920), np.uint8)
    layout = layouts.load("two-by-four")
    boxes = [cut(picture, around(cell, cells.SPARE_PX)) for cell in layout.cells]
    np.testing.assert_array_equal(np.stack([augment.plain(box) for box in boxes])[:, None], crops(picture, layout))


def test_a_digit_survives_alteration_and_never_the_same_way(monkeypatch):
    """Centred within a pixel or so and as bright as the digit, not its background."""
    monkeypatch.setattr(augment, "SMALL", 0.0)  # see below
    box = np.zeros((60, 40), np.uint8)
    box[20:40, 15:25] = 255
    rng = np.random.default_rng(0)
    seen = np.stack([augment.altered(box, rng) for _ in range(300)])
    assert np.abs(seen).max() <= 0.5
    assert len(np.unique(seen.reshape(300, -1), axis=0)) == 300
    inside, outside = seen[:, 12:20, 13:19].mean((1, 2)), seen[:, :4].mean((1, 2))
    assert ((inside - outside) > 0.3).all()
    rows = (seen - seen.min((1, 2), keepdims=True)).mean(2)
    centre = (rows * np.arange(32)).sum(1) / rows.sum(1)
    assert 0.1 < centre.std() < 1.5


def test_a_small_digit_has_background_around():
    spare = cells.SPARE_PX
    box = np.full((48 + 2 * spare, 32 + 2 * spare), 255, np.uint8)  # what lies beyond the cell is not seen
    box[spare:-spare, spare:-spare] = 40
    box[spare + 6 : -spare - 6, spare + 8 : -spare - 8] = 200
    rng = np.random.default_rng(0)
    seen = np.stack([augment._small(box, rng) for _ in range(200)])
    assert seen.shape[1:] == (48, 32)
    assert seen.max() <= 200
    rows, columns = (seen.max(2) > 120).sum(1), (seen.max(1) > 120).sum(1)
    (x0, x1), (y0, y1) = augment.SMALL_SCALES
    assert 36 / y1 - 1 <= rows.min() < 36 / y1 + 3 < 36 / y0 - 3 < rows.max() <= 36 / y0 + 1
    assert 16 / x1 - 1 <= columns.min() < 16 / x1 + 2 < 16 / x0 - 1 < columns.max() <= 16 / x0 + 1
    assert (seen[:, [0, -1]] == 40).all()  # the digit stays inside


def test_of_an_earlier_digit_less_is_left_than_of_the_present_one():
    box, earlier = np.full((20, 10), 200, np.uint8), np.zeros((20, 10), np.uint8)
    rng = np.random.default_rng(0)
    left = 1 - np.array([augment.ghostly(box, earlier, rng).mean() / 200 for _ in range(200)])
    low, high = augment.GHOST
    assert low - 0.01 < left.min() < low + 0.05
    assert high - 0.05 < left.max() < high + 0.01 < 0.5


def test_every_digit_is_learned_as_often():
    digits = np.repeat([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, NO_DIGIT], [50, 40, 30, 20, 1, 5, 5, 5, 5, 5, 400])
    counts = np.bincount(digits[task._balanced(digits)])
    assert counts.tolist() == [50] * 10 + [100]
    with pytest.raises(DatasetError, match="shows the digit 4, 9"):
        task._balanced(digits[(digits != 4) & (digits != 9)])


def test_the_threshold_refuses_one_in_ten_thousand():
    rng = np.random.default_rng(0)
    confidence = rng.uniform(0.85, 1.0, 100_000)
    probabilities = np.zeros((100_000, 11), np.float32)
    probabilities[:, 3] = confidence
    digits = np.full(100_000, 3)
    least = task.threshold(probabilities, digits)
    assert (confidence < least).mean() == pytest.approx(1e-4, rel=0.2)
    assert task.threshold(probabilities, digits + 1) == task.LEAST_THRESHOLD  # nothing is read right
    probabilities[:, 3] = 0.3
    assert task.threshold(probabilities, digits) == task.LEAST_THRESHOLD


def test_a_killed_training_ends_in_the_same_bytes(dataset, tmp_path):
    whole = train_reader([dataset], tmp_path / "whole", FAST)

    def kill(report):
        if report.epoch == 2 and report.step > 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_reader([dataset], tmp_path / "killed", FAST, report=kill)
    resumed = train_reader([dataset], tmp_path / "killed", FAST, resume=True)
    assert (tmp_path / "killed/reader.onnx").read_bytes() == (tmp_path / "whole/reader.onnx").read_bytes()
    assert resumed.metrics == whole.metrics
    card = json.loads((tmp_path / "whole/reader.json").read_text())
    assert card["metrics"]["by_weather"]["quay-day"]["digits"] == whole.metrics["digits"] == 4 * 8 * (1 + task.ROUNDS)
    assert Reader(tmp_path / "whole/reader.onnx").threshold == whole.metrics["threshold"]


def test_the_command_line_trains(dataset, tmp_path):
    status, printed, _ = run("train", "reader", dataset, "--out", tmp_path / "made", "--epochs", 1, "--json")
    assert status == 0
    assert json.loads(printed)["digits"] == 288
    assert (tmp_path / "made/reader.md").exists()


def test_torn_frames_are_left_out(dataset):
    (found,) = datasets.read_all([dataset], "train")

    def tear(row: Row):
        return msgspec.structs.replace(row, torn_row_px=30) if row.frame < 10 else row

    torn = found.with_rows(table_of(map(tear, found.rows)))
    kept = sum(row.split == "train" and row.frame >= 10 for row in found.rows)
    assert len(cells.gather([torn], "train", 0).weather) == kept


def test_one_clear_message(dataset, tmp_path):
    with pytest.raises(DatasetError, match="no frame of the split 'test' shows rope lengths"):
        cells.gather(datasets.read_all([dataset], "train"), "test", 0)
    broken = tmp_path / "broken"
    shutil.copytree(dataset, broken)
    picture = next((broken / "images").rglob("*.jpg"))
    picture.write_bytes(b"no picture")
    with pytest.raises(DatasetError, match="changed or damaged"):
        train_reader([broken], tmp_path / "out", FAST)
    with pytest.raises(DatasetError, match="not a dataset"):
        train_reader([tmp_path], tmp_path / "none", FAST)
    with pytest.raises(TrainingError, match="device 'none' cannot be used"):
        train_reader([dataset], tmp_path / "none", dataclasses.replace(FAST, device="none"))
    assert not (tmp_path / "none").exists()
    with pytest.raises(TrainingError, match="does not contain a training"):
        train_reader([dataset], broken, FAST)
