"""SwingBench: the clips of a season, the format of entries, and the scorer."""

import csv
import json
import math

import av
import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

from simgrab.cli import cli
from simgrab.errors import BenchError
from simgrab.instrument.contract import Measurement
from simgrab.judge.bench import board, entry, season
from simgrab.judge.bench.entry import About, Answers, Entry
from simgrab.judge.bench.files import Target, hidden_like, published, season_of, targets
from simgrab.judge.bench.score import THRESHOLDS_DEG, recall, sanity, score
from simgrab.judge.bench.season import Season


def target(name="a", n=90, peak_deg=12.0, phase=0.0):
    times = np.arange(n) / 9
    return Target(name, times, np.deg2rad(np.abs(peak_deg * np.sin(2 * np.pi * times / 8 + phase))))


TARGETS = (
    target("a"), target("b", 60, 5.0, 1.0), target("c", 40, 11.0, 2.0),
    *(target(name, 50, 6.0, phase) for phase, name in enumerate("defgh")),
)  # fmt: skip
FRAMES = {t.clip: len(t.times) for t in TARGETS}


def off_by(error_deg, targets=TARGETS, width_deg=0.2, name="method"):
    def answers(t):
        alpha = t.alpha + np.deg2rad(error_deg)
        half = np.deg2rad(width_deg) / 2
        return Answers(("ok",) * len(alpha), alpha, alpha - half, alpha + half, np.full(len(alpha), 0.01))

    return Entry(About(name, "picture", "open"), {t.clip: answers(t) for t in targets})


def test_the_nightly_clips_have_every_weather_and_every_pair_of_mount_and_offset():
    clips = season.nightly()
    assert len(set(clips)) == 12
    assert {c.weather for c in clips} == set(season.WEATHERS)
    assert len({(c.mount, c.offset) for c in clips}) == 9
    assert sum(c.swing == "alarm" for c in clips) == 6
    assert set(clips) < set(season.full())
    assert len(set(season.full())) == 144


def test_tilt_and_seed_of_a_clip_follow_from_the_seasons_seed():
    clip = season.nightly()[3]
    same, other = Season(seed=7).scenario(clip), Season(seed=8).scenario(clip)
    assert same == Season(seed=7, salt="salt").scenario(clip)
    assert same.camera.beta_deg != other.camera.beta_deg
    assert same.seed != other.seed
    assert season.LEAST_TILT_DEG <= same.camera.beta_deg <= season.MOST_TILT_DEG


def test_every_clip_is_a_scenario_as_its_name_says():
    for clip in season.full():
        scene = Season(seed=0).scenario(clip)
        assert scene.camera.offset_y_m == season.OFFSETS_M[clip.offset]
        assert type(scene.camera.mount).__name__.lower().startswith(clip.mount)
        assert scene.display_layout is not None


def test_the_commitment_binds_to_everything_that_a_season_is():
    one = Season("autumn", seed=5, salt="a")
    changes = ({"seed": 6}, {"salt": "b"}, {"frames": 541}, {"subset": "full"}, {"width_px": 1920}, {"name": "winter"})
    others = [msgspec.structs.replace(one, **change) for change in changes]
    assert len({season.commitment for season in (one, *others)}) == 7


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


def test_recall_is_the_mean_over_thresholds():
    # 0.4° is within 0.5, 0.75, 1, 1.5 and 2 of the eight thresholds.
    assert recall(off_by(0.4).clips["a"], TARGETS[0]) == pytest.approx(5 / 8)
    # On a threshold it counts as within, whatever the rounding of the file.
    assert recall(off_by(0.5).clips["a"], TARGETS[0]) == pytest.approx(5 / 8)


def test_frames_without_an_angle_are_within_no_threshold_and_those_without_a_grab_do_not_count():
    truth = sanity(TARGETS, "open")[0].clips["a"]
    alpha = truth.alpha.copy()
    alpha[:45] = np.nan
    half = Answers(truth.status, alpha, alpha, alpha, truth.seconds)
    assert recall(half, TARGETS[0]) == pytest.approx(0.5)
    unknown = Target("a", TARGETS[0].times, np.where(np.arange(90) < 45, np.nan, TARGETS[0].alpha))
    assert recall(half, unknown) == 1


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
    mixed = Entry(About("mixed", "picture", "open"), off_by(0.05).clips | worse)
    found = [s for s in score([even, mixed], TARGETS) if not s.sanity]
    assert [s.about.method for s in found] == ["mixed", "even"]
    assert [s.rank for s in found] == [1, 1]


