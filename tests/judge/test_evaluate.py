"""`simgrab evaluate`: errors that were planted are found, each where it was planted."""

import dataclasses
import itertools
import json
import math

import av
import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest
from browser import needs_chromium, shown
from click.testing import CliRunner
from conftest import small_scene
from films import film
from oracle import Oracle

from simgrab.cli import cli
from simgrab.dataset import datasets
from simgrab.dataset.render import render
from simgrab.errors import DatasetError, RecordError, RunError
from simgrab.instrument.alarm import events
from simgrab.instrument.contract import Measurement
from simgrab.instrument.estimate.follow import Known
from simgrab.instrument.pipeline import Pipeline
from simgrab.instrument.read import Reader
from simgrab.instrument.run import runs
from simgrab.instrument.run.run import RunOptions, run
from simgrab.judge.check import metrics
from simgrab.judge.check.trial import flat
from simgrab.judge.evaluate import budget, swings, truths, warnings
from simgrab.judge.evaluate.alignment import begins
from simgrab.judge.evaluate.budget import CHAIN
from simgrab.judge.evaluate.evaluation import evaluate
from simgrab.judge.evaluate.page import page
from simgrab.judge.evaluate.table import tables

SIZE = {"camera__width_px": 640, "camera__height_px": 360,
        "camera__focal": {"model": "pixels", "focal_length_px": 548.3}}  # fmt: skip


@pytest.fixture(scope="module")
def swinging(tmp_path_factory):
    """A dataset and a video of the same twelve seconds: working cycles, a fixed camera, the display."""
    folder = tmp_path_factory.mktemp("swinging")
    scene = small_scene(
        "work-cycles", frames=60, clip__frame_rate_hz=5.0, display__layout="two-by-four",
        camera__mount={"model": "fixed"}, clip__drop_share=0.04, clip__repeat_share=0.05, **SIZE,
    )  # fmt: skip
    render(scene, folder / "data", video=folder / "swing.mp4")
    return folder


def measured(folder, out, *, of="data", **errors):
    rows = datasets.read(folder / "data").rows
    camera = folder / "data" / "camera.toml"
    if of == "swing.mp4":
        table = pq.read_table(folder / "swing.parquet").to_pylist()
        rows = tuple(rows[row["frame"]] for row in table)
    return run(folder / of, camera, out, Pipeline(Oracle(list(rows), **errors), Reader()), RunOptions(video=False))


def altered(run, change):
    """Change each measurement of a run."""
    return dataclasses.replace(run, measurements=tuple(map(change, run.measurements)))


@pytest.fixture(scope="module")
def clean(swinging):
    return measured(swinging, swinging / "clean")


def test_a_run_without_errors_has_none(clean, swinging):
    found = evaluate(clean, swinging / "data")
    assert found["frames"]["known"] == 60
    assert found["detection"]["map50_95"] == pytest.approx(1)
    assert found["detection"]["recall"] == 1
    assert found["detection"]["centre"]["p95_px"] == pytest.approx(0, abs=1e-9)
    assert found["detection"]["jitter_px"] == pytest.approx(0, abs=1e-9)
    assert found["reading"]["digits_right"]["value"] == 1
    chain = found["budget"]["chain"]
    assert chain[0]["rmse_deg"] < 1e-4
    assert chain[1]["rmse_deg"] < 1e-4  # a fixed camera's tilt does not change
    assert found["budget"]["run"]["rmse_deg"] == pytest.approx(found["angle"]["overall"]["rmse_deg"])


