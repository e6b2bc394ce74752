"""SwingBench: the clips of a season, the format of entries, and the scorer."""

import contextlib
import csv
import json
import math
import re
import shutil
from types import SimpleNamespace

import av
import msgspec
import numpy as np
import pytest
from commands import run

from simgrab.dataset.sensor_files import describe
from simgrab.dataset.tables import calibration_of
from simgrab.errors import BenchError, InstrumentError, RecordError
from simgrab.instrument.contract import Frame, Measurement
from simgrab.instrument.estimate import MeanRay, RopeAware
from simgrab.instrument.estimate.inertial.readings import FORCE, RATE, STAMP, read_imu
from simgrab.instrument.pipeline import Pipeline
from simgrab.lab.bench import board, entry, files, season
from simgrab.lab.bench.entry import Answers, Entry, MethodDescription
from simgrab.lab.bench.files import ClipTruth, Published, hidden_like, published, season_of, targets
from simgrab.lab.bench.score import THRESHOLDS_DEG, recall, sanity, score
from simgrab.lab.bench.season import Season
from simgrab.model.records.observations import Detection, Reading
from simgrab.runtime import processes
from simgrab.world.extensions import Recipe
from simgrab.world.sensors import record


@pytest.fixture(autouse=True)
def few_replications(monkeypatch):
    """Intervals, of which no test here compares the ends, take long."""
    monkeypatch.setattr("simgrab.lab.bench.score.REPLICATIONS", 2)


def target(name="a", n=90, peak_deg=12.0, phase=0.0):
    times = np.arange(n) / 9
    return ClipTruth(name, times, np.deg2rad(np.abs(peak_deg * np.sin(2 * np.pi * times / 8 + phase))))


TARGETS = (
    target("a"), target("b", 60, 5.0, 1.0), target("c", 40, 11.0, 2.0),
    *(target(name, 50, 6.0, phase) for phase, name in enumerate("defgh")),
)  # fmt: skip
FRAMES = {t.clip: len(t.times) for t in TARGETS}
OPEN = Published("open", season.VERSION, "", "", FRAMES)


def off_by(error_deg, targets=TARGETS, width_deg=0.2, name="method"):
    def answers(t):
        alpha = t.alpha + np.deg2rad(error_deg)
        half = np.deg2rad(width_deg) / 2
        return Answers(("ok",) * len(alpha), alpha, alpha - half, alpha + half, np.full(len(alpha), 0.01))

    return Entry(MethodDescription(name, "picture", "open"), {t.clip: answers(t) for t in targets})


def test_the_nightly_clips_have_every_weather_and_every_pair_of_mount_and_offset():
    clips = season.nightly()
    assert len(set(clips)) == 12
    assert {c.weather for c in clips} == set(season.WEATHERS)
    assert len({(c.mount, c.offset) for c in clips}) == 9
    assert sum(c.swing == "alarm" for c in clips) == 6
    assert set(clips) < set(season.full())
    assert [clip.swing for clip in Season(subset="trial").clips] == ["work", "alarm"]
    assert len(set(season.full())) == 144
    for clip in season.full():
        scene = Season(seed=0).scenario(clip)
        assert scene.camera.offset_y_m == season.OFFSETS_M[clip.offset]
        assert type(scene.camera.mount).__name__.lower().startswith(clip.mount)
        assert scene.display_layout is not None


def test_tilt_and_seed_of_a_clip_follow_from_the_seasons_seed():
    clip = season.nightly()[3]
    same, other = Season(seed=7).scenario(clip), Season(seed=8).scenario(clip)
    assert same == Season(seed=7, salt="salt").scenario(clip)
    assert same.camera.beta_deg != other.camera.beta_deg
    assert same.seed != other.seed
    assert season.LEAST_TILT_DEG <= same.camera.beta_deg <= season.MOST_TILT_DEG


def test_the_commitment_binds_to_everything_that_a_season_is():
    one = Season("autumn", seed=5, salt="a")
    changes = ({"seed": 6}, {"salt": "b"}, {"frames": 541}, {"subset": "full"}, {"width_px": 1920}, {"name": "winter"})
    others = [msgspec.structs.replace(one, **change) for change in (*changes, {"sensors": ("imu",)})]
    assert len({season.commitment for season in (one, *others)}) == 8
    assert Season().commitment == "5ab75c881399c521c3a559c87c939dbb861fa978b9fa12c4bf0cb4ba5feaf237"  # is published


