"""The controller's data: one crane in any units, files that are wrong, and the clock's offset."""

import dataclasses
import re
from datetime import UTC, datetime, timedelta

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import swinging
import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st
from swinging import nobody

from simgrab.errors import RecordError, RunError
from simgrab.instrument import pipeline as rooms
from simgrab.instrument.controller import DELAY_SD_S, ClockOffset, Controller, clock_offset, in_words
from simgrab.instrument.controller_file import ControllerFacts, read_controller
from simgrab.instrument.drive import Drive
from simgrab.instrument.estimate import RopeAware
from simgrab.instrument.pipeline import Pipeline
from simgrab.instrument.run.run import _controller
from simgrab.io.strict import convert

TIME = np.arange(600) / 10
SLEW, RADIUS = 0.3 + 1.5 * np.sin(TIME / 9), 22 + 3 * np.cos(TIME / 15)
NO_TIMES = np.zeros(0)
ROPE = 15 + 6 * np.sin(TIME / 7)
JIB_M, PIVOT_M = 30.0, 1.5
PER = {"s": 1, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "m": 1, "dm": 0.1, "cm": 0.01, "mm": 1e-3, "ft": 0.3048}
PER |= {"deg": np.pi / 180, "rad": 1}
START = datetime(2026, 3, 2, 8, 15, tzinfo=UTC)


def written(folder, columns, tables, parquet=False, **more):
    """Write columns and their description; returns the data's path."""
    path = folder / f"crane.{'parquet' if parquet else 'csv'}"
    if parquet:
        pq.write_table(pa.table(columns), path)
    else:
        rows = zip(*([str(cell) for cell in column] for column in columns.values()), strict=True)
        path.write_text("\n".join(",".join(row) for row in [tuple(columns), *rows]) + "\n", encoding="utf-8")
    path.with_suffix(".toml").write_text(tomli_w.dumps(tables | more), encoding="utf-8")
    return path


def quantity(column, unit, resolution=1e-3, **more):
    return {"column": column, "unit": unit, "resolution": resolution, "rate_hz": 10.0, "jitter_s": 0.0} | more


def plain(folder, change=lambda columns: columns, **tables):
    """Write the crane in metres, degrees and seconds, after a change of its columns."""
    columns = {"t": TIME, "slew": np.degrees(SLEW), "radius": RADIUS, "rope": ROPE}
    lengths = {name: quantity(name, "m", constant_m=0.0) for name in ("radius", "rope")}
    about = {"time": {"column": "t"}, "slew": quantity("slew", "deg")} | lengths
    return written(folder, change({name: texts(values) for name, values in columns.items()}), about | tables)


@settings(max_examples=15, deadline=None)
@given(
    clock=st.sampled_from(["s", "ms", "us", "ns", "iso"]), angle=st.sampled_from(["deg", "rad"]),
    length=st.sampled_from(["m", "dm", "cm", "mm", "ft"]), wrapped=st.booleans(), clockwise=st.booleans(),
    luff=st.booleans(), constant=st.sampled_from([0.0, 2.5]), lag=st.sampled_from([0.0, 0.4]),
    parquet=st.booleans(),
)  # fmt: skip
def test_one_crane_is_read_from_any_units(
    tmp_path_factory, clock, angle, length, wrapped, clockwise, luff, constant, lag, parquet
):
    late = TIME + lag
    times = late / PER.get(clock, 1) + 100
    if clock == "iso":
        times = [(START + timedelta(seconds=t)).isoformat() for t in late.tolist()]
    slew = -SLEW if clockwise else SLEW
    slew = np.mod(slew, 2 * np.pi) if wrapped else slew
    columns = {"t": times, "slew": slew / PER[angle], "rope": (ROPE - constant) / PER[length]}
    about = {"slew": quantity("slew", angle, clockwise=clockwise, lag_s=lag)}
    about["time"] = {"column": "t", "unit": clock, "start": START.isoformat() if clock == "iso" else 100.0}
    about["rope"] = quantity("rope", length, 0.01 / PER[length], constant_m=constant, lag_s=lag)
    if luff:
        columns["jib"] = np.arccos((RADIUS - PIVOT_M) / JIB_M) / PER[angle]
        about["luff"] = quantity("jib", angle, jib_m=JIB_M, pivot_m=PIVOT_M, lag_s=lag)
    else:
        columns["jib"] = (RADIUS - constant) / PER[length]
        about["radius"] = quantity("jib", length, constant_m=constant, lag_s=lag)
    found = read_controller(written(tmp_path_factory.mktemp("units"), columns, about, parquet))
    np.testing.assert_allclose(found.time, TIME, atol=2e-6)
    np.testing.assert_allclose(np.diff(found.slew), np.diff(SLEW), atol=1e-6)
    np.testing.assert_allclose(found.radius, RADIUS, atol=1e-6)
    np.testing.assert_allclose(found.rope, ROPE, atol=1e-6)
    assert found.slew_sd == pytest.approx(1e-3 * PER[angle] / np.sqrt(12))
    assert found.notes == ()


@pytest.mark.parametrize(("unit", "factor"), [("m/s", 1), ("km/h", 3.6), ("kn", 3600 / 1852), ("mph", 3600 / 1609.344)])
def test_the_wind_is_its_root_mean_square_while_there_are_frames(tmp_path, unit, factor):
    """One reading a minute, of 3 m/s, later of 12 m/s, and at last of both in turns."""
    minute = np.arange(90)
    speed = np.select([minute < 30, minute < 60], [3.0, 12.0], np.where(minute % 2, 3.0, 12.0))
    columns = {"t": 60.0 * minute, "v": factor * speed}
    about = {"time": {"column": "t"}, "wind": {"column": "v", "unit": unit, "resolution": 0.1, "rate_hz": 1 / 60}}
    found = read_controller(written(tmp_path, columns, about))
    assert found.wind_m_s(np.arange(0, 600, 0.1)) == pytest.approx(3)
    assert found.wind_m_s(np.arange(3000, 3500, 0.1)) == pytest.approx(12)
    assert found.shifted(ClockOffset(1800.0, 1.0, "")).wind_m_s(np.arange(4800, 5300, 0.1)) == pytest.approx(12)
    assert found.wind_m_s(np.arange(3600, 5340, 0.1)) == pytest.approx(np.sqrt((9 + 144 + 36) / 3), rel=1e-3)
    assert not found.reports_motion
    assert found.wind_m_s(np.arange(0, 600, 0.1) - 1e6) == pytest.approx(3)


