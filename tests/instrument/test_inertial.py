"""Pictures and an inertial sensor: preintegration, the camera's motion, α with a levelled camera, bad files."""

import dataclasses
import json
import re
from functools import cache

import numpy as np
import pytest
import swinging
from click.testing import CliRunner
from swinging import nobody

import simgrab
from simgrab.cli.estimate import command
from simgrab.dataset.sensor_files import describe
from simgrab.errors import RecordError, RunError
from simgrab.instrument.contract import Frame
from simgrab.instrument.estimate import PendulumSmoother, RopeAware, pendulum_smoother
from simgrab.instrument.estimate.inertial import live
from simgrab.instrument.estimate.inertial.live import InertialTracker
from simgrab.instrument.estimate.inertial.preintegration import preintegrate, rotation, rotation_vector
from simgrab.instrument.estimate.inertial.readings import STAMP, ImuReadings, read_imu
from simgrab.instrument.estimate.inertial.sensed import sensed
from simgrab.instrument.pipeline import Pipeline, assemble
from simgrab.instrument.run.run import run
from simgrab.model import scenes
from simgrab.model.geometry import camera_rotation, rotation_z, to_camera
from simgrab.world.trajectory.trajectory import Trajectory

LEVELLED = {"camera.mount": {"model": "levelled"}}
FRAMES = 700  # 78 s: a whole working cycle


def scenario(noise="mems"):
    return scenes.load("work-cycles", {
        "display.layout": "two-by-four", "frames": FRAMES, "seed": 100, **LEVELLED,
        "sensors.imu0": {"model": "imu", "mount": "camera", "noise": noise},
    })  # fmt: skip


@cache
def recording(noise):
    return simgrab.sensors(scenario(noise))["imu0"]


def readings(noise="mems"):
    got = recording(noise)
    return ImuReadings(got.stamp_ns / 1e9, got.values[:, :3], got.values[:, 3:], np.eye(3))


@pytest.fixture(scope="module")
def crane():
    return swinging.record(fixed=False, frames=FRAMES, seed=100, camera__mount={"model": "levelled"})


def estimated(crane, imu, pixels=None, wander_px=0.0):
    noisy = crane.pixels + np.random.default_rng(3).normal(0, 1.5, crane.pixels.shape) if pixels is None else pixels
    estimator = PendulumSmoother(imu=imu, wander_px=wander_px)
    return estimator.estimate(noisy, crane.calibration, rope_length=crane.rope, time=crane.time)


def beginning(crane, frames):
    """Return the record's first frames."""
    first = {name: getattr(crane, name)[:frames] for name in ("time", "pixels", "rope", "alpha")}
    return dataclasses.replace(crane, **first)


def test_rotations_and_their_vectors_are_inverse():
    vectors = np.random.default_rng(0).normal(0, 0.8, (200, 3))
    vectors *= np.minimum(1, 3.1 / np.linalg.norm(vectors, axis=1))[:, None]
    vectors[:3] = [[0, 0, 0], [1e-9, 0, 0], [0, 3.1, 0]]
    turns = rotation(vectors)
    assert np.allclose(turns @ turns.swapaxes(1, 2), np.eye(3), atol=1e-12)
    assert np.allclose(rotation_vector(turns), vectors, atol=1e-9)
    assert np.allclose(rotation(np.array([0, 0, 0.7])), rotation_z(0.7), atol=1e-12)


def test_readings_are_summed_between_nodes_that_lie_anywhere():
    time = np.arange(0, 3, 0.005)
    rate, force = np.tile([0.1, -0.2, 0.5], (600, 1)), np.tile([0.3, 0.1, 9.8], (600, 1))
    imu = ImuReadings(time, rate, force, np.eye(3))
    nodes = np.array([0.0013, 0.5, 0.5021, 2.9])
    found = preintegrate(nodes, imu, np.eye(3))
    assert np.allclose(found.turn, rotation(rate[:3] * np.diff(nodes)[:, None]), atol=1e-12)
    assert np.allclose(found.rate, rate[:3], atol=1e-12)
    # The mean force in the first node's frame: of a frame that turns steadily, an integral in closed form.
    fine = np.linspace(0, np.diff(nodes)[2], 20001)
    mean = np.trapezoid(rotation(rate[0] * fine[:, None]) @ force[0], fine, axis=0) / fine[-1]
    assert np.allclose(found.force[2], mean, atol=1e-5)


