"""Tables are read as Arrow reads them, and without its threads."""

import subprocess
import sys

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from simgrab import parquet
from simgrab.errors import RecordError

COUNT = """
import pathlib, sys
import pyarrow as pa
from simgrab import parquet
from simgrab.errors import RunError

threads = lambda: {path.name for path in pathlib.Path("/proc/self/task").iterdir()}
pa.table({"a": [1.0]})
before = threads()
file = pathlib.Path(sys.argv[1])
parquet.read_table(file, RunError)
parquet.read_table(file, RunError, columns=["a"])
list(parquet.groups(file))
assert threads() == before, "Arrow reads in threads"
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    table = pa.table({"a": range(5000), "b": [str(i) for i in range(5000)], "c": [[1.0, 2.0]] * 5000})
    path = tmp_path_factory.mktemp("tables") / "a=7" / "table.parquet"
    path.parent.mkdir()
    pq.write_table(table, path, row_group_size=2000)
    return path


def test_a_table_is_what_arrow_reads(file):
    whole = pq.ParquetFile(file).read()
    assert parquet.read_table(file, RecordError) == whole
    assert parquet.parse_table(file.read_bytes(), RecordError, "x") == whole
    assert (
        parquet.read_table(file, RecordError, columns=["c", "a"]).column_names
        == pq.ParquetFile(file).read(["c", "a"]).column_names
    )
    assert [group.num_rows for group in parquet.groups(file)] == [2000, 2000, 1000]
    assert pa.concat_tables(parquet.groups(file)) == whole


def test_no_thread_is_started(file):
    subprocess.run([sys.executable, "-c", COUNT, str(file)], check=True)


TEXTS_OF_BYTES = pa.Array.from_buffers(
    pa.string(), 2, [None, pa.array([0, 2, 4], pa.int32()).buffers()[1], pa.py_buffer(b"\xff\xfe\xff\xfe")]
)


def test_rows_are_what_was_written():
    rows = [{"a": 1, "b": [0.5, None], "c": "é"}, {"a": None, "b": [], "c": None}]
    assert parquet.rows(pa.Table.from_pylist(rows), RecordError, "x") == rows
    assert parquet.rows(pa.table({"a": pa.array([], pa.int64())}), RecordError, "x") == []


@pytest.mark.parametrize(
    ("table", "problem"),
    [
        (pa.table({"when": TEXTS_OF_BYTES}), "x: column when cannot be read"),
        (pa.table({"when": pa.array([2**62], pa.timestamp("us"))}), "x: column when cannot be read"),
        (pa.Table.from_arrays([pa.array([1])] * 3, ["a", "b", "a"]), "x: column a is there twice"),
    ],
    ids=["text", "date", "twice"],
)
def test_a_column_that_python_cannot_hold_is_named(table, problem):
    with pytest.raises(RecordError, match=problem):
        parquet.rows(table, RecordError, "x")