def test_planted_errors_are_found_where_they_are(clean, swinging, tmp_path):
    bad = measured(swinging, tmp_path / "bad", noise_px=3.0, miss=10, shift_px=20.0)
    found, before = evaluate(bad, swinging / "data"), evaluate(clean, swinging / "data")
    labelled = found["detection"]["labelled"]
    assert found["detection"]["recall"] == pytest.approx(1 - (labelled // 10) / labelled)
    assert found["detection"]["longest_miss"] == 1
    assert found["detection"]["centre"]["u_mean_px"] == pytest.approx(20, abs=1.5)
    assert found["detection"]["centre"]["v_mean_px"] == pytest.approx(0, abs=1.5)
    assert found["detection"]["jitter_px"] == pytest.approx(3, rel=0.25)
    chain = {row["stage"]: row["rmse_deg"] for row in found["budget"]["chain"]}
    was = {row["stage"]: row["rmse_deg"] for row in before["budget"]["chain"]}
    for stage in [stage.name for stage in CHAIN[:-1]]:  # all but the centres
        assert chain[stage] == pytest.approx(was[stage], abs=0.02)
    assert chain["grab's centre as detected"] > was["grab's centre as detected"] + 0.1
    assert found["frames"]["missed"] == labelled // 10


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({}, ""),
        ({"focal_length_px": 575.7}, "focal_length_px 575.7 in place of 548.3"),
        ({"k1": -0.1, "offset_m": (0.0, -0.6, -0.3)}, "k1 -0.1 in place of 0; offset_m [0, -0.6, -0.3] in place of"),
        ({"offset_m": (0.0, 0.65, -0.3)}, ""),  # as far off as the file states
    ],
)
def test_a_camera_file_that_differs_from_the_true_camera_is_named(clean, swinging, changes, named):
    other = dataclasses.replace(clean, calibration=msgspec.structs.replace(clean.calibration, **changes))
    found = evaluate(other, swinging / "data")
    assert named in found["run"]["camera"]
    assert bool(found["run"]["camera"]) == bool(named)
    notes = [table.note for table in tables(found)]
    assert any(named and named in note for note in notes) == bool(named)


def test_misread_digits_are_counted(clean, swinging):
    def swapped(m):
        return msgspec.structs.replace(m, rope_text=(m.rope_text or "").translate(str.maketrans("38", "83")))

    found = evaluate(altered(clean, swapped), swinging / "data")
    of, right = found["reading"]["digits_right"]["of"], found["reading"]["digits_right"]["count"]
    rows = datasets.read(swinging / "data").rows
    shown = "".join(r.rope_text for r, m in zip(rows, clean.measurements, strict=True) if "?" not in m.rope_text)
    assert right <= of - shown.count("3") - shown.count("8") < of


def test_a_video_is_compared_through_its_table(clean, swinging, tmp_path):
    film = measured(swinging, tmp_path / "film", of="swing.mp4")
    lost = film.about["counts"]["lost"]
    assert lost > 0
    known = truths.of(film, swinging / "swing.mp4")
    assert sum(row is None for row in known.rows) == lost
    found = evaluate(film, known)
    assert found["angle"]["overall"]["rmse_deg"] == pytest.approx(
        evaluate(clean, swinging / "data")["angle"]["overall"]["rmse_deg"], abs=0.1
    )
    assert found["detection"]["centre"]["p95_px"] == pytest.approx(0, abs=1e-9)
    assert evaluate(film, swinging / "swing.parquet")["angle"] == found["angle"]


def reencoded(path, out, kept, grid_s):
    """Encode some of a video's frames again, with time stamps from 0 on a grid."""
    with av.open(str(path)) as file:
        frames = list(file.decode(video=0))[kept]

    times = [round((frame.time - frames[0].time) / grid_s) * grid_s for frame in frames]
    pictures = [frame.to_ndarray(format="rgb24") for frame in frames]
    return film(out, times, (640, 360), draw=lambda i, _: pictures[i], coding={"crf": "24"})


@pytest.mark.parametrize(
    ("kept", "grid_s"),
    [(slice(None), 1 / 24), (slice(17, 45), 1e-3), (slice(0, None, 2), 1e-3), (slice(21, None, 2), 1 / 24)],
    ids=["re-encoded", "cut", "resampled", "all three"],
)
def test_a_copy_of_a_video_is_compared_by_time(kept, grid_s, swinging, tmp_path):
    whole = measured(swinging, tmp_path / "whole", of="swing.mp4", shift_px=4.0)
    tilt = msgspec.convert(whole.about["tilt"], Known)
    original = list(truths.of(whole, swinging / "swing.mp4").rows)
    rows = [row for row in original if row is not None][kept]
    copy = reencoded(swinging / "swing.mp4", tmp_path / "copy.mp4", kept, grid_s)
    instrument = Pipeline(Oracle(rows, shift_px=4.0), Reader(), tilt=tilt)
    made = run(copy, swinging / "swing.camera.toml", None, instrument)
    known = truths.of(made, swinging / "swing.mp4")
    matched = [row for row in known.rows if row is not None]
    assert [row.time_s for row in matched] == [row.time_s for row in rows]
    wanted = {row.time_s for row in rows}
    error = np.rad2deg(whole.alpha) - [row.alpha_deg if row and row.time_s in wanted else np.nan for row in original]
    found = evaluate(made, known)
    assert found["angle"]["overall"]["rmse_deg"] == pytest.approx(np.sqrt(np.nanmean(error**2)), rel=0.05)
    assert "matched by time" in found["run"]["matched"]
    assert found["run"]["matched"] in tables(found)[2].note
    begin = rows[0].time_s - original[0].time_s
    assert truths.of(made, swinging / "swing.mp4", begin).rows == known.rows