def test_tracks_are_ranked_apart():
    rope = Entry(About("rope", "picture+rope", "open"), off_by(0.05).clips)
    found = [s for s in score([rope, off_by(1.2)], TARGETS) if not s.sanity]
    assert [(s.about.method, s.rank) for s in found] == [("method", 1), ("rope", 1)]


def test_ranks_follow_the_average_recall():
    entries = [off_by(error, name=f"{error}") for error in (0.05, 0.15, 0.25, 0.4, 0.6, 0.9)]
    found = [s for s in score(entries, TARGETS) if not s.sanity]
    assert [s.rank for s in found] == [1, 2, 3, 4, 5, 6]
    recalls = [s.figures["average_recall"].value for s in found]
    assert recalls == sorted(recalls, reverse=True)


def test_clips_without_a_grab_are_not_scored():
    empty = Target("empty", TARGETS[0].times, np.full(90, np.nan))
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
        return score([Entry(About("m", "picture", "open"), answers | {"a": changed})], TARGETS)[0].figures

    plain, low, late = with_alarm(0.0), with_alarm(-4.0), with_alarm(0.0, delay=3)
    assert plain["alarms_due"].value > plain["alarms_missed"].value == 0
    assert low["alarms_missed"].value == 1
    assert late["alarm_delay_frames"].value > plain["alarm_delay_frames"].value == 0
    high = score([off_by(6.0)], TARGETS)[0].figures
    assert high["alarms_false"].value > 0


def test_scores_are_the_same_to_the_last_digit():
    entries = [off_by(0.3), off_by(0.6, name="other")]
    texts = {board.table(score(entries, TARGETS), Season()) for _ in range(2)}
    assert len(texts) == 1
    rows = list(csv.DictReader(texts.pop().splitlines()))
    assert [row["method"] for row in rows] == ["method", "other", "truth", "last value", "constant 0°"]


def entered(folder):
    """Write a right entry for `TARGETS`."""
    folder.mkdir()
    (folder / ".DS_Store").touch()
    about = About("<b>method</b>", "picture", "open")
    (folder / "entry.json").write_text(json.dumps(msgspec.to_builtins(about)))
    for t in TARGETS:
        alpha = np.minimum(t.alpha + 0.001, 1.5)
        rows = [Measurement(status="ok", alpha=a, alpha_low=a, alpha_high=a + 0.01) for a in alpha.tolist()]
        rows[2] = Measurement(status="missed", reason="no grab")
        (folder / f"{t.clip}.csv").write_text(entry.written(t.clip, rows, 0.02))
    return folder


def test_what_is_written_is_read_back(tmp_path):
    found = entry.read(entered(tmp_path / "e"), "open", FRAMES)
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


def less(lines):
    lines[5] = lines[5].rsplit(",", 1)[0]


BAD = {
    "a header in another order": (edited(0, 0, "frame"), "line 1: the header must be clip,frame"),
    "a column less": (less, "line 6: 6 columns"),
    "another clip": (edited(3, 0, "b"), "line 4: clip 'b' in the file of 'a'"),
    "a frame twice": (edited(4, 1, "2"), "line 5: frame '2'; 3 is due"),
    "a frame missing": (lambda lines: lines.pop(9), "line 10: frame '9'; 8 is due"),
    "the end missing": (lambda lines: lines.pop(), "89 frames; the clip has 90"),
    "a frame too many": (lambda lines: lines.append("a,90,ok,1,,,0"), "only 90 frames"),
    "an unknown status": (edited(2, 2, "fine"), "line 3: status 'fine'"),
    "not a number": (edited(2, 3, "one"), "alpha_deg must be a number or empty, got 'one'"),
    "NaN": (edited(2, 3, "nan"), "alpha_deg must be finite"),
    "infinity": (edited(2, 5, "inf"), "high_deg must be finite"),
    "ok without an angle": (edited(2, 3, ""), "alpha_deg is required"),
    "an angle though missed": (edited(3, 3, "1.0"), "alpha_deg is required with status ok, and empty otherwise"),
    "below 0": (edited(2, 3, "-1"), "between 0 and 90"),
    "half an interval": (edited(2, 4, ""), "both be given"),
    "an interval upside down": (edited(2, 4, "80"), "is above high_deg"),
    "a negative time": (edited(2, 6, "-0.1"), "time_s must be 0 or more"),
    "no time": (edited(2, 6, ""), "time_s must be 0 or more"),
    "an open quote": (lambda lines: lines.append('"a'), "line 92: unexpected end of data"),
}