@pytest.mark.parametrize("noise", ["none", "mems"])
def test_a_sensor_tells_how_the_jib_head_moves_and_but_for_a_constant_how_the_camera_leans(crane, noise):
    story = Trajectory(scenario(noise))
    turn = np.array([story.at(frame).tilt.jib_from_camera for frame in range(FRAMES)])
    leans = -(turn @ camera_rotation(0.0, 0.0, 0.0).T)[:, :2, 2]
    (slew, radius), steps = crane.jib.T, np.diff(crane.time)
    head = radius[:, None] * np.stack([np.cos(slew - slew[0]), np.sin(slew - slew[0])], axis=-1)
    acceleration = np.diff(np.gradient(head, crane.time, axis=0), axis=0) / steps[:, None]
    motion = sensed(readings(noise), crane.calibration).motion
    off = motion.at(crane.time)[:, 4:] - leans
    assert np.degrees(leans.std(axis=0)).max() > 0.5
    assert np.degrees(off.std(axis=0)).max() < 0.04
    assert np.degrees(np.abs(off.mean(axis=0))).max() < (0.05 if noise == "none" else 3)
    assert acceleration.std(axis=0).max() > 0.1
    assert (motion.acceleration(crane.time) - acceleration).std(axis=0).max() < 0.03


def test_a_levelled_camera_needs_the_sensor(crane):
    found = estimated(crane, readings())
    blind = RopeAware().estimate(crane.pixels, crane.calibration, rope_length=crane.rope, time=crane.time)
    low, high = found.intervals[0].alpha.T
    assert crane.rms_deg(blind) > 0.5
    assert found.status == "ok"
    assert crane.rms_deg(found) < 0.2
    assert crane.covered(found) > 0.9
    assert np.degrees(np.median(high - low)) < 2
    assert found.diagnostics["noise_px"] == pytest.approx(1.4, abs=0.3)
    assert abs(np.degrees(found.beta) - np.degrees(crane.beta.mean())) < 0.5


def test_a_detectors_lasting_errors_are_estimated_beside_the_sensors(crane):
    without, found = (estimated(crane, readings(), crane.wandering(), wander) for wander in (0.0, 4.0))
    assert crane.covered(found) > 0.9
    assert crane.rms_deg(found) < 0.75 * crane.rms_deg(without)


def on_ropes(level_head_m, crane):
    """A record of 90 s below a jib head that starts and stops, on ropes whose head stays level."""
    ropes, step, seconds = 16.0, 0.005, 90.0
    time = np.arange(0, seconds, step)
    pulses = np.round(np.sin(2 * np.pi * time / np.array([[23.0], [31.0]])) * 0.9)
    a = 0.25 * pulses * np.array([[1.0], [0.6]])
    # The head moves as a point mass on the ropes: x'' = −g x/√(l² − x²), and against the jib head, in a plane each.
    x, velocity, path = np.array([1.0, 0.3]), np.zeros(2), np.empty((len(time), 2))
    for i, push in enumerate(a.T):
        path[i] = x
        velocity = velocity + step * (-9.80665 * x / ropes - push)
        x = x + step * velocity
    down = -np.sqrt(ropes**2 - np.sum(path**2, axis=1)) - level_head_m
    force = np.column_stack([a.T, np.full(len(time), 9.80665)])
    frames = slice(None, -20, 20)
    grab = np.column_stack([path, down])[frames]
    straight = camera_rotation(0.0, 0.0, 0.0)
    rng = np.random.default_rng(4)
    imu = ImuReadings(
        time, rng.normal(0, 1e-3, force.shape), force @ straight + rng.normal(0, 0.02, force.shape), np.eye(3)
    )
    camera = crane.calibration
    pixels = camera.intrinsics.project(to_camera(grab, np.tile(straight, (len(grab), 1, 1)), camera.offset_m))
    rope = np.linalg.norm(grab, axis=1)
    record = dataclasses.replace(
        crane, time=time[frames], pixels=pixels, rope=rope, alpha=np.arccos(-grab[:, 2] / rope)
    )
    return record, imu


