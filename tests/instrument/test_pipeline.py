"""The pipeline: two phases, what is carried when something is lost, and the same angles live."""

import dataclasses
import math
import re

import msgspec
import numpy as np
import pytest
import swinging
from scipy.interpolate import CubicSpline
from swinging import Feed, nobody

from simgrab.errors import CalibrationError, RecordError, RunError
from simgrab.instrument import angles
from simgrab.instrument import pipeline as rooms
from simgrab.instrument.contract import Frame
from simgrab.instrument.controller import Controller
from simgrab.instrument.estimate import ESTIMATORS, IntervalSettings, MeanRay, PendulumSmoother, RopeAware
from simgrab.instrument.estimate.follow import Known, follow, known, load
from simgrab.instrument.estimate.intervals import WORKING
from simgrab.instrument.forecast import MIDDLES_S, Forecast, Forecaster
from simgrab.instrument.pipeline import Pipeline
from simgrab.instrument.read import Reader
from simgrab.instrument.rope import rope
from simgrab.instrument.run.assumed import assumptions
from simgrab.instrument.run.subject import open_instrument
from simgrab.model import scenes
from simgrab.model.calibration import Calibration
from simgrab.model.records.observations import Detection, Reading
from simgrab.world.trajectory.trajectory import Trajectory
from tests.instrument.test_controller_fusion import controller

FRAMES = 900


@pytest.fixture
def forecasts():
    """Forecast as users' pipelines do."""


@pytest.fixture(autouse=True)
def without_forecasts(request, monkeypatch):
    """Leave forecasts out, which take most of the time, where a test does not ask for them."""
    if "forecasts" not in request.fixturenames:
        monkeypatch.setattr(angles, "forecasts", lambda *_: None)


@pytest.fixture(scope="module")
def crane():
    return swinging.record(frames=FRAMES)


def degrees(measurements):
    return np.degrees([np.nan if m.alpha is None else m.alpha for m in measurements])


def made(**settings):
    return Pipeline(**({"detector": nobody, "reader": Reader()} | settings))


def rms(error):
    return float(np.sqrt(np.nanmean(error**2)))


def test_the_default_estimator_takes_the_offset_into_account(crane):
    truth = np.degrees(crane.alpha)
    observations = crane.observations(1.5)
    chosen = made().conclude(observations, crane.calibration)
    assert chosen.estimate.estimator == "rope-aware"
    assert rms(degrees(chosen.measurements) - truth) < 0.15
    blind = made(estimator=MeanRay()).conclude(observations, crane.calibration)
    assert rms(degrees(blind.measurements) - truth) > 0.4


@pytest.mark.usefixtures("forecasts")
def test_without_a_display_the_default_does_without_the_rope(crane):
    camera = msgspec.structs.replace(crane.calibration, digit_layout=None)
    assert made().conclude(crane.observations(), camera).estimate.estimator == "mean-ray"
    assert made(reader=None).conclude(crane.observations(), crane.calibration).estimate.estimator == "mean-ray"
    with pytest.raises(RunError, match="rope-aware needs the rope's length"):
        made(estimator=RopeAware()).conclude(crane.observations(), camera)


@pytest.mark.parametrize("name", [name for name in ESTIMATORS if name != "pendulum-smoother"])
def test_a_known_tilt_gives_the_angles_and_intervals_of_its_estimate(crane, name):
    n, rng = len(crane.rope), np.random.default_rng(0)
    pixels, sd = crane.pixels.copy(), rng.uniform(0.5, 4, n)
    pixels[7] = np.nan
    camera = msgspec.structs.replace(crane.calibration, k1=-0.1, roll_deg=20.0)
    found = ESTIMATORS[name]().estimate(pixels, camera, rope_length=crane.rope, pixel_sd=sd)
    alpha, ends, _ = follow(known(found, camera), pixels, camera, rope_length=crane.rope, pixel_sd=sd)
    np.testing.assert_allclose(alpha, found.alpha, atol=1e-8)
    # Student's quantile for 900 frames, by which the estimate scales the noise too, is 0.1 % beyond the normal one.
    np.testing.assert_allclose(ends, found.interval("iid").alpha, atol=2e-5)