def test_sensors_change_no_scenario_of_a_picture_and_their_errors_follow_from_the_seasons_seed():
    clips = season.nightly()[:2]
    with_imu = Season(sensors=("imu", "encoders"))
    scenes = [with_imu.scenario(clip) for clip in clips]
    assert scenes == [Season().scenario(clip) for clip in clips]
    measured = [with_imu.with_sensors(scene) for scene in scenes]
    assert [set(scene.sensors) for scene in measured] == [{"imu0", "slew", "luff", "hoist"}] * 2
    assert measured[0].seed != measured[1].seed  # by which noise is drawn
    assert msgspec.structs.replace(measured[0], sensors={}) == scenes[0]


@pytest.mark.parametrize("sensors", [("gps",), ("lidar", "imu"), ("imu", "imu")])
def test_unknown_sensors_and_another_order_are_refused(sensors):
    with pytest.raises(BenchError, match="sensors: must be some of imu, encoders, cameras, lidar, controller, in"):
        Season(sensors=sensors)


def test_a_track_is_one_of_the_season():
    assert season.sensors_of("picture+rope", ("imu",)) == ()
    assert season.sensors_of("picture+imu+lidar", ("imu", "cameras", "lidar")) == ("imu", "lidar")
    for track in ("", "imu", "rope", "picture+imu+rope", "picture+rope+rope", "picture+lidar", "picture+"):
        with pytest.raises(ValueError, match=f"got {re.escape(repr(track))}"):
            season.sensors_of(track, ("imu",))


def test_the_truth_scores_everything_and_the_others_made_from_it_what_they_must():
    truth, last, zero = sorted(
        score([], TARGETS), key=lambda s: ["truth", "last value", "constant 0°"].index(s.about.method)
    )
    assert truth.figures["average_recall"].value == 1
    assert truth.figures["rmse_deg"].value == 0
    assert truth.figures["coverage"].value == 1
    assert (truth.figures["alarms_missed"].value, truth.figures["alarms_false"].value) == (0, 0)
    swings = np.rad2deg(np.concatenate([t.alpha for t in TARGETS]))
    assert zero.figures["rmse_deg"].value == pytest.approx(np.sqrt(np.mean(swings**2)))
    assert zero.figures["alarms_missed"].value > 0
    expected = np.mean([np.mean([(np.rad2deg(t.alpha) <= e).mean() for e in THRESHOLDS_DEG]) for t in TARGETS])
    assert zero.figures["average_recall"].value == pytest.approx(expected)
    assert truth.figures["average_recall"].value > last.figures["average_recall"].value > expected


def test_recall_is_the_mean_over_thresholds_of_the_frames_with_a_grab():
    # 0.4° is within 0.5, 0.75, 1, 1.5 and 2 of the eight thresholds; on one it counts, whatever the file rounds to.
    assert recall(off_by(0.4).clips["a"], TARGETS[0]) == recall(off_by(0.5).clips["a"], TARGETS[0]) == 5 / 8
    truth = sanity(TARGETS, "open")[0].clips["a"]
    alpha = np.where(np.arange(90) < 45, np.nan, truth.alpha)
    half = Answers(truth.status, alpha, alpha, alpha, truth.seconds)
    assert recall(half, TARGETS[0]) == pytest.approx(0.5)
    assert recall(half, ClipTruth("a", TARGETS[0].times, np.where(np.isnan(alpha), np.nan, TARGETS[0].alpha))) == 1


def test_errors_coverage_and_time():
    (found,) = (s for s in score([off_by(0.3, width_deg=0.4)], TARGETS) if not s.sanity)
    figures = found.figures
    for name in ("rmse_deg", "p95_deg", "at_10_deg"):
        assert figures[name].value == pytest.approx(0.3)
    assert figures["coverage"].value == 0
    assert figures["ms_per_frame"].value == pytest.approx(10)
    (wider,) = (s for s in score([off_by(0.3, width_deg=0.7)], TARGETS) if not s.sanity)
    assert wider.figures["coverage"].value == 1


