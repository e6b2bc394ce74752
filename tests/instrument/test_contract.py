"""One contract for all estimators."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
import tracemalloc
from importlib.metadata import EntryPoint

import msgspec
import numpy as np
import pytest

from simgrab.errors import RecordError
from simgrab.instrument import estimate
from simgrab.instrument.estimate import ESTIMATORS, GROUP, EstimatorTable, IntervalSettings
from simgrab.instrument.estimate.solve import stated_ends
from simgrab.model.geometry import camera_rotation
from tests.instrument import pendulum_simulator as pendulum
from tests.instrument import studies

CAMERA = studies.camera()
NAMES = list(ESTIMATORS)
ORDERLESS = [n for n in NAMES if not ESTIMATORS[n].needs_time]


@pytest.fixture(scope="module")
def record():
    """A swing that every estimator can work on: pixels, rope and time of 130 frames."""
    rng = np.random.default_rng(7)
    swing = pendulum.free(rng, 1, 14.5, pendulum.Hoist(24.0, 16.0, 1.0, 12.0), np.deg2rad(3), 0.005)
    rotation = camera_rotation(np.deg2rad(4.0), 1.1, 0.0)
    place = np.array([[0.2, -0.1, 0.0]])
    pixels = pendulum.seen(rng, swing, CAMERA.intrinsics.project, rotation=rotation, offset=place)[0]
    return pixels, swing.rope, swing.time


def run(name, pixels, rope, time, camera=CAMERA):
    return ESTIMATORS[name]().estimate(pixels, camera, rope_length=rope, time=time)


def test_an_estimator_is_imported_when_it_is_used_and_one_that_is_not_installed_is_one_line(monkeypatch):
    code = (
        "import sys; from simgrab.instrument.estimate import ESTIMATORS; assert 'mean-ray' in list(ESTIMATORS); "
        "assert not {'numpy', 'scipy'} & set(sys.modules); ESTIMATORS['mean-ray']; "
        "assert not {'scipy.optimize', 'simgrab.instrument.estimate.rope_aware'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
    offered = [
        EntryPoint("mine", "simgrab.instrument.estimate.mean_ray:MeanRay", GROUP),
        EntryPoint("gone", "simgrab.gone.room:Estimator", GROUP),
        EntryPoint("wrong", "pathlib:Path", GROUP),
        EntryPoint("mean-ray", "somebody.else:Estimator", GROUP),
    ]
    monkeypatch.setattr(estimate, "entry_points", lambda group: offered if group == GROUP else [])
    table = EstimatorTable({"mean-ray": "simgrab.instrument.estimate.mean_ray:MeanRay"})
    assert list(table) == ["mean-ray", "gone", "mine", "wrong"]
    assert table["mine"] is table["mean-ray"]
    assert table.get("neither") is None
    for short in ("paper", "paper_iteration", "PaperIteration", "iteration"):
        assert ESTIMATORS[short] is ESTIMATORS["paper-iteration"]
    assert "pape" not in ESTIMATORS
    assert EstimatorTable({"mean-ray": "", "mean-square": ""}).full("mean") == "mean"  # which fits both
    with pytest.raises(RecordError, match=r"'gone' \(simgrab.gone.room:Estimator\) is not installed: No module named"):
        table["gone"]
    with pytest.raises(RecordError, match="not a subclass"):
        table["wrong"]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("frames", [0, 1])
def test_too_few_frames_are_refused_with_a_reason(name, frames, record):
    pixels, rope, time = record
    found = run(name, pixels[:frames], rope[:frames], time[:frames])
    assert found.status == "refused"
    assert str(frames) in found.reason
    assert "parameters" in found.reason
    assert (found.beta, found.sigma, found.alpha, found.intervals) == (None, None, None, ())


@pytest.mark.parametrize("name", NAMES)
def test_intervals_include_how_a_camera_leans_that_is_not_fixed(name, record):
    pixels, rope, time = record
    fixed, levelled, rigid = (
        run(name, pixels, rope, time, msgspec.structs.replace(CAMERA, mount=mount))
        for mount in ("fixed", "levelled", "rigid")
    )
    np.testing.assert_array_equal(levelled.alpha, fixed.alpha)
    far = fixed.alpha > np.quantile(fixed.alpha, 0.9)
    wide, wider, widest = (stated_ends(one)[far, 1] - one.alpha[far] for one in (fixed, levelled, rigid))
    np.testing.assert_allclose(np.sqrt(wider**2 - wide**2), 1.96 * np.deg2rad(0.85), rtol=0.2)
    np.testing.assert_allclose(np.sqrt(widest**2 - wide**2), 1.96 * np.deg2rad(1.5), rtol=0.4)


@pytest.mark.parametrize("name", ORDERLESS)
def test_independent_frames_are_of_a_camera_at_rest(name, record):
    pixels, rope, _ = record
    levelled = msgspec.structs.replace(CAMERA, mount="levelled")
    still, leaning = (run(name, pixels, rope, None, one) for one in (CAMERA, levelled))
    np.testing.assert_array_equal(stated_ends(leaning), stated_ends(still))


@pytest.mark.parametrize("name", NAMES)
def test_identical_frames_give_no_swing_and_no_false_certainty(name, record):
    time = record[2]
    pixels = np.tile([1010.0, 600.0], (len(time), 1))
    found = run(name, pixels, np.full(len(time), 20.0), time)
    assert found.ok
    assert np.isfinite([found.beta, found.sigma]).all()
    if name == "zero-tilt":  # what it takes for swing is the tilt
        assert found.sigma > 0.03
    else:
        assert found.sigma < 1e-6
    if name != "pendulum-smoother":  # a pendulum at rest does tell where down is
        assert found.interval("iid").beta is None
        assert "no scatter" in found.interval("iid").note


@pytest.mark.parametrize("name", NAMES)
def test_a_frame_without_a_pixel_is_a_missing_frame(name, record):
    pixels, rope, time = record
    gone = np.zeros(len(time), bool)
    gone[[3, 40, 41, 90]] = True
    holed = np.where(gone[:, None], np.nan, pixels)
    found, short = run(name, holed, rope, time), run(name, pixels[~gone], rope[~gone], time[~gone])
    assert found.frames == len(time) - 4
    if name == "pendulum-smoother":  # it knows where the grab was meanwhile
        assert abs(found.beta - short.beta) < 3e-4
        assert np.isfinite(found.alpha).all()
    else:
        np.testing.assert_allclose([found.beta, found.sigma], [short.beta, short.sigma], atol=1e-12)
        np.testing.assert_array_equal(np.isnan(found.alpha), gone)
        np.testing.assert_allclose(found.interval("iid").beta, short.interval("iid").beta, atol=1e-9)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("through_centre", [True, False])
def test_collinear_points(name, through_centre, record):
    _, rope, time = record
    along = 80 * np.sin(0.7 * time) + 30
    pixels = np.stack([960 + along, 540 + 0.5 * along + (0 if through_centre else 60)], -1)
    found = run(name, pixels, rope, time)
    if found.ok:
        assert np.isfinite(found.beta)
        assert np.isfinite(found.alpha).all()
        beta = found.intervals[0].beta
        assert beta[0] <= found.beta <= beta[1]
    else:
        assert found.reason


@pytest.mark.parametrize("name", ORDERLESS)
def test_the_order_of_frames_does_not_matter(name, record):
    pixels, rope, time = record
    order, settings = np.random.default_rng(0).permutation(len(time)), IntervalSettings(block_s=4.0)
    one, other = (
        ESTIMATORS[name](intervals=settings).estimate(pixels[i], CAMERA, rope_length=rope[i], time=time[i])
        for i in (slice(None), order)
    )
    np.testing.assert_allclose([one.beta, one.sigma], [other.beta, other.sigma], rtol=1e-8)
    np.testing.assert_allclose(one.alpha[order], other.alpha, atol=1e-8)
    for kind in ("iid", "blocks"):
        assert one.interval(kind).beta is not None
        np.testing.assert_allclose(one.interval(kind).beta, other.interval(kind).beta, atol=1e-8)
        np.testing.assert_allclose(one.interval(kind).sigma, other.interval(kind).sigma, rtol=1e-8)


@pytest.mark.parametrize("name", ORDERLESS)
def test_intervals_of_frames_that_must_be_apart_do_not_depend_on_the_frame_rate(name, record):
    pixels, rope, time = record
    settings = IntervalSettings(apart_s=6 * (time[1] - time[0]))
    estimator = ESTIMATORS[name](intervals=settings)
    twice = estimator.estimate(
        np.repeat(pixels, 2, axis=0),
        CAMERA,
        rope_length=np.repeat(rope, 2),
        time=np.linspace(0, time[-1], 2 * len(time)),
    )
    once = estimator.estimate(pixels, CAMERA, rope_length=rope, time=time)
    assert [one.kind for one in once.intervals] == ["iid"]
    assert np.ptp(once.interval("iid").beta) == pytest.approx(np.ptp(twice.interval("iid").beta), rel=0.1)
    free = run(name, pixels, rope, time).interval("iid").beta
    if name != "zero-tilt":
        assert np.ptp(once.interval("iid").beta) > 1.5 * np.ptp(free)


@pytest.mark.parametrize("name", ORDERLESS)
def test_wind_widens_intervals_by_the_grabs_lean(name, record):
    pixels, rope, time = record
    calm, windy = (
        ESTIMATORS[name](intervals=IntervalSettings(wind_m_s=wind)).estimate(
            pixels, CAMERA, rope_length=rope, time=time
        )
        for wind in (0.0, 14.0)
    )
    np.testing.assert_array_equal(windy.alpha, calm.alpha)
    added = windy.interval("iid").tilt - calm.interval("iid").tilt
    lean = np.radians(0.404) ** 2 / 2  # 14 m/s lean a grab of 17 t by 0.404°
    np.testing.assert_allclose(added[:2, :2], lean * np.eye(2), rtol=0.02)
    assert np.all(np.ptp(windy.interval("iid").alpha, axis=1) > np.ptp(calm.interval("iid").alpha, axis=1))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("turn", "zoom"), [(0.9, 1.0), (0.0, 1.7)])  # clockwise in the picture
def test_a_turned_or_finer_picture_gives_the_same_angles(name, turn, zoom, record):
    pixels, rope, time = record
    c, s = np.cos(turn), np.sin(turn)
    centre = np.array([CAMERA.cx_px, CAMERA.cy_px])
    changed = zoom * (pixels - centre) @ np.array([[c, s], [-s, c]]) + centre
    finer = msgspec.structs.replace(CAMERA, focal_length_px=zoom * CAMERA.focal_length_px)
    one, other = run(name, pixels, rope, time), run(name, changed, rope, time, finer)
    close = 2e-4 if name == "pendulum-smoother" else 1e-8
    np.testing.assert_allclose([one.beta, one.sigma], [other.beta, other.sigma], atol=close)
    np.testing.assert_allclose(one.alpha, other.alpha, atol=2 * close)
    if name != "zero-tilt":  # C'G' turns with the picture, and the azimuth is a right angle less it
        difference = other.tilt_azimuth + turn - one.tilt_azimuth
        assert abs((difference + np.pi) % (2 * np.pi) - np.pi) < max(close, 1e-6) * 20


@pytest.mark.parametrize("name", NAMES)
def test_nothing_is_written_into_and_nothing_is_remembered(name, record):
    given = [np.array(a) for a in record]
    before = [a.copy() for a in given]
    for a in given:
        a.flags.writeable = False
    estimator = ESTIMATORS[name]()
    pixels, rope, time = given
    one = estimator.estimate(pixels, CAMERA, rope_length=rope, time=time)
    other = estimator.estimate(pixels, CAMERA, rope_length=rope, time=time)
    for a, b in zip(given, before, strict=True):
        np.testing.assert_array_equal(a, b)
    assert (one.beta, one.sigma, one.tilt_azimuth) == (other.beta, other.sigma, other.tilt_azimuth)
    np.testing.assert_array_equal(one.alpha, other.alpha)
    with pytest.raises(dataclasses.FrozenInstanceError):
        estimator.intervals = None
    with pytest.raises(dataclasses.FrozenInstanceError):
        one.beta = 0.0


@pytest.mark.parametrize("name", NAMES)
def test_a_batch_is_its_records(name, record):
    pixels, rope, time = record
    many = np.stack([pixels, np.full_like(pixels, np.nan), pixels[::-1]])
    batch = ESTIMATORS[name]().batch(many, CAMERA, rope_length=rope, time=time)
    assert batch.ok.tolist() == [True, False, True]
    assert batch[1].status == "refused"
    assert batch[1].beta is None
    for i in (0, 2):
        alone = run(name, many[i], rope, time)
        np.testing.assert_allclose([batch[i].beta, batch[i].sigma], [alone.beta, alone.sigma], atol=1e-12)
        np.testing.assert_allclose(batch[i].alpha, alone.alpha, atol=1e-12)
        np.testing.assert_allclose(batch[i].intervals[0].beta, alone.intervals[0].beta, atol=1e-10)


SECOND = np.arange(130) == 5
WRONG = {
    "pixels without an axis": (lambda p, r, t: (p[:, 0], r, t), "", "shape"),
    "pixels of three numbers": (lambda p, r, t: (p[:, [0, 1, 1]], r, t), "", "shape"),
    "pixels of two records": (lambda p, r, t: (p[None], r, t), "", "shape"),
    "ropes of fewer frames": (lambda p, r, t: (p, r[1:], t), "", "rope_length must have shape"),
    "times of fewer frames": (lambda p, r, t: (p, r, t[1:]), "", "time must have shape"),
    "a rope of no length": (lambda p, r, t: (p, np.where(SECOND, 0.0, r), t), "", "row 5: must be above 0 m, got 0"),
    "no rope": (lambda p, _r, t: (p, None, t), "needs_rope", "needs the rope length"),
    "no time": (lambda p, r, _t: (p, r, None), "needs_time", "needs the time"),
    "time that runs back": (lambda p, r, t: (p, r, t[::-1]), "needs_time", "row 1: must increase"),
    **{f"a time of {wrong:g} s": (lambda p, r, t, wrong=wrong: (p, r, np.where(SECOND, wrong, t)), "",
                                  r"row 5: must lie within 1e\+12 s of 0") for wrong in (1e13, -1e308, 1.6e18)},
}  # fmt: skip


@pytest.mark.parametrize(("what", "name"), [
    (what, name) for what, (_, needed, _) in WRONG.items() for name in NAMES
    if not needed or getattr(ESTIMATORS[name], needed)
])  # fmt: skip
def test_what_is_no_record_raises(what, name, record):
    change, _, message = WRONG[what]
    with pytest.raises(RecordError, match=message):
        run(name, *change(*record))


@pytest.mark.parametrize("name", ORDERLESS)
def test_frames_of_one_instant_are_one_block(name, record):
    pixels, rope, time = record
    blocks = run(name, pixels, rope, np.full(len(time), 7.0)).interval("blocks")
    assert "too few blocks: 1 " in blocks.note


@pytest.mark.parametrize("name", ORDERLESS)
def test_a_million_frames_in_bounded_memory(name):
    rng = np.random.default_rng(1)
    pixels = rng.normal([1000.0, 580.0], 60.0, (1_000_000, 2))
    rope, time = rng.uniform(8, 35, 1_000_000), np.arange(1e6) / 9
    tracemalloc.start()
    found = run(name, pixels, rope, time)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found.ok
    assert found.interval("blocks").blocks == 4
    assert peak < 600e6  # 600 bytes a frame, of which the result keeps 40
