"""What errors do to readings: the law of their noise, their keys, clocks, limits and counts."""

import math

import numpy as np
import pytest
from test_sensors import near, scene

import simgrab
from simgrab.errors import ScenarioError
from simgrab.model import scenes
from simgrab.model.scenario import IMU_CLASSES, ImuNoise, variant
from simgrab.world.sensors.errors import SensorClock, SensorErrors, streams


def triad(seed=0, clip=0, name="imu0", **changes):
    return SensorErrors(3, streams(seed, clip, name), **{"rate_hz": 200.0} | changes)


def allan(values, samples):
    """Overlapping Allan deviation (IEEE Std 952) of each column, over so many samples."""
    mean = np.cumsum(np.vstack([np.zeros(values.shape[1]), values]), axis=0)
    mean = (mean[samples:] - mean[:-samples]) / samples
    return np.sqrt(np.mean((mean[samples:] - mean[:-samples]) ** 2, axis=0) / 2)


@pytest.mark.parametrize("name", ["adis16448", "mems"])
@pytest.mark.parametrize("kind", ["gyroscope", "accelerometer"])
def test_the_allan_deviation_is_what_was_set(name, kind):
    """N/√τ at a fifteenth of the τ at which both noises are equal, and K √(τ/3) at fifteen times it."""
    errors = IMU_CLASSES[name]
    density, walk = (getattr(errors, f"{kind}_{what}") for what in ("noise_density", "random_walk"))
    crossing = math.sqrt(3) * density / walk  # s
    rate = 60 / crossing
    still = triad(density=density, walk=walk, rate_hz=rate).read(np.zeros((600_000, 3)))[0]
    short, long = 4 / rate, 900 / rate
    white, walking = (np.sqrt(np.mean(allan(still, n) ** 2)) for n in (4, 900))
    assert white == pytest.approx(density / math.sqrt(short), rel=0.02)
    assert walking == pytest.approx(walk * math.sqrt(long / 3), rel=0.06)


def test_a_recorded_imu_has_the_noise_of_its_class_at_its_rate():
    """Over 30 s of standstill, with bias and scale taken off: only noise and counts are left."""
    still = scene({"swing.work": {"model": "hang"}}, frames=270, imu0={"model": "imu", "mount": "rope"})
    read = simgrab.sensors(still)["imu0"]
    errors = IMU_CLASSES["adis16448"]
    white = read.values - read.truth[:, 7:13] - read.truth[:, 1:7]
    counts = np.array([math.radians(errors.gyroscope_resolution_deg_s), errors.accelerometer_resolution_m_s2])
    expected = np.sqrt(
        200 * np.array([errors.gyroscope_noise_density, errors.accelerometer_noise_density]) ** 2 + counts**2 / 12
    )
    np.testing.assert_allclose(np.std(white, axis=0).reshape(2, 3).mean(axis=1), expected, rtol=0.03)
    turned_on = read.truth[0, 7:13].reshape(2, 3)
    assert (np.abs(turned_on) < 4 * np.array([[math.radians(0.5)], [0.196]])).all()
    assert np.abs(turned_on).max(axis=1).min() > 0


def test_readings_are_the_same_however_they_are_cut():
    felt = np.random.default_rng(0).standard_normal((1000, 3))
    settings = {"density": 1e-2, "walk": 1e-2, "bias": 0.1, "scale_error": 0.01, "misalignment": 0.01}
    whole = triad(**settings).read(felt)
    cut = triad(**settings)
    parts = [cut.read(felt[a:b]) for a, b in ((0, 1), (1, 333), (333, 333), (333, 1000))]
    for joined, one in zip(map(np.concatenate, zip(*parts, strict=True)), whole, strict=True):
        np.testing.assert_array_equal(joined, one)


def test_every_seed_clip_and_name_has_errors_of_its_own():
    felt, settings = np.zeros((5, 3)), {"density": 1.0, "walk": 1.0, "bias": 1.0}
    read = [
        triad(seed, clip, name, **settings).read(felt)[0].tobytes()
        for seed, clip, name in ((0, 0, "a"), (0, 0, "a"), (1, 0, "a"), (0, 1, "a"), (0, 0, "b"))
    ]
    assert read[0] == read[1]
    assert len(set(read)) == 4


