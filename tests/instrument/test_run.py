"""`simgrab run` from end to end: a rendered clip, a detector that is told the labels, the bundled reader."""

import dataclasses
import itertools
import json
import re
import sys
from pathlib import Path

import av
import cv2
import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest
import swinging
from browser import needs_chromium, shown
from click.testing import CliRunner
from films import film, picture
from oracle import Oracle

from simgrab.cli import cli
from simgrab.errors import InstrumentError, RunError, SimgrabError, SourceError
from simgrab.instrument.angles import arrays
from simgrab.instrument.contract import Frame, Measurement
from simgrab.instrument.controller import Controller
from simgrab.instrument.estimate import PaperIteration, PendulumSmoother
from simgrab.instrument.estimate.follow import Known, far_offset
from simgrab.instrument.estimate.follow import load as load_tilt
from simgrab.instrument.observation import Observation
from simgrab.instrument.pipeline import MeasuredRecord, Pipeline
from simgrab.instrument.read import Reader
from simgrab.instrument.run import runs
from simgrab.instrument.run.assumed import _of_size, assumptions
from simgrab.instrument.run.page import page
from simgrab.instrument.run.run import RunOptions, _controller, measure, run
from simgrab.instrument.run.table import beside_paper, held
from simgrab.instrument.run.video import OverlayVideo
from simgrab.instrument.source import open_source
from simgrab.model.calibration import Calibration
from simgrab.model.calibration import load as load_camera
from simgrab.model.layouts import load as layout
from simgrab.model.records.observations import Detection
from simgrab.model.truth import Row

SIZE = (640, 360)


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    """A video of five seconds with its truth table: a fixed camera, the display, two frames lost."""
    from conftest import small_scene

    from simgrab.dataset.video.render import render_video

    path = tmp_path_factory.mktemp("clip") / "swing.mp4"
    scene = small_scene(
        "work-cycles", frames=45, camera__width_px=SIZE[0], camera__height_px=SIZE[1], display__layout="two-by-four",
        camera__focal={"model": "pixels", "focal_length_px": 548.3}, camera__mount={"model": "fixed"},
        clip__drop_share=0.04,
    )  # fmt: skip
    render_video(scene, path)
    return path


def truth_of(path):
    rows = pq.read_table(path.with_suffix(".parquet")).to_pylist()
    names = set(Row.__struct_fields__)
    plain = {"file": "", "image_sha256": ""}
    return [msgspec.convert({k: v for k, v in row.items() if k in names} | plain, Row) for row in rows]