@pytest.mark.parametrize("net", [False, True])
@pytest.mark.parametrize(("unit", "factor"), [("t", 1), ("kg", 1000)])
def test_the_load_says_how_light_the_grab_is(tmp_path, unit, factor, net):
    """Ten seconds of an empty grab of 10 t, ten in which it digs and fills, and twenty with 14 t of cargo."""
    time = np.arange(0, 40, 0.5)
    tonnes = np.select([time < 10, time < 20], [10.0, 3.0 + 0.42 * (time - 10)], 24.0)
    columns = {"t": time, "m": factor * (tonnes - 10.0 * net)}
    load = {"column": "m", "unit": unit, "grab_t": 10.0, "net": net, "resolution": 0.1, "rate_hz": 2.0}
    found = read_controller(written(tmp_path, columns, {"time": {"column": "t"}, "load": load}))
    light = found.lightness(time)
    assert light[0] / light[-1] == pytest.approx(2.4)
    assert np.mean(light[tonnes > 8]) == pytest.approx(1)
    assert light[20:40].min() > light[-1] - 1e-9  # as it digs the lean is that between
    assert light[20:40].max() < light[0] + 1e-9
    np.testing.assert_allclose(found.shifted(ClockOffset(8.0, 1.0, "")).lightness(time + 8.0), light)
    assert not found.reports_motion
    for unknown in (None, np.column_stack([time, np.zeros(80)])):
        assert (dataclasses.replace(found, load=unknown).lightness(time) == 1).all()


def test_a_wind_of_another_rate_leaves_other_readings_as_they_are(tmp_path):
    """Two readings a second, longer than the others, or one that does not change and counts as none."""
    time = np.arange(0, 200, 0.05)
    (tmp_path / "v.csv").write_text("t,v\n" + "".join(f"{t},{8 + np.sin(t)}\n" for t in time), encoding="utf-8")
    wind = {"column": "v", "unit": "m/s", "resolution": 0.1, "rate_hz": 20.0, "file": "v.csv"}
    found, bare = read_controller(plain(tmp_path, wind=wind)), read_controller(plain(tmp_path))
    for name in ("time", "slew", "radius", "rope"):
        np.testing.assert_array_equal(getattr(found, name), getattr(bare, name))
    assert found.wind_m_s(TIME) == pytest.approx(8, abs=0.1)
    dead = wind | {"column": "t", "file": "", "rate_hz": 10.0}
    still = read_controller(
        plain(tmp_path, lambda columns: columns | {"w": ["0.0"] * 600}, wind=dead | {"column": "w"})
    )
    assert still.wind is None
    assert "wind: the same reading throughout, and not used" in still.notes[0]


def test_the_jibs_motion_is_that_of_the_latest_readings():
    """Uniform acceleration of both angle and radius."""
    slew, radius = 0.2 * TIME + 0.01 * TIME**2, 20 + 0.3 * TIME - 0.002 * TIME**2
    data, at = Controller(TIME, slew, radius), 30.03
    turn, out, r = 0.2 + 0.02 * at, 0.3 - 0.004 * at, 20 + 0.3 * at - 0.002 * at**2
    expected = [-0.004 - r * turn**2, r * 0.02 + 2 * out * turn, turn]
    np.testing.assert_allclose(data.jib_motion(at, NO_TIMES)[0], expected, rtol=1e-6)
    later = dataclasses.replace(data, slew=np.where(at < TIME, 99.0, slew))  # what is not yet known
    np.testing.assert_array_equal(later.jib_motion(at, NO_TIMES)[0], data.jib_motion(at, NO_TIMES)[0])
    for time, one in ((TIME[-1] + 0.6, data), (0.3, data), *(
        (at, dataclasses.replace(data, **{name: None})) for name in ("slew", "radius")
    )):  # fmt: skip
        assert np.isnan(one.jib_motion(time, NO_TIMES)[0]).all()