def test_entries_that_differ_surely_have_other_ranks_and_those_that_do_not_share_one():
    better, worse = off_by(0.05, name="better"), off_by(1.2, name="worse")
    ranks = {s.about.method: s.rank for s in score([worse, better, off_by(0.05, name="twin")], TARGETS) if not s.sanity}
    assert ranks == {"better": 1, "twin": 1, "worse": 3}


def test_an_entry_that_is_better_in_some_clips_alone_shares_the_rank():
    even = off_by(0.6, name="even")
    worse = {name: off_by(2.5).clips[name] for name in "cde"}
    mixed = Entry(MethodDescription("mixed", "picture", "open"), off_by(0.05).clips | worse)
    found = [s for s in score([even, mixed], TARGETS) if not s.sanity]
    assert [s.about.method for s in found] == ["mixed", "even"]
    assert [s.rank for s in found] == [1, 1]


def test_ranks_follow_the_average_recall_within_a_track():
    tracks = ("picture", "picture+rope", "picture+rope+imu", "picture+lidar")
    entries = [Entry(MethodDescription(track, track, "open"), off_by(0.05 + i).clips) for i, track in enumerate(tracks)]
    entries += [off_by(error, name=f"{error}") for error in (0.15, 0.25, 0.4)]
    found = [s for s in score(entries[::-1], TARGETS) if not s.sanity]
    ranked = [("picture", 1), ("0.15", 2), ("0.25", 3), ("0.4", 4), *((track, 1) for track in tracks[1:])]
    assert [(s.about.method, s.rank) for s in found] == ranked


def test_clips_without_a_grab_are_not_scored():
    empty = ClipTruth("empty", TARGETS[0].times, np.full(90, np.nan))
    entry = off_by(0.3, (*TARGETS, empty))
    one, other = (score([entry], t)[0] for t in (TARGETS, (*TARGETS, empty)))
    assert one.figures == other.figures
    assert other.clips == len(TARGETS)
    with pytest.raises(BenchError, match="no frame"):
        score([entry], [empty])


def test_alarms_that_are_due_missed_false_and_late():
    def with_alarm(add_deg, delay=0):
        answers = off_by(0.0, width_deg=0.0).clips
        alpha = answers["a"].alpha + np.deg2rad(add_deg)
        alpha = np.concatenate([np.zeros(delay), alpha[: len(alpha) - delay]])
        changed = Answers(answers["a"].status, alpha, alpha, alpha, answers["a"].seconds)
        return score([Entry(MethodDescription("m", "picture", "open"), answers | {"a": changed})], TARGETS)[0].figures

    plain, low, late = with_alarm(0.0), with_alarm(-4.0), with_alarm(0.0, delay=3)
    assert plain["alarms_due"].value > plain["alarms_missed"].value == 0
    assert low["alarms_missed"].value == 1
    assert late["alarm_delay_frames"].value > plain["alarm_delay_frames"].value == 0
    high = score([off_by(6.0)], TARGETS)[0].figures
    assert high["alarms_false"].value > 0


def test_a_report_is_the_page_of_the_scores_and_needs_their_file_alone(tmp_path):
    scores = score([off_by(0.3), off_by(0.6, name="<i>")], TARGETS[1:3])
    board.save(scores, Season(), csv_file=tmp_path / "a.csv", page=tmp_path / "a.html")
    again = score([off_by(0.3), off_by(0.6, name="<i>")], TARGETS[1:3])
    assert (tmp_path / "a.csv").read_text() == board.table(again, Season())
    board.save_page([board.read(tmp_path / "a.csv")], tmp_path / "b.html")
    page = (tmp_path / "b.html").read_text()
    assert page == (tmp_path / "a.html").read_text()
    assert "&lt;i&gt;" in page
    board.save_page([board.read(tmp_path / "a.csv")] * 2, tmp_path / "c.html")
    assert (tmp_path / "c.html").read_text().count("<h2>Season open: 2 clips, 100 frames") == 2
    text = (tmp_path / "a.csv").read_text()
    header, first, *others = text.splitlines()
    cells = first.split(",")
    place = board._COLUMNS.index("frames")
    one_of = "its rows must be of one season, one commitment and one scorer"
    for bad, words in (
        ("", "the header is not that of bench score --out"),
        (text.replace("rank", "place"), "the header is not"),
        (header, one_of),
        (text + "open,1\n", f"row {len(others) + 2} must have {len(board._COLUMNS)} cells"),
        ("\n".join([header, ",".join(cells[: place + 1])]), "row 1 must have"),
        ("\n".join([header, f"{first},", *others]), "row 1 must have"),
        (text.replace("open", "autumn", 1), one_of),
        (text.replace(Season().commitment, "0" * 64, 1), one_of),
        ("\n".join([header, ",".join([*cells[:-1], "inf"])]), "ms_per_frame_high must be finite, got 'inf'"),
    ):
        (tmp_path / "bad.csv").write_text(bad)
        with pytest.raises(BenchError, match=rf"bad\.csv: not scores of simgrab bench \({re.escape(words)}"):
            board.read(tmp_path / "bad.csv")


