import json
import re

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
import tomli_w
from click.testing import CliRunner

from simgrab.cli.estimate import command
from simgrab.errors import SimgrabError
from simgrab.instrument.estimate import ESTIMATORS, PendulumSmoother
from simgrab.instrument.estimate.intervals import WORKING
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import camera_rotation, grab_centre, to_camera

CAMERA = Calibration(width_px=1920, height_px=1080, focal_length_px=1644.82, cx_px=960.0, cy_px=540.0, k1=-0.1)


@pytest.fixture
def camera(tmp_path):
    CAMERA.save(tmp_path / "camera.toml")
    return tmp_path / "camera.toml"


@pytest.fixture
def table():
    """A swing at its own frequency under a camera tilted by 4 degrees."""
    time = np.arange(120) / 9
    sway = np.deg2rad(2) * np.stack([np.cos(0.7 * time), 0.4 * np.sin(0.7 * time)], -1)
    centre = grab_centre(np.hypot(*sway.T), np.arctan2(sway[:, 1], sway[:, 0]), 20.0)
    pixels = CAMERA.intrinsics.project(to_camera(centre, camera_rotation(np.deg2rad(4.0), 0.7, 0.0), np.zeros(3)))
    return {"u_px": pixels[:, 0], "v_px": pixels[:, 1], "rope_length_m": np.full(120, 20.0), "time_s": time}


def write(path, table):
    rows = zip(*table.values(), strict=True)
    text = "\n".join([",".join(table), *(",".join(str(cell) for cell in row) for row in rows)])
    path.write_text(text + "\n")
    return path


def controller(path, time, start=None, **quantities):
    """A controller's data, with their description beside them; ``start`` is its time 0."""
    write(path, {"t": time} | {name: np.broadcast_to(values, len(time)) for name, values in quantities.items()})
    about = {"time": {"column": "t", "clock_sd_s": 0.1} | ({"start": start} if start else {})}
    about |= {name: {"column": name, "rate_hz": 10.0, "resolution": 0.01} for name in quantities}
    path.with_suffix(".toml").write_text(tomli_w.dumps(about))
    return path


@pytest.fixture
def bare(tmp_path, table):
    return write(tmp_path / "bare.csv", {name: table[name] for name in ("u_px", "v_px", "time_s")})


def call(*arguments):
    return CliRunner().invoke(command, [str(a) for a in arguments])


@pytest.mark.parametrize(("quantity", "estimator"), [("rope", "rope-aware"), ("slew", "pendulum-smoother")])
def test_a_controllers_data_take_the_place_of_the_column(quantity, estimator, tmp_path, camera, table, bare):
    """They come 2 s late, and end 1 s before the pictures."""
    time = np.arange(-20, 124) / 10
    crane = controller(tmp_path / "crane.csv", time + 2, 2.0, **({quantity: 0.0} | {"rope": 20.0}))
    given = ["--camera", camera, "--json"]
    result = call(bare, *given, "--plc", crane)
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert (found["estimator"], found["status"]) == (estimator, "ok")
    assert len(found["alpha_deg"]) == 120
    said = "controller's clock: that of the pictures (-0.20 to +0.20 s), from its description"
    assert found["warnings"][-1].startswith(said)
    assert sum("rope.constant_m is not stated" in warning for warning in found["warnings"]) == 1
    if quantity == "rope":
        late = table["time_s"] > time[-1] + 0.1
        assert [alpha is None for alpha in found["alpha_deg"]] == late.tolist()
        own = {name: column[~late] for name, column in table.items()}
        own = call(write(tmp_path / "own.csv", own), *given, "--estimator", estimator)
        assert found["beta_deg"] == pytest.approx(json.loads(own.stdout)["beta_deg"])


def test_motion_beyond_the_controllers_data_is_left_out_as_in_a_run(tmp_path, camera, table, bare):
    """Its rope and slewing cover the first half of the record alone."""
    time = np.arange(-20, 60) / 10
    crane = controller(tmp_path / "crane.csv", time, rope=20.0, slew=0.0)
    found = json.loads(call(bare, "--camera", camera, "--json", "--plc", crane).stdout)
    assert found["status"] == "ok", found["reason"]
    assert [alpha is None for alpha in found["alpha_deg"]] == (table["time_s"] > time[-1] + 0.1).tolist()