def test_frames_to_come_are_as_uncertain_as_a_few_blocks_were(crane):
    estimator = MeanRay(intervals=IntervalSettings(block_s=30.0))
    found = estimator.estimate(crane.pixels, crane.calibration, time=crane.time)
    assert found.interval("blocks").blocks == 3
    _, ends, _ = follow(known(found, crane.calibration), crane.pixels, crane.calibration)
    np.testing.assert_allclose(ends, found.interval("blocks").alpha, atol=1e-9)
    assert np.ptp(ends, axis=-1).mean() > 2 * np.ptp(found.interval("iid").alpha, axis=-1).mean()


def test_the_detectors_noise_widens_its_frames_intervals_and_no_others(crane):
    sd = np.zeros(len(crane.rope))
    largest = int(crane.alpha.argmax())
    sd[largest] = 10.0
    without = RopeAware().estimate(crane.pixels, crane.calibration, rope_length=crane.rope)
    given = RopeAware().estimate(crane.pixels, crane.calibration, rope_length=crane.rope, pixel_sd=sd)
    width, before = (np.ptp(e.interval("iid").alpha, axis=-1) for e in (given, without))
    others = np.arange(len(sd)) != largest
    np.testing.assert_array_equal(width[others], before[others])
    noise = 2 * 1.96 * 10 / crane.calibration.focal_length_px
    assert width[largest] == pytest.approx(np.hypot(before[largest], noise), rel=0.05)
    with pytest.raises(RecordError, match=r"pixel_sd, row 3"):
        RopeAware().estimate(crane.pixels, crane.calibration, rope_length=crane.rope, pixel_sd=np.where(sd == 0, [
            -1.0 if i == 3 else 1.0 for i in range(len(sd))], 1.0))  # fmt: skip


def test_a_first_stretch_calibrates_what_comes_after(crane):
    truth, observations = np.degrees(crane.alpha), crane.observations(1.5)
    first = made(calibrate_s=60.0).conclude(observations, crane.calibration)
    assert first.estimate.frames == 540
    assert rms(degrees(first.measurements) - truth) < 0.3
    again = made(tilt=first.tilt).conclude(observations[540:], crane.calibration)
    np.testing.assert_allclose(degrees(again.measurements), degrees(first.measurements)[540:], atol=1e-9)
    assert again.estimate is None


@pytest.mark.usefixtures("forecasts")
def test_what_is_lost_is_carried_with_its_reason(crane):
    observations = crane.observations(1.0)
    nothing = {"box": None, "centre": None, "centre_sd": None}
    for i, changes in {
        10: {"lost": "lost: 0.22 s without a picture", "rope_status": "", "hoist_m": None} | nothing,
        20: {"missed": "nothing found"} | nothing,
        30: {"hoist_m": None, "rope_status": "refused", "rope_reason": "hoist.2 shows no digit"},
        40: {"hoist_m": observations[40].hoist_m + 3.0},
    }.items():
        observations[i] = msgspec.structs.replace(observations[i], **changes)
    for i in range(100, 160):  # longer than can be bridged
        observations[i] = msgspec.structs.replace(
            observations[i], hoist_m=None, rope_status="refused", rope_reason="glare"
        )
    found = made().conclude(observations, crane.calibration).measurements
    assert [found[i].status for i in (10, 20, 30, 40, 130)] == ["lost", "missed", "ok", "ok", "unread"]
    assert found[10].reason == "lost: 0.22 s without a picture"
    assert found[20].reason == "nothing found"
    assert found[130].reason == "glare"
    assert found[40].rope_status == "jump"
    for i in (30, 40):  # the length lies between its neighbours
        assert found[i].rope_length_m == pytest.approx(crane.rope[i], abs=0.1)
    assert sum(m.status == "unread" for m in found) == 60
    assert rms(degrees(found) - np.degrees(crane.alpha)) < 0.2


def test_ropes_are_bridged_no_further_than_stated(crane):
    observations = crane.observations()
    for i in [*range(5), *range(100, 117), *range(200, 220)]:
        observations[i] = msgspec.structs.replace(observations[i], hoist_m=None, rope_status="refused")
    length, _ = rope(observations, crane.calibration)
    assert np.isfinite(length[:117]).all()  # 17 frames leave 18 steps, 2 s
    assert np.abs(length[:117] - crane.rope[:117]).max() < 0.7
    assert np.isnan(length[200:220]).all()