@pytest.mark.parametrize("kept", [slice(None), slice(17, 47)])
def test_a_copy_of_another_size_is_compared_in_its_own_pixels(swinging, tmp_path, kept):
    whole = measured(swinging, tmp_path / "film", of="swing.mp4", shift_px=4.0)
    time, some = whole.time[kept] - whole.time[kept][0], whole.measurements[kept]
    whole = dataclasses.replace(whole, time=time, names=whole.names[kept], measurements=some)

    def reduced(values):
        return values and tuple(0.75 * value for value in values)

    fewer_px = tuple(
        msgspec.structs.replace(m, box=reduced(m.box), centre=reduced(m.centre), centre_sd=reduced(m.centre_sd))
        for m in some
    )
    small = dataclasses.replace(whole, calibration=whole.calibration.scaled(480, 270), measurements=fewer_px)
    before, found = (evaluate(one, swinging / "swing.mp4") for one in (whole, small))
    assert found["angle"] == before["angle"]
    assert found["detection"]["map50_95"] == before["detection"]["map50_95"]
    for stage in ("median_px", "p95_px"):
        assert found["detection"]["centre"][stage] == pytest.approx(0.75 * before["detection"]["centre"][stage])
    for row, was in zip(found["budget"]["chain"], before["budget"]["chain"], strict=True):
        assert row["rmse_deg"] == pytest.approx(was["rmse_deg"], abs=1e-3)
    assert "0.75 times as wide" in found["run"]["matched"]


def test_a_part_of_angles_alone_is_found_by_them(swinging, tmp_path):
    whole = measured(swinging, tmp_path / "film", of="swing.mp4")
    known = truths.of(whole, swinging / "swing.mp4").alpha
    angles = [
        Measurement(status="ok", alpha=alpha + 0.01) if np.isfinite(alpha) else Measurement(status="lost", reason="-")
        for alpha in known[17:47]
    ]
    time = whole.time[17:47] - whole.time[17]
    part = dataclasses.replace(whole, time=time, names=whole.names[17:47], measurements=tuple(angles))
    found = truths.of(part, swinging / "swing.mp4")
    np.testing.assert_array_equal(found.alpha, known[17:47])
    same = [Measurement(status=m.status, reason=m.reason, alpha=0.05 if m.alpha else None) for m in whole.measurements]
    constant = dataclasses.replace(whole, measurements=tuple(same))
    np.testing.assert_array_equal(truths.of(constant, swinging / "swing.mp4").alpha, known)  # its times are the video's
    with pytest.raises(RunError, match="state it by --start"):
        truths.of(dataclasses.replace(part, measurements=tuple(same[17:47])), swinging / "swing.mp4")


@pytest.mark.parametrize("noise", [0.002, 0.2])
@pytest.mark.parametrize("first", [0, 30])
def test_angles_alone_find_where_they_begin_or_nothing(first, noise):
    """The times of a cut are those of the video's first frames."""
    stamps, rng = np.arange(180) / 9, np.random.default_rng(0)
    true = np.abs(0.14 * np.exp(-stamps / 30) * np.sin(2 * np.pi * stamps / 8.3 + 0.4))
    measured = true[first : first + 90] + rng.normal(0, noise, 90)
    if noise < 0.1:
        start = begins(stamps[:90], stamps, measured[:, None], true[:, None], alone=True)
        assert start == pytest.approx(stamps[first], abs=1 / 9)
    else:
        with pytest.raises(RunError, match="hardly better"):
            begins(stamps[:90], stamps, measured[:, None], true[:, None], alone=True)


def written(path, columns, mark=","):
    rows = [",".join(columns)] + [",".join(map(str, row)) for row in zip(*columns.values(), strict=True)]
    path.write_text("\n".join(row.replace(",", mark) for row in rows) + "\n")
    return path