@pytest.mark.parametrize("unit", ["deg/s", "rad/s", "rpm"])
@pytest.mark.parametrize("clockwise", [False, True])
@pytest.mark.parametrize("luff", [False, True])
def test_setpoints_are_read_from_any_units_and_not_interpolated(tmp_path, unit, clockwise, luff):
    """Both drives start after 10.05 s. Between two readings the demand is that of the earlier one."""
    started, sign = TIME > 10, -1 if clockwise else 1
    of = {"deg/s": np.pi / 180, "rad/s": 1.0, "rpm": np.pi / 30}
    rate_unit = ("deg/s" if luff else "m/min") if unit == "deg/s" else ("rad/s" if luff else "m/s")
    angle = np.arccos((RADIUS - PIVOT_M) / JIB_M)
    jib = np.where(started, -0.02 if luff else 0.6, 0.0)
    columns = {
        "t": TIME + 0.3, "slew": sign * np.degrees(SLEW), "s": sign * 0.1 * started / of[unit],
        "jib": np.degrees(angle) if luff else RADIUS, "r": jib / {**of, "m/s": 1.0, "m/min": 1 / 60}[rate_unit],
    }  # fmt: skip
    length = {"constant_m": 0.0} if not luff else {"jib_m": JIB_M, "pivot_m": PIVOT_M}
    found = read_controller(written(tmp_path, {name: texts(one) for name, one in columns.items()}, {
        "time": {"column": "t"},
        "slew": quantity("slew", "deg", setpoint="s", setpoint_unit=unit, clockwise=clockwise, lag_s=0.3),
        "luff" if luff else "radius": quantity(
            "jib", "deg" if luff else "m", setpoint="r", setpoint_unit=rate_unit, lag_s=0.3, **length
        ),
    }))  # fmt: skip
    assert found.motion_late_s == 0.3
    np.testing.assert_allclose(found.slew_setpoint, 0.1 * started, atol=1e-6)
    out = 0.02 * JIB_M * np.sin(angle[101]) if luff else 0.6  # as the drive started
    np.testing.assert_allclose(found.radius_setpoint, out * started, atol=1e-4)
    later, _ = found.shifted(ClockOffset(5.0, 0.0, "")).jib_motion(20.0, NO_TIMES)
    np.testing.assert_allclose(later, found.jib_motion(15.0, NO_TIMES)[0], rtol=1e-9)


@pytest.mark.parametrize(
    ("setpoints", "used", "note"),
    [
        (["0.1"] * 600, 600, ""),
        (["70.0"] * 600, 0, "600 of 600 are not used, .*0.5 rad/s; is slew.setpoint_unit ri"),
        ([*["x"] * 20, *["0.1"] * 580], 580, "20 of 600 are not used, the first in row 1: no"),
        ([*["0.1"] * 300, *[""] * 300], 320, ""),  # it lasts for two seconds more
        ([""] * 600, 0, ""),
    ],
)
def test_bad_setpoints_are_not_used_and_the_readings_are(tmp_path, setpoints, used, note):
    path = plain(
        tmp_path, lambda columns: columns | {"s": setpoints, "r": ["0.0"] * 600},
        slew=quantity("slew", "deg", setpoint="s"), radius=quantity("radius", "m", constant_m=0.0, setpoint="r"),
    )  # fmt: skip
    found = read_controller(path)
    assert np.isfinite(found.slew_setpoint).sum() == used
    assert np.isfinite(found.slew).all()
    named = re.search(rf"slew.setpoint, column 's': {note}", "\n".join(found.notes))
    assert named if note else not found.notes


def test_a_setpoint_without_that_of_the_other_drive_is_named(tmp_path):
    found = read_controller(plain(tmp_path, slew=quantity("slew", "deg", setpoint="t")))
    assert "slew.setpoint is not used without that of the other" in found.notes[-1]


def test_a_luff_angle_that_is_hardly_ever_read_gives_no_setpoints(tmp_path):
    (tmp_path / "jib.csv").write_text("t,jib,r\n0.05,40.0,0.1\n55.05,41.0,0.1\n", encoding="utf-8")
    slew = quantity("slew", "deg", setpoint="s")
    luff = quantity("jib", "deg", setpoint="r", jib_m=JIB_M, file="jib.csv") | {"rate_hz": 0.02}
    columns = {"t": TIME, "slew": np.degrees(SLEW), "s": 0 * TIME}
    about = {"time": {"column": "t"}, "slew": slew, "luff": luff}
    found = read_controller(written(tmp_path, {name: texts(one) for name, one in columns.items()}, about))
    assert np.isnan(found.radius_setpoint).all()
    assert found.motion_late_s == 50.0
    assert np.isnan(found.jib_motion(30.0, NO_TIMES)[0]).all()


def trapezoid(time, speed, start, ramp, stop):
    """Position, speed and acceleration of a drive that starts, and may stop, each in a ramp."""
    fine = np.arange(-20, 80, 1e-3)
    rate = speed * np.clip(
        np.minimum((fine - start) / ramp, min((stop - start) / ramp, 1) - (fine - stop) / ramp), 0, 1
    )
    return [np.interp(time, fine, one) for one in (np.cumsum(rate) * 1e-3, rate, np.gradient(rate, 1e-3))]


def driven(start=99.0, ramp=5.0, stop=99.0, late=0.0):
    """Readings of the ten seconds up to 29.9 s of a drive whose setpoint is 0.12 rad/s for a while."""
    stamps = np.arange(200, 300) / 10
    setpoints = np.where((stamps >= start) & (stamps < stop), 0.12, 0.0)
    slew = trapezoid(stamps, 0.12, start + late, ramp, stop + late)[0]
    return stamps - 29.9, np.round(slew / 1e-3) * 1e-3, setpoints, 1e-3 / np.sqrt(12)


@pytest.mark.parametrize("late", [0.0, 0.4])
@pytest.mark.parametrize("ramp", [2.0, 5.0, 9.0])
@pytest.mark.parametrize(("start", "stop"), [(28.0, 99.0), (23.0, 99.0), (2.0, 28.0), (22.0, 28.0)])
def test_a_drive_is_expected_to_follow_its_setpoint(start, stop, ramp, late):
    """Six seconds ahead, from two seconds of a ramp on, after a stop of a drive that had not reached its speed too."""
    drive, after = Drive.of(*driven(start, ramp, stop, late)), np.array([0.0, 1.0, 3.0, 6.0])
    value, speed, acceleration = drive.ahead(after)
    true = trapezoid(29.9 + after, 0.12, start + late, ramp, stop + late)
    np.testing.assert_allclose(speed, true[1], atol=0.015)
    np.testing.assert_allclose(value, true[0], atol=0.03 if stop - start > ramp else 0.08)
    assert acceleration[0] == pytest.approx(true[2][0], abs=0.02 if ramp == 2 else 0.004)
    assert acceleration[3] == pytest.approx(true[2][3], abs=0.012)