@pytest.mark.parametrize("level_head_m", [0.0, 1.6])
def test_ropes_that_lean_more_than_the_grab_swing_faster_and_show_less(crane, level_head_m):
    record, imu = on_ropes(level_head_m, crane)
    found = estimated(record, imu)
    assert found.status == "ok"
    assert found.diagnostics["reach_m"] == pytest.approx(-level_head_m, abs=0.2)
    assert found.diagnostics["reach_m"] < 1e-9
    assert found.diagnostics["reach_m"] + found.diagnostics["longer_m"] == pytest.approx(-level_head_m, abs=0.15)
    assert record.rms_deg(found) < 0.1
    assert record.covered(found) > 0.9


def test_missing_frames_and_outliers(crane):
    rng = np.random.default_rng(1)
    pixels = crane.pixels + rng.normal(0, 1.5, crane.pixels.shape)
    pixels[rng.random(FRAMES) < 0.1] += 200
    pixels[300:360] = np.nan
    pixels[::4] = np.nan
    found = estimated(crane, readings(), pixels)
    assert found.frames == np.isfinite(pixels).all(axis=1).sum()
    seen = np.isfinite(pixels).all(axis=1)
    error = np.degrees(found.alpha - crane.alpha)[seen]
    assert np.sqrt(np.mean(error**2)) < 0.25


def heard(imu, kept, **changes):
    """Readings some of which are lost."""
    columns = {name: changes.get(name, getattr(imu, name))[kept] for name in ("time", "rate", "force")}
    return dataclasses.replace(imu, **columns)


def silent_from_the_start(imu):
    return heard(imu, (imu.time < 0.05) | (imu.time > 5), time=np.where(imu.time < 0.05, imu.time - 10, imu.time))