@pytest.mark.parametrize("of", ["data", "swing.mp4"])
def test_a_runs_table_alone_is_judged_as_the_run(of, swinging, tmp_path):
    measured(swinging, tmp_path / "run", of=of, miss=10)
    known = swinging / of
    whole = evaluate(tmp_path / "run", known)
    for name in (runs.TABLE, runs.SHEET):
        alone = evaluate(tmp_path / "run" / name, known)
        for part in ("frames", "detection", "reading", "angle", "interval", "alarm"):
            assert getattr(alone, part) == getattr(whole, part), part


@pytest.mark.parametrize(
    ("of", "key"), [("data", "frame"), ("data", "file"), ("swing.mp4", "frame"), ("swing.mp4", "time_s")]
)
def test_a_table_of_angles_by_another_program_is_judged(of, key, swinging, tmp_path):
    """A row without an angle is a missed frame; some rows are left out."""
    rows = list(datasets.read(swinging / "data").rows)
    keys = {"frame": range(60), "file": [row.file for row in rows]}
    if of == "swing.mp4":
        film = pq.read_table(swinging / "swing.parquet").to_pylist()
        rows = [rows[row["frame"]] for row in film]
        keys = {"frame": range(len(film)), "time_s": [row["pts_s"] for row in film]}
    angles = [row.alpha_deg + 0.5 for row in rows]
    angles[5], angles[9] = "NaN", ""
    columns = {key: list(keys[key])[3:], "alpha_deg": angles[3:], "mine": angles[3:]}
    found = evaluate(written(tmp_path / "mine.csv", columns), swinging / of)
    assert (found.frames.all, found.frames.missed, found.run.instrument) == (len(rows) - 3, 2, "mine")
    assert found.angle.overall.rmse_deg == pytest.approx(0.5)
    assert found.angle.overall.max_deg == pytest.approx(0.5)
    assert found.alarm is not None
    german = columns | {"alpha_deg": [str(angle).replace(".", "#") for angle in columns["alpha_deg"]]}
    german = written(tmp_path / "mine.csv", german, ";")
    german.write_text(german.read_text().replace("#", ","))
    assert evaluate(german, swinging / of) == found


@pytest.mark.parametrize(
    ("angle", "noted"),
    [
        (lambda true: 1.1 * np.radians(true), True),
        (lambda true: 1.1 * true, False),
        (lambda true: 0.1 * true, False),
        (lambda true: np.full(60, np.radians(true.mean())), False),  # an instrument that is stuck
        (lambda true: np.radians(2 * true.mean() - true), False),  # it follows nothing
    ],
)
def test_angles_in_radians_are_named(angle, noted, swinging, tmp_path):
    true = np.array([row.alpha_deg for row in datasets.read(swinging / "data").rows])
    found = evaluate(written(tmp_path / "mine.csv", {"frame": range(60), "alpha_deg": angle(true)}), swinging / "data")
    rmse = 0.1 * np.sqrt(np.mean(true**2))
    note = f"The angles seem to be in radians, not degrees: in degrees, their RMSE would be {rmse:.3f}°. "
    assert tables(found)[0].note.startswith(note) == noted