def entered(folder):
    """Write a right entry for `TARGETS`."""
    folder.mkdir()
    (folder / ".DS_Store").touch()
    about = MethodDescription("<b>method</b>", "picture", "open")
    (folder / "entry.json").write_text(json.dumps(msgspec.to_builtins(about)))
    for t in TARGETS:
        alpha = np.minimum(t.alpha + 0.001, 1.5)
        rows = [Measurement(status="ok", alpha=a, alpha_low=a, alpha_high=a + 0.01) for a in alpha.tolist()]
        rows[2] = Measurement(status="missed", reason="no grab")
        (folder / f"{t.clip}.csv").write_text(entry.written(t.clip, rows, 0.02))
    return folder


def test_what_is_written_is_read_back(tmp_path):
    found = entry.read(entered(tmp_path / "e"), OPEN)
    answers = found.clips["b"]
    assert answers.status[2] == "missed"
    assert math.isnan(answers.alpha[2])
    expected = np.delete(TARGETS[1].alpha + 0.001, 2)
    np.testing.assert_allclose(np.delete(answers.alpha, 2), expected, atol=np.deg2rad(1e-6))


def edited(line, column, text):
    def edit(lines):
        cells = lines[line].split(",")
        cells[column] = text
        lines[line] = ",".join(cells)

    return edit


BAD = {
    "a header in another order": (edited(0, 0, "frame"), "line 1: the header must be clip,frame"),
    "another clip": (edited(3, 0, "b"), "line 4: clip 'b' in the file of 'a'"),
    "a frame twice": (edited(4, 1, "2"), "line 5: frame '2'; 3 is due"),
    "the end missing": (lambda lines: lines.pop(), "89 frames; the clip has 90"),
    "a frame too many": (lambda lines: lines.append("a,90,ok,1,,,0"), "only 90 frames"),
    "an unknown status": (edited(2, 2, "fine"), "line 3: status 'fine'"),
    "not a number": (edited(2, 3, "one"), "alpha_deg must be a number or empty, got 'one'"),
    "infinity": (edited(2, 5, "inf"), "high_deg must be finite"),
    "ok without an angle": (edited(2, 3, ""), "alpha_deg is required"),
    "an angle though missed": (edited(3, 3, "1.0"), "alpha_deg is required with status ok, and empty otherwise"),
    "half an interval": (edited(2, 4, ""), "both be given"),
    "an interval upside down": (edited(2, 4, "80"), "is above high_deg"),
    "a negative time": (edited(2, 6, "-0.1"), "time_s must be 0 or more"),
    "an open quote": (lambda lines: lines.append('"a'), "line 92: unexpected end of data"),
}


@pytest.mark.parametrize("what", BAD)
def test_a_bad_file_is_refused_by_its_line(tmp_path, what):
    edit, words = BAD[what]
    file = entered(tmp_path / "e") / "a.csv"
    lines = file.read_text().splitlines()
    edit(lines)
    file.write_text("\n".join(lines) + "\n")
    (problem,) = entry.problems(tmp_path / "e", OPEN)
    assert "a.csv" in problem
    assert words in problem
    with pytest.raises(BenchError, match=r"a\.csv"):
        entry.read(tmp_path / "e", OPEN)


def test_all_problems_of_an_entry_are_listed(tmp_path):
    folder = entered(tmp_path / "e")
    (folder / "a.csv").unlink()
    (folder / "b.csv").write_bytes(b"\xff\xfe")
    (folder / "notes.txt").write_text("")
    (folder / "entry.json").write_text('{"method": "m", "track": "lidar", "season": "open"}')
    found = entry.problems(folder, OPEN)
    assert len(found) == 4
    for words in ("joined with + in this order; got 'lidar'", "notes.txt: not a file", "UTF-8", "a.csv"):
        assert any(words in problem for problem in found)
    other = entered(tmp_path / "other")
    autumn = msgspec.structs.replace(OPEN, name="autumn")
    assert "season 'open'; these clips are of season 'autumn'" in entry.problems(other, autumn)[0]


