import dataclasses
import shutil

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest
from commands import run
from films import film

from scripts import score_detector
from simgrab.dataset import datasets
from simgrab.dataset.tables import table_of
from simgrab.errors import DatasetError, DetectorError, SourceError
from simgrab.instrument.detect import pictures as detections
from simgrab.judge.evaluate import detection
from simgrab.judge.evaluate.intervals import clopper_pearson, standard_error
from simgrab.model import label_arrays as labels
from simgrab.model.records.observations import Detection
from simgrab.model.scenario import OrangePeel

NONE = Detection("none", "nothing found", 0.1)


@pytest.fixture(scope="module")
def known(dataset):
    return datasets.read(dataset)


def perfect(row):
    if labels.box(row) is None:
        return NONE
    ones = np.ones(4)
    return Detection("found", "", 0.9, labels.box(row), labels.centre(row), labels.yaw(row), ones, ones[:2], 0.01)


def gone(row):
    """The same frame without the grab."""
    nothing = {f"box_{e}_px": None for e in ("x0", "y0", "x1", "y1")}
    return msgspec.structs.replace(row, present=False, visible_fraction=0.0, **nothing)


def moved(found, *, box=0.0, centre=(0.0, 0.0), yaw=0.0):
    return dataclasses.replace(
        found, box=found.box + box, centre=found.centre + np.array(centre), yaw=(found.yaw + yaw) % np.pi
    )


def cases(known, detect):
    return detection.cases(known, [detect(row) for row in known.rows])


def test_a_perfect_detector_scores_1(known):
    scores = detection.score(cases(known, perfect))
    f = scores["overall"]
    assert f["map50_95"] == f["map50"] == pytest.approx(1.0)
    assert f["recall"] == 1
    assert f["longest_miss"] == 0
    assert f["false_boxes"] == 0
    assert f["centre"]["p95_px"] == 0
    assert f["coverage"] == {"box": 1, "centre": 1, "yaw": 1}
    assert scores["by_weather"]["quay-day"] == f
    assert sum(c["frames"] for c in scores["by_rope"].values()) == f["labelled"]
    f = detection.figures(cases(known, lambda _: NONE))  # and one that sees nothing 0
    assert f["map50_95"] == f["recall"] == f["centre"]["frames"] == 0
    assert f["longest_miss"] == f["labelled"] == 6
    assert f["coverage"]["centre"] is None


def test_tables_fit_120_columns_and_name_worlds_as_independent(known, capsys):
    scores = detection.score(cases(known, perfect))
    for group in (scores["overall"], scores["cut_off"]):
        group |= dict.fromkeys(("labelled", "empty", "false_boxes", "labelled_worlds", "missed_worlds"), 99_999)
        group |= {"recall": 0.9, "recall_interval": (0.8, 1.0), "false_interval": (0.0, 1.0)}
    score_detector.show(scores | {"detector": "bundled", "time": {"median_ms": 1.0, "p95_ms": 2.0}})
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) <= 120
    assert "…" not in printed
    assert "cut off by the picture's edge" in printed
    assert "Worlds, not frames, are independent: true intervals of shares are wider." in printed


def test_grabs_that_the_edge_cuts_are_scored_apart(known):
    rows = [msgspec.structs.replace(row, in_frame_fraction=0.9 if row.frame % 2 else 1.0) for row in known.rows]
    some = [dataclasses.replace(case, truth=row) for case, row in zip(cases(known, perfect), rows, strict=True)]
    cut = [case for case in some if case.labelled and case.truth.frame % 2]
    assert 0 < detection.score(some)["cut_off"]["labelled"] == len(cut) < len(some)


def test_a_planted_shift_is_seen(known):
    f = detection.figures(cases(known, lambda row: moved(perfect(row), centre=(2.0, 0.0))))
    assert f["centre"]["median_px"] == pytest.approx(2)
    assert f["centre"]["u_mean_px"] == pytest.approx(2)
    assert f["centre"]["v_mean_px"] == pytest.approx(0)
    assert f["coverage"]["centre"] == 0.5  # of u, but not of v
    assert f["map50_95"] == 1