def test_a_record_without_a_grab_is_refused_frame_by_frame(crane):
    observations = [
        msgspec.structs.replace(s, centre=None, box=None, missed="nothing found") for s in crane.observations()
    ]
    found = made().conclude(observations, crane.calibration)
    assert not found.estimate.ok
    assert {m.status for m in found.measurements} == {"missed"}
    few = observations[:-2] + crane.observations()[-2:]
    found = made().conclude(few, crane.calibration)
    assert found.measurements[-1].status == "refused"
    assert "fewer than" in found.measurements[-1].reason
    data = Controller(crane.time, rope=crane.rope)
    for reported in (None, data):
        assert made(controller=reported).conclude([], crane.calibration).measurements == ()


class Scripted:
    """Detector and reader that say what observations say, picture by picture."""

    name = "scripted"

    def __init__(self, observations):
        self.observations, self.at = [s for s in observations if not s.lost], -1

    def __call__(self, _picture):
        self.at += 1
        s = self.observations[self.at]
        if s.centre is None:
            return Detection("none", s.missed, 0.0)
        return Detection("found", "", s.score, np.array(s.box), np.array(s.centre), 0.0, np.ones(4),
                         np.array(s.centre_sd), 0.0)  # fmt: skip

    def read(self, _picture, _layout):
        s = self.observations[self.at]
        hoist, closing = s.rope_text.split()
        ok = s.hoist_m is not None
        return Reading("read" if ok else "refused", "" if ok else s.rope_reason, hoist, closing, s.hoist_m)


def frames_of(observations):
    blank = np.zeros((2, 2, 3), np.uint8)
    return [Frame(None if s.lost else blank, s.time_s, s.lost) for s in observations]


def lives(observations, calibration, **settings):
    """Measure observations frame by frame."""
    said = Scripted(observations)
    pipeline = Pipeline(**({"detector": said, "reader": said} | settings))
    return list(pipeline.live(frames_of(observations), calibration))


def measured_live(observations, calibration):
    return [one.measurement for one in lives(observations, calibration)]


def test_frames_through_detector_and_reader_give_what_their_sightings_give(crane):
    observations = crane.observations(1.0)
    observations[5] = msgspec.structs.replace(observations[5], centre=None, box=None, missed="nothing found")
    said = Scripted(observations)
    by_frames = Pipeline(said, said)(frames_of(observations), crane.calibration)
    by_sightings = made().conclude(observations, crane.calibration).measurements
    np.testing.assert_allclose(degrees(by_frames), degrees(by_sightings))
    assert [m.status for m in by_frames] == [m.status for m in by_sightings]


@pytest.mark.usefixtures("forecasts")
def test_a_live_record_ends_where_the_whole_one_does(crane):
    observations = crane.observations(1.0)
    live = lives(observations, crane.calibration)
    assert live[-1].measurement.warning is not None
    waiting = [one for one in live if one.tilt is None]
    assert len(waiting) == math.ceil(rooms.WARM_UP_S * 9)
    assert all("no tilt yet" in one.measurement.reason for one in waiting)
    found = degrees([one.measurement for one in live])
    whole = degrees(made().conclude(observations, crane.calibration).measurements)
    assert np.abs(found - whole)[-90:].max() < 0.1
    assert rms(found - np.degrees(crane.alpha)) < 0.5


@pytest.mark.parametrize("roll_deg", [0.0, 60.0])
def test_the_direction_of_the_swing_is_that_of_the_grab_from_below_the_rope_exit(roll_deg):
    swings = swinging.record(frames=FRAMES, camera__roll_deg=roll_deg)
    observations = swings.observations()
    live = measured_live(observations, swings.calibration)
    for measured in (live, made().conclude(observations, swings.calibration).measurements):
        found = np.array([np.nan if m.direction is None else m.direction for m in measured])
        some = (swings.alpha > np.radians(3)) & np.isfinite(found)
        assert some.sum() > 100
        assert np.median(np.abs(np.angle(np.exp(1j * (found - swings.direction)[some])))) < np.radians(2)


