"""The gate lets a sound pipeline through and stops each planted fault; what it writes is whole."""

import dataclasses
import functools
import html
import json
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import cv2
import msgspec
import numpy as np
import pytest
import tomli_w
from browser import needs_chromium, shown
from commands import run
from faults import FAULTS, LongLens, sound
from test_mistakes import leaning, tilt_of

import simgrab
from simgrab.errors import ScenarioError, SuiteError
from simgrab.instrument.alarm import events
from simgrab.instrument.contract import Measurement
from simgrab.instrument.estimate import RopeAware
from simgrab.instrument.pipeline import Pipeline
from simgrab.instrument.source import open_source
from simgrab.judge.check import baseline, cache, gate, golden, page, report, suite, table, trial, verdicts
from simgrab.judge.check.causes import Cause, _of_angles, causes
from simgrab.judge.check.gate import CheckOptions
from simgrab.judge.evaluate.budget import by_centres
from simgrab.judge.evaluate.evaluation import evaluate
from simgrab.judge.evaluate.truths import Truths
from simgrab.model.records.observations import Detection

# Limits so wide that only the baseline finds a fault.
SUITE = {
    "name": "small",
    "seed": 0,
    "seeds": 3,
    "changes": {
        "camera.width_px": 480,
        "camera.height_px": 270,
        "camera.focal": {"model": "pixels", "focal_length_px": 411.2},
        "camera.beta_deg": 5.0,
        "camera.tilt_azimuth_deg": 40.0,
        "image.samples": 0,
        "image.shadow_map_px": 0,
        "place": {"model": "plain"},
        "display.layout": "two-by-four",
        "swing.alpha.sigma_deg": 4.0,
    },
    "limits": {
        "detection.centre.median_px": {"upper": 20.0, "slack": 0.2},
        "reading.digits_right.value": {"lower": 0.1, "slack": 0.001},
        "angle.overall.rmse_deg": {"upper": 20.0, "slack": 0.01},
        "angle.overall.bias_deg": {"lower": -20.0, "upper": 20.0, "slack": 0.03},
    },
    "scenes": {"swing": {"scene": "quay-day", "frames": 16, "golden": [0]}},
}
RMSE = "angle.overall.rmse_deg"
SEEN_BY = {
    "detector 2 px to the right": "detection.centre.median_px",
    "3 read as 8": "reading.digits_right.value",
    "h 5 % off": "angle.overall.rmse_deg",
    "sign of gamma": "angle.overall.rmse_deg",
}