class Still:
    """An instrument that measures no swing."""

    name = "still"

    def __call__(self, frames, calibration):  # noqa: ARG002
        return [Measurement(status="ok", alpha=0.0, alpha_low=0.0, alpha_high=0.01) for _ in frames]


class Sensed(Still):
    """An instrument that reads the sensor in the camera's housing."""

    def with_sensors(self, sensors):
        assert sensors.keys() == {"imu0"}
        assert len(read_imu(sensors["imu0"]).time) == 400
        return self


class Middle:
    """A detector that finds the grab in the middle of any picture, and a reader that reads 20 m."""

    name = "middle"

    def __call__(self, _picture):
        return Detection("found", "", 1.0, box=np.array([300.0, 200, 340, 240]), centre=np.array([320.0, 220]))

    def read(self, _picture, _layout):
        return Reading("read", "", "2000", "2000", 20.0)


@pytest.fixture
def sensed(tmp_path, monkeypatch):
    """Public part of a season of two clips of 4 s with an inertial sensor each."""
    camera = calibration_of(Season().scenario(season.nightly()[0]))
    frames = [Frame(np.zeros((540, 960, 3), np.uint8), i / 9) for i in range(36)]
    monkeypatch.setattr(entry, "open_source", lambda _path: frames)
    monkeypatch.setattr(entry.calibration, "load", lambda _path: camera)
    for seed, clip in enumerate("ab"):
        folder = tmp_path / "season" / "clips" / clip / "imu0"
        folder.mkdir(parents=True)
        readings = np.random.default_rng(seed).normal([0, 0, 0, 0, 0, -9.8], 0.01, (400, 6))
        rows = [f"{10_000_000 * i}," + ",".join(map(str, row)) for i, row in enumerate(readings.tolist())]
        (folder / "data.csv").write_text("\n".join([",".join((STAMP, *RATE, *FORCE)), *rows]) + "\n")
        (folder / "sensor.yaml").write_text(describe(season.SENSORS["imu"]["imu0"], np.eye(4), 0.0))
    commit(tmp_path / "season")
    return tmp_path / "season"


def commit(folder, clips="ab"):
    digests = {clip: files._folder_sha256(folder / "clips" / clip) for clip in clips}
    public = Published("open", season.VERSION, "", "", dict.fromkeys(clips, 36), ("imu",), digests)
    (folder / "clips" / "season.json").write_text(json.dumps(msgspec.to_builtins(public)))


def test_a_method_is_given_the_sensors_of_its_track(sensed, tmp_path):
    entry.run(sensed, tmp_path / "e", Sensed(), "picture+imu")
    assert entry.problems(tmp_path / "e", published(sensed)) == []
    found = entry.read(tmp_path / "e", published(sensed))
    assert (found.about.track, found.about.reasons) == ("picture+imu", {})
    assert found.clips["b"].ok.all()
    without = msgspec.structs.replace(published(sensed), sensors=(), sensors_sha256={})
    (problem,) = entry.problems(tmp_path / "e", without)
    assert "joined with + in this order; got 'picture+imu'" in problem
    entry.run(sensed, tmp_path / "f", Still(), "picture+rope")  # takes none, and needs none
    with pytest.raises(InstrumentError, match="still takes no sensors: it has no method with_sensors"):
        entry.run(sensed, tmp_path / "g", Still(), "picture+imu")
    with pytest.raises(BenchError, match="track: must be 'picture', and any of 'rope', 'imu' joined"):
        entry.run(sensed, tmp_path / "g", Sensed(), "picture+rope+lidar")
    assert not (tmp_path / "g").exists()


HOSTILE = {
    "rows missing": (lambda lines: lines.__delitem__(slice(200, 260)), "the sensor is silent for 0.61 s at 1.98 s"),
    "an empty file": (list.clear, "it is not valid CSV"),
    "text": (lambda lines: lines.append("9999999999,a,b,c,d,e,f"), "holds something that is not a number"),
}