@pytest.mark.parametrize("what", BAD)
def test_a_bad_file_is_refused_by_its_line(tmp_path, what):
    edit, words = BAD[what]
    file = entered(tmp_path / "e") / "a.csv"
    lines = file.read_text().splitlines()
    edit(lines)
    file.write_text("\n".join(lines) + "\n")
    (problem,) = entry.problems(tmp_path / "e", "open", FRAMES)
    assert "a.csv" in problem
    assert words in problem
    with pytest.raises(BenchError, match=r"a\.csv"):
        entry.read(tmp_path / "e", "open", FRAMES)


def test_all_problems_of_an_entry_are_listed(tmp_path):
    folder = entered(tmp_path / "e")
    (folder / "a.csv").unlink()
    (folder / "b.csv").write_bytes(b"\xff\xfe")
    (folder / "notes.txt").write_text("")
    (folder / "entry.json").write_text('{"method": "m", "track": "lidar", "season": "open"}')
    found = entry.problems(folder, "open", FRAMES)
    assert len(found) == 4
    for words in (
        "track: must be one of picture, picture+rope, got 'lidar'",
        "notes.txt: not a file",
        "UTF-8",
        "a.csv",
    ):
        assert any(words in problem for problem in found)
    other = entered(tmp_path / "other")
    assert "season 'open'; these clips are of season 'autumn'" in entry.problems(other, "autumn", FRAMES)[0]


class Still:
    """An instrument that sees no swing."""

    name = "still"

    def __call__(self, frames, calibration):  # noqa: ARG002
        return [Measurement(status="ok", alpha=0.0, alpha_low=0.0, alpha_high=0.01) for _ in frames]


@pytest.mark.slow
def test_a_season_from_the_command_line(tmp_path, monkeypatch):
    monkeypatch.setattr(season, "nightly", lambda: season.full()[:1])
    monkeypatch.setattr("simgrab.judge.bench.files.MOST_ATTEMPTS", 1)
    place, out = str(tmp_path / "season"), tmp_path / "entry"
    prepare = [
        "bench",
        "prepare",
        "--out",
        place,
        "--frames",
        "3",
        "--size",
        "480x270",
        "--workers",
        "1",
        "--seed",
        "4",
    ]

    def call(*arguments, status=0):
        result = CliRunner().invoke(cli, [str(a) for a in arguments])
        assert result.exit_code == status, result.output
        return result.output

    assert Season(frames=3, width_px=480, height_px=270, seed=4).commitment in call(*prepare)
    assert "holds another season" in str(CliRunner().invoke(cli, [*prepare[:-1], "5"]).exception)
    odd = ["bench", "prepare", "--out", str(tmp_path / "odd"), "--size", "961x540"]
    assert "961" in str(CliRunner().invoke(cli, odd).exception)
    assert not (tmp_path / "odd").exists()
    (clip,) = (t.clip for t in targets(tmp_path / "season"))
    video = tmp_path / "season" / "clips" / f"{clip}.mp4"
    before = video.stat().st_mtime_ns
    call(*prepare)  # what is finished is left as it is
    assert video.stat().st_mtime_ns == before
    work = tmp_path / "season" / ".work"
    work.mkdir()  # as when it is interrupted while files move
    (tmp_path / "season" / "truth" / f"{clip}.manifest.json").rename(work / f"{clip}.manifest.json")
    call(*prepare)
    assert video.stat().st_mtime_ns == before
    public = [path for path in video.parent.iterdir() if path.suffix != ".mp4"]
    assert {path.name for path in public} == {f"{clip}.camera.toml", "season.json", "targets.csv"}
    for word in ("seed", "salt", "beta", "tilt", "alpha"):
        assert word not in "".join(path.read_text() for path in public)
    with av.open(str(video)) as film:
        assert set(film.metadata) <= {"major_brand", "minor_version", "compatible_brands", "encoder"}
    monkeypatch.setattr("simgrab.instrument.run.subject.open_instrument", lambda _name: Still())
    call("bench", "run", place, "--out", out, "--track", "picture")
    (tmp_path / "season" / "truth").rename(tmp_path / "secret")  # which methods and entrants do not have
    assert "valid" in call("bench", "check", place, out)
    (tmp_path / "secret").rename(tmp_path / "season" / "truth")
    call("bench", "score", place, out, "--out", tmp_path / "s.csv", "--page", tmp_path / "s.html")
    rows = list(csv.DictReader((tmp_path / "s.csv").read_text().splitlines()))
    assert [(row["method"], row["answered"]) for row in rows[:2]] == [
        ("still", "1.000000000"),
        ("truth", "1.000000000"),
    ]
    assert "SwingBench" in (tmp_path / "s.html").read_text()
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