def test_a_drive_may_be_stopped_sooner_but_not_later():
    after = np.array([0.0, 1.0, 3.0, 6.0])
    steady = Drive.of(*driven(start=2.0))
    value, speed, acceleration = steady.ahead(after)
    values, speeds, accelerations = steady.stopped(after)
    for one, all_of_it in ((value, values), (speed, speeds), (acceleration, accelerations)):
        np.testing.assert_allclose(all_of_it[-1], one, atol=1e-3)
    np.testing.assert_allclose(speeds[0], 0.12 * np.clip(1 - after / 4.5, 0, 1), atol=1e-3)
    np.testing.assert_allclose(accelerations[1], [0, -0.12 / 4.5, -0.12 / 4.5, 0], atol=1e-3)
    np.testing.assert_allclose(values[0] - values[0, 0], [0, 0.107, 0.24, 0.28], atol=0.02)
    braking = Drive.of(*driven(start=2.0, ramp=2.0, stop=28.9))
    assert (np.abs(braking.stopped(after)[1]) <= np.abs(braking.ahead(after)[1]) + 1e-12).all()
    np.testing.assert_allclose(braking.stopped(after)[2][1:], np.tile(braking.ahead(after)[2], (4, 1)), atol=1e-4)


def moving(**changes):
    """A controller of a jib that slews, from 10 s on, at 0.12 rad/s, and stands at 20 m; one with both setpoints."""
    data = Controller(
        TIME, trapezoid(TIME, 0.12, 10.0, 6.0, 99.0)[0], 0 * TIME + 20, slew_sd=1e-4, radius_sd=1e-3,
        slew_setpoint=np.where(TIME >= 10, 0.12, 0.0), radius_setpoint=0 * TIME,
    )  # fmt: skip
    return dataclasses.replace(data, **changes)


def test_the_jibs_motion_follows_the_setpoints():
    """In the middle of a ramp, and later; whatever later readings are."""
    now, ahead = moving().jib_motion(13.0, np.array([1.0, 5.0]))
    np.testing.assert_allclose(now, [-20 * 0.06**2, 20 * 0.02, 0.06], atol=0.01)
    np.testing.assert_allclose(ahead[-1], [[-20 * 0.08**2, 20 * 0.02, 0.08], [-20 * 0.12**2, 0, 0.12]], atol=0.02)
    np.testing.assert_allclose(ahead[0, 0], [-20 * 0.08**2, -20 * 0.08 / 4.5, 0.08], atol=0.03)
    later = moving(slew_setpoint=np.where((TIME >= 10) & (TIME < 13.01), 0.12, 0.0))
    np.testing.assert_array_equal(later.jib_motion(13.0, NO_TIMES)[0], now)
    exact = moving(slew_sd=0.0, radius_sd=0.0).jib_motion(13.0, NO_TIMES)[0]
    np.testing.assert_allclose(exact, now, atol=0.01)


@pytest.mark.parametrize(
    "changes",
    [
        {"slew": 0 * TIME},  # it stands, though speed is demanded
        {"slew": trapezoid(TIME, 0.12, 10.0, 6.0, 15.0)[0]},  # it is stopped by other means
        {"slew_setpoint": np.where(TIME < 19.5, 0.12, np.nan)},  # setpoints that end sooner than readings
        {"slew_setpoint": None},
        {"radius_setpoint": np.full(600, np.nan)},
    ],
)
def test_a_drive_that_does_not_follow_its_setpoint_is_measured_alone(changes):
    data = moving(**changes)
    now, ahead = data.jib_motion(20.0, np.array([1.0, 2.0]))
    assert np.isnan(ahead).all()
    without = dataclasses.replace(data, slew_setpoint=None, radius_setpoint=None)
    np.testing.assert_array_equal(now, without.jib_motion(20.0, NO_TIMES)[0])
    assert np.isfinite(now).all()
    assert np.isnan(data.jib_motion(TIME[-1] + 0.6, np.ones(1))[0]).all()


@pytest.mark.parametrize("jitter_s", [0.0, 0.01, 0.03])
@pytest.mark.parametrize("silent_s", [0.0, 0.4])
def test_the_jibs_motion_is_as_exact_as_it_is_said_to_be_or_not_given(jitter_s, silent_s):
    """Steady slewing, which does not accelerate around the circle, in steps of 0.1° and with jitter of the stamps."""
    rng, errors = np.random.default_rng(3), []
    for _ in range(100):
        slew = np.radians(np.round(np.degrees(0.1 * TIME + rng.uniform(0, 1)) / 0.1) * 0.1)
        sd = np.hypot(np.radians(0.1) / np.sqrt(12), 0.1 * jitter_s)
        stamps = TIME + rng.normal(0, jitter_s, len(TIME)).clip(-0.045, 0.045)
        data = Controller(stamps, slew, 0 * TIME + 25, None, sd, 0.003)
        errors.append(data.jib_motion(TIME[-1] + silent_s, NO_TIMES)[0][1])
    errors = np.array(errors)
    assert np.isfinite(errors).mean() in (0, 1)
    assert (silent_s, jitter_s) == (0.4, 0.03) or np.isfinite(errors).all()
    assert not np.isfinite(errors).any() or np.sqrt(np.mean(errors**2)) < 0.12


def test_a_reported_wind_is_a_stated_one():
    crane = swinging.record(frames=450)
    data = Controller(crane.time, rope=crane.rope, wind=np.array([[0.0, 9.0], [9.0, 9.0]]))

    def pipeline(wind_m_s, controller):
        intervals = dataclasses.replace(rooms.WORKING, wind_m_s=wind_m_s)
        return Pipeline(nobody, nobody, RopeAware(intervals=intervals), controller=controller)

    silent = dataclasses.replace(data, wind=None)
    cases = [(0.0, data), (9.0, silent), (9.0, dataclasses.replace(data, wind=data.wind * (1.0, 0.3))), (0.0, silent)]
    found = [pipeline(*case).conclude(crane.observations(1.0), crane.calibration) for case in cases]
    reported, stated, both, unknown = (each.measurements[100].alpha_high for each in found)
    assert reported == stated == both > unknown
    assert found[0].estimator.intervals.wind_m_s == 9.0