def test_a_sensor_more_changes_no_other():
    imu = {"imu0": {"model": "imu", "mount": "rope"}}
    more = imu | {"a": {"model": "inclinometer", "mount": "camera"}, "z": {"model": "hoist-encoder"}}
    alone, among = (simgrab.sensors(scene({}, frames=9, **sensors))["imu0"] for sensors in (imu, more))
    for name in ("stamp_ns", "values", "truth"):
        np.testing.assert_array_equal(getattr(alone, name), getattr(among, name))


def test_scale_misalignment_and_bias_have_the_spread_that_was_set():
    """A thousand sensors feel (1, 2, 3): each axis errs by scale, by the other two's share, and by its bias."""
    felt = np.array([[1.0, 2.0, 3.0]])
    errors = np.array([
        triad(name=f"s{i}", bias=0.02, scale_error=0.01, misalignment=0.005).read(felt)[0][0] - felt[0]
        for i in range(1000)
    ])  # fmt: skip
    square = felt[0] ** 2
    expected = np.sqrt(0.02**2 + 0.01**2 * square + 0.005**2 * (square.sum() - square))
    np.testing.assert_allclose(errors.std(axis=0), expected, rtol=0.1)
    near(errors.mean(axis=0), 0, atol=4 * expected.max() / math.sqrt(1000))


def test_readings_stay_in_range_and_are_whole_counts():
    felt = np.linspace(-5, 5, 300).reshape(-1, 3)
    read, _ = triad(limit=2.0, resolution=0.25).read(felt)
    assert set(np.unique(read)) == set(np.arange(-2.0, 2.01, 0.25))
    assert np.abs(read - np.clip(felt, -2, 2)).max() <= 0.125


def test_a_clock_stamps_late_and_runs_fast():
    clock = SensorClock(100.0, offset=0.25, drift=1e-4)
    samples = np.arange(1_000_001.0)
    true, stamped = clock.times(samples), clock.stamps(samples)
    np.testing.assert_allclose(stamped, 0.25 + (1 + 1e-4) * true, rtol=1e-14)
    np.testing.assert_allclose(np.diff(stamped), 0.01, rtol=1e-6)
    assert true[-1] == pytest.approx(10_000 - 0.99990001, abs=1e-6)  # in a sensor's 10,000 s pass 1 s less


def test_clocks_are_drawn_with_the_spread_that_was_set():
    errors = ImuNoise(clock_offset_ms=5.0, clock_drift_ppm=20.0)
    drawn = [SensorClock.draw(100.0, errors, streams(0, clip, "imu0")) for clip in range(1000)]
    assert np.std([clock.offset for clock in drawn]) == pytest.approx(5e-3, rel=0.1)
    assert np.std([clock.drift for clock in drawn]) == pytest.approx(20e-6, rel=0.1)


def test_a_recording_samples_the_whole_clip_once():
    imu = {"model": "imu", "mount": "rope", "noise": {"clock_drift_ppm": 1000.0, "clock_offset_ms": 30.0}}
    clips = scene({"clip.clip_frames": 250}, frames=400, imu0=imu)
    for clip, seconds in ((0, 250 / 9), (-1, 150 / 9)):  # the first is longer than a block of physics
        read = simgrab.sensors(clips, clip)["imu0"]
        time, drift = read.true("time [s]"), 1 - 0.005 / np.diff(read.true("time [s]"))
        assert time[0] == 0
        assert seconds - 0.0051 < time[-1] < seconds
        near(np.diff(read.stamp_ns), 5_000_000, atol=1)
        assert np.ptp(drift) < 1e-9
        assert 1e-5 < abs(drift[0]) < 4e-3
    with pytest.raises(IndexError, match="clip 2 is out of range: the scenario has 2 clips"):
        simgrab.sensors(clips, 2)


