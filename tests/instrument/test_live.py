"""A live run for hours: faults are found and reported, the controller's file is followed, memory is bounded."""

import threading
import time
import weakref
from concurrent.futures import wait
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
import swinging
import tomli_w
from films import film
from streams import over_tcp
from test_pipeline import lives, made
from test_run import CAMERA, nothing

from simgrab.errors import RecordError, RunError, SourceError
from simgrab.instrument import pipeline as rooms
from simgrab.instrument import video
from simgrab.instrument.contract import Frame, Measurement
from simgrab.instrument.controller import Controller
from simgrab.instrument.controller_feed import ControllerFeed
from simgrab.instrument.estimate import MeanRay
from simgrab.instrument.estimate.record import PixelRecord
from simgrab.instrument.faults import Backlog, FaultWatch
from simgrab.instrument.observation import Observation
from simgrab.instrument.pipeline import Pipeline
from simgrab.instrument.run import run as running
from simgrab.instrument.run.run import RunOptions
from simgrab.instrument.source import open_source
from simgrab.io import playback

AT, SHIFT_PX = 150, 40.0  # frame of a knock, and how far it moves the picture: 1.5°


@pytest.fixture(scope="module")
def crane():
    return swinging.record(frames=420)


def moved(observations, some):
    observations = list(observations)
    for i in some:
        u, v = observations[i].centre
        observations[i] = msgspec.structs.replace(observations[i], centre=(u + SHIFT_PX, v))
    return observations


def test_memory_is_bounded(crane, monkeypatch):
    monkeypatch.setattr(rooms, "KEPT_S", 15.0)
    lengths, estimate = [], PixelRecord.estimate
    monkeypatch.setattr(PixelRecord, "estimate", lambda r, *rest: lengths.append(len(r.time)) or estimate(r, *rest))
    lives([Observation(i / 9, lost="lost") for i in range(800)], crane.calibration, estimator=MeanRay())
    assert len(lengths) > 5
    assert max(lengths[1:]) == 15 * 9 + 1


def test_a_knock_is_found_and_the_tilt_estimated_again(crane):
    seen = crane.observations(1.0)
    tilt = made().conclude(seen, crane.calibration).tilt
    found = lives(moved(seen, range(AT, len(seen))), crane.calibration, tilt=tilt)
    ((fault, at),) = [(fault, i) for i, one in enumerate(found) for fault in one.faults]
    assert fault.kind == "camera"
    assert "by 1.4°" in fault.text or "by 1.5°" in fault.text
    assert AT < at < AT + 45
    assert found[at].tilt == tilt
    assert found[at + 1].tilt is None
    assert "no tilt yet" in found[at + 1].measurement.reason
    assert found[-1].tilt.beta_deg != tilt.beta_deg
    late = slice(-30, None)
    alpha = np.degrees([one.measurement.alpha for one in found[late]])
    assert np.abs(alpha - np.degrees(crane.alpha[late])).mean() < 0.7


def test_a_detector_that_errs_for_a_second_is_no_knock(crane):
    seen = crane.observations(1.0)[:260]
    tilt = made().conclude(seen, crane.calibration).tilt
    assert not any(one.faults for one in lives(moved(seen, range(AT, AT + 9)), crane.calibration, tilt=tilt))


def test_half_a_minute_without_an_angle_a_change_of_light_and_news_of_the_source_are_reported():
    watch, found = FaultWatch(), []
    for i in range(1200):
        ok = not 300 <= i < 700
        level = 20 if i > 900 else 120
        frame = Frame(np.full((32, 32, 3), level, np.uint8), i / 9, note="turned" + "; jumped" * (i == 200))
        measured = {"status": "ok", "alpha": 0.1} if ok else {"status": "missed", "reason": "fog"}
        watch.frame(frame, Measurement(**measured))
        found += watch.found(i / 9)
    kinds = [(fault.kind, round(fault.time_s)) for fault in found]
    assert kinds[:3] == [("source", 22), ("grab", 63), ("grab", 78)]
    assert found[1].text == "no angle for 30 s: fog"
    assert {kind for kind, _ in kinds[3:]} == {"exposure"}
    assert 100 <= kinds[3][1] < 106


def test_a_stream_that_is_measured_late_is_reported_and_so_is_its_end():
    backlog = Backlog()
    late = [2.0, 0.0, 0.1, 1.6, 2.9, 3.1, 4.0, 2.0, 3.5, 1.0, 0.0, 3.2]  # s, beyond the time from start to picture
    said = [backlog.step(1000.0 + i + late_s, float(i)) for i, late_s in enumerate(late)]
    assert [i for i, text in enumerate(said) if text] == [5, 9, 11]
    assert said[5] == "frames are measured 3 s late: this computer is too slow, or they came late"
    assert said[9] == "frames are measured in time again"