@pytest.mark.parametrize(("mount", "alone"), [("", True), ("fixed", True), ("levelled", False), ("rigid", False)])
def test_the_direction_is_stated_of_cameras_that_do_not_move_and_with_the_controllers_motion(crane, mount, alone):
    camera, observations = msgspec.structs.replace(crane.calibration, mount=mount), crane.observations()[300:500]
    live = measured_live(observations, camera)[-1:]
    whole, with_motion, smoothed = (
        made(**settings).conclude(observations, camera).measurements
        for settings in (
            {}, {"controller": controller(crane.time, crane.jib + [np.pi / 3, 0.0])}, {"estimator": PendulumSmoother()}
        )
    )  # fmt: skip
    for measured, stated in ((live, alone), (whole, alone), (with_motion, True), (smoothed, alone)):
        assert all((m.direction is not None) == stated for m in measured)
    large = crane.alpha[300:500] > np.radians(3)
    off = np.array([m.direction for m in with_motion])[large] - crane.direction[300:500][large]
    assert large.sum() > 100
    assert np.median(np.abs(np.angle(np.exp(1j * off)))) < np.radians(2)


def test_a_live_record_takes_the_controllers_rope(crane):
    few, camera = crane.observations(1.0)[:200], msgspec.structs.replace(crane.calibration, digit_layout=None)
    data = Controller(crane.time, rope=crane.rope)
    live = lives(few, camera, reader=None, controller=data)
    np.testing.assert_allclose([one.measurement.rope_length_m for one in live], crane.rope[:200])
    assert live[-1].tilt.estimator == "rope-aware"


@pytest.mark.parametrize(("clock_sd_s", "by_display"), [(5.0, True), (0.1, False)])
def test_a_live_record_on_a_clock_that_is_not_known_takes_the_display_while_it_is_read(crane, clock_sd_s, by_display):
    few = crane.observations(1.0)[:200]
    few[150:] = [msgspec.structs.replace(one, rope_status="unread", hoist_m=None) for one in few[150:]]
    data = Controller(crane.time - 4.0, rope=crane.rope + 0.5, clock_sd_s=clock_sd_s)

    def lengths(controller):
        live = lives(few, crane.calibration, controller=controller)
        return np.array([one.measurement.rope_length_m or np.nan for one in live])

    own, display, found = data.rope_at(crane.time[:200]), lengths(None), lengths(data)
    read = np.isfinite(display)
    assert read[:150].all()
    assert not read[-30:].any()
    np.testing.assert_array_equal(found, np.where(read, display, own) if by_display else own)


@pytest.mark.parametrize(("mount", "given", "sign"), [
    ("fixed", "display", 1), ("fixed", "display", -1), ("fixed", "live", -1),
    ("levelled", "controller", 1), ("levelled", "controller", -1),
])  # fmt: skip
def test_a_mirrored_offset_is_named_however_exactly_it_is_stated(mount, given, sign):
    crane = swinging.record(fixed=False, frames=460, seed=301, camera__mount={"model": mount}, camera__offset_x_m=0.4)
    x, y, z = crane.calibration.offset_m
    camera = msgspec.structs.replace(crane.calibration, offset_m=(sign * x, y, z), offset_sd_m=1e-3)
    seen, record = crane.observations(1.0), None
    instrument = made(controller=controller(crane.time, crane.jib) if given == "controller" else None)
    if given == "live":
        tilt = lives(seen, camera)[-1].tilt
    else:
        record = instrument.conclude(seen, camera)
        tilt = record.tilt
    beyond = assumptions(camera, record, tilt, instrument, ())["beyond"]
    assert ("standard deviations of 0.05 m from offset_m" in beyond) == (sign < 0)


@pytest.mark.parametrize(("late_s", "followed"), [(-2.5, True), (0.0, True), (0.0, False), (2.5, False)])
def test_a_live_record_reports_a_controllers_clock_that_is_off_the_displays(crane, late_s, followed):
    data = Controller(crane.time - late_s, rope=crane.rope + 0.1, clock_sd_s=5.0)
    given = {"feed": Feed(dataclasses.replace(data, hold_s=3.0))} if followed else {"controller": data}
    live = lives(crane.observations(1.0)[:720], crane.calibration, **given)
    found = [fault.text for one in live for fault in one.faults if fault.kind == "controller"]
    assert len(found) == bool(late_s)
    if found:  # a display is taken to be 0.5 s late
        off_s, side = re.fullmatch(r"its clock is (\S+) s .*(behind|ahead of) the pictures', .*", found[0]).groups()
        assert float(off_s) == pytest.approx(abs(late_s - 0.5), abs=0.2)
        assert (side == "behind") == (late_s > 0)