REFUSED = {
    "does not turn": (lambda imu: dataclasses.replace(imu, rate=0 * imu.rate), "the pictures contradict the sensor"),
    "starts late": (lambda imu: dataclasses.replace(imu, time=imu.time + 5), "last from 5"),
    "falls silent": (lambda imu: heard(imu, (imu.time < 30) | (imu.time > 31)), "silent for 1.0"),
    "is silent across the start": (silent_from_the_start, "silent for"),
    "reports g": (lambda imu: dataclasses.replace(imu, force=imu.force / 9.81), "is the accelerometer in m/s²?"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_a_sensor_that_cannot_be_used_is_refused(what, crane):
    change, reason = REFUSED[what]
    assert reason in estimated(beginning(crane, 350), change(readings())).reason


def test_frames_far_apart_are_estimated_on_either_side(crane, monkeypatch):
    monkeypatch.setattr(pendulum_smoother, "CUT_S", 5.0)
    kept = np.r_[:300, 360:FRAMES]
    parts = {name: getattr(crane, name)[kept] for name in ("time", "pixels", "rope", "alpha")}
    apart = dataclasses.replace(crane, **parts)
    found = estimated(apart, readings())
    assert found.status == "ok", found.reason
    assert apart.rms_deg(found) < 0.2
    assert apart.covered(found) > 0.9


def test_a_short_record_and_frames_that_hardly_differ_in_time_are_estimated_or_refused(crane):
    short = beginning(crane, 25)
    for time in (short.time, short.time * 1e-4):
        found = estimated(dataclasses.replace(short, time=time), readings(), short.pixels)
        assert found.status == "ok" or found.reason


def test_a_sensor_belongs_to_one_record(crane):
    two = np.stack([crane.pixels] * 2)
    with pytest.raises(RecordError, match="one record at a time"):
        PendulumSmoother(imu=readings()).batch(two, crane.calibration, rope_length=crane.rope, time=crane.time)


@pytest.fixture
def folder(tmp_path):
    got, about = recording("mems"), scenario().sensors["imu0"]
    (tmp_path / "sensor.yaml").write_text(describe(about, got.body_from_sensor, 0.0), encoding="utf-8")
    rows = "\n".join(
        f"{stamp},{','.join(map(repr, row))}" for stamp, row in zip(got.stamp_ns, got.values.tolist(), strict=True)
    )
    (tmp_path / "data.csv").write_text(",".join([STAMP, *got.columns]) + "\n" + rows + "\n", encoding="utf-8")
    return tmp_path


def test_files_are_read_as_they_were_recorded(folder):
    found, expected = read_imu(folder), readings()
    for name in ("time", "rate", "force", "camera_from_sensor"):
        assert np.array_equal(getattr(found, name), getattr(expected, name))
    errors = scenario().sensors["imu0"].errors
    assert found.gyroscope_noise_density == errors.gyroscope_noise_density
    assert found.accelerometer_random_walk == errors.accelerometer_random_walk


def lines(count, change):
    def broken(folder):
        text = (folder / "data.csv").read_text(encoding="utf-8").splitlines()[:count]
        (folder / "data.csv").write_text("\n".join(change(text)) + "\n", encoding="utf-8")

    return broken


def swapped(text):
    return [*text[:5], text[7], text[6], text[5], *text[8:]]


def described(old, new):
    def broken(folder):
        text = (folder / "sensor.yaml").read_text(encoding="utf-8")
        assert old in text
        (folder / "sensor.yaml").write_text(text.replace(old, new), encoding="utf-8")

    return broken


BROKEN = {
    "no readings": (lambda folder: (folder / "data.csv").unlink(), "data.csv: No such file"),
    "no description": (lambda folder: (folder / "sensor.yaml").unlink(), "sensor.yaml: No such file"),
    "a clock that jumps back": (lines(20, swapped), "row 6: must increase"),
    "NaN": (lines(20, lambda t: [*t[:4], t[4].rpartition(",")[0] + ",nan", *t[5:]]), "row 4"),
    "a value that is no reading": (lines(20, lambda t: [*t[:4], t[4].rpartition(",")[0] + ",1e9", *t[5:]]), "row 4"),
    "words": (lines(20, lambda t: [*t[:4], t[4].rpartition(",")[0] + ",fast", *t[5:]]), "not a number"),
    "a column less": (lines(20, lambda t: [row.rpartition(",")[0] for row in t]), "is missing"),
    "a row cut short": (lines(20, lambda t: [*t[:4], t[4][:30], *t[5:]]), "not valid CSV"),
    "one row": (lines(2, lambda t: t), "1 rows; at least 2"),
    "nothing": (lines(0, lambda _t: []), "data.csv"),
    "an encoder": (described("sensor_type: imu", "sensor_type: encoder"), "an imu is needed"),
    "no pose": (described("T_BS:", "pose:"), "T_BS is missing"),
    "a pose of words": (described("data: [1.0", "data: [one"), "16 numbers"),
    "a pose that is no rotation": (described("data: [1.0", "data: [2.0"), "rotation matrix"),
    "a negative density": (described("gyroscope_noise_density: ", "gyroscope_noise_density: -"), "0 or more"),
    "a list": (lambda folder: (folder / "sensor.yaml").write_text("- 1\n"), "T_BS is missing"),
    "no YAML": (lambda folder: (folder / "sensor.yaml").write_text("{[}"), "not valid YAML"),
    "code": (lambda folder: (folder / "sensor.yaml").write_text("!!python/name:os.getcwd"), "not valid YAML"),
    "brackets": (lambda folder: (folder / "sensor.yaml").write_text("[" * 60_000), "not valid YAML"),
    "a tag that does not fit": (lambda folder: (folder / "sensor.yaml").write_text("a: !!bool x"), "not valid YAML"),
}  # fmt: skip


@pytest.mark.parametrize("what", list(BROKEN))
def test_bad_files_are_one_line(folder, what):
    spoil, message = BROKEN[what]
    spoil(folder)
    with pytest.raises(RecordError) as caught:
        read_imu(folder)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_estimate_and_run_take_the_folder(crane, folder, tmp_path):
    (tmp_path / "camera.toml").write_text(crane.calibration.to_toml(), encoding="utf-8")
    few = beginning(crane, 300)
    rows = [
        f"{t!r},{u!r},{v!r},{r!r}"
        for t, (u, v), r in zip(few.time.tolist(), few.pixels.tolist(), few.rope.tolist(), strict=True)
    ]
    (tmp_path / "record.csv").write_text("time_s,u_px,v_px,rope_length_m\n" + "\n".join(rows) + "\n", encoding="utf-8")
    call = [str(tmp_path / "record.csv"), "--camera", str(tmp_path / "camera.toml"), "--imu", str(folder)]
    done = CliRunner().invoke(command, [*call, "--json"])
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["estimator"] == "pendulum-smoother"
    refused = CliRunner().invoke(command, [*call, "--estimator", "mean-ray"])
    assert refused.exit_code == 2
    assert "--imu selects its own estimator" in refused.output
    assert assemble(imu=folder).estimator.name == "pendulum-smoother"
    with pytest.raises(RunError, match="leave out estimator and calibration"):
        assemble(imu=folder, estimator="mean-ray")


def test_frame_by_frame_from_the_first_minute_on(crane):
    """The sensor falls silent at the end: until then its readings are there, and from then on there is no swing."""
    imu, noisy = readings(), crane.pixels + np.random.default_rng(3).normal(0, 1.5, crane.pixels.shape)
    cut = np.searchsorted(imu.time, crane.time[-1] - 0.5)
    tracker = InertialTracker(PendulumSmoother(imu=heard(imu, slice(cut))), crane.calibration)
    rows = zip(crane.time.tolist(), noisy.tolist(), crane.rope.tolist(), strict=True)
    found = [tracker.step(time, None if 600 < i < 605 else (u, v), rope) for i, (time, (u, v), rope) in enumerate(rows)]
    alpha, ends = np.array([one[0] for one in found]), np.array([one[1] for one in found])
    seen = np.isfinite(alpha)
    assert not seen[:540].any()
    assert seen[550:601].all()
    assert not seen[601:605].any()
    assert seen[605 : FRAMES - 8].all()
    assert not seen[-1]
    assert "the sensor's readings last" in tracker.waiting or "no tilt yet" in tracker.waiting
    assert np.degrees(np.sqrt(np.mean((alpha - crane.alpha)[seen] ** 2))) < 0.3
    assert np.mean((ends[seen, 0] <= crane.alpha[seen]) & (crane.alpha[seen] <= ends[seen, 1])) > 0.85


def test_a_run_starts_again_where_pixels_move_as_no_grab_can(crane, monkeypatch):
    monkeypatch.setattr(live, "LOST_S", 3.0)
    tracker = InertialTracker(PendulumSmoother(imu=readings()), crane.calibration)
    wrong = np.where(np.arange(FRAMES)[:, None] < 560, 0.0, np.random.default_rng(5).uniform(-400, 400, (FRAMES, 2)))
    rows = zip(crane.time.tolist(), (crane.pixels + wrong).tolist(), crane.rope.tolist(), strict=True)
    found = np.array([tracker.step(time, (u, v), rope)[0] for time, (u, v), rope in rows])
    assert np.isfinite(found[545:560]).all()
    assert np.isnan(found[620:]).all()
    assert "for 3 s hardly a pixel agreed with the sensor" in tracker.waiting


def test_a_run_starts_again_after_a_pause_and_goes_on_while_the_grab_is_out_of_sight(crane, monkeypatch):
    monkeypatch.setattr(live, "PAUSE_S", 5.0)
    imu = readings()
    for paused in (True, False):
        tracker, found = InertialTracker(PendulumSmoother(imu=imu), crane.calibration), []
        for i, (time, (u, v), rope) in enumerate(zip(crane.time, crane.pixels, crane.rope, strict=True)):
            away = 560 <= i < 620
            found += [] if away and paused else [tracker.step(float(time), None if away else (u, v), float(rope))[0]]
        assert np.isfinite(found[545:560]).all()
        assert np.isnan(found[-80:]).all() == paused
        assert ("no frame for 6.8 s" in tracker.waiting) == paused


def test_a_record_that_gives_no_start_neither_grows_nor_hides_the_reason(crane):
    tracker = InertialTracker(PendulumSmoother(imu=readings()), crane.calibration)  # which last for 78 s
    for second in range(600):
        assert np.isnan(tracker.step(300.0 + second, (900.0, 500.0), 20.0)[0])
        kept = float(re.match(r"no tilt yet: (\d+) s", tracker.waiting)[1])
        assert kept <= live.MOST_S + live.AGAIN_S
        assert second < 60 or "the sensor's readings last from" in tracker.waiting


def test_a_stream_has_no_sensor(crane, tmp_path, monkeypatch):
    class Endless:
        live = True

    monkeypatch.setattr("simgrab.instrument.run.run.open_source", lambda *_args, **_kwargs: Endless())
    pipeline = Pipeline(nobody, None, PendulumSmoother(imu=readings()))
    with pytest.raises(RunError, match="a stream cannot be used"):
        run("rtsp://camera/1", crane.calibration, tmp_path / "run", pipeline)
    assert not (tmp_path / "run").exists()


def test_a_sensor_without_a_display_is_refused(crane):
    pipeline = Pipeline(nobody, None, PendulumSmoother(imu=readings()))
    with pytest.raises(RunError, match="needs the rope's length"):
        next(pipeline.live(iter([Frame(np.zeros((2, 2, 3), np.uint8), 0.0)]), crane.calibration))