ROPE, SLEW = ({"column": name, "rate_hz": 10.0, "resolution": 0.01} for name in ("rope", "slew"))


def followed(folder, unit="s", **more):
    facts = {"time": {"column": "t", "unit": unit}, "rope": ROPE, "slew": SLEW} | more
    path = folder / "crane.csv"
    path.with_suffix(".toml").write_text(tomli_w.dumps(facts))
    path.write_text("t,rope,slew\n" + "5,1,1\n" * 100)
    return path


def test_dates_are_followed_without_a_start_and_a_file_that_begins_again_from_its_first_row(tmp_path):
    path = followed(tmp_path, "iso")
    feed = ControllerFeed(path)
    feed.poll(0.0, 0.0)
    for second in range(1, 9):
        with path.open("w" if second == 5 else "a") as file:
            file.write("t,rope,slew\n" * (second == 5))
            file.write("".join(f"2026-03-02T08:00:0{second}.{i},{second}.{i},0\n" for i in range(10)))
        reported = feed.poll(second + 0.9, second + 0.9)
        assert not any("refused" in note for note in reported.notes)
    np.testing.assert_allclose(reported.rope_at(np.array([5.2, 8.4])), [5.2, 8.4], atol=0.01)


def test_a_file_with_semicolons_and_decimal_commas_is_followed(tmp_path):
    path = followed(tmp_path, "iso")
    path.write_bytes("t;rope;slew;m³\n".encode("cp1252"))
    feed = ControllerFeed(path)
    assert feed.poll(0.0, 0.0) is None
    for second in range(1, 9):
        with path.open("a") as file:
            file.write("".join(f"08:00:0{second},{i};{second},{i};0,0;1\n" for i in range(10)))
        reported = feed.poll(second + 0.9, second + 0.9)
    np.testing.assert_allclose(reported.rope_at(np.array([5.2, 8.4])), [5.2, 8.4], atol=0.01)
    with path.open("a") as file:
        file.write("1;2\n")
    feed.poll(9.9, 9.9)
    assert "new rows have other numbers of cells than the header" in feed.problem


def test_a_growing_file_is_followed_and_its_silence_reported(tmp_path):
    path = followed(tmp_path)
    feed, watch, found, rest = ControllerFeed(path), FaultWatch(), {}, ""
    for i in range(600):
        now = i / 9
        clock = 5000.0 if now < 20 else 100.0  # the controller's clock is set back
        if not 300 < i < 420:
            text = rest + f"{now + clock:.2f},{20 + now / 10:.3f},{now:.2f}\n"
            text, rest = (text[:4], text[4:]) if i == 100 else (text, "")  # a line may come in two parts
            with path.open("w" if i == 500 else "a") as file:  # and the file may start again
                file.write("t,rope,slew\n" * (i == 500) + text)
        reported = feed.poll(now, now + 3.0 * (i % 7 == 3))  # some frames come late
        watch.controller(now, reported, feed)
        found |= dict.fromkeys([i] * bool(news := watch.found(now)), news)
        if i in (60, 290, 480, 599):
            assert reported.rope_at(np.array([now]))[0] == pytest.approx(20 + now / 10, abs=0.05)
    assert np.isnan(reported.rope_at(np.array([now + 2]))[0])
    assert [fault.kind for (fault,) in found.values()] == ["controller"] * 3
    jumped, stopped, again = found
    assert 180 < jumped < 180 + 9 * 10
    assert stopped == pytest.approx(300 + 9 * 10, abs=3)
    assert 420 <= again < 430


@pytest.mark.parametrize(
    ("more", "states"),
    [
        ({"radius": ROPE}, True),
        ({"luff": ROPE | {"jib_m": 30.0}}, True),
        ({}, False),
        ({"slew": SLEW | {"rate_hz": 1.0}, "radius": ROPE}, False),
    ],
)
def test_motion_is_followed_in_slew_and_radius_that_come_as_often_as_anything_else(tmp_path, more, states):
    assert ControllerFeed(followed(tmp_path, **more)).states_motion == states