def test_a_planted_pull_outwards_is_seen(known):
    def pulled(row):
        outward = labels.centre(row) - (row.cx_px, row.cy_px)
        return moved(perfect(row), centre=3 * outward / np.linalg.norm(outward))

    c = detection.figures(cases(known, pulled))["centre"]
    assert c["radial_mean_px"] == pytest.approx(3)
    assert c["radial_mean_share"] > 0
    assert c["box_radial_mean_px"] != pytest.approx(3)
    # A detector without a centre is scored by its box's.
    bare = [dataclasses.replace(perfect(row), centre=None, centre_sd_px=None) for row in known.rows]
    c = detection.figures(detection.cases(known, bare))["centre"]
    assert c["radial_mean_px"] == pytest.approx(c["box_radial_mean_px"])
    assert c["median_px"] > 0


def test_boxes_off_by_a_little_cost_precision(known):
    f = detection.figures(cases(known, lambda row: moved(perfect(row), box=6.0, yaw=0.1)))
    assert f["map50"] == pytest.approx(1)
    assert 0.3 < f["map50_95"] < 0.95
    assert f["coverage"] == {"box": 0, "centre": 1, "yaw": 0}


def test_false_boxes_on_empty_frames_count_and_slivers_do_not(known):
    rows = list(known.rows)
    empty = known.with_rows(table_of([gone(row) for row in rows[:3]] + rows[3:]))
    said = [perfect(rows[0]), NONE, NONE, *map(perfect, rows[3:])]
    f = detection.figures(detection.cases(empty, said))
    assert (f["labelled"], f["empty"], f["false_boxes"]) == (3, 3, 1)
    assert f["recall"] == 1
    assert f["map50_95"] < 1  # a false box as sure as the true ones
    sliver = msgspec.structs.replace(rows[0], visible_fraction=0.05)
    f = detection.figures(cases(known.with_rows(table_of([sliver, *rows[1:]])), perfect))
    assert (f["labelled"], f["empty"], f["false_boxes"], f["map50_95"]) == (5, 0, 0, pytest.approx(1))


def test_runs_of_misses_end_with_a_clip_a_world_and_a_dataset(known):
    def longest(*rows):
        return detection.figures([detection.Case(row, True, NONE) for row in rows])["longest_miss"]

    first, second, third = known.rows[:3]
    assert longest(first, third) == 2
    assert longest(first, second, first) == 2
    assert longest(first, second, msgspec.structs.replace(third, clip=1)) == 2
    assert longest(first, second, msgspec.structs.replace(third, variant=1)) == 2
    some = [detection.Case(row, True, NONE, "", name) for row, name in ((first, ""), (second, ""), (third, "other"))]
    assert detection.figures(some)["longest_miss"] == 2


def test_worlds_with_an_error_are_counted_and_those_of_datasets_kept_apart(known):
    first, second, third = known.rows[:3]
    rows = [(first, ""), (second, ""), (third, ""), (first, "other"), (msgspec.structs.replace(third, variant=1), "")]
    f = detection.figures([detection.Case(row, True, NONE, "", name) for row, name in rows] +
                          [detection.Case(third, True, perfect(third), "", "third")])  # fmt: skip
    assert (f["labelled_worlds"], f["missed_worlds"], f["recall"]) == (4, 3, pytest.approx(1 / 6))
    assert (f["empty_worlds"], f["false_worlds"]) == (0, 0)
    empty = [detection.Case(gone(row), False, perfect(row) if name else NONE, "", name) for row, name in rows]
    f = detection.figures(empty)
    assert (f["empty_worlds"], f["false_worlds"], f["false_boxes"]) == (3, 1, 1)