def test_series_of_other_rates_and_gaps_are_put_together(tmp_path):
    """The rope in a file of its own at 2 Hz, and silent from 20 to 30 s; slewing at 10 Hz, silent from 40 to 45 s."""
    some = np.flatnonzero((TIME < 20) | (TIME > 30))[::5]
    (tmp_path / "rope.csv").write_text("t,l\n" + "".join(f"{TIME[i]},{ROPE[i]}\n" for i in some), encoding="utf-8")
    kept = (TIME < 40) | (TIME > 45)
    about = {"time": {"column": "t"}, "slew": quantity("slew", "rad", jitter_s=0.02)}
    about["rope"] = quantity("l", "m", file="rope.csv") | {"rate_hz": 2.0}
    found = read_controller(written(tmp_path, {"t": TIME[kept], "slew": SLEW[kept]}, about))
    assert found.radius is None
    assert any(note.endswith("slew without radius or luff: a radius of 25 m is assumed") for note in found.notes)
    assert found.slew_sd == pytest.approx(0.02 * np.quantile(np.abs(np.gradient(SLEW, TIME)[kept]), 0.98), rel=0.05)
    at = np.arange(1, 59, 0.05)
    known = found.rope_at(at)
    silent = (at > 19.4) & (at < 30.2) | (at > 39.8) & (at < 45.2)
    np.testing.assert_allclose(known[~silent], np.interp(at, TIME, ROPE)[~silent], atol=0.01)
    assert np.isnan(known[(at > 19.7) & (at < 30) | (at > 40.1) & (at < 45)]).all()
    assert np.isnan(np.interp(at, found.time, found.slew)[(at > 40.1) & (at < 45)]).all()


def cell(name, row, text):
    def changed(columns):
        columns[name][row] = text
        return columns

    return changed


def column(name, change):
    return lambda columns: columns | {name: change(columns[name])}


def texts(values):
    return [f"{value:.6f}" for value in values]


REFUSED_ROWS = {
    "the clock jumps back for a second": (
        column("t", lambda t: [*t[:300], *texts(TIME[300:] - 1)]),
        "10 of 600 readings refused, the first in row 301: it does not increase",
    ),
    "the clock jumps ahead once": (cell("t", 9, "1e9"), "1 of 600 readings refused, the first in row 10: it does not"),
    "a time twice": (cell("t", 9, "0.8"), "1 of 600 readings refused"),
    "no time": (cell("t", 9, "nan"), "time, column 't': 1 of 600 readings refused, the first in row 10: not a time"),
    "NaN": (cell("rope", 9, "nan"), "rope, column 'rope': 1 of 600 readings refused, the first in row 10: not a num"),
    "text": (cell("slew", 9, "n/a"), "slew, column 'slew': 1 of 600 readings refused, the first in row 10: not a num"),
    "nothing": (cell("rope", 9, ""), "rope, column 'rope': 1 of 600 cells are empty"),
    "infinity": (cell("radius", 9, "inf"), "radius, column 'radius': 1 of 600 readings refused"),
    "a length that no rope has": (cell("rope", 9, "6553.5"), "the first in row 10: not between 0.5 and 200 m"),
    "a length that the hoist cannot reach": (cell("rope", 9, "40"), "the first in row 10: faster than 3 m/s"),
}


@pytest.mark.parametrize("what", list(REFUSED_ROWS))
def test_rows_that_cannot_be_right_are_refused_with_their_number(tmp_path, what):
    change, expected = REFUSED_ROWS[what]
    found = read_controller(plain(tmp_path, change))
    assert expected in found.notes[0]
    assert (np.diff(found.time) > 0).all()
    if "jumps back" not in what:
        assert len(found.notes) == 1
        np.testing.assert_allclose(found.rope_at(TIME[1:-1]), ROPE[1:-1], atol=0.02)