@pytest.fixture(scope="module")
def found(clip, tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "run"
    instrument = Pipeline(Oracle(truth_of(clip), noise_px=0.5, miss=15), Reader())
    return run(clip, clip.with_suffix(".camera.toml"), out, instrument), out


def test_every_frame_has_its_angle_or_a_reason(found, clip):
    result, _ = found
    lost = [m for m in result.measurements if m.status == "lost"]
    missed = [m for m in result.measurements if m.status == "missed"]
    assert len(result.measurements) == 45
    assert len(lost) == 45 - len(truth_of(clip)) > 0
    assert len(missed) == len(truth_of(clip)) // 15
    assert all(m.reason for m in lost + missed)
    seen = [m for m in result.measurements if m.status != "lost"]
    pairs = [(m, row) for m, row in zip(seen, truth_of(clip), strict=True) if m.rope_status == "read"]
    assert len(pairs) > 0.85 * len(seen)  # digits of 9 x 14 px
    assert all(m.rope_text == row.rope_text for m, row in pairs)


def test_the_folder_holds_what_was_found(found):
    result, out = found
    assert sorted(p.name for p in out.iterdir()) == [
        "alarms.json", "angles.csv", "angles.parquet", "annotated.mp4", "camera.toml", "report.html", "run.json",
        "tilt.toml",
    ]  # fmt: skip
    assert runs.load(out).calibration == result.calibration
    assert load_tilt(out / "tilt.toml").beta_deg == result.about["estimate"]["beta_deg"]
    sheet = (out / "angles.csv").read_text().splitlines()
    assert len(sheet) == 46
    assert json.loads((out / "run.json").read_text())["counts"]["ok"] == sum(
        m.status == "ok" for m in result.measurements
    )


def test_the_annotated_video_has_every_frame(found):
    _, out = found
    with av.open(str(out / "annotated.mp4")) as file:
        pictures = [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]
    assert len(pictures) == 45
    assert pictures[0].shape == (SIZE[1], SIZE[0], 3)


def test_published_stands_beside_measured(found):
    result, _ = found
    table = {row[0]: row[1:] for row in beside_paper(result)}
    assert table["tilt β̂ (deg)"][0] == "2.530"
    again = PaperIteration().estimate(result.pixels, result.calibration)
    assert table["tilt β̂ (deg)"][1] == f"{np.rad2deg(again.beta):.3f}"
    assert table["tilt β̂ (deg)"][2] == f"{result.about['tilt']['beta_deg']:.3f}"
    assert table["iterations"][0] == "8"
    assert ["Beside the paper" in page(result, {}, paper=asked) for asked in (True, False)] == [True, False]
    facts = dict(held(result))
    assert facts["frames"] == "45"
    assert facts["rope lengths read"].split()[2] == str(45 - result.about["counts"]["lost"])
    assert facts["95 % intervals by"] == "frames that are 0.6 s apart"
    assert facts["early warnings"] == "0"
    warned = result.about | {"warnings": [{"onset_s": second + 0.04} for second in range(1, 9)]}
    many = dict(held(dataclasses.replace(result, about=warned)))
    assert many["early warnings"] == "8, at 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, … s"
    for missing, needed in (({}, "more than a second, and --live if"), ({"rope_length_m": None}, "rope lengths")):
        none = [msgspec.structs.replace(m, warning=None, **missing) for m in result.measurements]
        silent = dict(held(dataclasses.replace(result, measurements=none)))
        assert silent["early warnings"].startswith(f"none: they need {needed}")


def test_a_live_run_writes_the_same_files(clip, tmp_path):
    instrument = Pipeline(Oracle(truth_of(clip)), Reader(), tilt=None)
    live = run(clip, clip.with_suffix(".camera.toml"), tmp_path / "live", instrument, RunOptions(live=True))
    assert all(m.status in ("refused", "lost") for m in live.measurements)  # five seconds are no warm-up
    assert live.about["tilt"] is None
    assert 0 < live.about["speed"]["latency_median_s"] <= live.about["speed"]["latency_p99_s"]
    camera = msgspec.structs.replace(load_camera(clip.with_suffix(".camera.toml")), mount="")
    whole = run(clip, camera, tmp_path / "whole", Pipeline(Oracle(truth_of(clip)), Reader()))
    tilt = load_tilt(tmp_path / "whole" / "tilt.toml")
    given = Pipeline(Oracle(truth_of(clip)), Reader(), tilt=tilt)
    live = run(clip, camera, tmp_path / "given", given, RunOptions(live=True))
    np.testing.assert_allclose(live.alpha, whole.alpha, atol=1e-6)
    facts = dict(held(live))
    assert "lean of the grab in steady wind" in facts["95 % intervals"]
    warning = dict(held(whole))["warning"]
    assert "errors of up to 2° that no 95 % interval here includes" in warning
    assert warning.endswith("; --plc or --imu measures the lean")
    again = dict(held(run(clip, camera, tmp_path / "again", given)))["warning"]
    assert again.endswith("; --plc or --imu, without --calibration, measures the lean")
    assert facts["warning"].endswith("; --imu measures the lean")
    assert (tmp_path / "given" / "annotated.mp4").exists()


def nothing(_picture):
    return Detection("none", "nothing found", 0.0)


def middle(_picture):
    return Detection("found", "", 0.9, np.array([20.0, 10.0, 40.0, 30.0]), np.array([30.0, 20.0]))


nothing.name, middle.name = "nobody", "middle"
CAMERA = Calibration(64, 36, 60.0, 32.0, 18.0)


def black(_i, size):
    return np.zeros((*size[::-1], 3), np.uint8)


def test_clips_that_show_nothing_give_a_run_with_reasons(tmp_path):
    camera = Calibration(1920, 1080, 1600.0, 960.0, 540.0, digit_layout=layout("two-by-four"))
    path = film(tmp_path / "black.mp4", np.arange(5) / 9, (1920, 1080), draw=black)
    result = run(path, camera, tmp_path / "out", Pipeline(nothing, Reader()))
    assert {(m.status, m.reason, m.rope_status) for m in result.measurements} == {
        ("missed", "nothing found", "refused")
    }
    assert (tmp_path / "out" / "report.html").exists()
    assert not (tmp_path / "out" / "tilt.toml").exists()
    grey = film(tmp_path / "grey.mp4", np.arange(5) / 9, (1920, 1080))
    result = run(grey, camera, tmp_path / "grey", Pipeline(middle, Reader()))
    assert {m.status for m in result.measurements} == {"unread"}
    assert "no digits where the layout has the display" in {m.reason for m in result.measurements}


@pytest.mark.parametrize("live", [False, True])
def test_what_cannot_be_measured_is_one_clear_error_and_leaves_nothing(tmp_path, live):
    (tmp_path / "text.mp4").write_text("not a video")
    small = film(tmp_path / "small.mp4", np.arange(5) / 9, (8, 8))
    cut = film(tmp_path / "cut.mp4", np.arange(60) / 9)
    cut.write_bytes(cut.read_bytes()[:-300])
    for source, told in (("text.mp4", "not a video"), (small.name, "8x8"), (cut.name, "not a video")):
        out = tmp_path / "out"
        with pytest.raises(SourceError, match=told):
            run(tmp_path / source, CAMERA, out, Pipeline(nothing, None), RunOptions(live=live))
        assert not out.exists()
        assert not list(tmp_path.glob(".out*"))


@pytest.mark.parametrize("live", [False, True])
def test_a_run_that_measured_nothing_has_failed_and_says_why(tmp_path, live):
    folder = tmp_path / "pictures"
    folder.mkdir()
    for i in range(3):
        (folder / f"{i}.jpg").write_bytes(cv2.imencode(".jpg", picture(i))[1].tobytes()[:-100])
    result = run(folder, CAMERA, tmp_path / "a", Pipeline(nothing, None), RunOptions(live=live))
    why = result.failure
    assert why.startswith(f"{folder}: no picture could be read (3 lost; the first: 0.jpg cannot be read as an image: ")
    assert json.loads((tmp_path / "a" / "run.json").read_text())["failure"] == why
    assert runs.load(tmp_path / "a").failure == why
    cv2.imwrite(str(folder / "3.jpg"), picture(3))
    result = run(folder, CAMERA, tmp_path / "b", Pipeline(nothing, None), RunOptions(live=live))
    assert result.failure.startswith(f"{folder}: no frame gave an angle (3 lost, 1 missed; the first: ")
    if not live:
        result = run(folder, CAMERA, tmp_path / "c", Acting(zero))
        assert result.failure is None
        assert json.loads((tmp_path / "c" / "run.json").read_text())["failure"] is None


@pytest.mark.parametrize(("right", "cut"), [(40.0, False), (62.0, True)])
def test_boxes_that_reach_the_edge_of_the_picture_are_named(right, cut):
    found = measured(Acting(outputs(box=(20.0, 10.0, right, 30.0))))
    notes = ["frames whose box reaches the picture's edge, so that the centre is less exact: 16"]
    assert found.about["notes"] == (notes if cut else [])


@pytest.mark.parametrize("calibrate_s", [None, 60.0])
def test_a_source_without_frames_is_refused(calibrate_s):
    with pytest.raises(SourceError, match="yard: it contains no frames"):
        measure([], CAMERA, Pipeline(nothing, None, calibrate_s=calibrate_s), source="yard")


def test_a_run_with_too_few_frames_says_so():
    found = measure([Frame(picture(i), None) for i in range(2)], CAMERA, Pipeline(middle, None), source="two")
    assert found.failure.endswith("(2 refused; mean-ray refused: 2 frames: fewer than the 3 parameters)")
    assert {m.reason for m in found.measurements} == {"no tilt: 2 frames: fewer than the 3 parameters"}


def test_the_command_line_ends_with_1_where_nothing_was_measured(tmp_path, monkeypatch):
    from simgrab.instrument import pipeline

    monkeypatch.setattr(pipeline, "opened", lambda _: nothing)
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "0.jpg").write_bytes(b"no picture")
    CAMERA.save(tmp_path / "camera.toml")
    command = ["run", str(tmp_path / "pictures"), "--camera", str(tmp_path / "camera.toml"), "--out"]
    said = CliRunner().invoke(cli, [*command, str(tmp_path / "out")])
    assert said.exit_code == 1
    assert said.stderr.splitlines()[-1].startswith(
        f"simgrab: {tmp_path / 'pictures'}: no picture could be read (1 lost"
    )
    assert (tmp_path / "out" / "report.html").exists()
    said = CliRunner().invoke(cli, [*command, str(tmp_path / "b"), "--json"])
    assert said.exit_code == 1
    assert "no picture could be read" in json.loads(said.stdout)["failure"]