@pytest.mark.parametrize("what", HOSTILE)
def test_a_sensor_that_cannot_be_used_is_a_status_and_a_reason(sensed, tmp_path, what):
    edit, words = HOSTILE[what]
    file = sensed / "clips" / "a" / "imu0" / "data.csv"
    lines = file.read_text().splitlines()
    edit(lines)
    file.write_text("".join(f"{line}\n" for line in lines))
    commit(sensed, "a")
    refused = entry.run(sensed, tmp_path / "e", Pipeline(Middle(), Middle()), "picture+rope+imu")
    assert words in refused["a"]
    found = entry.read(tmp_path / "e", published(sensed))
    assert set(found.clips["a"].status) == {"refused"}
    assert words in found.about.reasons["a"]


def test_sensors_of_another_clip_are_refused_for_every_method(sensed, tmp_path):
    for clip, folder in (("a", "b"), ("a", None)):
        shutil.rmtree(sensed / "clips" / clip)
        if folder:
            shutil.copytree(sensed / "clips" / folder, sensed / "clips" / clip)
        entry.run(sensed, tmp_path / f"{folder}", Sensed(), "picture+imu")
        found = entry.read(tmp_path / f"{folder}", published(sensed))
        assert set(found.clips["a"].status) == {"refused"}
        assert found.clips["b"].ok.all()
        assert "clips/a: not the sensors' files that season.json commits to" in found.about.reasons["a"]


def test_without_the_rope_length_in_the_track_no_display_is_read(sensed, tmp_path):
    times = []

    class Counting(Middle):
        def read(self, picture, layout):
            times.append(1)
            return super().read(picture, layout)

    pipeline = Pipeline(Middle(), Counting())
    entry.run(sensed, tmp_path / "e", pipeline, "picture")
    assert len(times) == 0
    entry.run(sensed, tmp_path / "f", pipeline, "picture+rope")
    assert len(times) == 72


@pytest.mark.parametrize(
    ("instrument", "track", "words"),
    [
        (Pipeline(Middle(), Middle()), "picture+imu", "pendulum-smoother needs the rope's length on the display"),
        (Pipeline(Middle(), Middle(), RopeAware()), "picture", "rope-aware needs the rope's length on the display"),
        (Pipeline(Middle(), Middle()), "picture+rope+lidar", "uses the sensors imu0 and plc; there are: lidar0"),
        (Still(), "picture+lidar", "still takes no sensors"),
    ],
)  # fmt: skip
def test_inputs_that_an_instrument_cannot_use_are_refused_before_the_first_clip(
    sensed, tmp_path, monkeypatch, instrument, track, words
):
    opened = []
    monkeypatch.setattr(entry, "open_source", opened.append)
    path = sensed / "clips" / "season.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"sensors": ["imu", "lidar"]}))
    with pytest.raises((BenchError, InstrumentError), match=words):
        entry.run(sensed, tmp_path / "e", instrument, track)
    with pytest.raises(BenchError, match="method: must be a text of length <= 100"):
        entry.run(sensed, tmp_path / "e", Still(), "picture", method="m" * 101)
    assert opened == []


class Odd:
    """An estimator, and an instrument, that cannot use any record."""

    name, needs_rope, needs_time = "odd", False, False

    def estimate(self, *_args, **_options):
        raise RecordError("row 3 is odd")

    __call__ = estimate


class OddRays(MeanRay):
    estimate = Odd.estimate


@pytest.mark.parametrize("instrument", [Odd(), Pipeline(Middle(), Middle(), OddRays())], ids=["own", "pipeline"])
def test_a_record_that_an_instrument_cannot_use_is_refused_and_the_run_goes_on(
    sensed, tmp_path, instrument, monkeypatch
):
    monkeypatch.setattr("simgrab.instrument.run.subject.open_instrument", lambda _name: instrument)
    status, _, said = run("bench", "run", sensed, "--out", tmp_path / "e", "--track", "picture")
    assert status == 0
    assert said.splitlines()[-2:] == [f"{clip}: no angle: row 3 is odd" for clip in "ab"]
    found = entry.read(tmp_path / "e", published(sensed))
    assert {status for answers in found.clips.values() for status in answers.status} == {"refused"}
    assert found.about.reasons == dict.fromkeys("ab", "row 3 is odd")