def write(folder, **changes):
    path = folder / "small.toml"
    path.write_text(tomli_w.dumps(SUITE | changes))
    return path


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Folder with the suite, its baseline recorded with the sound pipeline, and a cache."""
    folder = tmp_path_factory.mktemp("check")
    small = suite.load(write(folder))
    result = gate.record(small, options(folder, sound))
    assert result.passed
    return folder


def limited(folder, limits, **changes):
    return suite.load(write(folder, limits=limits, **changes))


def why_of(trial, *failed):
    return [cause.text for cause in causes(trial, failed or [RMSE])]


def options(folder, make, **changes):
    made = make(folder / "cache") if make in (sound, *FAULTS.values()) else make
    return CheckOptions(**{"instrument": made, "baseline": folder / "baselines", "cache": folder / "cache"} | changes)


def check(folder, make=sound, small=None, **changes):
    return gate.check(small or suite.load(folder / "small.toml"), options(folder, make, **changes))


def scene_of(*given, **changes):
    (scene,) = check(*given, **changes).scenes.values()
    return scene


@pytest.fixture(scope="module")
def sound_trial(place):
    return scene_of(place).trial


def notes_of(trial, folder, limits, metrics=(), change=lambda _: {}):
    """Notes on a trial with other metrics, and with a change of its true rows."""
    rows = tuple(msgspec.structs.replace(row, **change(row)) for row in trial.known.rows)
    known, metrics = dataclasses.replace(trial.known, rows=rows), {**trial.metrics, **dict(metrics)}
    other = dataclasses.replace(trial, known=known, metrics=metrics)
    return gate.judged("swing", other, limited(folder, limits).limits).notes


def failed(result):
    return {verdict.what: verdict.message for verdict in result.verdicts if verdict.status == "failed"}


def forever(frame):  # noqa: ARG001
    while True:
        time.sleep(60)


def a_program(frame):  # noqa: ARG001
    return subprocess.run(["sleep", "60"], check=True)


def catching(frame):
    try:
        return forever(frame)
    except Exception:
        return Measurement(status="missed", reason="an error")


@pytest.mark.parametrize("measure", [forever, a_program, catching])
def test_an_instrument_that_does_not_end_is_stopped_in_one_line(measure, place):
    class Hanging:
        name = "hanging"

        def __call__(self, frames, calibration):  # noqa: ARG002
            for i, frame in enumerate(frames):
                yield measure(frame) if i == 3 else Measurement(status="ok", alpha=0.05)

    before, begun = signal.getsignal(signal.SIGALRM), time.monotonic()
    verdict = scene_of(place, Hanging(), timeout_s=0.5).verdicts[0]
    assert time.monotonic() - begun < 20
    assert (verdict.scene, verdict.what, verdict.status) == ("swing", "instrument", "failed")
    assert re.fullmatch(
        r"hanging: TimeLimit: no end in 0\.5 s \(.*test_check_gate\.py, line \d+\); "
        "the last frame it took is 3, and measured up to frame 2",
        verdict.message,
    )
    assert signal.getsignal(signal.SIGALRM) == before
    assert signal.getitimer(signal.ITIMER_REAL) == (0, 0)


def test_a_time_limit_that_is_kept_changes_nothing(place):
    assert check(place, timeout_s=600).passed


def test_a_sound_pipeline_passes_with_the_very_figures_that_were_recorded(place):
    result = simgrab.check(place / "small.toml", options(place, sound))
    assert result.passed
    assert {v.what for v in result.verdicts} == {"baseline", *SUITE["limits"], "golden frame 0"}
    for verdict in result.verdicts:
        assert verdict.what not in SUITE["limits"] or verdict.value == verdict.reference


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_is_stopped_by_the_baseline(place, fault):
    problems = failed(check(place, FAULTS[fault]))
    assert "worse than the baseline" in problems[SEEN_BY[fault]]


def test_another_seed_is_compared_with_the_spread_over_seeds(place):
    result = check(place, seed=3)
    assert result.passed
    assert not any(v.what.startswith("golden") for v in result.verdicts)
    recorded = baseline.load(place / "baselines").scenes["swing"].metrics[RMSE]
    (rmse,) = (v for v in result.verdicts if v.what == RMSE)
    assert rmse.reference == pytest.approx(np.mean(recorded))
    assert rmse.allowed > 0.01 + 3 * np.std(recorded, ddof=1)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"name": "other"}, "suite 'small'"),
        ({"seed": 1}, "scenes.swing.seed was recorded with another value"),
        ({"changes": SUITE["changes"] | {"camera.beta_deg": 6.0}}, "scenes.swing.camera.beta_deg was recorded with"),
        ({"scenes": {"swing": SUITE["scenes"]["swing"], "more": {"scene": "quay-day", "frames": 2}}}, "scenes.more"),
        ({"limits": SUITE["limits"] | {"detection.recall": {"lower": 0}}}, "detection.recall was not recorded"),
    ],
)
def test_a_stale_baseline_is_named_and_fails(place, tmp_path, changes, reason):
    recorded = baseline.load(place / "baselines")
    (message,) = baseline.stale(recorded, suite.load(write(tmp_path, **changes)), recorded.instrument)
    assert reason in message


def test_a_baseline_of_another_instrument_or_version_is_stale(place, monkeypatch):
    class Renamed:
        name = "another"

        def __call__(self, frames, calibration):
            return sound(place / "cache")(frames, calibration)

    assert "instrument" in failed(check(place, Renamed()))["baseline"]
    monkeypatch.setattr(baseline, "__version__", "7.8.9")
    assert "simgrab '0.1', and this is '7.8'" in failed(check(place))["baseline"]


def test_without_a_baseline_limits_alone_are_held(place, tmp_path):
    result = check(place, small=suite.load(write(tmp_path)), baseline=None)
    assert result.passed
    assert "none is recorded" in result.notes[0]
    assert "limits only" in result.notes[0]
    shares = {"frames.ok": {"lower": 0.95}, "detection.recall": {"lower": 0.5}, "frames.missed": {"upper": 1.0}}
    counted = check(place, small=limited(tmp_path, shares), baseline=None)
    assert counted.of_suite[1].endswith("limits between 0 and 1 on counts, which are no shares: frames.ok ≥ 0.95")
    plain = SUITE["scenes"]["swing"] | {"golden": []}
    free = check(place, small=limited(tmp_path, {}, scenes={"swing": plain}), baseline=None)
    assert free.notes[-1] == "swing: nothing is judged, because it has no limits"
    tight = limited(tmp_path, {RMSE: {"upper": 0.001}})
    assert "misses the limit ≤ 0.001" in failed(check(place, small=tight, baseline=None))[RMSE]


def test_a_baseline_that_is_named_must_be_there(place, tmp_path):
    with pytest.raises(SuiteError, match=r"tpyo: no baseline is recorded there"):
        check(place, baseline=tmp_path / "tpyo")


def test_what_the_baseline_has_too_few_values_for_is_reported(place, tmp_path):
    small = suite.load(place / "small.toml")
    gate.record(small, options(place, sound, baseline=tmp_path), seeds=1)
    result = check(place, baseline=tmp_path, seed=2)
    assert result.passed
    assert "compared with limits only" in result.notes[0]
    assert "angle.overall.rmse_deg" in result.notes[0]
    same = check(place, baseline=tmp_path)  # the very frames that were recorded
    assert "compared with limits only" not in " ".join(same.notes)


def test_a_recorded_seed_beyond_a_limit_is_named(place, tmp_path):
    first, second = (scene_of(place, seed=seed, baseline=None).metrics[RMSE] for seed in (0, 1))
    between = limited(tmp_path, {RMSE: {"upper" if first < second else "lower": (first + second) / 2}})
    recorded = gate.record(between, options(place, sound, baseline=tmp_path / "new"), seeds=2)
    assert recorded.passed
    assert f"swing: warning: not met with seed 1: {RMSE}" in " ".join(recorded.notes)


def test_nothing_is_recorded_where_a_limit_is_not_met(place, tmp_path):
    result = gate.record(limited(tmp_path, {RMSE: {"upper": 0.001}}), options(place, sound, baseline=tmp_path / "new"))
    assert not result.passed
    assert result.of_suite[0].startswith("nothing was recorded, because limits are not met")
    assert not (tmp_path / "new").exists()


def test_a_limit_that_the_last_scene_misses_ends_the_recording_before_other_seeds(place, tmp_path):
    last = SUITE["scenes"]["swing"] | {"limits": {RMSE: {"upper": 0.001}}}
    small = suite.load(write(tmp_path, scenes=SUITE["scenes"] | {"last": last}))
    begun = []
    result = gate.record(small, options(
        place, sound, baseline=tmp_path / "new", cache=tmp_path / "cache",
        progress=lambda name, *_: begun.append(name),
    ))  # fmt: skip
    assert not result.passed
    assert list(dict.fromkeys(begun)) == ["swing, seed 0", "last, seed 0"]


def test_limits_that_a_constant_answer_meets_are_named(place, tmp_path):
    result = check(place)
    (note,) = result.notes
    recorded = gate.record(suite.load(place / "small.toml"), options(place, sound, baseline=tmp_path), seeds=1)
    assert note in recorded.notes
    assert re.fullmatch(
        r"swing: warning: .* in every frame would pass: angle.overall.rmse_deg ≤ 20 \(constant: .*", note
    )
    found = result.scenes["swing"].trial
    true = np.array([row.alpha_deg for row in found.dataset.rows])

    def warned(**limits):
        limits = {f"angle.overall.{k}": suite.Limit(**v) for k, v in limits.items()}
        return [v.what[14:-4] for v in verdicts.lax(verdicts.of_trial("swing", found, limits, None, 1), limits)]

    least = true.std()  # of the errors of the best constant answer, which is the mean
    bias = {"lower": -0.1, "upper": 0.1}  # which a constant answer always meets
    assert warned(rmse_deg={"upper": 1.01 * least}, bias_deg=bias) == ["rmse", "bias"]
    assert warned(rmse_deg={"upper": 0.99 * least}, bias_deg=bias) == []
    assert warned(rmse_deg={"upper": 0.99 * least}, max_deg={"upper": 1.02 * np.ptp(true) / 2}) == ["max"]
    assert warned(bias_deg=bias) == ["bias"]
    assert warned(frames={"lower": 1}) == []


@pytest.mark.parametrize("by_deg", [0.0, 0.005, 0.02])
def test_a_figure_that_is_better_than_the_baseline_by_more_than_its_slack_is_named(by_deg, place, sound_trial):
    better = {**sound_trial.metrics, RMSE: sound_trial.metrics[RMSE] - by_deg, "time.per_frame_s": 0.1}
    other, small = dataclasses.replace(sound_trial, metrics=better), suite.load(place / "small.toml")
    past = baseline.load(place / "baselines")
    past.scenes["swing"].metrics["time.per_frame_s"] = (9.0,) * 3  # on another computer
    limits = dict(small.limits_of("swing")) | {"time.per_frame_s": suite.Limit(upper=10)}
    scene = gate.judged("swing", other, limits, past)
    notes = [note for note in scene.notes if "better than the baseline" in note]
    assert {v.status for v in scene.verdicts} == {"passed"}
    assert len(notes) == (by_deg > SUITE["limits"][RMSE]["slack"])
    assert all(f"{RMSE} {better[RMSE]:.4g} (baseline: {sound_trial.metrics[RMSE]:.4g})" in note for note in notes)


def test_the_last_value_is_that_of_the_frame_before_in_the_same_clip():
    rows = [
        SimpleNamespace(present=True, alpha_deg=alpha, clip=clip, rope_length_m=20.0)
        for alpha, clip in ((1.0, 0), (3.0, 0), (6.0, 1), (6.5, 1), (2.0, None), (9.0, None))
    ]
    limits = {f"angle.overall.{name}_deg": suite.Limit(upper=1) for name in ("rmse", "max")}
    found = trial.naive(Truths(tuple(rows), ("",) * 6, 0.1), limits)
    assert found["angle.overall.max_deg"] == pytest.approx((4.0, 2.0))
    assert found["angle.overall.rmse_deg"][1] == pytest.approx(np.sqrt((2.0**2 + 0.5**2) / 2))
    independent = trial.naive(Truths(tuple(rows[-2:]), ("",) * 2, 0.1), limits)
    assert independent["angle.overall.max_deg"] == (pytest.approx(3.5), None)


@dataclasses.dataclass
class Altered:
    """The sound pipeline, what it measures changed by a function of that and of the calibration."""

    place: Path
    change: Callable
    name: str = "altered"

    def __call__(self, frames, calibration):
        return self.change(sound(self.place / "cache").record(frames, calibration).measurements, calibration)


def two_degrees_more(measured, _):
    """Add 2° to the angles, and miss the grab in frame 5."""
    return [
        Measurement(status="missed", reason="<no grab>")
        if i == 5
        else msgspec.structs.replace(m, alpha=m.alpha + np.deg2rad(2), alpha_high=m.alpha_high + np.deg2rad(2))
        for i, m in enumerate(measured)
    ]


def times(factor):
    """Multiply the angles."""
    no_interval = {"alpha_low": None, "alpha_high": None}
    return lambda measured, _: [msgspec.structs.replace(m, alpha=factor * m.alpha, **no_interval) for m in measured]


def long_rope(measured, calibration):
    """Add 8 m to the rope lengths, and compute with them."""
    centres = np.array([m.centre for m in measured])
    lengths = np.array([m.rope_length_m for m in measured]) + 8.0
    alphas = RopeAware().estimate(centres, calibration, rope_length=lengths).alpha
    for m, alpha, length in zip(measured, alphas.tolist(), lengths.tolist(), strict=True):
        yield msgspec.structs.replace(m, alpha=alpha, alpha_low=None, alpha_high=None, rope_length_m=length)


def late(measured, _):
    """Give each frame the angle of two frames before."""
    return [msgspec.structs.replace(m, centre=None, box=None) for m in (*measured[-2:], *measured[:-2])]


def astray(measured, _, every=4):
    """Shift box and centre by 150 px in every k-th frame."""
    for i, m in enumerate(measured):
        box, centre = (None if where is None else np.array(where) + 150.0 for where in (m.box, m.centre))
        yield msgspec.structs.replace(m, box=box, centre=centre) if i % every == 0 else m


def test_the_page_states_why_a_check_failed(place, tmp_path):
    small = limited(tmp_path, {RMSE: {"upper": 1}, "frames.ok": {"lower": 16}})
    result = check(place, Altered(place, two_degrees_more), small, baseline=None)
    why = " ".join(why_of(result.scenes["swing"].trial))
    assert "1 of 16 frames with a grab have no angle: missed (<no grab>) in 1." in why
    assert re.search(r"the measured angle is (1\.[89]|2\.[012])\d° too large", why)
    assert "the error arises where this pipeline computes its angles" in why
    text = page.page(result)
    assert "2 of 3 checks failed" in text
    assert "missed (&lt;no grab&gt;)" in text
    assert text.count("<img") == 5  # the largest errors, and the frame without an angle
    stated = html.unescape(page.page(check(place)))
    assert re.search(
        r"cover the true angle in \d+% of the frames that have one; 95 % is stated\. The pipeline's", stated
    )
    assert re.search(r"tilt is \d\.\d\d° with an azimuth of \d+°; the best constant one is 5\.00° .* 40°\.", stated)
    assert "Pictures are reduced to a width of 640 px" in text
    off = [float(error) for error in re.findall(r"<figcaption>.*error ([+-][\d.]+)°", text)]
    assert len(off) == 4
    assert off == sorted(off, reverse=True)
    assert page.page(result) == text
    scene = scene_of(place, FAULTS["detector 2 px to the right"])
    assert re.match(
        r"On .* (1\.[89]|2\.[012]) px right of and 0\.\d px (below|above) the true one\. Largest errors of the centre",
        " ".join(why_of(scene.trial, "detection.centre.median_px")),
    )


def test_an_impossible_scene_is_refused_before_another_is_rendered(tmp_path, monkeypatch):
    deep = {"scene": "quay-day", "frames": 2, "changes": {"swing.rope_length_m": 27.9, "swing.clamp": False}}
    path = write(tmp_path, scenes={**SUITE["scenes"], "deep": deep})
    monkeypatch.setattr(gate.cache, "rendered", lambda *_args, **_options: pytest.fail("rendered"))
    for act, given in ((gate.check, {"baseline": None}), (gate.record, {})):
        with pytest.raises(ScenarioError, match="into the ground"):
            act(suite.load(path), options(tmp_path, sound, **given))


def test_a_wrong_tilt_is_named(place, tmp_path):
    scene = scene_of(place, FAULTS["sign of gamma"], limited(tmp_path, {RMSE: {"upper": 1.0}}), baseline=None)
    found = re.search(
        r"Correct the tilt first: this pipeline's is (\S+)° with an azimuth of (\S+)°, from 16 frames; the true one is "
        r"(\S+)° with (\S+)°. With that, the RMSE would be (\S+)° instead of (\S+)°\.",
        scene.causes,
    )
    own, azimuth, true, true_azimuth, rmse, worse = map(float, found.groups())
    assert (true, true_azimuth, own, azimuth % 360) == (5.0, 40.0, pytest.approx(5, abs=0.5), pytest.approx(320, abs=5))
    assert rmse < 0.1 < 1.0 < worse
    assert "the error arises" not in scene.causes
    scene = scene_of(place, FAULTS["h 5 % off"])  # its wrong tilt is not what its angles follow from
    assert "the tilt first" not in " ".join(why_of(scene.trial))


def test_what_wrong_centres_cause_is_not_taken_for_another_mistake(sound_trial):
    """Of centres 6 px to the right, from which the angles follow with the true tilt or without any."""
    run, known = sound_trial.run, sound_trial.known
    centred = tuple(msgspec.structs.replace(m, centre=(m.centre[0] + 6, m.centre[1])) for m in run.measurements)
    seen = []
    for row, centre in zip(known.rows, by_centres(dataclasses.replace(run, measurements=centred), known), strict=True):
        pose = np.reshape(row.jib_from_grab, (3, 4))
        pose[:, 3] = centre
        seen.append(msgspec.structs.replace(row, jib_from_grab=tuple(pose.ravel())))
    for lean in (np.zeros(2), -tilt_of(known.rows)):
        angles, stated = leaning(seen, lean=lean), bool(lean.any())
        found = [msgspec.structs.replace(m, alpha=float(a)) for m, a in zip(centred, angles, strict=True)]
        about = run.about | {"tilt": None, "estimate": None}
        trial = dataclasses.replace(sound_trial, run=dataclasses.replace(run, measurements=tuple(found), about=about))
        why = " ".join(why_of(trial))
        assert ("as if the tilt of 5.0° were left out" in why) == stated
        assert ("The angles are as" in why) == stated
        assert ("Correct the centre first" in why) != stated


@pytest.mark.parametrize("missed", [0, 1])
def test_errors_that_nothing_explains_are_stated_as_such(sound_trial, missed, monkeypatch):
    """Of a pipeline that outputs angles alone, and misses a frame or none."""
    true = sound_trial.known.alpha
    noise = np.random.default_rng(0).normal(0, np.deg2rad(2.0), len(true))
    measured = [Measurement(status="ok", alpha=float(alpha)) for alpha in np.abs(true + noise)]
    measured[:missed] = [Measurement(status="missed", reason="hidden")] * missed
    about = sound_trial.run.about | {"tilt": None, "estimate": None}
    run = dataclasses.replace(sound_trial.run, measurements=tuple(measured), about=about)
    evaluation = msgspec.structs.replace(sound_trial.evaluation, budget=None)
    trial = dataclasses.replace(sound_trial, run=run, evaluation=evaluation)
    *others, last = why_of(trial)
    assert last == "No single mistake was found that explains the errors of the angle."
    assert len(others) == missed
    monkeypatch.setattr("simgrab.judge.check.causes.FEW_LOST", 0.1)
    for failed, stated in (([RMSE], 0), ([RMSE, "frames.ok"], missed)):
        assert len(why_of(trial, *failed)) == 1 + stated


def kept(measured, _):
    """Keep the angle of the frame before, without a centre, in every fourth frame, and 20° in the last one."""
    angles = [m.alpha for m in measured]
    for i, m in enumerate(measured):
        alpha = np.deg2rad(20.0) if i == 15 else angles[i - 1] if i % 4 == 3 else m.alpha
        yield Measurement(status="ok", alpha=alpha) if i % 4 == 3 else m


def test_angles_without_a_centre_and_of_frames_without_a_grab_are_named(place, tmp_path):
    small = limited(tmp_path, {RMSE: {"upper": 0.5}})
    scene = scene_of(place, Altered(place, kept), small, baseline=None)
    assert re.fullmatch(
        r"4 angles have no centre beside them; 3 of these repeat the frame before\. Without the 4 the RMSE "
        r"would be 0\.\d\d° instead of \d\.\d\d°\.",
        scene.causes,
    )
    assert scene.metrics["frames.without_grab"] == 0
    assert not any("without a grab" in note for note in scene.notes)
    rows = list(scene.trial.known.rows)
    rows[3] = msgspec.structs.replace(rows[3], present=False, box_x0_px=None)
    known = dataclasses.replace(scene.trial.known, rows=tuple(rows))
    found = evaluate(scene.trial.run, known)
    ghost = dataclasses.replace(scene.trial, known=known, evaluation=found, metrics=trial.flat(found.to_dict()))
    assert ghost.metrics["frames.without_grab"] == 1
    assert why_of(ghost, "frames.ok")[-1] == "1 of 16 angles are of frames without a grab."
    assert "swing: warning: 1 of 16 angles are of frames without a grab; set a limit on frames.without_grab" in (
        gate.judged("swing", ghost, small.limits).notes
    )


def test_a_figure_without_a_value_is_explained_by_no_other_error(place, tmp_path):
    small = limited(tmp_path, {"alarm.missed": {"upper": 0}, RMSE: {"upper": 20.0}})
    scene = scene_of(place, FAULTS["detector 2 px to the right"], small, baseline=None)
    assert [verdict.what for verdict in scene.verdicts if verdict.status == "failed"] == ["alarm.missed"]
    assert scene.causes == ""


def swinging(rows, peak_deg):
    """A swing of one period over the rows."""
    alphas = np.abs(np.sin(np.linspace(0, np.pi, len(rows)))) * peak_deg
    return tuple(msgspec.structs.replace(row, alpha_deg=float(a)) for row, a in zip(rows, alphas, strict=True))


def timed(sound_trial, peak_deg):
    """A trial of a swing of one period, measured without errors."""
    known = dataclasses.replace(sound_trial.known, rows=swinging(sound_trial.known.rows, peak_deg))
    times = 0.25 * np.arange(len(known.rows))
    measured = [Measurement(status="ok", alpha=a) for a in known.alpha.tolist()]
    about = sound_trial.run.about | {"tilt": None, "estimate": None}
    run = dataclasses.replace(
        sound_trial.run, time=times, measurements=tuple(measured), events=events(times, measured), about=about
    )
    found = evaluate(run, known)
    return trial.Trial(sound_trial.dataset, trial.flat(found.to_dict()), run, known, found)


MISSED, FALSE, PRECISION = ({f"alarm.{name}": limit} for name, limit in (
    ("missed", {"upper": 0}), ("false", {"upper": 0}), ("precision", {"lower": 0.9})))  # fmt: skip


@pytest.mark.parametrize(
    ("scenes", "how"),
    [
        ([(12.0, MISSED)], "always"),
        ([(12.0, FALSE)], "never"),
        ([(9.0, MISSED | FALSE)], "never"),
        ([(12.0, MISSED | FALSE)], "always"),  # one alarm, beside a swing beyond 9.5 degrees
        ([(12.0, MISSED | FALSE), (9.0, MISSED | FALSE)], ""),
        ([(12.0, MISSED | PRECISION)], ""),
        ([(12.0, {RMSE: {"upper": 0.1}})], ""),
    ],
)
def test_limits_on_alarms_that_never_or_always_alarming_meets_are_named(
    scenes, how, sound_trial, place, tmp_path, monkeypatch
):
    trials = {f"swing {i}": timed(sound_trial, peak_deg) for i, (peak_deg, _) in enumerate(scenes)}
    one = SUITE["scenes"]["swing"] | {"golden": []}
    named = {name: one | {"limits": limits} for name, (_, limits) in zip(trials, scenes, strict=True)}
    small = limited(tmp_path, {}, scenes=named)
    left = iter([*trials.values()] * 2)
    monkeypatch.setattr(gate, "trial", lambda *_: next(left))
    checked = check(place, small=small, baseline=None)
    recorded = gate.record(small, options(place, sound, baseline=tmp_path / "new"), seeds=1)
    assert checked.passed
    for report_ in (checked, recorded):
        notes = [note for note in report_.of_suite if "limits on alarms are too loose" in note]
        assert len(notes) == bool(how)
        assert all(f"that {how} raises an alarm" in note for note in notes)
    constants = {v.what: v.constant for v in checked.verdicts if v.what.startswith("alarm.")}
    best = {"alarm.missed": 0, "alarm.false": 0, "alarm.precision": pytest.approx(0.375, abs=0.1)}
    assert constants == {what: best[what] for what in constants}


@pytest.mark.parametrize(
    ("peak_deg", "off_deg", "danger", "limits", "explained"),
    [
        (9.0, 2.0, None, {"alarm.sure": {"lower": 1}}, False),  # the scene has none
        (9.0, 2.0, None, {"alarm.sure": {"lower": 1}, RMSE: {"upper": 1}}, True),
        (12.0, 0.05, 0.0, {"alarm.missed": {"upper": 0}}, False),  # its angles exceed 10°
        (12.0, -3.0, None, {"alarm.missed": {"upper": 0}}, True),
        (12.0, 2.0, None, {"interval.width_deg": {"upper": 0.1}}, False),
        (12.0, 2.0, None, {"interval.share": {"lower": 0.9}}, True),
    ],
)
def test_only_limits_that_right_angles_would_meet_are_explained(
    sound_trial, tmp_path, peak_deg, off_deg, danger, limits, explained
):
    """Of angles that differ by a constant."""
    known = dataclasses.replace(sound_trial.known, rows=swinging(sound_trial.known.rows, peak_deg))
    angles = np.abs(known.alpha + np.deg2rad(off_deg)).tolist()
    measured = [
        Measurement(status="ok", alpha=a, alpha_low=a - 0.01, alpha_high=a + 0.01, danger=danger) for a in angles
    ]
    times = 0.25 * np.arange(len(angles))
    run = dataclasses.replace(
        sound_trial.run, time=times, measurements=tuple(measured), events=events(times, measured),
        about=sound_trial.run.about | {"tilt": None, "estimate": None},
    )  # fmt: skip
    found = evaluate(run, known)
    trial_ = dataclasses.replace(
        sound_trial, run=run, known=known, evaluation=found, metrics=trial.flat(found.to_dict())
    )
    scene = gate.judged("swing", trial_, limited(tmp_path, limits).limits)
    assert {v.status for v in scene.verdicts} == {"failed"}
    assert bool(scene.causes) == explained


def test_frames_in_which_the_grab_hardly_swings_are_named(sound_trial, tmp_path):
    limits = {RMSE: {"upper": 1.0}}
    (note,) = notes_of(sound_trial, tmp_path, limits, change=lambda row: {"alpha_deg": 0.01 * row.alpha_deg})
    assert note.startswith("swing: warning: the grab hardly swings (standard deviation 0.0")


@pytest.mark.parametrize(("change", "named"), [({"rope_length_m": 20.0}, True), ({}, False)])
def test_limits_on_lengths_that_do_not_change_are_named(sound_trial, tmp_path, change, named):
    notes = notes_of(sound_trial, tmp_path, {"reading.length.p95_m": {"upper": 1.0}}, change=lambda _: change)
    assert any("the rope's length hardly changes" in note for note in notes) == named


def test_a_limit_on_missed_alarms_is_named_where_no_swing_can_be_missed(sound_trial, tmp_path):
    for sure, said in ((0.0, ["swing: warning: alarm.missed tests nothing, since no swing exceeds 10.5°"]), (1.0, [])):
        metrics = {"alarm.sure": sure, "alarm.missed": 0.0}
        *notes, last = notes_of(sound_trial, tmp_path, {"alarm.missed": {"upper": 0}}, metrics)
        assert notes == said
        assert last == "swing: warning: no limit is on angle.*, so that the same angle in every frame may pass"
    assert not notes_of(sound_trial, tmp_path, {RMSE: {"upper": 0.4}})


@pytest.mark.parametrize(
    ("factor", "text"),
    [
        (0.0, "The measured angle hardly follows the swing"),
        (np.pi / 180, "as if it were converted from degrees to radians twice"),
        (0.5, "the measured angle is 0.50 times the true one. Without it the RMSE would be 0.1"),
    ],
)
def test_a_factor_of_the_angles_is_named_alone(place, factor, text):
    trial = scene_of(place, Altered(place, times(factor))).trial
    (why,) = [line for line in why_of(trial) if "tilt" not in line and "entre" not in line]
    assert text in why
    assert "constant" not in why


def test_a_wrong_centre_comes_before_the_tilt_that_is_estimated_from_it(place):
    scene = scene_of(place, FAULTS["detector 2 px to the right"])
    why = " ".join(why_of(scene.trial))
    assert scene.trial.evaluation.budget.limit == "tilt estimated"  # most of the whole error
    assert re.search(r"Correct centre and tilt: the centre's error \(95th percentile\) is 2\.\d px\.", why)
    assert "the tilt first" not in why


def test_angles_in_degrees_are_named():
    true = np.linspace(0.1, 1.4, 20)
    (said,) = _of_angles(np.rad2deg(true), true)
    assert "57.30 times the true one, as if it were in degrees" in said


def test_a_factor_that_leaves_no_less_than_a_constant_answer_is_not_named():
    true = np.linspace(1.0, 2.0, 20)
    assert not any("factor" in said for said in _of_angles(9 + 5 * np.cos(40 * true), true))
    assert "factor" in next(_of_angles(4.6 * true, true))


def test_a_factor_that_leaves_as_little_as_a_constant_is_named_beside_it():
    true = np.linspace(2.0, 4.0, 20)
    noise = 0.2 * (-1.0) ** np.arange(20)
    (said,) = _of_angles(1.1 * true + noise, true)
    assert "a constant or a factor: on average, the measured angle is 0.30° too large, or 1.10 times the true" in said
    (said,) = _of_angles(true + 0.3, true)
    assert "is a constant: on average, the measured angle is 0.30° too large. Without it" in said


def test_a_mistake_is_named_only_where_the_check_would_pass_without_it(place, tmp_path):
    def why(instrument, metric, upper):
        return scene_of(place, instrument, limited(tmp_path, {metric: {"upper": upper}}), baseline=None).causes

    long = dataclasses.replace(sound(place / "cache"), estimator=LongLens(times=1.3))
    cases = (
        (Altered(place, late), RMSE, 0.3, 0.01, "those of 2 frames before theirs"),
        (long, RMSE, 0.3, 0.1, "focal length of 5"),
        (Altered(place, long_rope), RMSE, 0.25, 0.1, "Rope lengths are 8.0"),
        (Altered(place, long_rope), "reading.length.p95_m", 0.1, 1e-6, "Rope lengths are 8.0"),
    )
    for instrument, metric, upper, too_low, text in cases:
        found = why(instrument, metric, upper)
        assert text in found
        assert "Rope" in text or "Correct the" not in found  # no stage beside what explains it all
        assert text not in why(instrument, metric, too_low)


def test_centres_that_a_figure_leaves_out_are_stated(place, tmp_path):
    small = limited(tmp_path, {"detection.centre.p95_px": {"upper": 25.0}, "detection.recall": {"lower": 0.7}})
    result = check(place, Altered(place, astray), small, baseline=None)
    assert {v.what: v.frames for v in result.verdicts[:2]} == {
        "detection.centre.p95_px": "12 of 16 frames", "detection.recall": ""
    }  # fmt: skip
    (warning,) = (note for note in result.notes if "warning" in note)
    assert re.search(r"leaves out 4 of 16 centres, up to 21\d px off", warning)
    assert warning.endswith("frames 0, 4, 8, 12")
    assert " (12 of 16 frames)" in page.page(result)
    assert warning in json.loads(report.as_json(result))["notes"]
    strict = limited(tmp_path, {"detection.centre.p95_px": {"upper": 0.01}, RMSE: {"upper": 0.01}})
    result = check(place, Altered(place, astray), strict, baseline=None)
    (scene,) = result.scenes.values()
    for frame in (0, 4, 8, 12):
        assert f" px in frame {frame}" in scene.causes
        assert re.search(rf"<figcaption>Frame {frame}: .*, centre 21\d\.\d px off", page.page(result))
    assert "Correct the centre first: the centre's error (95th percentile) is 21" in scene.causes
    written = json.loads(report.as_json(result))
    assert written["causes"] == dict.fromkeys(result.scenes, scene.causes)
    (listed,) = written["worst_frames"].values()
    assert {0, 4, 8, 12} <= {one["frame"] for one in listed if one["centre_off_px"] > 210}
    first = listed[-1]
    assert first["true_deg"] == scene.trial.dataset.rows[first["frame"]].alpha_deg
    assert "the error arises" not in scene.causes
    assert "largest contribution" not in scene.causes
    scene = scene_of(place, FAULTS["3 read as 8"], strict, baseline=None)
    assert "The largest contribution in its error budget: " in scene.causes
    found = scene.trial.evaluation
    first, still, *others = found.budget.chain
    for times, leaves_deg, said in (  # simgrab's estimator's error from its inputs; that of a tilt that does not change
        (0.0, 0.0, ""), (1.5, 0.0, "the error arises where"), (0.0, 50.0, "does not change leaves an RMSE of 50.00°"),
    ):  # fmt: skip
        own = msgspec.structs.replace(found.budget.run, rmse_deg=times * found.budget.chain[-1].rmse_deg)
        chain = (first, msgspec.structs.replace(still, rmse_deg=leaves_deg), *others)
        other = msgspec.structs.replace(found, budget=msgspec.structs.replace(found.budget, run=own, chain=chain))
        why = " ".join(why_of(dataclasses.replace(scene.trial, evaluation=other)))
        assert said in why
        assert ("tilt changes" in why) == (leaves_deg > 0)
        assert "largest contribution" not in why
    every = check(place, Altered(place, functools.partial(astray, every=1)), small, baseline=None)
    assert failed(every)["detection.centre.p95_px"].endswith("(IoU of at least 0.5), and none of 16 does")
    assert not check(place, small=small, baseline=None).notes[1:]


@needs_chromium
def test_the_page_fits_windows_and_phones(place, tmp_path):
    for instrument in (FAULTS["h 5 % off"], Broken(raises)):
        shown(page.page(check(place, instrument)), tmp_path)


def test_a_metric_that_is_not_there_fails_and_is_reported(place, tmp_path):
    limits = {"angle.by_weather.fog.rmse_deg": {"upper": 1}, "alarm.missed": {"upper": 0}}
    problems = failed(check(place, small=limited(tmp_path, limits), baseline=None))
    assert "no frame of that kind has a measured and a true angle" in problems["angle.by_weather.fog.rmse_deg"]
    assert 'give it swing.model = "dynamic"' in problems["alarm.missed"]  # independent frames know no time


@pytest.mark.parametrize(
    ("metric", "metrics", "reason"),
    [
        ("alarm.median_delay", {"events": 0}, "the true swing never exceeds 10°"),
        ("alarm.recall", {"events": 0}, "the true swing never exceeds 10°"),
        ("alarm.recall", {"events": 1, "already_on": 0}, "no frame beyond 10° has an angle"),
        ("warning.lead_s", {"events": 0}, "the true swing never exceeds 10.5°"),
        ("alarm.median_delay", {"events": 1, "already_on": 1},
         "of 1 event of the true swing, 1 began while an alarm was on already"),
        ("alarm.median_delay", {"events": 2, "already_on": 0}, "of 2 events of the true swing, 2 raised no alarm"),
        ("alarm.median_delay", {"events": 3, "already_on": 1},
         "of 3 events of the true swing, 1 began while an alarm was on already and 2 raised no alarm"),
        ("warning.lead_s", {"events": 2}, "of 2 events of the true swing, 2 raised no warning"),
        ("alarm.precision", {"events": 2}, "no frame is reported beyond 10°"),
        ("warning.peak_coverage", {"events": 2}, "the instrument output no peak"),
        ("warning.lead_s", {}, "the instrument output no warning"),
        ("detection.recall", {}, "the instrument output no box"),
        ("reading.length.p95_m", {}, "the scene has no such data"),
    ],
)  # fmt: skip
def test_the_reason_for_a_figure_without_a_value_is_stated(sound_trial, metric, metrics, reason):
    measured = [msgspec.structs.replace(m, box=None) for m in sound_trial.run.measurements]
    run = dataclasses.replace(sound_trial.run, measurements=tuple(measured))
    part = metric.partition(".")[0]
    found = dataclasses.replace(sound_trial, run=run, metrics={f"{part}.{k}": float(v) for k, v in metrics.items()})
    (verdict,) = verdicts.of_trial("swing", found, {metric: suite.Limit(lower=0)}, None, 1)
    assert verdict.message == f"no value: {reason}"


def test_an_instrument_that_misses_every_grab_has_no_recall(place, tmp_path):
    small = limited(tmp_path, {"detection.recall": {"lower": 0.5}})
    blind = Broken(dark)
    assert "0 misses the limit ≥ 0.5" in failed(check(place, blind, small, baseline=None))["detection.recall"]


class Broken:
    name = "broken"

    def __init__(self, act):
        self.act = act

    def __call__(self, frames, calibration):
        assert calibration.width_px == 480
        return self.act(frames)


def dark(frames):
    return [Measurement(status="missed", reason="dark") for _ in frames]


def raises(_):
    return 1 / 0


NO_LIST = "broken: must return a list, one Measurement for each frame; got "


@pytest.mark.parametrize(
    ("act", "cause"), [(lambda _: None, f"{NO_LIST}NoneType"), (lambda _: 3, f"{NO_LIST}int"), (raises, "ZeroDivision")]
)
def test_an_instrument_that_breaks_is_a_failure_reported_in_one_line(place, act, cause):
    problem = failed(check(place, Broken(act), baseline=None))["instrument"]
    assert cause in problem
    assert "\n" not in problem


@dataclasses.dataclass
class BrokenDetector:
    """Outputs something else than a box for the tenth picture."""

    other: Any
    name: str = "odd"
    pictures: int = 0

    def __call__(self, _):
        self.pictures += 1
        found = Detection("found", "", 0.9, centre=np.array([240.0, 130.0]))
        return self.other() if self.pictures == 10 else found


@pytest.mark.parametrize(
    ("other", "cause"),
    [
        (lambda: None, "odd: expected a Detection, got NoneType"),
        (lambda: Detection("found", "", 0.9), "odd: 'found' needs a box or a centre"),
        (lambda: Detection("found", "", 0.9, centre=np.array([1, np.nan])), "odd: centre: 2 finite numbers are"),
        (lambda: Detection("found", "", 0.9, box=np.zeros(3)), "odd: box: 4 finite numbers are required, got [0. 0. 0"),
        (lambda: 1 / 0, f"ZeroDivisionError: division by zero ({__file__}, line "),
    ],
)
def test_a_detection_that_is_invalid_is_a_failure_that_names_its_frame(place, other, cause):
    problem = failed(check(place, Pipeline(BrokenDetector(other), None), baseline=None))["instrument"]
    assert cause in problem
    assert problem.endswith(", in frame 9")


def test_a_pipeline_that_is_slow_misses_a_limit_on_its_time(place, tmp_path):
    def slow(frames):
        time.sleep(0.8)
        return dark(frames)

    small = limited(tmp_path, {"time.per_frame_s": {"upper": 0.04}})
    result = check(place, Broken(slow), small, baseline=None)
    verdict, _ = result.verdicts
    assert verdict.message.endswith("misses the limit ≤ 0.04")
    assert verdict.value >= 0.8 / 16
    assert f"The pipeline took {verdict.value:.3g} s per frame." in page.page(result)


def test_the_time_to_read_frames_is_not_the_instruments(place, monkeypatch):
    class Slow:
        def __init__(self, path):
            self._source = open_source(path)
            self.name = self._source.name

        def __iter__(self):
            for frame in self._source:
                time.sleep(0.1)
                yield frame

    monkeypatch.setattr(trial, "open_source", Slow)
    assert scene_of(place, Broken(dark), baseline=None).metrics["time.per_frame_s"] < 0.1 / 2


def test_frames_without_an_angle_are_no_cause_of_a_limit_on_time(sound_trial):
    lost = [Measurement(status="missed", reason="dark") for _ in sound_trial.run.measurements]
    blind = dataclasses.replace(sound_trial, run=dataclasses.replace(sound_trial.run, measurements=tuple(lost)))
    assert not why_of(blind, "time.per_frame_s")
    for metric in ("frames.ok", "detection.recall"):
        assert "16 of 16 frames with a grab have no angle: missed (dark) in 16." in why_of(blind, metric)


def test_nothing_is_recorded_of_an_instrument_that_fails(place, tmp_path):
    small = suite.load(write(tmp_path))
    result = gate.record(small, options(place, Broken(raises), baseline=tmp_path / "new"))
    assert not result.passed
    assert not (tmp_path / "new").exists()
    with pytest.raises(SuiteError, match="name another by --baseline"):
        gate.record(small, options(place, sound, baseline=None))


def test_a_dataset_is_drawn_once_and_again_when_its_pictures_changed(place):
    scenario = suite.load(place / "small.toml").scenario("swing")
    found = cache.rendered(scenario, place / "cache")
    manifest, picture = found.path / "manifest.json", found.image(found.rows[3])
    before, bytes_before = manifest.stat().st_mtime_ns, picture.read_bytes()
    assert cache.rendered(scenario, place / "cache").path == found.path
    assert manifest.stat().st_mtime_ns == before
    picture.write_bytes(found.image(found.rows[4]).read_bytes())
    cache.rendered(scenario, place / "cache")
    assert manifest.stat().st_mtime_ns != before
    assert picture.read_bytes() == bytes_before


def test_the_cache_goes_by_the_code_that_draws_alone(tmp_path, monkeypatch):
    """A page, an instrument or a judge changes no pixel; the world, a label and a scene's key may."""
    monkeypatch.setattr(cache, "PACKAGE", tmp_path)
    digests = []
    for name in ("text.py", "pages/studio/app.py", "reports/html.py", "judge/audit.py", "pages/studio/page.js",
                 "cli/run.py", "world/scene.py", "model/truth.py", "model/scenario/swing.py"):  # fmt: skip
        (tmp_path / name).parent.mkdir(exist_ok=True, parents=True)
        (tmp_path / name).write_text("pass")
        digests.append(cache._drawing_code.__wrapped__())
    assert len(set(digests[:6])) == 1
    assert len(set(digests)) == 4


