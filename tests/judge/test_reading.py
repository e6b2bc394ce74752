import shutil

import numpy as np
import pytest
from scipy import stats

from simgrab.dataset.render import render
from simgrab.errors import DatasetError
from simgrab.instrument.read import Reader
from simgrab.io.pictures import encode
from simgrab.judge.evaluate import reading, reading_trial
from simgrab.judge.evaluate.reading import Read, Share
from simgrab.model import layouts, scenes
from simgrab.model.records.observations import Reading
from simgrab.world.camera.overlay import Overlay

READABLE = {
    "camera.width_px": 640,
    "camera.height_px": 360,
    "camera.focal": {"model": "pixels", "focal_length_px": 548.0},
    "place": {"model": "plain"},
    "image.samples": 0,
    "image.shadow_map_px": 0,
    "image.quality": 90,
    "frames": 4,
}


def read(text, found, *, below=None, status=None, frame="f", group="rain"):
    hoist, closing = found.split()
    status = status or ("refused" if "?" in found else "read")
    made = Reading(status, "", hoist, closing, np.ones(8), None, None, None)
    return Read(frame, group, text, below or text, made)


def test_every_kind_of_frame_is_counted_once():
    right, wrong, refused = (
        read("2015 2137", "2015 2137"),
        read("2015 2137", "2013 2737"),
        read("2015 2137", "20?5 2138"),
    )
    score = reading.score([right, wrong, refused])
    assert score.digits_right == Share(20, 23)  # the refused one's other digits were read, one of them wrong
    assert score.digits_refused == Share(1, 24)
    assert score.frames_right == Share(1, 2)
    assert score.frames_refused == Share(1, 3)
    assert score.torn_right == score.torn_refused == Share(0, 0)
    assert score.wrong == (wrong,)


def test_torn_displays_are_scored_apart():
    """Each number may be as above or as below; digits of both in one number are a mixture."""
    cases = ("2015 2137", "1899 0266", "2015 0266", "1815 2137", "20?? 2137")  # the last but one is a mixture
    reads = [read("2015 2137", found, below="1899 0266") for found in cases]
    score = reading.score(reads)
    assert score.torn_right == Share(3, 5)
    assert score.torn_refused == Share(1, 5)
    assert score.wrong == (reads[3],)
    assert score.digits_right == score.frames_right == Share(0, 0)


def test_groups_come_in_order_and_then_all():
    reads = [read("2015 2137", "2015 2137", group=g) for g in ("rain", "fog", "rain")]
    assert [(s.group, s.frames_right.of) for s in reading.by_group(reads)] == [("rain", 2), ("fog", 1), ("all", 3)]


def test_the_interval_is_clopper_and_pearsons():
    for count, of in ((0, 10), (3, 10), (10, 10), (99_999, 100_000)):
        known = stats.binomtest(count, of).proportion_ci(0.95, method="exact")
        assert Share(count, of).interval == pytest.approx((known.low, known.high), abs=1e-12)
    assert Share(0, 0).interval == (0.0, 1.0)
    assert Share(0, 0).value is None