@pytest.fixture
def recording(tmp_path, monkeypatch):
    """Function that renders the first clip of a season with an inertial sensor, of which the video is left out."""
    clip, one = season.nightly()[0], Season(frames=9, sensors=("imu",))
    monkeypatch.setattr(files, "_drawn", lambda season, clip: season.scenario(clip))
    for part in ("clips", "truth"):
        (tmp_path / part).mkdir()

    def video(scenario, path, *, progress, resume):  # noqa: ARG001
        for side in files._SIDES:
            path.with_suffix(side).write_text(json.dumps({"digest": scenario.digest()}))
        progress(1, 9)

    monkeypatch.setattr(files, "render_video", video)
    return (
        lambda: files._render(one, tmp_path, clip),
        lambda: files._finished(one, tmp_path, clip),
        tmp_path / "clips" / clip.name / "imu0",
    )


def test_an_interrupted_recording_of_sensors_leaves_no_file_that_is_cut(recording, monkeypatch):
    render, finished, folder = recording
    ticks = []
    monkeypatch.setattr(processes, "_on_tick", lambda: ticks.append(1))
    whole = record.record

    def interrupted(*arguments):
        yield next(whole(*arguments))
        raise KeyboardInterrupt

    monkeypatch.setattr(record, "record", interrupted)
    with pytest.raises(KeyboardInterrupt):
        render()
    assert len(ticks) == 2  # of the video, and of the sensor
    assert not folder.exists()
    monkeypatch.setattr(record, "record", whole)
    render()
    assert finished()
    recorded = (folder / "data.csv").read_bytes()
    (folder / "sensor.yaml").unlink()
    monkeypatch.setattr(record, "record", interrupted)
    with pytest.raises(KeyboardInterrupt):
        render()
    assert (folder / "data.csv").read_bytes() == recorded
    assert not finished()


def test_sensors_that_render_count_in_the_memory_of_workers(tmp_path, monkeypatch):
    asked = []

    def pool(workers, **_options):
        asked.append(workers)
        raise KeyboardInterrupt

    monkeypatch.setattr(files, "Pool", pool)
    monkeypatch.setattr(files.machine, "cores", lambda: 8)
    monkeypatch.setattr(
        files.machine, "free_bytes", lambda: 6 * files.memory_bytes(Recipe(Season().scenario(season.nightly()[0])))
    )
    for kinds in ((), ("imu",), ("cameras", "lidar")):
        with pytest.raises(KeyboardInterrupt):
            files.prepare(Season(sensors=kinds), tmp_path / "-".join(("season", *kinds)))
    assert asked[0] == asked[1] == 6 > asked[2]