def test_numbers_of_frames_say_where_a_part_of_a_video_is(swinging, tmp_path):
    """The angles are constant; they raise a false alarm."""
    part = {"frame": range(20, 40), "alpha_deg": [12.0] * 20}
    found = evaluate(written(tmp_path / "part.csv", part), swinging / "swing.mp4")
    assert (found.frames.known, found.angle.overall.frames, found.alarm.false) == (20, 20, 1)
    stamps = pq.read_table(swinging / "swing.parquet")["pts_s"].to_pylist()[20:40]
    timed = written(tmp_path / "part.csv", {"time_s": stamps, "alpha_deg": part["alpha_deg"]})
    with pytest.raises(RunError, match="state it by --start"):
        evaluate(timed, swinging / "swing.mp4")
    assert evaluate(timed, swinging / "swing.mp4", 0.0) == found


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "the file is empty; a header alpha_deg, and frame, time_s or file is needed"),
        ("frame,alpha_deg\n", "no rows below the header"),
        ("frame,alpha\n0,1\n", "column alpha_deg is missing; there are: frame, alpha"),
        ("t,alpha_deg\n0,1\n", "column time_s or frame is missing; there are: t, alpha_deg"),
        ("frame,alpha_deg\n0,1\n1,big\n", "alpha_deg, row 2: 'big' is not a number"),
        ('frame,alpha_deg\n0,"1,5"\n', "alpha_deg, row 1: '1,5' is not a number; write decimals with a point"),
        ("frame,alpha_deg\n0,1,5\n", "Expected 2 columns, got 3.*decimals need points"),
        ("frame,alpha_deg\n0,-2.5\n", "alpha_deg, row 1: is -2.5; must be 0 to 90, or empty"),
        ("frame,alpha_deg\n0,inf\n", "alpha_deg, row 1: is inf"),
        ("frame,alpha_deg\nNaN,1\n", "frame, row 1: is missing"),
        ("frame,alpha_deg\n0,1\n0,1\n", "frame, row 2: must increase"),
        ("frame,alpha_deg\n0,1\n7000,1\n", r"frame, row 2: is 7000; must be a whole number from 0 to \d\d$"),
        ("frame,alpha_deg\n0.5,1\n", "frame, row 1: is 0.5; must be a whole"),
        ("time_s,alpha_deg\n0,1\n,1\n", "time_s, row 2: is missing"),
        ("frame,alpha_deg,status\n0,1,ok\n1,2,missed\n", "row 2: alpha is only allowed with status 'ok'"),
        ("frame,alpha_deg,status\n0,1,fine\n", "row 1: Invalid enum value 'fine'"),
        ("frame,alpha_deg,status\n0,,ok\n", "row 1: status 'ok' needs alpha"),
    ],
)
def test_a_table_that_is_none_is_refused_in_a_line(text, named, swinging, tmp_path):
    path = tmp_path / "angles.csv"
    path.write_text(text)
    with pytest.raises(RecordError, match=rf"angles\.csv.*{named}"):
        evaluate(path, swinging / "swing.mp4")


def test_a_table_names_files_of_the_dataset(swinging, tmp_path):
    path = written(tmp_path / "angles.csv", {"file": ["000001.jpg", "mine.jpg"], "alpha_deg": [1, 2]})
    with pytest.raises(RecordError, match=r"file, row 2: is mine.jpg; must be one of the dataset's, such as images/"):
        evaluate(path, swinging / "data")


def test_a_cut_that_fits_anywhere_is_refused(clean, swinging, tmp_path):
    whole = measured(swinging, tmp_path / "film", of="swing.mp4")
    still = [msgspec.structs.replace(m, centre=(320.0, 180.0) if m.centre else None) for m in whole.measurements[20:40]]
    cut = dataclasses.replace(whole, time=whole.time[20:40] - 3.97, names=whole.names[20:40], measurements=tuple(still))
    with pytest.raises(RunError, match=r"cannot tell where .* begins: its positions follow .*; state it by --start"):
        truths.of(cut, swinging / "swing.mp4")
    with pytest.raises(RunError, match="--start is of videos"):
        truths.of(clean, swinging / "data", 1.0)


def test_what_does_not_belong_together_is_refused(clean, swinging, dataset, tmp_path):
    small = msgspec.structs.replace(clean.calibration, width_px=320, height_px=200)
    smaller = dataclasses.replace(clean, calibration=small)
    with pytest.raises(RunError, match="none of the frames"):
        truths.of(dataclasses.replace(clean, names=("elsewhere.jpg",) * 60), swinging / "data")
    with pytest.raises(DatasetError, match="not the truth table"):
        truths.of(clean, tmp_path / "none.mp4")
    with pytest.raises(RunError, match=r"lacks 55 of the run.s 60 frames, such as images/train/000005.jpg"):
        truths.of(clean, dataset)
    with pytest.raises(RunError, match="its labels differ"):
        truths.of(dataclasses.replace(clean, about=clean.about | {"labels_sha256": "of another"}), swinging / "data")
    with pytest.raises(RunError, match="the run's are 320x200"):
        truths.of(smaller, swinging / "data")
    strange = dataclasses.replace(clean, names=(*clean.names[:-1], "elsewhere.jpg"))
    with pytest.raises(RunError, match=r"lacks 1 of the run.s 60 frames, such as .*elsewhere\.jpg"):
        truths.of(strange, swinging / "data")
    with pytest.raises(RunError, match="not a run"):
        runs.load(tmp_path)


def test_every_number_that_may_be_limited_has_its_name(clean, swinging):
    figures = flat(evaluate(clean, swinging / "data"))
    assert not [metric for metric, value in figures.items() if value is not None and metrics.unknown(metric)]
    assert set(figures) >= metrics.NAMES - {metrics.TIME}