def test_the_table_lists_wrong_frames():
    reads = [read("2015 2137", "2015 2137"), read("2015 2137", "2015 2187", frame="000012.jpg")]
    scores = reading.by_group(reads)
    text = reading.table(scores)
    assert "- 000012.jpg: shows 2015 2137, read 2015 2187" in text
    assert "| all | 16 | 93.7500 |" in text
    assert reading.as_json(scores)[-1]["wrong"] == [
        {"frame": "000012.jpg", "group": "rain", "shows": "2015 2137", "read": "2015 2187"}
    ]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Displays of two layouts in one dataset, neither of which its camera file has."""
    layout = {
        "width_px": 640, "height_px": 360, "digit_width_px": 28, "digit_height_px": 44, "decimals": 3,
        "hoist_px": [[300 + 34 * k, 20] for k in range(4)], "clock": {"x_px": 8, "y_px": 330, "size_px": 20},
    }  # fmt: skip
    values = [layout | {"closing_px": [[x + 34 * k, 100] for k in range(4)]} for x in (40, 400)]
    varied = {"display.layout": {"dist": "one-of", "values": values}}
    change = {"clip.clip_frames": 2, "display.constant_m": 7.0, "vary": varied}
    path = tmp_path_factory.mktemp("read") / "shown"
    render(scenes.load("quay-day", READABLE | change), path)
    return path


def test_a_dataset_whose_layout_varies_is_read(dataset):
    reads = reading.read_dataset(dataset, Reader())
    assert len(reads) == 4
    score = reading.score(reads)
    assert score.digits_right == Share(32, 32)
    assert score.frames_refused.count == 0


def test_a_dataset_without_picture_or_display_is_refused(dataset, tmp_path):
    bare = tmp_path / "bare"
    shutil.copytree(dataset, bare)
    next((bare / "images").rglob("*.jpg")).unlink()
    with pytest.raises(DatasetError, match="has labels but no image"):
        reading.read_dataset(bare, Reader())
    bare = tmp_path / "other"
    shutil.copytree(dataset, bare)
    next((bare / "images").rglob("*.jpg")).write_bytes(b"another")
    with pytest.raises(DatasetError, match="does not match the digest in its labels"):
        reading.read_dataset(bare, Reader())
    with pytest.raises(DatasetError, match="no frame shows rope lengths"):
        reading.read_dataset(dataset, Reader(), split="none")


def test_displays_show_every_digit_in_every_cell_as_often():
    layout = layouts.load("four-point-four")
    shown = list(reading_trial.displays(layout, 4000, seed=2))
    digits = np.array([[int(c) for c in one.rope_text if c.isdigit()] for one in shown])
    for cell in digits.T:
        assert stats.chisquare(np.bincount(cell, minlength=10)).pvalue > 1e-5
    assert all(one.torn_row_px is None and one.rope_text == one.rope_text_below for one in shown)
    assert shown == list(reading_trial.displays(layout, 4000, seed=2))


def test_torn_displays_tear_where_digits_are():
    layout = layouts.load("two-by-four")
    for one in reading_trial.displays(layout, 200, seed=2, torn=True):
        assert 32 < one.torn_row_px < 132
        hoist, closing = np.subtract(layout.lengths(one.rope_text), layout.lengths(one.rope_text_below))
        assert abs(hoist) <= 0.26
        assert abs(closing) <= 0.26


def backdrop():
    rng = np.random.default_rng(4)
    return rng.normal(120, 50, (1080, 1920, 3)).clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize("name", layouts.names())
def test_a_part_is_coded_as_the_whole_picture_is(name):
    """Every pixel that the reader looks at."""
    import cv2

    layout, picture = layouts.load(name), backdrop()
    (trial,) = reading_trial.stills([picture], layout, reading_trial.displays(layout, 1, 0), 60)
    whole = Overlay(layout).blend(picture, trial.shown)
    whole = cv2.imdecode(np.frombuffer(encode(whole[..., ::-1], "jpeg", 60), np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    for x0, y0, x1, y1 in layout.cells:
        around = np.s_[y0 - 6 : y1 + 6, x0 - 4 : x1 + 4]
        np.testing.assert_array_equal(trial.rgb[around], whole[around])
        assert (trial.rgb[around] != picture[around]).any()


def test_a_video_shows_what_was_sent():
    layout = layouts.load("two-by-four")
    scenario = scenes.load("calm-day", {"clip.bit_rate_mbit_s": 4.0})
    shown = list(reading_trial.displays(layout, 4, 3))
    flat = np.full((1080, 1920, 3), 100, np.uint8)
    trials = list(reading_trial.video([flat], layout, iter(shown), scenario, 0))
    assert [trial.shown for trial in trials] == shown
    for trial in trials:
        sent = Overlay(layout).blend(flat, trial.shown).astype(int)
        assert np.abs(trial.rgb - sent)[32:132, 1748:1872].mean() < 25