def test_a_refusal_has_an_exit_status(tmp_path, camera, table):
    """The controller reports slewing for the first half of the record alone."""
    time = np.arange(60) / 10
    crane = controller(tmp_path / "crane.csv", time, slew=3 * time)
    given = [write(tmp_path / "swing.csv", table), "--camera", camera, "--plc", crane]
    shown, plain = call(*given), call(*given, "--json")
    assert (shown.exit_code, plain.exit_code) == (1, 1)
    assert "pendulum-smoother: refused. the controller reports from" in shown.stdout
    assert json.loads(plain.stdout)["status"] == "refused"
    assert json.loads(plain.stdout)["above_10_deg"] == {"share": None, "low": None, "high": None}


def test_deviations_of_pixels_widen_intervals_as_in_a_run(tmp_path, camera, table):
    """They are columns of a run's angles.csv; frames without a detection have none."""
    gone = np.arange(120) == 7
    blank = {name: np.where(gone, "", table[name].astype(str)) for name in ("u_px", "v_px")}
    stated = table | blank | {"u_sd_px": np.where(gone, "", "3.0"), "v_sd_px": np.where(gone, "", "4.0")}
    given = ["--camera", camera, "--estimator", "pendulum", "--json"]
    found = json.loads(call(write(tmp_path / "stated.csv", stated), *given).stdout)
    exact = json.loads(call(write(tmp_path / "exact.csv", table | blank), *given).stdout)
    pixels, length, time = (table[name][~gone] for name in ("u_px", "rope_length_m", "time_s"))
    pixels = np.column_stack([pixels, table["v_px"][~gone]])
    estimator = PendulumSmoother(wander_px=12.5**0.5, intervals=WORKING)
    ends = estimator.estimate(pixels, CAMERA, rope_length=length, time=time, pixel_sd=np.full(119, 12.5**0.5))
    stated, plain = (np.array(one["intervals"][0]["alpha_deg"], float) for one in (found, exact))
    assert found["frames"] == 119
    assert found["alpha_deg"][7] is None
    assert np.isnan(stated[7]).all()
    np.testing.assert_allclose(stated[~gone], np.degrees(ends.intervals[0].alpha), rtol=1e-6)
    widths = [np.nanmean(np.diff(one)) for one in (stated, plain)]
    assert widths[0] > 1.3 * widths[1]


def test_the_share_of_frames_above_10_degrees_is_printed(tmp_path, camera, table):
    centre = np.mean([table["u_px"], table["v_px"]], axis=1)
    far = table | {name: c + 6 * (table[name] - c) for name, c in zip(("u_px", "v_px"), centre, strict=True)}
    file = write(tmp_path / "far.csv", far)
    found = json.loads(call(file, "--camera", camera, "--json").stdout)
    alpha, (low, high) = np.array(found["alpha_deg"]), np.array(found["intervals"][0]["alpha_deg"]).T
    above = found["above_10_deg"]
    assert (above["low"], above["high"]) == (np.mean(low > 10), np.mean(high > 10))
    assert above["low"] < above["share"] < above["high"]
    assert above["share"] == pytest.approx(np.mean(alpha > 10), abs=0.1)
    shown = call(file, "--camera", camera).stdout
    assert f"{100 * above['share']:.2f}" in shown
    assert f"{100 * above['low']:.2f} to {100 * above['high']:.2f}" in shown