def test_an_annotated_video_that_breaks_off_gives_what_it_held(tmp_path):
    path = film(tmp_path / "a.mp4", np.arange(120) / 9, (160, 90))
    run(path, Calibration(160, 90, 150.0, 80.0, 45.0), tmp_path / "out", Acting(zero))
    data = (tmp_path / "out" / "annotated.mp4").read_bytes()
    assert len(list(open_source(tmp_path / "out" / "annotated.mp4"))) == 120
    (tmp_path / "half.mp4").write_bytes(data[: len(data) // 2])
    frames = list(open_source(tmp_path / "half.mp4"))
    assert 40 < len(frames) < 100
    assert frames[-1].reason == "the video is truncated here (the file is cut off)"
    assert [frame.time_s for frame in frames] == pytest.approx(np.arange(len(frames)) / 9, abs=1e-4)


def shorter(frames):
    return frames[:-1]


def longer(frames):
    return [*frames, Frame(None, 99.0, "late")]


def later(frames):
    return [*frames[:2], Frame(frames[2].picture, 0.25), *frames[3:]]


@pytest.mark.parametrize(("changed", "counts", "k"), [(shorter, (4, 3), 3), (longer, (4, 5), 4), (later, (4, 4), 2)])
def test_a_source_that_changes_while_it_is_measured_is_refused(tmp_path, monkeypatch, changed, counts, k):
    class Changing:
        name, count, live, passes = "yard", None, False, 0

        def __iter__(self):
            self.passes += 1
            frames = [Frame(picture(i), i / 9) for i in range(4)]
            return iter(frames if self.passes == 1 else changed(frames))

    monkeypatch.setattr("simgrab.instrument.run.run.open_source", lambda *_args, **_kwargs: Changing())
    before, after = counts
    with pytest.raises(SourceError) as refused:
        run("yard", CAMERA, tmp_path / "out", Pipeline(nothing, None))
    assert str(refused.value) == (
        f"yard: it changed while it was measured: {before} frames at first, then {after} when read again for the "
        f"annotated video, other ones from frame {k} on"
    )
    assert not (tmp_path / "out").exists()


def test_what_was_assumed_of_a_source_is_stated_once(tmp_path):
    def state(stream):
        stream.set_display_rotation(180)

    path = film(tmp_path / "a.mp4", np.arange(5) / 9, state=state)
    result = run(path, CAMERA, tmp_path / "out", Pipeline(nothing, None))
    assert runs.load(tmp_path / "out").about["notes"] == ["pictures are turned by 180°"]
    assert held(result)[:2] == [("source", str(path)), ("  note", "pictures are turned by 180°")]
    assert page(result, {}).count("pictures are turned by 180°") == 1


def test_an_interrupted_live_run_keeps_what_it_has(tmp_path):
    seen = []

    def impatient(picture):
        if len(seen) == 12:
            raise KeyboardInterrupt
        seen.append(picture.shape)
        return nothing(picture)

    impatient.name = "impatient"
    path = film(tmp_path / "a.mp4", np.arange(40) / 9)
    result = run(path, CAMERA, tmp_path / "out", Pipeline(impatient, None), RunOptions(live=True))
    assert len(result.measurements) == len(result.time) == len(runs.load(tmp_path / "out").measurements) == 12
    with pytest.raises(KeyboardInterrupt):
        run(path, CAMERA, tmp_path / "whole", Pipeline(impatient, None))
    with pytest.raises(KeyboardInterrupt):  # twelve are seen already, so that nothing is measured
        run(path, CAMERA, tmp_path / "at once", Pipeline(impatient, None), RunOptions(live=True))
    assert not (tmp_path / "whole").exists()
    assert not (tmp_path / "at once").exists()


def test_nothing_is_overwritten(tmp_path):
    (tmp_path / "out").mkdir()
    path = film(tmp_path / "a.mp4", np.arange(5) / 9)
    with pytest.raises(RunError, match="exists"):
        run(path, CAMERA, tmp_path / "out", Pipeline(nothing, None))


def test_a_failure_midway_leaves_nothing(tmp_path):
    def fails(_picture):
        raise KeyError("the detector broke")

    fails.name = "broken"
    path = film(tmp_path / "a.mp4", np.arange(5) / 9)
    with pytest.raises(KeyError):
        run(path, CAMERA, tmp_path / "out", Pipeline(fails, None))
    assert [p.name for p in tmp_path.iterdir()] == ["a.mp4"]


class Acting:
    """Somebody's own instrument, which does with the frames what a test asks."""

    name = "acting"

    def __init__(self, act):
        self.act = act

    def __call__(self, frames, calibration):  # noqa: ARG002
        return self.act(frames)


def zero(frames):
    for frame in frames:
        lost = frame.picture is None
        yield Measurement(status="lost", reason=frame.reason) if lost else Measurement(status="ok", alpha=0.0)


def ahead(frames):
    """Begin before it has seen anything, and then take every frame but the last."""
    yield Measurement(status="refused", reason="warming up")
    yield from zero(itertools.islice(frames, 8))


def test_anybodys_instrument_runs_but_not_frame_by_frame(tmp_path):
    path = film(tmp_path / "a.mp4", np.delete(np.arange(9), 4) / 9)
    whole, other = (run(path, CAMERA, None, one).measurements for one in (Acting(zero), Acting(ahead)))
    assert [m.status for m in whole] == ["ok"] * 4 + ["lost"] + ["ok"] * 4
    assert [m.status for m in other] == ["refused"] + ["ok"] * 4 + ["lost"] + ["ok"] * 3
    with pytest.raises(RunError, match="frame by frame"):
        run(path, CAMERA, None, Acting(zero), RunOptions(live=True))


def measured(instrument):
    return measure([Frame(picture(i), i / 9) for i in range(16)], CAMERA, instrument)


def raises(_):
    return 1 / 0


def raises_in_frame_9(frames):
    return [1 / (i - 9) and MEASURED for i, _ in enumerate(frames)]


def raises_late(frames):
    for i, _ in enumerate(frames):
        if i >= 2:  # it measures frame 0 once it has taken frame 2
            yield 1 / (i - 11) and MEASURED


def quits(_):
    sys.exit("no licence")


def finds_no_file(_):
    raise FileNotFoundError(2, "No such file or directory", "weights.onnx")


MEASURED = Measurement(status="ok", alpha=0.1)


def outputs(**fields):
    return lambda frames: [Measurement(**{"status": "ok", "alpha": 0.1} | fields) for _ in frames]


ACTS = {
    "raises": (raises, "ZeroDivisionError: division by zero"),
    "raises in frame 9": (raises_in_frame_9, "the last frame it took is 9"),
    "raises in frame 9 after all frames": (lambda f: raises_in_frame_9(list(f)), "it had taken all 16 frames"),
    "raises in frame 9 of its own": (raises_late, "the last frame it took is 11, and measured up to frame 8"),
    "quits": (quits, "SystemExit: no licence"),
    "gives nothing": (lambda _: None, "must return a list, one Measurement for each frame; got NoneType"),
    "gives too few": (lambda _: [MEASURED], "measurements of"),
    "never ends": (
        lambda frames: itertools.chain((MEASURED for _ in frames), itertools.repeat(MEASURED)),
        "more than 16 measurements of 16 frames",
    ),
    "never asks, and never ends": (lambda _: itertools.repeat(MEASURED), "more than 16 measurements of 16 frames"),
    "asks too late": (
        lambda frames: (next(frames) and MEASURED if i == 9 else MEASURED for i in itertools.count()),
        "requested frame 0 after",
    ),
    "asks for too few": (lambda frames: [MEASURED for _ in itertools.islice(frames, 4)], "4 measurements of 16 frames"),
    "finds no file": (finds_no_file, "'weights.onnx'"),
    "gives numbers": (lambda frames: [0.1 for _ in frames], "frame 0: expected a Measurement, got float"),
    "gives a text": (outputs(alpha="0.1"), "frame 0: alpha"),
    "gives no angle in frame 9": (
        lambda frames: [MEASURED if i != 9 else Measurement(status="ok") for i, _ in enumerate(list(frames))],
        "frame 9: status 'ok' needs alpha",
    ),
    "gives an angle of no grab": (outputs(status="missed", reason="-"), "alpha is only allowed with status 'ok'"),
    "gives no reason": (outputs(status="lost", alpha=None), "a reason is required unless the status is 'ok'"),
    "gives a reason with an angle": (outputs(reason="why"), "a reason is required unless the status is 'ok'"),
    "gives a status of its own": (outputs(status="fine"), "frame 0: status: invalid enum value 'fine'; there are: ok,"),
    "gives nan": (outputs(alpha=float("nan")), "frame 0: alpha"),
    "gives a centre of nan": (outputs(centre=(float("nan"), 1.0)), "centre: (nan, 1.0) is not finite"),
    "gives a sure danger": (outputs(danger=1.5), "frame 0: danger"),
    "gives an interval upside down": (outputs(alpha_low=0.2, alpha_high=0.1), "alpha_low: 0.2 rad is above"),
    "gives one number of two": (outputs(rope_text="0615"), "got '0615'"),
    "gives degrees": (outputs(alpha=5.0), "5 rad is beyond the horizontal; angles are in radians"),
    "gives a box upside down": (outputs(box=(1.0, 9.0, 5.0, 4.0)), "y0 < y1 are required"),
    "gives a bad box": (outputs(box=(1.0, 2.0)), "frame 0: box"),
}


@pytest.mark.parametrize("act", ACTS)
def test_an_instrument_that_breaks_is_refused_in_one_line(act):
    act, cause = ACTS[act]
    with pytest.raises((InstrumentError, RunError)) as problem:
        measured(Acting(act))
    assert cause in str(problem.value)
    assert "\n" not in str(problem.value)


@pytest.mark.parametrize("fails", [raises, lambda _: np.linalg.inv(np.zeros((2, 2))), lambda _: json.loads("{")])
def test_a_failure_in_a_library_is_placed_in_the_instrument(fails):
    with pytest.raises(InstrumentError, match=re.escape(f"({__file__}, line ")):
        measured(Acting(fails))


def test_numbers_of_numpy_are_numbers():
    box, centre = np.array([1.0, 2.0, 3.0, 4.0]), (np.float32(2), np.float64(3))
    found = measured(Acting(outputs(alpha=np.float32(0.1), box=box, centre=centre))).measurements[0]
    assert (found.box, found.centre) == ((1.0, 2.0, 3.0, 4.0), (2.0, 3.0))


def test_anybodys_instrument_runs_from_the_command_line(tmp_path, monkeypatch):
    path = film(tmp_path / "a.mp4", np.arange(9) / 9)
    CAMERA.save(tmp_path / "camera.toml")
    (tmp_path / "still_pipe.py").write_text(
        "from simgrab.instrument.contract import Measurement\n"
        "class Still:\n"
        "    name = 'still'\n"
        "    def __call__(self, frames, calibration):\n"
        "        return [Measurement(status='ok', alpha=0.0) for _ in frames]\n"
    )
    monkeypatch.chdir(tmp_path)
    common = ["run", str(path), "--camera", "camera.toml", "--instrument", "still_pipe:Still", "--no-video"]
    said = CliRunner().invoke(cli, [*common, "--out", "out", "--json"])
    assert said.exit_code == 0, said.output
    assert json.loads(said.output)["counts"]["ok"] == 9
    said = CliRunner().invoke(cli, [*common, "--out", "b", "--estimator", "mean-ray"])
    assert "cannot be combined with --detector" in said.output
    assert not Path("b").exists()


def test_stills_are_of_the_largest_swing_and_of_every_alarm():
    overlay = OverlayVideo(None)
    alphas = np.radians([2.0, 12.0, 11.0, *[1.0] * 60, 10.5, 10.9, 3.0])
    for i, alpha in enumerate(alphas):
        overlay.add(Frame(picture(i), i / 9), Measurement(status="ok", alpha=alpha))
    assert sorted(overlay.stills) == [1, 64]


@pytest.fixture(scope="module")
def alarmed():
    """A run with alarms, without pictures."""
    crane = swinging.record("slew-alarm", frames=400, seed=3)
    seen = crane.observations(1.0)
    measured = Pipeline(nothing, Reader()).conclude(seen, crane.calibration)
    high = [
        msgspec.structs.replace(m, alpha=a, danger=float(a > 0.1745), alpha_low=a, alpha_high=a)
        for m, a in zip(measured.measurements, crane.alpha, strict=True)
    ]

    said = Acting(lambda _: high)
    said.name = "said </script> & <b>"
    frames = [Frame(None, s.time_s, "-") for s in seen]
    return measure(frames, crane.calibration, said, source="a <video>")


def test_a_run_states_what_it_assumed_and_what_its_intervals_owe_to_that(found, clip):
    result, out = found
    assert result.about["camera"] == str(clip.with_suffix(".camera.toml"))
    assumed = json.loads((out / "run.json").read_text())["assumed"]
    assert assumed["inputs"] == []  # a rendered camera is known
    ends = np.rad2deg([(m.alpha_low, m.alpha_high) for m in result.measurements if m.alpha_low is not None])
    assert assumed["width_deg"] == pytest.approx(np.mean(ends[:, 1] - ends[:, 0]))
    assert dict(held(result))["95 % intervals"] == assumed["text"]
    assert "warning" not in dict(held(result))  # it is rendered by a fixed camera

    def again(estimator=None, **changes):
        camera = msgspec.structs.replace(result.calibration, **changes)
        instrument = Pipeline(Oracle(truth_of(clip), noise_px=0.5, miss=15), Reader(), estimator)
        return measure(open_source(clip), camera, instrument).about["assumed"]

    exact, unknown = again(offset_sd_m=0.0), again(offset_sd_m=0.5, assumed=("focal_length_px", "offset_m"))
    assert exact["offset_deg"] == pytest.approx(0, abs=1e-6)
    assert unknown["width_deg"] - unknown["offset_deg"] == pytest.approx(exact["width_deg"], rel=0.05)
    assert unknown["offset_deg"] > assumed["offset_deg"] > 0
    parts = again(mount="levelled")["parts_deg"]
    assert next(iter(parts)) == "mount"
    assert list(parts.values()) == sorted(parts.values(), reverse=True)
    assert parts["tilt"] == pytest.approx(assumed["parts_deg"]["tilt"])
    sure = Pipeline(Oracle(truth_of(clip), miss=15), Reader())
    of_sure = measure(open_source(clip), result.calibration, sure).about["assumed"]["parts_deg"]
    assert assumed["parts_deg"]["centre"] > of_sure["centre"] >= 0
    assert "without the camera's lean on its mount (levelled), " in again(mount="levelled")["text"]
    assert "stated, and so taken as exact: focal length, lens distortion, rope lengths' constant" in assumed["text"]
    assert "taken as exact: lens distortion, rope lengths' constant" in unknown["text"]
    assert "focal length 548.3 px (1 % more makes angles up to 1 % smaller)" in unknown["text"]
    bare = again(digit_layout=None)  # mean-ray knows of no offset
    assert (bare["width_deg"], bare["text"].count("camera offset")) == (None, 1)
    assert again(PendulumSmoother(), offset_sd_m=0.5)["offset_deg"] is not None
    assert assumed["beyond"] == ""


WIDE = Calibration(1920, 1080, 1000.0, 960.0, 540.0, offset_m=(0.0, 0.6, -0.3), offset_sd_m=0.05)
BOUNDED = Measurement(status="ok", alpha=0.1, alpha_low=0.0, alpha_high=0.2)


def assumed(measured=(BOUNDED,), tilt=None, *, timed=False, **changes):
    camera = msgspec.structs.replace(WIDE, **changes)
    return assumptions(camera, None, tilt, Pipeline(None, None), measured, timed=timed)


@pytest.mark.parametrize(
    ("moved_m", "text"), [(0.09, ""), (-0.11, "(0.00, 0.49, -0.30) m, 2.2 standard deviations of 0.05 m from")]
)
def test_an_estimated_offset_far_from_the_stated_one_is_named(moved_m, text):
    tilt = Known("rope-aware", 9, 3.0, 0.0, (0.0, 0.6 + moved_m, -0.3), ((0.0,) * 4,) * 4)
    found = assumed((), tilt)["beyond"]
    assert text in found
    assert bool(found) == bool(text)


PITCHES = 'unless the camera pitches with the jib (mount = "rigid"), '


@pytest.mark.parametrize(
    ("y", "mount", "said"),
    [
        (0.46, "", ""), (0.44, "", f"{PITCHES}the camera offset is (0.00, 0.44, -0.30) m"), (0.44, "rigid", ""),
        (0.44, "fixed", "the camera offset is (0.00, 0.44, -0.30) m, 3.2 standard deviations of 0.05 m from "),
    ],
)  # fmt: skip
def test_an_offset_that_only_a_pitching_camera_explains_is_named(y, mount, said):
    camera, fixed = msgspec.structs.replace(WIDE, mount=mount), np.array([0.0, y, -0.3])
    found = far_offset(WIDE.offset_m, camera, by_motion=True, fixed=fixed)
    assert found.startswith(said)
    assert bool(found) == bool(said)
    assert not far_offset(WIDE.offset_m, camera, fixed=fixed)


@pytest.mark.parametrize(
    ("mount", "leans"),
    [("", "no 95 % interval"), ("levelled", "1.7° wider"), ("rigid", "2.9° wider"), ("fixed", "")],
)
def test_a_camera_that_is_known_to_be_fixed_is_not_doubted(mount, leans):
    found = assumed(timed=True, mount=mount)["leans"]
    assert leans in found
    assert bool(found) == bool(leans)


@pytest.mark.parametrize(
    ("given", "changes", "text"),
    [
        (((),), {}, ""),
        (([Measurement(status="ok", alpha=0.1)],), {}, "none: the record does not determine them"),
        (([BOUNDED],), {"assumed": ("focal_length_px",)}, "errors of these are not in them: focal length 1000 px"),
        (([BOUNDED],), {"assumed": ("k1",)}, "errors of these are not in them: no lens distortion"),
        (([BOUNDED],), {"assumed": ("k1",), "k1": -0.2}, "errors of these are not in them: lens distortion k1 = -0.2"),
        (([BOUNDED], Known("mean-ray", 9, 3.0, 0.0, None, ((0.0,) * 2,) * 2)), {"offset_m": (0.0, 0.65, -0.3)},
         "errors of these are not in them: camera offset (0, 0.65, -0.3) ± 0.05 m, which without rope lengths, of a "
         "display or --plc, is taken for tilt (2.0° on 20 m of rope)"),
    ],
)  # fmt: skip
def test_what_intervals_do_not_hold_is_stated(given, changes, text):
    found = assumed(*given, **changes)["text"]
    assert found.startswith(text)
    assert bool(found) == bool(text)


def rectangle(camera, yaw, size):
    wide, high = size * (np.cos(yaw) + 1.5 * np.sin(yaw)), size * (1.5 * np.cos(yaw) + np.sin(yaw))
    return camera.cx_px - wide / 2, camera.cy_px - high / 2, camera.cx_px + wide / 2, camera.cy_px + high / 2


def disc(camera, _yaw, size):
    return camera.cx_px - size / 2, camera.cy_px - size / 2, camera.cx_px + size / 2, camera.cy_px + size / 2


def hoisted(shape, turn, error):
    """A grab 3 m wide on ropes of 8 to 20 m below the camera, which turns by ``turn`` rad as it is hoisted."""
    lengths = np.linspace(8, 20, 180)
    yaw = turn * (20 - lengths) / 12
    seen = []
    for length, turned in zip(lengths.tolist(), yaw.tolist(), strict=True):
        box = shape(WIDE, turned, WIDE.focal_length_px * 3 / (length + WIDE.offset_m[2]))
        seen.append(Measurement(status="unread", reason="-", box=box, rope_length_m=length + error))
    return lengths, yaw, seen


@pytest.mark.parametrize(("error", "text"), [(-2.5, "2.5 m longer"), (-1.0, ""), (1.0, ""), (2.5, "2.5 m shorter")])
def test_less_of_a_wrong_constant_is_enough_where_the_yaw_is_known(error, text):
    _, yaw, seen = hoisted(rectangle, 0.0, error)
    found = _of_size(WIDE, seen, yaw)
    assert text in found
    assert bool(found) == bool(text)
    assert _of_size(WIDE, seen, np.full(len(yaw), np.nan)) == ""


@pytest.mark.parametrize(("error", "word"), [(-5.0, "longer"), (0.0, ""), (5.0, "shorter")])
def test_a_wrong_constant_is_among_the_notes_and_stated_once_in_the_report(error, word):
    _, _, seen = hoisted(disc, 0.0, error)
    frames = [Frame(None, i / 9, "-") for i in range(len(seen))]
    found = measure(frames, WIDE, Acting(lambda passing: [seen[i] for i, _ in enumerate(passing)]), source="a video")
    notes = [note for note in found.about["notes"] if note.startswith("contradicts the camera file: ")]
    assert len(notes) == bool(word)
    assert all(word in note for note in notes)
    assert [name for name, text in held(found) if "size in the picture" in text] == [
        "contradicts the camera file"
    ] * bool(word)


@pytest.mark.parametrize("known", ["all", "none", "on long ropes"])
@pytest.mark.parametrize(
    ("shape", "turn", "error", "text"),
    [
        (rectangle, 0.0, -5.0, "5.0 m longer"), (rectangle, 0.0, 0.0, ""), (rectangle, 0.0, 5.0, "5.0 m shorter"),
        (rectangle, 0.5, 0.0, ""), (disc, 0.5, 0.0, ""), (rectangle, 0.5, 5.0, "5.0 m shorter"),
    ],
)  # fmt: skip
def test_a_wrong_constant_of_the_ropes_length_shows_in_the_grabs_size(shape, turn, error, text, known):
    lengths, yaw, seen = hoisted(shape, turn, error)
    yaw[{"all": lengths < 0, "none": lengths > 0, "on long ropes": lengths < 14}[known]] = np.nan
    found = _of_size(WIDE, seen, yaw)
    if known == "all" or not turn:  # else a rectangle that turns looks like a wrong length
        assert text in found if text and known != "on long ropes" else found == ""
    elif known == "on long ropes":
        assert found == ""


@needs_chromium
def test_the_report_opens_in_a_browser_and_takes_the_operators_word(alarmed, tmp_path):
    assert alarmed.events
    _, jpeg = cv2.imencode(".jpg", picture(0, (640, 360)))
    text = page(alarmed, {alarmed.events[0].peak: jpeg.tobytes(), int(np.nanargmax(alarmed.alpha)): jpeg.tobytes()})
    told = shown(text, tmp_path, """
      document.querySelector("input[value=true]").click();
      const extra = { count: document.getElementById("count").textContent, first: events[0].confirmed };
    """)  # fmt: skip
    assert sorted(figure["kind"] for figure in told["figures"]) == ["img"] * 2 + ["svg"] * 4
    assert told["extra"]["first"] == "true"
    n = len(alarmed.events)
    assert told["extra"]["count"] == ("all confirmed" if n == 1 else f"{n - 1} of {n} not yet confirmed")


def test_the_page_keeps_to_itself(alarmed):
    text = page(alarmed, {})
    assert not re.search(r"(?:src|href)=['\"](?!data:|#)", text)
    assert "said &lt;/script&gt; &amp; &lt;b&gt;" in text
    assert "a &lt;video&gt;" in text


def test_the_command_line(clip, tmp_path, monkeypatch):
    from simgrab.instrument import pipeline

    monkeypatch.setattr(pipeline, "opened", lambda _: Oracle(truth_of(clip)))
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "runs" / "swing-run"
    said = CliRunner().invoke(cli, ["run", str(clip), "--no-video", "--calibrate", "3s"])
    assert said.exit_code == 0, said.output
    known = json.loads((out / "run.json").read_text())
    assert f"{known['tilt']['beta_deg']:.3f}" in said.output
    assert "the paper" not in said.output
    assert "2.530" not in said.output
    assert not (out / "annotated.mp4").exists()
    tilt = str(out / "tilt.toml")
    beside = ["run", str(clip), "--out", str(tmp_path / "a"), "--live", "--calibration", tilt, "--no-video", "--paper"]
    said = CliRunner().invoke(cli, beside)
    assert "the paper's video" in said.output
    assert "2.530" in said.output
    said = CliRunner().invoke(
        cli, ["run", str(clip), "--out", str(tmp_path / "b"), "--live", "--calibration", tilt, "--json"]
    )
    assert said.exit_code == 0, said.output
    assert json.loads(said.stdout)["counts"]["ok"] > 40
    readings = "".join(f"{row.time_s},{row.rope_length_m}\n" for row in truth_of(clip))
    (tmp_path / "crane.csv").write_text(f"t,l\n{readings}4.0,15.0\n")
    (tmp_path / "crane.toml").write_text(
        'time = {column = "t"}\nrope = {column = "l", resolution = 0.01, rate_hz = 9.0}\n'
    )
    by_plc = ["run", str(clip), "--out", str(tmp_path / "d"), "--no-video", "--plc", "crane.csv"]
    said = CliRunner().invoke(cli, by_plc)
    assert said.exit_code == 0, said.output
    known = json.loads((tmp_path / "d/run.json").read_text())
    assert known["controller"]["clock_offset_s"] == pytest.approx(0, abs=1)
    assert "1 of 45 readings refused, the first in row 45: it does not increase" in "".join(known["notes"])
    assert "controller's clock" in said.output
    informed = runs.load(tmp_path / "d")
    later = {"kind": "controller", "time_s": 60.0, "text": "its clock is +3.99 s (+3.43 to +4.56) behind the pictures'"}
    rows = dict(held(dataclasses.replace(informed, about=informed.about | {"faults": [later]})))
    assert rows["controller's clock"].startswith(
        "+3.99 s (+3.43 to +4.56) behind the pictures'; at first that of the pictures (-9.80 to +9.80 s)"
    )
    assert "controller's load" not in rows
    assert "pitch" not in rows
    bolted = informed.about["tilt"] | {"radius_m": 25.7, "pitch_deg_per_m": [2.0, 0.3], "pitch_sd_deg_per_m": 0.05}
    rows = dict(held(dataclasses.replace(informed, about=informed.about | {"tilt": bolted})))
    assert rows["pitch"] == "2.02 ± 0.10 deg for each metre of radius; the tilt is that at 25.7 m"
    assert "tilt's azimuth" not in rows
    by_swing = {"tilt_azimuth_deg": 41.0, "diagnostics": {"roll_deg": 4.0, "roll_sd_deg": 0.3}}
    stated = {"tilt_azimuth_deg": 45.0, "roll_deg": 0.0}
    rolled = {name: informed.about[name] | of for name, of in (("estimate", by_swing), ("tilt", stated))}
    rows = dict(held(dataclasses.replace(informed, about=informed.about | rolled)))
    assert rows["tilt's azimuth"] == "41 deg by this roll; 45 deg in tilt.toml by the camera file's roll of 0 deg"
    for why, begins in (("", "used: "), ("it rests", "not used: it rests")):
        about = informed.about | {"controller": informed.about["controller"] | {"load_unused": why}}
        assert dict(held(dataclasses.replace(informed, about=about)))["controller's load"].startswith(begins)
    for arguments, expected in (
        (["--plc", str(tmp_path / "none.csv")], "none.toml: No such file"),
        (["--calibrate", "soon"], "invalid duration"),
        (["--estimator", "mode"], "mode"),
        (["--calibrate", "3s", "--live"], "calibrates continuously"),
        (["--camera", str(tmp_path / "none.toml")], "none.toml"),
        (["--rate", "9"], "its own time stamps"),
    ):
        said = CliRunner().invoke(cli, ["run", str(clip), "--out", str(tmp_path / "c"), *arguments])
        assert said.exit_code
        assert expected in said.output + str(said.exception)
        assert said.exception is None or isinstance(said.exception, SystemExit | SimgrabError)
        assert not (tmp_path / "c").exists()


@pytest.mark.parametrize("imu", [None, object()])  # beside which the load is used, too
@pytest.mark.parametrize(
    ("smooths", "tonnes", "unused"),
    [
        (True, 9.0, ""),
        (True, 2.0, "it does not change"),
        (False, 9.0, "it needs --imu, or slewing or luffing by --plc"),
    ],
)
def test_a_run_states_why_the_load_was_not_used(smooths, tonnes, unused, imu):
    time = np.arange(9.0)
    load = np.column_stack([time, 1e3 * np.where(time < 4, 2.0, tonnes)])
    reported = Controller(time, time / 50, time + 20, load=load, grab_kg=2000.0)
    kind = PendulumSmoother(controller=reported, imu=imu) if smooths else PaperIteration()
    record = MeasuredRecord(arrays([Observation(t) for t in time], time), (), None, None, estimator=kind)
    pipeline = Pipeline(None, None, controller=reported)
    assert _controller(pipeline, record)["load_unused"] == unused
    assert _controller(pipeline, None)["load_unused"] == "live runs do not use it"