REFUSED = {
    "no file": (lambda _p: None, {}, None, "No such file"),
    "a column less": (lambda c: c, {"rope": quantity("hoist", "m")}, None, "'hoist' is missing; there are: 't, slew"),
    "no setpoints": (lambda c: c, {"slew": quantity("slew", "deg", setpoint="s")}, None, "column 's' is missing"),
    "angles as setpoints": (
        lambda c: c, {"slew": quantity("slew", "deg", setpoint="slew")}, None,
        "slew.setpoint: must be another column than 'slew'",
    ),
    "centimetres for metres": (
        column("rope", lambda _c: texts(100 * ROPE)), {}, None,
        "600 of 600 readings refused, the first in row 1: not between 0.5 and 200 m; 1722.11 would be plausible in cm:",
    ),
    "metres for centimetres": (
        lambda c: c, {"rope": quantity("rope", "cm")}, None, "; 17.2211 would be plausible in m or ft: see rope.unit",
    ),
    "radians for degrees": (lambda c: c, {"slew": quantity("slew", "rad")}, None, "is slew.unit right?"),
    "kilometres an hour": (
        column("rope", lambda _c: ["90"] * 600), {"wind": quantity("rope", "m/s")}, None,
        "not between -0.1 and 80 m/s; 90 would be plausible in km/h or kn or mph: see wind.unit",
    ),
    "milliseconds for seconds": (column("t", lambda _c: texts(1000 * TIME)), {}, None, "is time.unit right?"),
    "words alone": (column("rope", lambda c: ["on"] * len(c)), {}, None, "600 of 600 readings refused"),
    "a clock that runs back": (column("t", lambda c: c[::-1]), {}, None, "599 of 600 readings refused"),
    "decimal commas": (
        column("rope", lambda _c: [f'"{text}"'.replace(".", ",") for text in texts(ROPE)]), {}, None,
        "600 of 600 readings refused, the first in row 1: not a number; write decimals with a point",
    ),
    "times of day as texts": (
        column("t", lambda _c: ["08:15:00"] * 600), {"time": {"column": "t", "unit": "iso", "start": "2026-03-02"}},
        None, "begins with 08:15:00: both need a date or none",
    ),
    "no times": (
        column("t", lambda _c: ["8.15"] * 600), {"time": {"column": "t", "unit": "iso", "start": "08:15:00"}},
        None, "not a time; texts such as 2026-03-02T08:15:00, 02.03.2026 08:15:00 or 08:15:00 are needed",
    ),
    "a zone in start alone": (
        column("t", lambda _c: [f"{START + timedelta(seconds=t):%Y-%m-%dT%H:%M:%S.%f}" for t in TIME.tolist()]),
        {"time": {"column": "t", "unit": "iso", "start": "2026-03-02T08:15:00Z"}}, None,
        "begins with 2026-03-02T08:15:00.000000: both need a date or none, and a time zone or none",
    ),
    "one row": (lambda c: {name: cells[:1] for name, cells in c.items()}, {}, None, "1 rows; at least 2"),
    "nothing": (lambda c: c, {}, "", "the file is empty"),
    "no text": (lambda c: c, {}, b"\xff\xfe\x00t,slew\n", "invalid start byte"),
    "an unknown key": (lambda c: c, {"speed": {}}, None, "speed: unknown key"),
    "a wrong unit": (lambda c: c, {"rope": quantity("rope", "inch")}, None, "rope.unit: must be one of: m, dm, cm"),
    "no rate": (lambda c: c, {"rope": {"column": "rope", "resolution": 0.01}}, None, "rope.rate_hz: missing"),
    "nothing to read": (lambda c: c, {"slew": None, "radius": None, "rope": None}, None, "at least one of the tables"),
    "radius and luff": (lambda c: c, {"luff": quantity("rope", "deg", jib_m=30.0)}, None, "luff: leave it out"),
    "a date without a start": (lambda c: c, {"time": {"column": "t", "unit": "iso"}}, None, "time.start: is missing"),
    "a file from elsewhere": (lambda c: c, {"rope": quantity("t", "m", file="../x.csv")}, None, "beside or below"),
}  # fmt: skip