def test_errors_are_those_of_arithmetic():
    e = swings.errors(np.radians([1.0, 2.0, 3.0, np.nan]), np.radians([0.0, 2.0, 5.0, 1.0]))
    assert e["frames"] == 3
    assert e["bias_deg"] == pytest.approx(-1 / 3)
    assert e["rmse_deg"] == pytest.approx(math.sqrt(5 / 3))
    assert e["max_deg"] == pytest.approx(2)
    assert swings.errors(np.array([np.nan]), np.array([0.0]))["rmse_deg"] is None


def said(degrees, danger):
    alpha = np.radians(degrees)
    return [Measurement(status="ok", alpha=a, danger=float(a > math.radians(10)) if danger else None) for a in alpha]


def compare(estimated, true, *, danger=True):
    times = np.arange(len(true)) / 9
    measurements = said(estimated, danger)
    return swings.alarms(times, measurements, events(times, measurements), np.radians(true))


def test_alarms_are_judged_by_event():
    true = np.full(400, 2.0)
    true[50:60], true[200:210], true[300:310] = 11.0, 10.3, 9.7
    late, early = true.copy(), true.copy()
    late[50:53] = 9.0
    assert compare(true, true) == {
        "events": 2, "sure": 1, "missed": 0, "reported": 2, "false": 0, "delays": [0, 0], "already_on": 0,
        "median_delay": 0.0, "precision": 1.0, "recall": 1.0,
    }  # fmt: skip
    assert compare(late, true)["delays"] == [3, 0]
    assert compare(true, true, danger=False) == compare(true, true)
    between = true.copy()
    between[60:200] = 9.05  # holds the first alarm until the second event
    one = compare(between, true)
    assert (one["reported"], one["delays"], one["already_on"], one["median_delay"]) == (1, [0], 1, 0.0)
    early[195:200] = 10.1
    assert compare(early, true)["delays"] == [0, -5]
    blind = compare(np.full(400, 2.0), true)
    assert (blind["missed"], blind["reported"], blind["recall"], blind["precision"]) == (1, 0, 0.0, None)
    grey = true.copy()
    grey[300:310] = 10.2  # the true swing reaches 9.7: neither right nor false
    assert compare(grey, true)["false"] == 0
    wrong = true.copy()
    wrong[350:355] = 12.0
    assert compare(wrong, true)["false"] == 1
    assert compare(wrong, true)["precision"] == pytest.approx(20 / 25)


def test_early_warnings_are_judged_by_lead_and_by_what_follows():
    times, true = np.arange(1080) / 9, np.full(1080, 2.0)
    true[360:370], true[630:640] = 11.0, 12.0
    chance = np.full(1080, 0.5)
    chance[324:360], chance[639:642], chance[900:909] = 0.9, 0.8, 1.0  # 4 s before, too late, and for nothing

    def given(chance):
        return [Measurement(status="ok", alpha=np.radians(2), warning=p, peak=0.2) for p in chance.tolist()]

    found = warnings.score(times, given(chance), np.radians(true))
    counts = {"events": 2, "missed": 0, "late": 1, "reported": 3, "false": 1}
    assert {name: found[name] for name in counts} == counts
    assert found["leads"] == pytest.approx([4, -1])
    assert found["false_per_h"] == pytest.approx(3600 / times[-1])
    silent = warnings.score(times, given(0.1 * chance), np.radians(true))
    assert (silent["missed"], silent["lead_s"], silent["reported"]) == (2, None, 0)


def test_forecasts_are_judged_by_what_happens():
    happened = np.arange(100) < 70
    assert warnings.reliability(np.full(100, 0.7), happened) == pytest.approx(0)
    assert warnings.reliability(np.where(np.arange(100) < 50, 0.3, 0.9), happened) == pytest.approx((0.7 + 0.5) / 2)
    times = np.arange(0, 60, 1 / 9)
    swing = np.abs(0.1 * np.cos(2 * np.pi * times / 8))
    said = [Measurement(status="ok", alpha=a, rope_length_m=9.81 * (4 / np.pi) ** 2, peak=0.1) for a in swing.tolist()]
    found = warnings.score(times, said, swing)
    for name in ("peak_rmse_deg", "persist_rmse_deg", "two_frames_rmse_deg"):
        assert found[name] < 0.2
    assert np.nanmax(warnings.within(times, swing)) == pytest.approx(0.1)
    assert np.isnan(warnings.within(times, swing)[-50:]).all()