def test_each_clip_has_the_motion_of_its_own_draw():
    ropes = {"dist": "one-of", "values": [10.0, 20.0, 30.0]}
    changes = {"frames": 6, "clip.clip_frames": 1, "vary": {"swing.work.rope_length_m": ropes}}
    scene = scenes.load("free-swing", changes | {"sensors.hoist": {"model": "hoist-encoder"}})
    lengths = [simgrab.sensors(scene, clip)["hoist"].true("rope_length [m]")[0] for clip in range(6)]
    assert lengths == [variant(scene, frame).scenario.swing.work.rope_length_m for frame in range(6)]
    assert len(set(lengths)) > 1
    longer = simgrab.sensors(scene, 2, randomiser=lambda *_: {"swing.work.rope_length_m": 33.0})["hoist"]
    assert longer.true("rope_length [m]")[0] == 33.0


IMU = {"model": "imu", "mount": "grab"}
REFUSED = [
    (
        {"sensors.imu0": IMU | {"mount": "hook"}},
        "sensors.imu0.mount: must be one of: jib-head, camera, platform, rope, grab",
    ),
    ({"sensors.imu0": {"model": "imu"}}, "sensors.imu0.mount: missing"),
    ({"sensors.imu0": {"mount": "grab"}}, "sensors.imu0.model: missing; one of: imu, inclinometer, slew-encoder"),
    ({"sensors.imu0": IMU | {"noise": "cheap"}}, "noise: must be one of: adis16448, mems, none, or a table; got"),
    ({"sensors.imu0": IMU | {"noise": {"gyroscope_noise_density": math.nan}}}, "density: must be a finite number"),
    ({"sensors.imu0": IMU | {"noise": {"drift": 1}}}, "sensors.imu0.noise.drift: unknown key"),
    ({"sensors.imu0": IMU | {"rate_hz": math.inf}}, "sensors.imu0.rate_hz: must be a finite number"),
    ({"sensors": {"../evil": IMU}}, r"sensors.../evil: a name has 1 to 64 of a-z"),
    ({"sensors": {f"s{i}": IMU for i in range(33)}}, "sensors: at most 32 sensors, got 33"),
    ({"sensors": [IMU]}, "sensors: must be a table, got [{"),
    ({"sensors.a": 3}, "sensors.a: must be a table such as { model = "),
    ({"sensors.imu0": IMU, "swing": {"model": "iid"}}, "sensors: independent frames have no motion to measure; set"),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "message"), REFUSED)
def test_bad_keys_are_refused_in_a_line_that_names_them(changes, message):
    with pytest.raises(ScenarioError) as caught:
        scenes.load("free-swing", changes)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_sensor_is_set_on_the_command_line():
    changes = scenes.parse_changes(['sensors.imu0={model="imu", mount="grab"}', "sensors.imu0.rate_hz=100"])
    imu = scenes.load("free-swing", changes).sensors["imu0"]
    assert (imu.mount, imu.rate_hz, imu.noise) == ("grab", 100.0, "adis16448")


def test_sensors_neither_vary_nor_come_without_physics(tmp_path):
    scene = scenes.load("free-swing", {"sensors.imu0": IMU, "frames": 2, "clip.clip_frames": 1})
    varied = scene.to_dict() | {"vary": {"sensors.imu0.rate_hz": {"dist": "one-of", "values": [100.0, 200.0]}}}
    with pytest.raises(ScenarioError, match=r"vary\.sensors\.imu0\.rate_hz: .*cannot vary"):
        scenes.of_manifest({"scenario": varied}, "here", lambda *_: b"")
    with pytest.raises(ScenarioError, match="sensors: there are none"):
        simgrab.sensors("free-swing")
    with pytest.raises(ScenarioError, match="sensors: a trajectory of yours gives poses without accelerations"):
        simgrab.render(scene, tmp_path / "out", trajectory=lambda *_: None)
    with pytest.raises(ScenarioError, match="sensors: need a dataset"):
        simgrab.render_video(scene, tmp_path / "swing.mp4")
    assert not list(tmp_path.iterdir())