def test_a_wind_that_comes_seldom_does_not_disturb_what_is_followed(tmp_path):
    wind = {"column": "wind", "rate_hz": 0.01, "resolution": 0.1}
    path = followed(tmp_path, wind=wind)
    path.write_text("t,rope,slew,wind\n")
    feed = ControllerFeed(path)
    feed.poll(0.0, 0.0)
    for i in range(1, 40):
        with path.open("a") as file:
            file.write(f"{i / 10},{20 + i / 100},1,\n")
        reported = feed.poll(i / 10, i / 10)
    assert reported.rope_at(np.array([3.9]))[0] == pytest.approx(20.39)
    path.with_suffix(".toml").write_text(tomli_w.dumps({"time": {"column": "t"}, "wind": wind}))
    with pytest.raises(RecordError, match="does not read the wind; state it by --wind-m-s"):
        ControllerFeed(path)


def test_a_file_that_cannot_be_followed_is_refused(tmp_path):
    path = followed(tmp_path)
    path.rename(tmp_path / "crane.parquet")
    with pytest.raises(RecordError, match="cannot be followed"):
        ControllerFeed(tmp_path / "crane.parquet")


def test_a_lost_stream_is_connected_again_and_a_jump_of_its_stamps_is_no_gap(tmp_path, monkeypatch):
    monkeypatch.setattr(video, "RETRY_S", 0.2)
    monkeypatch.setattr(video, "GIVE_UP_S", 1.0)
    first, later = (film(tmp_path / f"{s}.ts", s + np.arange(30) / 9).read_bytes() for s in (0, 4000))
    with over_tcp(first + later, first) as url:
        frames = list(open_source(url))
    times = np.array([frame.time_s for frame in frames])
    notes = [frame.note for frame in frames if frame.note]
    assert (np.diff(times) > 0).all()
    assert times[-1] < 30
    assert sum(frame.picture is not None for frame in frames) > 80
    assert "time stamps jumped by +399" in notes[0]
    assert notes[1].startswith("connected again after")
    assert "no connection" in frames[-1].reason


def test_time_goes_on_while_a_stream_stands_still(tmp_path, monkeypatch):
    monkeypatch.setattr(playback, "PATIENCE_S", (15.0, 1.5))
    monkeypatch.setattr(video, "RETRY_S", 0.1)
    monkeypatch.setattr(video, "GIVE_UP_S", 1.0)
    data = film(tmp_path / "a.ts", np.arange(30) / 9).read_bytes()

    def stalls():
        yield data
        time.sleep(2.5)

    with over_tcp(stalls(), data) as url:
        seen = [frame.time_s for frame in open_source(url) if frame.picture is not None]
    assert len(seen) > 50
    assert np.diff(seen).max() > 1  # of 1.5; a frame that comes as the wait ends counted for it


def test_stamps_that_go_on_after_a_frame_that_came_late_do_not_jump(tmp_path, monkeypatch):
    stamps = np.arange(60) / 9 + 12 * (np.arange(60) >= 30)
    clock = [0.0]
    monkeypatch.setattr(video, "time", SimpleNamespace(monotonic=lambda: clock[0]))
    with over_tcp(film(tmp_path / "a.ts", stamps).read_bytes()) as url:
        frames, seen = iter(open_source(url)), list[float]()
        while len(seen) < 55:
            clock[0] = float(stamps[len(seen) + 1])  # a picture ends where the next begins
            frame = next(frames)
            assert not frame.note
            if frame.picture is not None:
                seen.append(frame.time_s)
    np.testing.assert_allclose(seen, stamps[:55], atol=1e-3)


def test_a_connection_that_takes_long_does_not_shift_the_time(tmp_path, monkeypatch):
    data, clock, opened = film(tmp_path / "a.ts", np.arange(30) / 9).read_bytes(), [0.0], video.open_video

    def slowly(*arguments):
        clock[0] += 15.0
        return opened(*arguments)

    monkeypatch.setattr(video, "time", SimpleNamespace(monotonic=lambda: clock[0], sleep=lambda _: None))
    with over_tcp(data, data) as url:
        frames, late = iter(open_source(url)), []
        monkeypatch.setattr(video, "open_video", slowly)
        while len(late) < 50:
            frame = next(frames)
            if frame.picture is not None:
                late.append(clock[0] - frame.time_s)
                clock[0] += 1 / 9
    assert late[30] > 10
    np.testing.assert_allclose(late[32:], 0.0, atol=0.2)


def run_live(folder, frames, out="out", instrument=None, **callbacks):
    """Measure a film in parts of two seconds."""
    path, options = film(folder / "a.mp4", np.arange(frames) / 9), RunOptions(live=True, video=False)
    with pytest.MonkeyPatch.context() as short:
        short.setattr(running, "PART_S", 2.0)
        instrument = instrument or Pipeline(nothing, None)
        return running.run(path, CAMERA, out and folder / out, instrument, options, **callbacks)