def test_a_means_error_is_that_of_groups():
    values = np.random.default_rng(0).normal(size=40)
    plain = values.std(ddof=1) / np.sqrt(40)
    assert standard_error(values, range(40)) == pytest.approx(plain)
    assert standard_error(np.repeat(values, 15), np.repeat(np.arange(40), 15).tolist()) == pytest.approx(plain)
    assert standard_error(values, [0] * 40) == pytest.approx(plain)
    assert standard_error(values[:1], [0]) == 0


def test_intervals_are_exact():
    assert clopper_pearson(0, 500) == pytest.approx((0, 0.00735), abs=1e-5)
    assert clopper_pearson(998, 1000) == pytest.approx((0.99279, 0.99976), abs=1e-5)
    assert clopper_pearson(0, 0) is None


def test_of_tines_that_look_alike_no_yaw_is_scored(known, monkeypatch):
    tines = msgspec.structs.replace(known.scenario, grab=OrangePeel())
    monkeypatch.setattr(type(known), "scenario", property(lambda _: tines))
    assert detection.figures(cases(known, perfect))["coverage"] == {"box": 1, "centre": 1, "yaw": None}


def test_yaw_is_the_direction_of_the_grabs_x_axis(crooked_dataset):
    for row in datasets.read(crooked_dataset).rows:
        lips = np.reshape(row.keypoints, (-1, 3))[6:, :2]
        along_y = lips[0] - lips[1]  # lip corners of one shell lie along the grab's y axis
        angle = np.arctan2(along_y[1], along_y[0]) - labels.yaw(row)
        assert abs(abs((angle + np.pi / 2) % np.pi - np.pi / 2) - np.pi / 2) < np.radians(12)  # perspective


class Fixed:
    """Says what is known, file by file."""

    name = "fixed"

    def __init__(self, known):
        self.said = iter([perfect(row) for row in known.rows])

    def __call__(self, picture):
        assert picture.shape == (270, 480, 3)
        return next(self.said)


def test_detections_are_kept_as_a_table(known, tmp_path):
    watched = detections.detect(known.path, Fixed(known))
    detections.save(watched, tmp_path / "d.parquet")
    table = pq.read_table(tmp_path / "d.parquet").to_pylist()
    assert [row["file"] for row in table] == [str(known.image(row)) for row in known.rows]
    np.testing.assert_allclose([row["u_px"] for row in table], [row.grab_u_px for row in known.rows])
    detections.save(watched, tmp_path / "d.csv")
    for name in ("d.csv", "d.parquet"):
        status, _, problem = run("estimate", tmp_path / name, "--camera", known.path / "camera.toml")
        assert status == 0, problem


def test_a_picture_that_cannot_be_read_and_a_video_are_refused(known, tmp_path):
    shutil.copy(known.image(known.rows[0]), tmp_path / "b.jpg")
    assert detections.detect(tmp_path, Fixed(known)).files == (tmp_path / "b.jpg",)
    (tmp_path / "a.jpg").write_bytes(b"no picture")
    with pytest.raises(SourceError, match=r"a\.jpg cannot be read"):
        detections.detect(tmp_path, Fixed(known))
    with pytest.raises(SourceError, match="is a video"):
        detections.detect(film(tmp_path / "a.mp4", [0.0]), Fixed(known))


def test_the_picture_that_a_detector_cannot_take_is_named(known):
    def refuses(_):
        raise DetectorError("too small")

    with pytest.raises(DetectorError, match=r"000000\.jpg: too small"):
        detections.detect(known.path, refuses)


def test_only_the_pictures_that_labels_are_of_are_scored(known, tmp_path):
    shutil.copytree(known.path, tmp_path / "other")
    other = datasets.read(tmp_path / "other")
    assert detections.detect_dataset(other.path, other.rows, Fixed(known)).files == tuple(map(other.image, other.rows))
    shutil.copy(other.image(other.rows[0]), other.image(other.rows[1]))
    with pytest.raises(DatasetError, match="does not match the digest in its labels"):
        detections.detect_dataset(other.path, other.rows, Fixed(known))