@pytest.mark.parametrize(("every_s", "factor", "faults"), [(4.0, 1.0, 0), (4.0, 3.28, 1)])
def test_a_controller_that_writes_seldom_is_on_time_and_one_in_feet_is_reported_once(crane, every_s, factor, faults):
    data = Controller(crane.time - 0.5, rope=factor * crane.rope, clock_sd_s=5.0)
    feed = Feed(dataclasses.replace(data, hold_s=5.0), every_s=every_s)
    live = lives(crane.observations(1.0)[:1800], crane.calibration, feed=feed)
    assert len([fault for one in live for fault in one.faults if fault.kind == "controller"]) == faults
    last = np.array([one.measurement.rope_length_m for one in live[-100:]])
    assert np.abs(last - crane.rope[len(live) - 100 : len(live)]).max() < 6  # those of the display, where they differ


def test_an_estimator_of_another_kind_is_refused():
    class Upright:
        def estimate(self, pixels, calibration, *, rope_length, time): ...

    with pytest.raises(RunError, match=r"^estimator: Upright does not derive from .* in an instrument of your own"):
        made(estimator=Upright())


def test_a_live_record_uses_the_wind_that_the_controller_reports(crane):
    few = crane.observations(1.0)[:200]

    def last(wind_m_s):
        wind = np.array([[0.0, wind_m_s], [60.0, wind_m_s]])
        data = Controller(crane.time, rope=crane.rope, wind=wind)
        return lives(few, crane.calibration, controller=data)[-1]

    calm, windy = (last(wind_m_s).tilt.covariance[0][0] for wind_m_s in (3.0, 12.0))
    lean = [IntervalSettings(wind_m_s=wind_m_s).lean_variance for wind_m_s in (3.0, 12.0)]
    assert windy - calm == pytest.approx(lean[1] - lean[0], rel=0.05)


@pytest.mark.usefixtures("forecasts")
@pytest.mark.parametrize("states_motion", [True, False])
def test_a_live_forecast_uses_the_motion_that_a_controller_reports(crane, monkeypatch, states_motion):
    """From counted readings, ten a second, as they become known; unless a recorded one's clock is not known well."""
    reports, planned, step = [], [], Forecaster.step

    def watched(self, time, swing, sd, rope, *motion):
        reports.extend(one[0] for one in motion[:1])
        planned.extend(one[0] for one in motion[1:])
        return step(self, time, swing, sd, rope, *motion)

    monkeypatch.setattr(Forecaster, "step", watched)
    few, at = crane.observations(1.0)[:300], np.arange(0, 60, 0.1)
    counts = np.array([np.radians(0.1), 0.01])
    slew, radius = (CubicSpline(crane.time, crane.jib)(at) / counts).round().T * counts[:, None]
    data = Controller(at, slew, radius, None, *(counts / np.sqrt(12)).tolist())

    feed = Feed(data, states_rope=False, states_motion=states_motion, latest_s=60.0)
    lives(few, crane.calibration, feed=feed)
    monkeypatch.setattr(angles, "forecast", lambda _, sd: Forecast(*np.full((5, len(sd)), np.nan)))
    if not states_motion:
        assert not reports
        return
    found = np.array([np.full(3, np.nan), *reports])
    assert found.shape == (300, 3)
    assert np.isnan(found[:10]).all()
    true = Trajectory(scenes.load("work-cycles", {"camera.mount": {"model": "fixed"}}))
    felt = np.array([true.at(i).apparent_gravity[:2] for i in range(20, 300)])
    assert np.sqrt(np.mean((found[20:, :2] + felt) ** 2)) < 0.25 * np.abs(felt).max()
    np.testing.assert_allclose(found[20:, 2], np.gradient(crane.jib[:, 0], crane.time)[20:300], atol=0.02)
    assert np.isnan(np.array(planned)).all()
    standing = dataclasses.replace(data, slew=0 * slew, radius=0 * radius + 20.0, slew_setpoint=0 * at)
    feed.data = dataclasses.replace(standing, radius_setpoint=0 * at)
    lives(few, crane.calibration, feed=feed)
    np.testing.assert_allclose(planned[-1], 0, atol=1e-3)
    reports.clear()
    lives(few, crane.calibration, controller=dataclasses.replace(data, clock_sd_s=1.0))
    assert not reports
    late = dataclasses.replace(data, motion_late_s=0.3)
    lives(few, crane.calibration, controller=late)
    until = [data.time <= one - 0.3 for one in crane.time[1:300]]
    known = [dataclasses.replace(data, time=data.time[some], slew=slew[some], radius=radius[some]) for some in until]
    expected = [
        one.jib_motion(now, MIDDLES_S)[0] for one, now in zip(known, crane.time[1:300], strict=True) if len(one.time)
    ]
    np.testing.assert_array_equal(reports[-len(expected) :], expected)