def test_a_check_killed_while_it_clears_its_cache_goes_on(place, monkeypatch):
    scenario = suite.load(place / "small.toml").scenario("swing")
    found = cache.rendered(scenario, place / "cache")
    found.image(found.rows[0]).write_bytes(b"damaged")

    def killed(folder, **_):
        (next(Path(folder).rglob("manifest.json"))).unlink()
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(shutil, "rmtree", killed)
        with pytest.raises(KeyboardInterrupt):
            cache.rendered(scenario, place / "cache")
    again = cache.rendered(scenario, place / "cache")
    assert again.data.labels_sha256 == found.data.labels_sha256
    assert not list((place / "cache").glob("*.draft"))


def altered(place, folder, change, **keys):
    """Copy the golden frame of the baseline with a change of its picture and of what is noted of it."""
    kept = golden.load(place / "baselines")["swing/0"]
    picture = change(cv2.imread(str(place / "baselines" / kept.file)))
    assert cv2.imwrite(str(folder / kept.file), picture, [cv2.IMWRITE_JPEG_QUALITY, 95])
    noted = msgspec.structs.replace(kept, sha256="another", **keys)
    (folder / golden.FILE).write_bytes(msgspec.json.encode({"swing/0": noted}))
    dataset = cache.rendered(suite.load(place / "small.toml").scenario("swing"), place / "cache")
    return golden.look("swing", 0, dataset, folder, 0.8)