@pytest.mark.slow
def test_a_season_from_the_command_line(tmp_path, monkeypatch):
    monkeypatch.setattr(season, "nightly", lambda: season.full()[:1])
    monkeypatch.setattr("simgrab.lab.bench.files.MOST_ATTEMPTS", 1)
    place, out = tmp_path / "season", tmp_path / "entry"
    prepare = ["bench", "prepare", "--out", place]
    prepare += ["--frames", 3, "--size", "480x270", "--workers", 1, "--sensors", "imu", "--seed", 4]

    def call(*arguments, status=0):
        found, printed, problem = run(*arguments)
        assert found == status, problem
        return printed

    assert Season(frames=3, width_px=480, height_px=270, seed=4, sensors=("imu",)).commitment in call(*prepare)
    assert "holds another season" in run(*prepare[:-1], 5)[2]
    assert "961" in run("bench", "prepare", "--out", tmp_path / "odd", "--size", "961x540")[2]
    assert not (tmp_path / "odd").exists()
    (clip,) = (t.clip for t in targets(tmp_path / "season"))
    video = tmp_path / "season" / "clips" / f"{clip}.mp4"
    before = video.stat().st_mtime_ns
    work = tmp_path / "season" / ".work"
    work.mkdir()  # as when it is interrupted while files move
    (tmp_path / "season" / "truth" / f"{clip}.manifest.json").rename(work / f"{clip}.manifest.json")
    digest = published(tmp_path / "season").sensors_sha256
    (video.with_suffix("") / "imu0" / "data.csv").unlink()  # is recorded again, and the same
    call(*prepare)
    assert video.stat().st_mtime_ns == before  # what is finished is left as it is
    assert published(tmp_path / "season").sensors_sha256 == digest
    public = [path for path in video.parent.rglob("*") if path.is_file() and path.suffix != ".mp4"]
    assert {path.name for path in public} == {
        f"{clip}.camera.toml", "season.json", "targets.csv", "data.csv", "sensor.yaml"
    }  # fmt: skip
    for word in ("seed", "salt", "beta", "tilt", "alpha"):
        assert word not in "".join(path.read_text() for path in public)
    with av.open(str(video)) as film:
        assert set(film.metadata) <= {"major_brand", "minor_version", "compatible_brands", "encoder"}
    call("bench", "run", place, "--out", tmp_path / "fusion", "--track", "picture+rope+imu")
    assert "valid" in call("bench", "check", place, tmp_path / "fusion")
    monkeypatch.setattr("simgrab.instrument.run.subject.open_instrument", lambda _name: Still())
    call("bench", "run", place, "--out", out, "--track", "picture")
    (tmp_path / "season" / "truth").rename(tmp_path / "secret")  # which methods and entrants do not have
    assert "valid" in call("bench", "check", place, out)
    (tmp_path / "secret").rename(tmp_path / "season" / "truth")
    call("bench", "score", place, out, "--out", tmp_path / "s.csv", "--page", tmp_path / "s.html")
    rows = list(csv.DictReader((tmp_path / "s.csv").read_text().splitlines()))
    assert [(row["method"], float(row["answered"])) for row in rows[:2]] == [("still", 1.0), ("truth", 1.0)]
    assert "SwingBench" in (tmp_path / "s.html").read_text()
    call("bench", "report", tmp_path / "s.csv", "--out", tmp_path / "r.html")
    assert (tmp_path / "r.html").read_text() == (tmp_path / "s.html").read_text()
    (out / f"{clip}.csv").unlink()
    call("bench", "check", place, out, status=1)
    secret = tmp_path / "season" / "truth" / "season.json"
    secret.write_text(secret.read_text().replace('"seed": 4', '"seed": 5'))
    with pytest.raises(BenchError, match="commits to"):
        season_of(tmp_path / "season")
    secret.write_text(secret.read_text().replace('"seed": 5', '"seed": 4'))
    season_of(tmp_path / "season")
    public = tmp_path / "season" / "clips" / "season.json"
    for name, words in (("../x", "clips"), ("a/b", "clips")):
        plain = json.loads(public.read_text()) | {"clips": {name: 3}}
        (tmp_path / "season" / "clips" / "season.json").write_text(json.dumps(plain))
        with pytest.raises(BenchError, match=words):
            published(tmp_path / "season")
    public.write_text("[]")
    with pytest.raises(BenchError, match="table"):
        published(tmp_path / "season")


def test_a_hidden_season_keeps_its_secrets_when_it_is_continued(tmp_path):
    first = hidden_like(Season("autumn"), tmp_path)
    assert first != hidden_like(Season("autumn"), tmp_path)
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth" / "season.json").write_text(json.dumps(msgspec.to_builtins(first)))
    assert hidden_like(Season("autumn"), tmp_path) == first
    with pytest.raises(BenchError, match="the season is not complete; simgrab bench prepare"):
        published(tmp_path)


@pytest.mark.parametrize("subset", season.SUBSETS)
def test_a_season_of_too_few_frames_is_refused_at_once(subset, tmp_path):
    with pytest.raises(BenchError, match="frames: 60; clips with an alarm need some 480"):
        files.prepare(Season("short", subset, frames=60), tmp_path / "season")
    assert not (tmp_path / "season").exists()


def test_an_alarm_that_does_not_come_is_refused_before_any_clip_is_rendered(tmp_path, monkeypatch):
    here = SimpleNamespace(map=lambda work, clips, name: map(work, clips))  # noqa: ARG005
    monkeypatch.setattr(files, "Pool", lambda *_, **_options: contextlib.nullcontext(here))
    monkeypatch.setattr(files, "MOST_ATTEMPTS", 1)
    monkeypatch.setattr(files, "LEAST_FRAMES", 2)
    with pytest.raises(BenchError, match="no such swing within 2 frames; some 480 are needed"):
        files.prepare(Season("short", frames=2), tmp_path)
    assert not list(tmp_path.rglob("*.mp4"))