def test_a_long_live_run_is_written_in_parts(tmp_path):
    lines = []
    found = run_live(tmp_path, 45, report=lines.append)
    parts = [running.runs.load(tmp_path / name) for name in ("out", "out-2", "out-3")]
    times = np.concatenate([part.time for part in parts])
    np.testing.assert_allclose(times, np.arange(45) / 9, atol=1e-3)
    assert len(parts[0].time) == 18
    np.testing.assert_array_equal(parts[-1].time, found.time)
    assert lines[0] == "tilt: by mean-ray"
    assert lines[1:] == [f"written: {tmp_path / name}" for name in ("out", "out-2")]


def test_frames_are_measured_while_a_part_is_written(tmp_path, monkeypatch):
    write, further = running._write, threading.Event()

    def waiting(*args, **options):
        assert further.wait(30)
        write(*args, **options)

    monkeypatch.setattr(running, "_write", waiting)
    run_live(tmp_path, 30, progress=lambda done, _: done < 25 or further.set())
    assert (tmp_path / "out/run.json").exists()
    assert (tmp_path / "out-2/run.json").exists()


def test_nothing_of_a_part_is_kept_once_it_is_written(tmp_path, monkeypatch):
    alive, counts = weakref.WeakSet(), []

    class Notes(running._Notes):
        def __init__(self):
            super().__init__()
            alive.add(self)

    class AtOnce(running.ThreadPoolExecutor):
        def submit(self, *args):
            wait([future := super().submit(*args)])
            return future

    monkeypatch.setattr(running, "_Notes", Notes)
    monkeypatch.setattr(running, "ThreadPoolExecutor", AtOnce)
    run_live(tmp_path, 50, progress=lambda done, _: done in (17, 34, 50) and counts.append(len(alive)))
    assert counts == [1, 1, 1]  # that of the part which is measured


def test_an_interrupt_while_a_part_is_waited_for_ends_the_run_with_the_next(tmp_path, monkeypatch):
    write, further = running._write, threading.Event()

    def waiting(*args, **options):
        assert further.wait(30)
        write(*args, **options)

    class Interrupted(running.ThreadPoolExecutor):
        def submit(self, *args):
            future = super().submit(*args)
            whole = future.result

            def result():
                if not further.is_set():
                    further.set()
                    raise KeyboardInterrupt
                return whole()

            future.result = result
            return future

    monkeypatch.setattr(running, "_write", waiting)
    monkeypatch.setattr(running, "ThreadPoolExecutor", Interrupted)
    run_live(tmp_path, 45)
    parts = [running.runs.load(tmp_path / name) for name in ("out", "out-2")]
    np.testing.assert_allclose(np.concatenate([part.time for part in parts]), np.arange(36) / 9, atol=1e-3)
    assert not list(tmp_path.glob("out-3*"))


@pytest.mark.parametrize("frames", [30, 300])
def test_a_part_that_cannot_be_written_ends_the_run(tmp_path, monkeypatch, frames):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(running, "_write", full)
    with pytest.raises(RunError, match="No space left"):
        run_live(tmp_path, frames)
    assert [left.name for left in tmp_path.iterdir()] == ["a.mp4"]


def test_what_prevented_a_part_is_noted_with_what_ended_the_run(tmp_path, monkeypatch):
    ended, add = threading.Event(), running._Parts.add_writing_to

    def adds(parts, problem):
        ended.set()
        add(parts, problem)

    def full(*_, **__):
        assert ended.wait(30)
        raise OSError(28, "No space left on device")

    def stop(done, _):
        if done == 25:
            raise SourceError("the picture is gone")

    monkeypatch.setattr(running, "_write", full)
    monkeypatch.setattr(running._Parts, "add_writing_to", adds)
    with pytest.raises(SourceError, match="the picture is gone") as found:
        run_live(tmp_path, 30, progress=stop)
    assert "No space left" in found.value.__notes__[0]
    assert [left.name for left in tmp_path.iterdir()] == ["a.mp4"]


@pytest.mark.parametrize(
    ("clock_sd_s", "used"),
    [
        (0.3, ", and the jib's motion for warnings"),
        (1.0, " where the display shows none: its clock is not known"),
    ],
)
def test_a_live_run_on_a_file_says_what_it_uses_of_the_controller(tmp_path, clock_sd_s, used):
    time, lines = np.arange(60) / 10, []
    reported = Controller(time, 0.1 * time, 20 + 0 * time, 15 + 0 * time, clock_sd_s=clock_sd_s)
    instrument = Pipeline(nothing, None, controller=reported)
    run_live(tmp_path, 20, None, instrument, report=lines.append)
    assert lines == [f"tilt: by rope-aware; of the controller the rope length is used{used}"]