@pytest.mark.parametrize("what", list(REFUSED))
def test_hostile_files_are_one_line(tmp_path, what):
    change, tables, content, expected = REFUSED[what]
    if what == "no file":
        path = tmp_path / "crane.csv"
    else:
        path = plain(tmp_path, change)
        about = {name: table for name, table in (tables_of(path) | tables).items() if table is not None}
        path.with_suffix(".toml").write_text(tomli_w.dumps(about), encoding="utf-8")
    if content is not None:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(RecordError) as caught:
        read_controller(path)
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("encoding", ["utf-8", "cp1252"])
def test_a_file_of_a_spreadsheet_is_read(tmp_path, encoding):
    """Semicolons, decimal commas, a degree sign and a BOM or Windows-1252."""
    path = plain(tmp_path, **{"slew": quantity("slew °", "deg")})
    expected = read_controller(plain(tmp_path))
    path.with_suffix(".toml").write_text(tomli_w.dumps(tables_of(path) | {"slew": quantity("slew °", "deg")}), "utf-8")
    text = path.read_text(encoding="utf-8").replace("slew", "slew °").replace(",", ";").replace(".", ",")
    path.write_bytes(text.encode("utf-8-sig" if encoding == "utf-8" else encoding))
    found = read_controller(path)
    for name in ("time", "slew", "rope"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    assert found.notes == expected.notes


def tables_of(path):
    import tomllib

    return tomllib.loads(path.with_suffix(".toml").read_text(encoding="utf-8"))


@pytest.mark.parametrize("start", [86_390.0, 10.0])
@pytest.mark.parametrize(("unit", "zone"), [("s", ""), ("iso", ""), ("iso", "+02:00")])
def test_times_of_day_may_pass_midnight_by_the_wall_clock(tmp_path, start, unit, zone):
    """The log begins at 86,380 s of the day, and the video before midnight or after it."""
    seconds, about = (TIME + 86_380) % 86_400, {"column": "t", "unit": unit, "start": start}
    if unit == "iso":
        about["start"], *written = (
            f"{int(t // 3600):02d}:{int(t // 60 % 60):02d}:{t % 60:09.6f}{zone}" for t in (start, *seconds)
        )
    cells = texts(seconds) if unit == "s" else written
    found = read_controller(plain(tmp_path, column("t", lambda _c: cells), time=about))
    np.testing.assert_allclose(found.time, TIME - (start - 86_380) % 86_400, atol=1e-5)
    assert "passes midnight" in found.notes[0]
    assert len(found.notes) == 1


@pytest.mark.parametrize("form", ["%Y-%m-%d %H:%M:%S.%f", "%d.%m.%Y %H:%M:%S.%f"])
def test_dates_are_read_in_their_usual_forms(tmp_path, form):
    cells = [(START + timedelta(seconds=t)).strftime(form) for t in TIME.tolist()]
    about = {"column": "t", "unit": "iso", "start": (START + timedelta(seconds=2)).strftime(form)}
    found = read_controller(plain(tmp_path, column("t", lambda _c: cells), time=about))
    np.testing.assert_allclose(found.time, TIME - 2, atol=1e-5)


def test_a_start_that_is_not_stated_is_named_with_the_clock(tmp_path):
    assert "without time.start" in read_controller(plain(tmp_path)).stated_clock.source
    stated = read_controller(plain(tmp_path, time={"column": "t", "start": 0.0}))
    assert stated.stated_clock.source == "its description"


def reading(offset=0.0, clock_sd_s=5.0, rope=ROPE):
    return Controller(TIME - offset, rope=rope, clock_sd_s=clock_sd_s)


def displayed(time, delay):
    """Lengths on a display that takes a new value five times a second."""
    return np.round(np.interp(np.floor(time * 5) / 5 - delay, TIME, ROPE), 2)


def test_a_reading_holds_for_less_than_a_period_outside_of_all():
    data, period = reading(), float(TIME[1] - TIME[0])
    before, after = TIME[0] - period * np.array([1.1, 0.9]), TIME[-1] + period * np.array([0.9, 1.1])
    np.testing.assert_equal(data.rope_at(before), [np.nan, ROPE[0]])
    np.testing.assert_equal(data.rope_at(after), [ROPE[-1], np.nan])


@pytest.mark.parametrize("offset", [-7.3, 0.0, 2.2])
def test_the_clocks_offset_is_found_from_the_display_within_its_delay(offset):
    frames = np.arange(5, 50, 1 / 9)
    for delay in (0.0, 0.4, 0.8):  # and a tenth of a second more, for which the display holds a value
        found = clock_offset(reading(offset), frames, displayed(frames, delay) + 1.0)
        assert found.offset_s == pytest.approx(offset + delay + 0.1 - 0.5, abs=0.05)
        low, high = found.interval_s
        assert low < offset < high
        assert high - low < 1.3
        assert found.difference_m == pytest.approx(1.0, abs=0.1)
        assert "+1.0" in found.note
    known = clock_offset(reading(0.0, clock_sd_s=0.02), frames, displayed(frames, 0.8))
    assert abs(known.offset_s) < 0.01


@pytest.mark.parametrize("offset", [-7.3, 0.0, 2.17])
def test_a_display_does_not_delay_the_controllers_own_lengths(offset):
    """As in the table of a run that used them."""
    frames, data = np.arange(10, 50, 1 / 9), reading(offset)
    found = clock_offset(data, frames, data.shifted(ClockOffset(offset, 0.0, "")).rope_at(frames))
    assert found.offset_s == pytest.approx(offset, abs=0.002)
    assert found.sd_s == DELAY_SD_S  # what a run knows by a display; it may know more by the swing
    assert found.source == "its own lengths"


def test_a_clock_that_lengths_cannot_show_is_the_stated_one():
    frames = np.arange(5, 50, 1 / 9)
    still = clock_offset(reading(rope=np.full(len(TIME), 15.0)), frames, np.full(len(frames), 15.0))
    none = clock_offset(reading(rope=None), frames, np.full(len(frames), 15.0))
    unread = clock_offset(reading(), frames, np.full(len(frames), np.nan))
    assert {(one.offset_s, one.sd_s, one.source) for one in (still, none, unread)} == {(0.0, 5.0, "its description")}


def test_another_record_is_refused():
    frames = np.arange(5, 50, 1 / 9)
    with pytest.raises(RecordError, match=r"does not follow the display's: they differ by \d\.\d m"):
        clock_offset(reading(), frames, 30 - displayed(frames, 0.5))
    for stated, true in (("m", "ft"), ("ft", "m"), ("cm", "m"), ("mm", "cm"), ("m", "dm")):
        wrong = dataclasses.replace(reading(rope=ROPE * PER[stated] / PER[true]), rope_unit=stated)
        with pytest.raises(RecordError, match=rf"they follow in {true}, not {stated}: see rope\.unit"):
            clock_offset(wrong, frames, displayed(frames, 0.5))
    with pytest.raises(RecordError, match=r"is it another record\?"):  # a display that hardly moves fits any factor
        clock_offset(reading(rope=15 + (ROPE - 15) / 2), frames, 15 + 0.1 * np.sin(frames))
    with pytest.raises(RecordError, match=r"no time in common: 0\.0 to 59\.9 s and 100\.0 to .* time\.start"):
        clock_offset(reading(), frames + 95, displayed(frames, 0.5))


def without_display(crane):
    return [msgspec.structs.replace(s, rope_status="", hoist_m=None, rope_text=None) for s in crane.observations(1.0)]


def test_the_controllers_rope_replaces_a_display():
    crane = swinging.record(frames=450)
    camera = msgspec.structs.replace(crane.calibration, digit_layout=None)
    blind = without_display(crane)
    data = Controller(crane.time, rope=crane.rope, notes=("one row refused",))
    pipeline = Pipeline(nobody, None, controller=data)
    found = pipeline.conclude(blind, camera)
    without = Pipeline(nobody, None, RopeAware(intervals=rooms.WORKING)).conclude
    assert found.estimate.estimator == "rope-aware"
    np.testing.assert_array_equal(found.arrays.rope_length, crane.rope)
    assert found.clock.source == "its description"
    with pytest.raises(RunError, match="there is none of the controller"):
        without(blind, camera)
    half = dataclasses.replace(data, time=crane.time[:200], rope=crane.rope[:200])
    late = dataclasses.replace(pipeline, controller=half).conclude(blind, camera).measurements[300]
    assert (late.status, late.reason) == ("unread", "neither a display nor the controller states the rope's length")
    about = _controller(pipeline, found)
    assert about["notes"] == ["one row refused"]
    assert (about["clock_offset_s"], about["clock_by_motion_s"], about["clock_used_s"]) == (0.0, None, 0.0)
    assert about["wind_m_s"] is None
    windy = dataclasses.replace(pipeline, controller=dataclasses.replace(data, wind=np.array([[0.0, 9.0], [9.0, 9.0]])))
    assert _controller(windy, found)["wind_m_s"] == 9.0
    later = dataclasses.replace(found.estimate, diagnostics={"clock_s": -0.4, "clock_sd_s": 0.1})  # 0.4 s late
    assert _controller(pipeline, dataclasses.replace(found, estimate=later))["clock_used_s"] == -0.4
    with pytest.raises(RecordError, match="follow each other in time"):
        pipeline.conclude([msgspec.structs.replace(s, time_s=None) for s in blind], camera)


@pytest.mark.parametrize("late_s", [1.5, 0.1])
def test_the_rope_is_that_of_the_clock_that_the_swing_shows(late_s):
    """Without a display, and a controller that is late."""
    crane = swinging.record(frames=400, seed=104)
    camera = msgspec.structs.replace(crane.calibration, digit_layout=None)
    blind = without_display(crane)
    late = np.arange(crane.time[0], crane.time[-1], 0.05)
    series = [np.interp(late, crane.time, of) for of in (*crane.jib.T, crane.rope)]
    data = Controller(late + late_s, *series, 1e-4, 0.003, clock_sd_s=1.0)
    found = Pipeline(nobody, None, controller=data).conclude(blind, camera)
    late = found.estimate.diagnostics
    assert late["clock_s"] == pytest.approx(-late_s, abs=0.05)
    assert abs(late["clock_s"] + late_s) < 3 * late["clock_sd_s"] < 0.3
    used = np.array([m.rope_length_m for m in found.measurements], float)
    known = slice(int(late_s < 1), None)  # at 0.1 s the first frame is of before the first reading
    np.testing.assert_allclose(used[known], crane.rope[known], atol=0.03)
    np.testing.assert_array_equal(used, found.arrays.rope_length)
    off = np.array([m.alpha for m in found.measurements], float) - crane.alpha
    assert np.degrees(np.sqrt(np.mean(off[known] ** 2))) < 0.1


def test_an_estimator_with_a_controller_gets_it_on_the_pictures_clock(monkeypatch):
    @dataclasses.dataclass(frozen=True)
    class Informed(RopeAware):
        controller: Controller | None = None

    crane, seen = swinging.record(frames=450), []
    data = Controller(crane.time - 3.0, crane.time * 0, None, crane.rope, clock_sd_s=5.0)
    monkeypatch.setattr(Informed, "_conclude", lambda self, frames, camera: seen.append(self.controller) or
                        RopeAware._conclude(self, frames, camera))  # fmt: skip
    found = Pipeline(nobody, nobody, Informed(), controller=data).conclude(crane.observations(1.0), crane.calibration)
    assert found.estimate.ok
    assert found.clock.offset_s == pytest.approx(2.5, abs=0.1)  # the display of this record has no delay
    np.testing.assert_allclose(seen[0].time, data.time + found.clock.offset_s)


def test_a_description_is_a_value_too(tmp_path):
    path = plain(tmp_path)
    facts = convert(tables_of(path), ControllerFacts, RecordError)
    path.with_suffix(".toml").unlink()
    np.testing.assert_allclose(read_controller(path, facts).rope, ROPE, atol=1e-6)
    with pytest.raises(RecordError, match=r"crane\.toml: No such file"):
        read_controller(path)


@pytest.mark.parametrize(
    ("offset_s", "said"),
    [
        (0.0, "that of the pictures (-0.98 to +0.98 s), from a file"),
        (-1.0, "+1.00 s (+0.02 to +1.98) ahead of the pictures', from a file"),
        (1.0, "+1.00 s (+0.02 to +1.98) behind the pictures', from a file"),
    ],
)
def test_a_clock_is_stated_in_words(offset_s, said):
    clock = ClockOffset(offset_s, 0.5, "a file")
    assert in_words(clock.offset_s, clock.interval_s, clock.source, None) == said


def test_radii_of_live_runs_are_of_readings_known_by_then():
    time = np.arange(0, 60, 0.5)
    radius = np.where(time < 30, 20.0, 20 + 0.4 * (time - 30))
    data = Controller(time, None, radius.copy(), radius_sd=0.01, clock_sd_s=0.2, motion_late_s=1.0)
    at = np.array([-1.0, 0.5, 20.0, 30.9, 40.0, 40.4, 59.4, 63.0])
    whole, live = data.radii(at), data.radii(at, live=True)
    np.testing.assert_allclose(whole.value[2:6], 20 + 0.4 * np.maximum(at[2:6] - 30, 0), atol=1e-9)
    assert np.isnan(live.value[:2]).all()
    np.testing.assert_allclose(live.value[[2, 3, 4]], [20, 20, 24], atol=1e-9)  # it luffs on for a second
    assert live.sd[2] == pytest.approx(0.01)
    assert live.sd[4] == pytest.approx(np.hypot(0.01, 0.4 * 0.2), rel=1e-6)
    assert live.sd[7] > 0.5  # long after the last reading
    later = dataclasses.replace(data, radius=np.where(time > 39, 99.0, radius))
    np.testing.assert_array_equal(later.radii(at[:5], live=True).value, live.value[:5])
    data.radius[-4:] = np.nan  # a series that ends sooner than the others
    assert np.isfinite(data.radii(np.array([59.9]), 0.3, live=True).value).all()
    assert Controller(time, None, np.full(120, np.nan)).radii(at) is None
    assert Controller(time, radius).radii(at) is None


@pytest.mark.parametrize("lag_s", [-2.0, 0.4])
def test_readings_are_not_known_before_their_time(tmp_path, lag_s):
    path = plain(
        tmp_path, slew=quantity("slew", "deg", lag_s=lag_s), radius=quantity("radius", "m", constant_m=0.0, lag_s=lag_s)
    )
    assert read_controller(path).motion_late_s == max(lag_s, 0.0)
