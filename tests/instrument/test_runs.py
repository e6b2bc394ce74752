import dataclasses
import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from films import picture
from test_run import CAMERA, Acting

from simgrab.errors import RunError
from simgrab.instrument.contract import Frame, Measurement
from simgrab.instrument.run import runs
from simgrab.instrument.run.run import measure


def fixed(frames):
    for i, frame in enumerate(frames):
        if frame.picture is None:
            yield Measurement(status="lost", reason=frame.reason)
        else:
            yield Measurement(status="ok", alpha=0.2, danger=0.9, centre=(30.0 + i, 20.0), rope_text="1500 1600")


@pytest.fixture
def made():
    frames = [Frame(picture(i), i / 9) for i in range(11)]
    return measure([*frames, Frame(None, 11 / 9, "gone")], CAMERA, Acting(fixed), source="video")


@pytest.fixture
def folder(made, tmp_path):
    runs.save(made, tmp_path)
    return tmp_path


def change(path, place, value):
    data = json.loads(path.read_text())
    inner = data
    for step in place[:-1]:
        inner = inner[step]
    inner[place[-1]] = value
    path.write_text(json.dumps(data))


def test_a_saved_run_is_read_back(made, folder):
    again = runs.load(folder)
    assert len(again.events) == len(made.events) == 1
    assert (again.instrument, again.source, again.names) == (made.instrument, made.source, made.names)
    np.testing.assert_array_equal(again.time, made.time)
    assert runs.alarms(again.events)[0] == pytest.approx(runs.alarms(made.events)[0])
    for one, other in zip(runs.rows(again), runs.rows(made), strict=True):
        assert one == pytest.approx(other)
    assert again.about == json.loads(json.dumps(made.about))


@pytest.mark.parametrize("frames", [0, 1, 1024, 1025])
def test_a_table_has_a_row_for_each_frame(made, frames):
    nothing = Measurement(status="missed", reason="-")
    names = tuple(map(str, range(frames)))
    table = runs.table(dataclasses.replace(made, time=None, names=names, measurements=(nothing,) * frames))
    assert table["file"].to_pylist() == list(names)
    assert table.schema == runs.table(made).schema


@pytest.mark.parametrize(
    ("file", "place", "value", "named"),
    [
        (runs.ABOUT, ("counts", "ok"), "many", "counts"), (runs.ABOUT, ("counts",), 3, "counts"),
        (runs.ABOUT, ("tilt",), {"beta_deg": 3}, "tilt"), (runs.ABOUT, ("estimate",), [], "estimate"),
        (runs.ABOUT, ("timed",), "yes", "timed"), (runs.ABOUT, ("instrument",), {}, "instrument"),
        (runs.ALARMS, (0, "end_s"), [1.0], ""), (runs.ALARMS, (0, "peak_frame"), 1.5, ""),
        (runs.ALARMS, (0, "danger"), None, ""), (runs.ALARMS, (0, "alpha_deg"), "x", ""),
    ],
)  # fmt: skip
def test_facts_and_alarms_of_another_kind_are_refused(folder, file, place, value, named):
    change(folder / file, place, value)
    with pytest.raises(RunError, match=rf"not a run of simgrab .*{named}"):
        runs.load(folder)


@pytest.mark.parametrize(
    ("column", "values", "named"),
    [
        ("rope_text", ["15"] * 12, "rope_text: must be four digits"),
        ("u_px", [float("nan")] * 12, "centre: .* is not finite"),
        ("alpha_deg", [91.0] * 12, "beyond the horizontal"),
        ("time_s", [None] * 12, "float"),
        ("file", [3] * 12, "str"),
        ("file", None, "file"),
        ("status", [2**62] * 12, "status"),
    ],
)
def test_rows_that_no_instrument_gives_are_refused(folder, column, values, named):
    table = pq.read_table(folder / runs.TABLE)
    i = table.column_names.index(column)
    changed = table.remove_column(i) if values is None else table.set_column(i, column, pa.array(values))
    pq.write_table(changed, folder / runs.TABLE)
    with pytest.raises(RunError, match=rf"not a run of simgrab .*{named}"):
        runs.load(folder)