@pytest.mark.usefixtures("forecasts")
def test_a_live_record_carries_what_is_lost(crane):
    observations = crane.observations(1.0)[:400]
    observations[300] = msgspec.structs.replace(observations[300], lost="lost", centre=None, box=None, hoist_m=None)
    observations[310] = msgspec.structs.replace(observations[310], hoist_m=observations[310].hoist_m + 5)
    live = measured_live(observations, crane.calibration)
    assert live[300].status == "lost"
    assert live[310].rope_status == "jump"
    assert live[310].rope_length_m == pytest.approx(crane.rope[310], abs=0.2)
    with pytest.raises(RunError, match="follow each other"):
        list(made().live([Frame(None, None, "-")], crane.calibration))
    with pytest.raises(RunError, match="whole record"):
        list(made(estimator=PendulumSmoother()).live([], crane.calibration))


def test_a_tilt_file_comes_back_and_a_bad_one_is_refused(tmp_path, crane):
    tilt = made().conclude(crane.observations(1.0), crane.calibration).tilt
    path = tmp_path / "tilt.toml"
    path.write_text(tilt.to_toml())
    assert load(path) == tilt
    path.write_text(tilt.to_toml().replace("beta_deg", "bet_deg"))
    with pytest.raises(CalibrationError, match=r"tilt\.toml: bet_deg"):
        load(path)
    with pytest.raises(CalibrationError, match="cannot read"):
        load(tmp_path / "none.toml")
    with pytest.raises(ValueError, match="shape"):
        Known("mean-ray", 5, 1.0, 0.0, (0.0, 0.0, 0.0), ((1.0, 0.0), (0.0, 1.0)))


def test_a_tilt_serves_a_camera_file_that_states_another_roll(crane):
    """Once the roll is known, the picture's directions turn; what the pixels say of α stays."""
    seen = crane.observations(1.0)
    first = made().conclude(seen, crane.calibration)
    found = []
    for by in (0.0, -9.0):
        camera = msgspec.structs.replace(crane.calibration, mount="fixed", roll_deg=crane.calibration.roll_deg + by)
        found.append(made(tilt=first.tilt).conclude(seen, camera))
    np.testing.assert_allclose(degrees(found[1].measurements), degrees(found[0].measurements), atol=1e-9)
    assert found[1].tilt.tilt_azimuth_deg == pytest.approx((first.tilt.tilt_azimuth_deg + 9.0) % 360)
    ways = np.degrees([[m.direction for m in one.measurements] for one in found])
    assert np.abs((ways[1] - ways[0] + 180) % 360 - 180 - 9.0).max() < 1e-9


def test_settings_that_exclude_each_other_are_refused():
    with pytest.raises(RunError, match="combined with a calibration that is given"):
        rooms.assemble(calibrate_s=60.0, tilt="tilt.toml")
    with pytest.raises(RunError, match="live"):
        rooms.assemble(calibrate_s=60.0, live=True)
    with pytest.raises(RunError, match="there are: paper-iteration"):
        rooms.assemble(estimator="means")


def test_independent_frames_are_measured_each_by_its_own_reading(crane):
    observations = [msgspec.structs.replace(s, time_s=None) for s in crane.observations()]
    observations[3] = msgspec.structs.replace(observations[3], hoist_m=None, rope_status="refused", rope_reason="torn")
    found = made().conclude(observations, crane.calibration)
    assert found.measurements[3].status == "unread"
    assert sum(m.status == "ok" for m in found.measurements) == FRAMES - 1
    assert dataclasses.asdict(found.estimate)["frames"] == FRAMES - 1


def test_the_smoother_runs_on_a_record(crane):
    found = made(estimator=PendulumSmoother()).conclude(crane.observations(1.5), crane.calibration)
    assert rms(degrees(found.measurements) - np.degrees(crane.alpha)) < 0.15
    assert found.tilt is not None