def test_coverage_is_the_share_within():
    ends = np.array([[0.09, 0.11]] * 3 + [[np.nan, np.nan]])
    found = swings.coverage(ends, np.array([0.1, 0.12, 0.11, 0.1]))
    assert found["share"] == pytest.approx(2 / 3)
    assert found["frames"] == 3
    assert found["width_deg"] == pytest.approx(math.degrees(0.02))


def test_the_command_line_prints_tables_and_json(clean, swinging, tmp_path):
    folder, data = str(swinging / "clean"), str(swinging / "data")
    told = CliRunner().invoke(cli, ["evaluate", folder, data, "--page", str(tmp_path / "e.html")])
    assert told.exit_code == 0, told.output
    for words in ("Error budget", "rope-aware", "COCO mAP@50:95", "Largest contribution"):
        assert words in told.output
    plain = json.loads(CliRunner().invoke(cli, ["evaluate", folder, data, "--json"]).output)
    assert plain["angle"]["overall"] == pytest.approx(evaluate(clean, data)["angle"]["overall"])
    assert (tmp_path / "e.html").read_text().count("<svg") == 2
    assert len(list(tmp_path.iterdir())) == 1


@needs_chromium
def test_the_page_opens_in_a_browser(clean, swinging, tmp_path):
    known = truths.of(clean, swinging / "data")
    told = shown(page(clean, known, evaluate(clean, known)), tmp_path)
    assert [figure["kind"] for figure in told["figures"]] == ["svg", "svg"]


def test_an_instrument_that_outputs_angles_alone_is_judged_by_them(clean, swinging):
    def bare(m):
        return Measurement(status=m.status, reason=m.reason, alpha=m.alpha)

    known = truths.of(clean, swinging / "data")
    alone = dataclasses.replace(altered(clean, bare), about=clean.about | {"estimate": None, "tilt": None})
    found = evaluate(alone, known)
    assert (found["detection"], found["reading"], found["budget"]) == (None, None, None)
    assert found["angle"] == evaluate(clean, known)["angle"]
    assert found["interval"]["share"] is None
    assert [t.title for t in tables(found)] == ["Errors of the swing angle, degrees", "Alarms"]
    for factor, said in ((1.0, True), (100.0, False)):
        rows = tuple(row and msgspec.structs.replace(row, alpha_deg=factor * row.alpha_deg) for row in known.rows)
        note = tables(evaluate(alone, dataclasses.replace(known, rows=rows)))[0].note
        assert ("The grab hardly swings (standard deviation 0.0" in note) == said
    assert "Errors of the swing angle" in page(alone, known, found)


def test_each_figure_needs_its_own_field_alone(clean, swinging):
    known = truths.of(clean, swinging / "data")
    whole = evaluate(clean, known)

    def only(*fields):
        def kept(m):
            return Measurement(status=m.status, reason=m.reason, alpha=m.alpha, **{f: getattr(m, f) for f in fields})

        return evaluate(altered(clean, kept), known)

    centres = only("centre")["detection"]
    assert centres["centre"] == whole["detection"]["centre"]
    assert (centres["recall"], centres["map50"], centres["false_boxes"]) == (None, None, None)
    lengths = only("rope_length_m")["reading"]
    assert lengths["length"] == whole["reading"]["length"]
    assert lengths["digits_right"]["value"] is None
    assert only("rope_text")["reading"]["digits_right"] == whole["reading"]["digits_right"]
    for found in (whole, only("centre"), only("rope_length_m"), only("box")):
        cells = [cell for table in tables(found)[:2] for row in table.rows if len(row) == 2 for cell in row]
        assert not [cell for cell in cells if "None" in cell or not any(map(str.isalnum, cell.replace("to", "")))]


def test_texts_with_points_are_compared_by_their_digits_and_silence_is_refusal(clean, swinging):
    def with_texts(change):
        texts = altered(clean, lambda m: msgspec.structs.replace(m, rope_text=change(m.rope_text)))
        return evaluate(texts, swinging / "data")["reading"]

    assert with_texts(lambda text: f"{text[:2]}.{text[2:7]}.{text[7:]}") == with_texts(lambda text: text)
    turn = itertools.count()
    silent = with_texts(lambda text: None if next(turn) % 2 else text)
    assert silent["frames_refused"]["count"] >= 30 - 3