@pytest.mark.parametrize("name", list(ESTIMATORS))
def test_every_estimator_prints_json_that_says_what_the_table_says(name, tmp_path, camera, table):
    file = write(tmp_path / "swing.csv", table)
    result = call(file, "--camera", camera, "--estimator", name, "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.output)
    assert found["estimator"] == name
    assert found["status"] == "ok"
    assert len(found["alpha_deg"]) == 120
    assert found["intervals"][0]["kind"] == ("posterior" if name == "pendulum-smoother" else "iid")
    if name in ("mean-ray", "pendulum-smoother"):
        assert found["beta_deg"] == pytest.approx(4.0, abs=0.5)
    shown = call(file, "--camera", camera, "--estimator", name)
    assert f"{found['beta_deg']:.3f}" in shown.output
    assert ("too few blocks" if name == "pendulum-smoother" else "of frames 0.6 s apart") in shown.output


def test_the_mean_ray_is_the_default(tmp_path, camera, table):
    file = write(tmp_path / "swing.csv", table)
    result = call(file, "--camera", camera)
    assert "mean-ray, 120 frames" in result.output


def test_parquet_and_csv_are_one(tmp_path, camera, table):
    pa.parquet.write_table(pa.table(table), tmp_path / "swing.parquet")
    file = write(tmp_path / "swing.csv", table)
    one, other = (call(f, "--camera", camera, "--json").output for f in (file, tmp_path / "swing.parquet"))
    assert json.loads(one) == json.loads(other)


def test_a_datasets_labels_are_a_record(tmp_path, camera, table):
    labels = {"frame": np.arange(120), "grab_u_px": table["u_px"], "grab_v_px": table["v_px"]}
    labels |= {"rope_length_m": table["rope_length_m"], "time_s": pa.nulls(120, pa.float64())}
    pa.parquet.write_table(pa.table(labels), tmp_path / "labels.parquet")
    pa.parquet.write_table(pa.table(table), tmp_path / "swing.parquet")
    for name in ("mean-ray", "rope-aware"):
        one, other = (
            json.loads(call(tmp_path / f, "--camera", camera, "--estimator", name, "--json").stdout)
            for f in ("labels.parquet", "swing.parquet")
        )
        assert one["beta_deg"] == other["beta_deg"]
        assert one["alpha_deg"] == other["alpha_deg"]
        assert one["intervals"][0]["note"] == ""  # no times were given


@pytest.mark.parametrize(
    ("name", "rope"), [(n, r) for n, kind in ESTIMATORS.items() for r in (True, False) if r or not kind.needs_rope]
)
@pytest.mark.parametrize("offset", [0.0, 0.02, 0.6])  # on 20 m: 0, 0.06 and 1.7 deg
def test_an_offset_that_passes_for_tilt_is_warned_of(name, rope, offset, tmp_path, table):
    msgspec.structs.replace(CAMERA, offset_m=(0.0, offset, -0.3)).save(tmp_path / "camera.toml")
    knows = ESTIMATORS[name].needs_rope
    file = write(tmp_path / "swing.csv", table if rope else without("rope_length_m")(table))
    result = call(file, "--camera", tmp_path / "camera.toml", "--estimator", name, "--json")
    warned = not knows and (offset > 0.1 if rope else offset > 0)
    warnings = json.loads(result.stdout)["warnings"]
    assert len(warnings) == warned
    assert result.stderr.count("warning: ") == warned
    if warned:
        assert f"{offset:.2f} m" in warnings[0]
        assert name in warnings[0]
        assert "rope-aware" in warnings[0]
        assert "\n" not in warnings[0]
        assert ("1.7 deg" in warnings[0]) == rope


def changed(column, row, value):
    def change(table):
        table[column] = [value if i == row else cell for i, cell in enumerate(table[column])]
        return table

    return change


def kept(rows):
    return lambda table: {name: values[:rows] for name, values in table.items()}


def without(column):
    return lambda table: {name: values for name, values in table.items() if name != column}


def scaled(factor):
    return lambda table: table | {"u_px": table["u_px"] * factor, "v_px": table["v_px"] * factor}


BAD = {
    "no v": ("mean-ray", without("v_px"), r"column v_px is missing; there are: u_px, rope_length_m, time_s"),
    "both pairs": (
        "mean-ray",
        lambda table: table | {"grab_u_px": table["u_px"], "grab_v_px": table["v_px"]},
        r"columns u_px, v_px and grab_u_px, grab_v_px are both present; keep only one pair",
    ),
    "a mixed pair": (
        "mean-ray",
        lambda table: without("v_px")(table) | {"grab_v_px": table["v_px"]},
        r"columns u_px and grab_v_px are both present",
    ),
    "half of the labels' pair": (
        "mean-ray",
        lambda table: {"grab_u_px": table["u_px"], "time_s": table["time_s"]},
        r"column grab_v_px is missing; there are: grab_u_px, time_s",
    ),
    "no rope": ("rope-aware", without("rope_length_m"), r"column rope_length_m is missing"),
    "no time": ("pendulum-smoother", without("time_s"), r"column time_s is missing"),
    "fractions": ("mean-ray", scaled(1 / 1920), r"use pixels, not fractions"),
    "another picture": ("mean-ray", scaled(4.0), r"u_px, row 1: \d+\.?\d* lies outside any picture of 1920 x 1080"),
    "no rows": ("mean-ray", kept(0), r"no rows"),
    "two rows": ("mean-ray", kept(2), r"2 of 2 rows have a pixel; mean-ray needs at least 3"),
    "four rows": ("rope-aware", kept(4), r"4 of 4 rows have a pixel and a rope length; rope-aware needs at least 5"),
    "rope 0": ("rope-aware", changed("rope_length_m", 4, 0.0), r"rope_length_m, row 5: is 0; must be metres, above 0"),
    "rope in cm": ("rope-aware", changed("rope_length_m", 0, 2000.0), r"rope_length_m, row 1: is 2000; must be metres"),
    "a deviation below 0": (
        "mean-ray",
        lambda table: table | {"u_sd_px": np.where(np.arange(120) == 3, -1.0, 1.0)},
        r"u_sd_px, row 4: is -1; must be 0 px or more",
    ),
    "rope gone": ("rope-aware", changed("rope_length_m", 2, ""), r"rope_length_m, row 3: is missing"),
    "a word": ("mean-ray", changed("v_px", 9, "left"), r"v_px, row 10: 'left' is not a number"),
    "time back": ("pendulum-smoother", changed("time_s", 6, 0.1), r"time_s, row 7: must increase, got 0.1 after"),
    "time gone": ("mean-ray", changed("time_s", 6, ""), r"time_s, row 7: is missing"),
}


@pytest.mark.parametrize("what", BAD)
def test_bad_input_is_reported_in_one_line_with_row_or_column(what, tmp_path, camera, table):
    estimator, change, message = BAD[what]
    file = write(tmp_path / "bad.csv", change(table))
    result = call(file, "--camera", camera, "--estimator", estimator)
    assert isinstance(result.exception, SimgrabError), result.output
    text = str(result.exception)
    assert "\n" not in text
    assert "bad.csv" in text
    assert re.search(message, text), text


@pytest.mark.parametrize(("content", "message"), [("", "the file is empty"), ("u_px,v_px\n1,2,3\n", "cannot read")])
def test_a_file_that_is_no_table(content, message, tmp_path, camera):
    (tmp_path / "bad.csv").write_text(content)
    result = call(tmp_path / "bad.csv", "--camera", camera)
    assert message in str(result.exception)
    assert "\n" not in str(result.exception)


def test_columns_that_are_not_read_may_have_any_names(tmp_path, camera, table):
    file = write(tmp_path / "plain.csv", table)
    header, *rows = file.read_text().splitlines()
    (tmp_path / "sheet.csv").write_text("\n".join([f"{header},note,note,,", *(f"{row},a,b,," for row in rows)]))
    found = [call(tmp_path / name, "--camera", camera, "--json") for name in ("plain.csv", "sheet.csv")]
    assert [one.exit_code for one in found] == [0, 0]
    assert found[0].output == found[1].output
    (tmp_path / "bad.csv").write_text("u_px,v_px,u_px\n1,2,3\n")
    assert "duplicate column u_px" in str(call(tmp_path / "bad.csv", "--camera", camera).exception)


def test_files_that_are_not_there(tmp_path, camera, table):
    assert "cannot read" in str(call(tmp_path / "no.csv", "--camera", camera).exception)
    file = write(tmp_path / "swing.csv", table)
    assert "cannot read camera file" in str(call(file, "--camera", tmp_path / "no.toml").exception)