def without_grab(picture):
    x0, y0, x1, y1 = 180, 70, 300, 200
    picture[y0:y1, x0:x1] = picture[y0:y1, x0:x1].mean(axis=(0, 1))
    return picture


def test_golden_frames_are_compared_by_hash_or_by_likeness(place, tmp_path, monkeypatch):
    def status(change, **keys):
        verdict, difference = altered(place, tmp_path, change, **keys)
        assert difference is None or (verdict.status, difference.shape) == ("failed", (270, 3 * 480, 3))
        return verdict.status, verdict.message

    def unchanged(picture):
        return picture

    assert "rendered by the same renderer" in status(unchanged)[1]
    assert status(unchanged, drawn_by="another")[0] == "passed"
    assert status(without_grab, drawn_by="another")[0] == "failed"
    assert "out of date" in status(unchanged, digest="another")[1]
    assert "size" in status(lambda p: p[:200], drawn_by="another")[1]
    monkeypatch.setattr(golden, "cpu_features", lambda: {"numpy": ("another",)})
    assert status(unchanged)[0] == "passed"
    assert status(without_grab)[0] == "failed"


@pytest.fixture
def shell(place, tmp_path, monkeypatch):
    """Run the command line where ``pipelines.py`` offers the sound pipeline, the faults and broken factories."""
    faults = Path(__file__).parents[1]
    (tmp_path / "pipelines.py").write_text(
        f"import sys\nsys.path.insert(0, {str(faults)!r})\nimport faults\nCACHE = {str(place / 'cache')!r}\n"
        "def sound(): return faults.sound(CACHE)\ndef shifted(): return faults.shifted(CACHE)\n"
        "def fails(): raise RuntimeError('no model file')\nclass NoName: pass\n"
    )
    (tmp_path / "no_import.py").write_text("import nothing_of_that_name\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr(sys, "modules", {k: v for k, v in sys.modules.items() if k not in ("pipelines", "no_import")})

    common = ("--cache", place / "cache", "--baseline", place / "baselines", "--out", tmp_path / "out")
    return lambda *arguments, at=place / "small.toml": run("check", at, *common, *arguments)


def test_the_command_passes_and_writes_json_and_junit(shell, tmp_path):
    status, out, _ = shell("--instrument", "pipelines:sound")
    assert status == 0
    assert "passed" in out
    result = json.loads((tmp_path / "out" / "check.json").read_text())
    assert result["status"] == "passed"
    assert result["metrics"]["swing"]["detection.recall"] == 1.0
    cases = ElementTree.parse(tmp_path / "out" / "junit.xml").findall(".//testcase")
    assert len(cases) == len(result["verdicts"])
    assert {c.get("classname") for c in cases} == {"simgrab.small", "simgrab.small.swing"}
    assert {c.get("time") for c in cases if c.get("classname") == "simgrab.small"} == {"0.000"}
    of_scene = [float(c.get("time")) for c in cases if c.get("classname") == "simgrab.small.swing"]
    assert sum(of_scene) == pytest.approx(result["seconds"]["swing"], abs=0.001 * len(of_scene))
    assert min(of_scene) > 0
    assert ElementTree.parse(tmp_path / "out" / "junit.xml").find(".//property").get("value") == "check.html"
    assert "<h1>Suite “small”: passed</h1>" in (tmp_path / "out" / "check.html").read_text()


def test_with_quiet_notes_alone_are_printed_on_stderr(shell, tmp_path):
    record = ("--update-baseline", "--seeds", 1, "--baseline", tmp_path / "new", "--quiet")
    status, out, said = shell("--instrument", "pipelines:sound", *record)
    assert (status, out) == (0, "")
    first, *others = said.splitlines()
    assert first == f"recorded over 1 seed in {tmp_path / 'new'}"
    assert all(": warning: " in line for line in others)


def test_what_few_seeds_allow_is_said(place, tmp_path):
    small = suite.load(place / "small.toml")
    result = gate.record(small, options(place, sound, baseline=tmp_path), seeds=2)
    warning, ranges = result.of_suite[1:]
    least, most = sorted(baseline.load(tmp_path).scenes["swing"].metrics["angle.overall.rmse_deg"])
    assert ranges.startswith("swing: over these seeds: detection.centre.median_px ")
    assert f", angle.overall.rmse_deg {least:.4g} to {most:.4g}, " in ranges
    allowed = "a figure may be worse than its mean by 1949 standard deviations"
    assert warning.startswith(f"warning: on other frames {allowed}")
    later = check(place, baseline=tmp_path, seed=2)
    (warning,) = later.of_suite
    assert warning.startswith(f"warning: on other frames than those recorded, as here, {allowed}")
    assert warning in ElementTree.fromstring(report.as_junit(later)).findtext(".//system-out")
    assert warning in html.unescape(page.page(later))
    assert not check(place, baseline=tmp_path, seed=1).of_suite  # which was recorded
    (note,) = gate._of_other_frames(10, small, others=True)
    assert note.startswith(
        "on other frames than those recorded, as here, a figure may be worse than its mean by 6 stan"
    )
    assert not gate._of_other_frames(10, small)


@pytest.mark.parametrize("flaw", [{"sead": 1}, {"baseline": "small.toml"}])
def test_no_result_of_an_earlier_check_remains_after_status_2(shell, tmp_path, flaw):
    written = {"check.html", "check.json", "junit.xml"}
    assert shell("--instrument", "pipelines:sound")[0] == 0
    assert {path.name for path in (tmp_path / "out").iterdir()} == written
    assert shell("--baseline", tmp_path / "none", at=write(tmp_path, **flaw))[0] == 2
    assert not list((tmp_path / "out").iterdir())


@pytest.mark.usefixtures("shell")
def test_no_result_remains_in_the_default_folder_of_a_suite_that_cannot_be_read(tmp_path):
    kept = tmp_path / "port.toml"
    write(tmp_path).rename(kept)
    assert run("check", kept, "--instrument", "pipelines:fails")[0] == 1
    assert (tmp_path / "runs" / "check-port" / "check.html").exists()
    kept.write_text("name = ")
    assert run("check", kept, "--instrument", "pipelines:fails")[0] == 2
    assert not list(tmp_path.glob("runs/*/*"))


@pytest.mark.parametrize("result", [None, "{", "[]", '{"pictures": []}'])
def test_files_that_no_check_wrote_remain(shell, tmp_path, result):
    (tmp_path / "out").mkdir()
    texts = {"check.html": "mine", "junit.xml": "<testsuites/>"} | ({} if result is None else {"check.json": result})
    for name, text in texts.items():
        (tmp_path / "out" / name).write_text(text)
    assert shell(at="no-such-suite")[0] == 2
    assert {path.name: path.read_text() for path in (tmp_path / "out").iterdir()} == texts


def test_the_command_fails_with_status_1(shell, tmp_path):
    status, out, _ = shell("--instrument", "pipelines:shifted")
    assert status == 1
    assert "worse than the baseline" in out
    root = ElementTree.parse(tmp_path / "out" / "junit.xml").getroot()
    failures = root.findall(".//failure")
    assert len(failures) == int(root.find("testsuite").get("failures")) > 0
    assert "worse than the baseline" in failures[0].get("message")
    (why,) = (line for line in out.splitlines() if line.startswith("swing: On average the measured centre lies"))
    assert all(one.get("message").endswith(why.removeprefix("swing: ")) for one in failures)
    assert why.removeprefix("swing: ") in (tmp_path / "out" / "check.html").read_text()


@pytest.mark.parametrize(
    ("name", "cause"),
    [
        ("pipelines:fails", "RuntimeError: no model file"),
        ("pipelines:NoName", "has no name"),
        ("pipelines:nothing", "AttributeError"),
        ("no_import:any", "No module named 'nothing_of_that_name'"),
        ("no_such_module:any", "No module named 'no_such_module'; searched: "),
        ("no_such_module.x:any", f", the packages of {sys.prefix}"),
        ("simgrab.no_such_module:any", "No module named 'simgrab.no_such_module'; searched: "),
        ("no_such_module.y:any", f" {Path.cwd()}, "),
        ("no_such_module:x", "no_such_module:x: cannot be imported"),  # to rich, ":x:" is an emoji
        ("pipelines", "package.module:factory"),
    ],
)
def test_an_instrument_that_cannot_be_had_is_a_failure(shell, tmp_path, name, cause):
    status, out, _ = shell("--instrument", name, "--quiet")
    assert status == 1
    assert cause in out
    assert json.loads((tmp_path / "out" / "check.json").read_text())["status"] == "failed"


def test_a_broken_suite_is_an_error_and_leaves_nothing(shell, tmp_path):
    bad = write(tmp_path, limts={})
    assert "limts: unknown key (did you mean 'limits'" in shell("--instrument", "pipelines:sound", at=bad)[2]
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("terminal", [True, False])
def test_names_of_figures_are_whole_in_a_log_of_80_columns(terminal, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("FORCE_COLOR" if terminal else "NO_COLOR", "1")
    names = ["reading.frames_refused.value", "detection.centre.box_radial_mean_px", "angle.by_rope.15 to 20 m.rmse_deg"]
    found = [
        report.Verdict(scene="night-light-snow", what=name, status="passed", value=0.1234, limit="≥ -0.4, ≤ 0.4",
                       reference=0.2, allowed=0.1, frames="12 of 16 frames")
        for name in names
    ]  # fmt: skip
    table.show(report.Report("s", "i", 0, tuple(found)))
    out = capsys.readouterr().out
    assert all(name in out for name in names)
    assert terminal or "0.1234 (12 of 16 frames)" in out  # a log has no width
    assert out.count("passed") == len(names) + 2
    assert "…" not in out


def test_a_cause_that_most_failed_scenes_have_in_common_is_stated_once(capsys):
    def scene(name, *causes, status="failed"):
        outcome = report.Outcome((report.Verdict(scene=name, what="frames.ok", status=status, message="x"),), {}, 0.0)
        outcome.__dict__["found"] = causes  # as they are cached
        return outcome

    def whole(**scenes):
        return report.Report("s", "i", 0, scenes={name: scene(name, *found) for name, found in scenes.items()})

    late, length = "{{Rope}} lengths are {:.2f} s late", "Rope lengths are 1.1 times the true ones"
    own = Cause("3 of 9 frames have no angle: missed (no box, or {none}) in 3.")
    found = {"a": [Cause("A.", (late.format(1.5),)), own], "b": [Cause("B.", (late.format(-0.75),)), own]}
    found |= {"c": [Cause("C.", (length, late.format(1.5)))], "d": [own]}
    every = whole(**found)
    every.scenes["e"] = scene("e", status="passed")
    common = "In 3 of 4 scenes that failed (a, b, c): {Rope} lengths are -0.75 to 1.50 s late."
    assert list(every.common) == json.loads(report.as_json(every))["common_causes"] == [common]
    assert page.page(every).count(common) == 1
    table.show(every)
    assert common in capsys.readouterr().out
    assert not list(whole(**{name: found[name] for name in "ad"}).common)
    alone, either = Cause("A.", ("the roll is -3°",)), Cause("B.", ("the roll is 4°", "the tilt is 1°"))
    assert [*whole(a=[alone], b=[either], c=[], d=[either]).common] == [
        "In 3 of 4 scenes that failed (a, b, d): the roll is -3 to 4°."
    ]
    assert [text.partition(": ")[2] for text in whole(a=[either], b=[either]).common] == [
        "the roll is 4°.",
        "the tilt is 1°.",
    ]


def test_a_report_takes_away_its_own_pictures_alone(tmp_path):
    picture = np.zeros((4, 12, 3), np.uint8)
    save = functools.partial(report.save, out=tmp_path, page="")
    save(report.Report("s", "i", 0, scenes={"a": report.Outcome((), {}, 0.0, {"a-000000.png": picture})}))
    (tmp_path / "golden" / "baseline.json").write_text("{}")
    save(report.Report("s", "i", 0))
    assert [path.name for path in (tmp_path / "golden").iterdir()] == ["baseline.json"]