def test_an_estimators_name_is_an_instrument():
    made = open_instrument("smoother")
    assert isinstance(made.estimator, PendulumSmoother)
    assert made.estimator.intervals == WORKING
    assert open_instrument("bundled").estimator is None


def test_a_rope_shorter_than_the_offset_has_no_swing():
    camera = Calibration(1920, 1080, 1600.0, 960.0, 540.0, offset_m=(0.0, 3.0, 0.0))
    tilt = Known("rope-aware", 9, 1.0, 0.0, (0.0, 3.0, 0.0), tuple((0.0,) * 4 for _ in range(4)))
    alpha, *_ = follow(tilt, [[960.0, 540.0]], camera, rope_length=[2.0])  # shorter than the offset
    assert np.isnan(alpha).all()


@pytest.fixture(scope="module")
def bolted():
    """A record below a camera that is bolted to the jib, the camera, and the tilt that it shows with the controller."""
    crane = swinging.record(fixed=False, frames=900, seed=101, camera__mount={"model": "rigid"})
    camera = msgspec.structs.replace(crane.calibration, mount="rigid")
    data = Controller(crane.time, *crane.jib.T, crane.rope, 1e-3, 3e-3, clock_sd_s=0.3)
    return crane, camera, made(controller=data).conclude(crane.observations(1.0), camera).tilt


@pytest.mark.parametrize("clock_sd_s", [0.3, 1.0])
def test_a_given_tilt_follows_the_radius_that_the_controller_reports(bolted, clock_sd_s):
    """Unless its clock may be too far off, which a display shows of a whole record."""
    crane, camera, tilt = bolted
    data = Controller(crane.time, *crane.jib.T, crane.rope, 1e-3, 3e-3, clock_sd_s=clock_sd_s)
    assert np.hypot(*tilt.pitch_deg_per_m) == pytest.approx(2.0, abs=0.2)
    seen = crane.observations(1.0)[:700]
    instrument = made(controller=data, tilt=tilt)
    whole = instrument.conclude(seen, camera)
    live = lives(seen, camera, controller=data, tilt=tilt)
    for measured, exact in ((whole.measurements, True), ([one.measurement for one in live], clock_sd_s < 0.5)):
        off = np.degrees(np.array([m.alpha for m in measured]) - crane.alpha[:700])
        width = np.degrees(np.median([m.alpha_high - m.alpha_low for m in measured]))
        if exact:
            assert np.sqrt(np.mean(off**2)) < 0.2
            assert width < 1.0
        else:
            assert width > 4.0
    for record, leans in ((whole, False), (None, clock_sd_s > 0.5)):
        text = assumptions(camera, record, tilt, instrument, whole.measurements, timed=True)["leans"]
        assert bool(text) == leans


@pytest.mark.parametrize("case", ["every half second", "from 10 s on", "silent for 3 s", "slow", "a clock 0.3 s off"])
def test_a_live_tilt_follows_a_radius_that_comes_seldom_late_or_with_gaps(bolted, case):
    crane, camera, tilt = bolted
    at = np.arange(0, 100, 1.0 if case == "slow" else 0.1)
    columns = [np.interp(at, crane.time, one) for one in (*crane.jib.T, crane.rope)]
    data = Controller(at, *columns, 1e-3, 3e-3, 0.3, hold_s=1.0)
    if case == "silent for 3 s":
        data.radius[(at > 30) & (at < 33)] = np.nan
    given = {"feed": Feed(data, states_radius=True, every_s=0.5)}
    if case == "from 10 s on":
        some = at >= 10
        part = {name: getattr(data, name)[some] for name in ("time", "slew", "radius", "rope")}
        given = {"controller": dataclasses.replace(data, **part)}
    if case == "a clock 0.3 s off":
        given = {"controller": dataclasses.replace(data, time=at + 0.3)}
    live = lives(crane.observations(1.0)[:500], camera, tilt=tilt, **given)
    assert not [fault for one in live for fault in one.faults if fault.kind == "camera"]
    measured = [one.measurement for one in live][100 if case == "from 10 s on" else 10 :]
    true = crane.alpha[500 - len(measured) : 500]
    low, alpha, high = np.array([(m.alpha_low, m.alpha, m.alpha_high) for m in measured]).T
    assert rms(np.degrees(alpha - true)) < 0.3
    assert np.mean((low <= true) & (true <= high)) > 0.93