def test_a_roll_that_is_not_known_is_the_cameras_fault(clean, swinging):
    turned = msgspec.structs.replace(clean.calibration, roll_deg=clean.calibration.roll_deg + 10)
    chain = evaluate(dataclasses.replace(clean, calibration=turned), swinging / "data")["budget"]["chain"]
    before = evaluate(clean, swinging / "data")["budget"]["chain"]
    for now, then in zip(chain[:3], before, strict=False):
        assert now["rmse_deg"] == pytest.approx(then["rmse_deg"])


def test_a_mount_may_turn_the_camera_and_nothing_may_change_it(clean, swinging):
    known = truths.of(clean, swinging / "data")

    def of(**changes):
        rows = [msgspec.structs.replace(row, **changes) if i % 2 else row for i, row in enumerate(known.rows)]
        return budget.budget(clean, dataclasses.replace(known, rows=tuple(rows)))

    assert of(roll_deg=known.rows[0].roll_deg + 0.1)["chain"][2]["rmse_deg"] is not None
    assert of(offset_y_m=0.3) is None
    assert of(fx_px=500.0) is None


def test_a_run_with_the_controllers_data_has_no_budget_from_pixels_alone(clean, swinging):
    informed = dataclasses.replace(clean, about=clean.about | {"controller": {"clock_offset_s": 0.0}})
    assert evaluate(informed, swinging / "data")["budget"] is None


def test_a_run_without_a_display_is_not_said_to_have_read_one(clean, swinging):
    blind = altered(clean, lambda m: msgspec.structs.replace(m, rope_text=None, rope_status=""))
    read, length = (
        next(t for t in tables(evaluate(one, swinging / "data").to_dict()) if t.title == "Reading")
        for one in (clean, blind)
    )
    assert read.note == "The display lags behind the rope."
    assert length.note == ""
    assert length.rows == (read.rows[-1],)
    unknown = altered(blind, lambda m: msgspec.structs.replace(m, rope_length_m=None))
    found = evaluate(unknown, swinging / "data")["budget"]
    assert not [row["stage"] for row in (*found["chain"], *found["aside"]) if "length" in row["stage"]]


def test_a_refused_stage_is_the_limit():
    names = [stage.name for stage in CHAIN]

    def of(*rmse):
        return budget.limit([{"stage": n, "rmse_deg": e} for n, e in zip(names, rmse, strict=True)])

    assert of(0, 0.1, 0.3, 0.31, 0.32, 0.33) == "tilt estimated"
    assert of(0, 0.05, 0.4, None, 0.31, 0.32) == "camera as nominally known (refused)"


def test_all_contributions_are_named_the_largest_first():
    chain = [{"stage": s, "rmse_deg": e} for s, e in (("true", 0.0), ("tilt", 0.3), ("camera", 0.5), ("rope", 0.499))]
    assert budget.contributions(chain) == "camera (0.40°); then tilt (0.30°)"
    assert budget.contributions([*chain, {"stage": "centre", "rmse_deg": None}]) == "centre (refused)"


def test_the_computation_of_angles_itself_may_be_the_limit(clean, swinging):
    own = altered(clean, lambda m: m if m.alpha is None else msgspec.structs.replace(m, alpha=4 * m.alpha))
    assert evaluate(clean, swinging / "data").budget.limit != "the run itself"
    assert evaluate(own, swinging / "data").budget.limit == "the run itself"


def test_a_tilt_that_was_given_is_given_to_the_chain_too(clean, swinging):
    given = dataclasses.replace(clean, about=clean.about | {"estimate": None})
    found = evaluate(given, swinging / "data")["budget"]
    assert found["tilt"] == "given"
    assert found["chain"][-1]["rmse_deg"] == pytest.approx(found["run"]["rmse_deg"], abs=1e-3)
    assert found["drawn"]["frames"] == 0
    tables(evaluate(given, swinging / "data"))
    assert evaluate(clean, swinging / "data")["budget"]["tilt"] == "estimated"


def test_independent_frames_are_judged_without_alarms(tmp_path, tmp_path_factory):
    data = tmp_path_factory.mktemp("iid") / "data"
    render(small_scene(frames=12, display__layout="two-by-four", **SIZE), data)
    rows = list(datasets.read(data).rows)
    made = run(data, data / "camera.toml", tmp_path / "out", Pipeline(Oracle(rows), Reader()), RunOptions(video=False))
    found = evaluate(made, data)
    assert made.time is None
    assert found["alarm"] is None
    assert found["frames"]["known"] == 12
    assert found["angle"]["overall"]["frames"] == sum(m.status == "ok" for m in made.measurements) > 5
