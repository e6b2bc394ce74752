"""Tables are read as Arrow reads them, and without its threads."""

import os
import subprocess
import sys

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from simgrab.errors import RecordError
from simgrab.io import parquet

COUNT = """
import pathlib, sys
import pyarrow as pa
from simgrab.dataset import datasets
from simgrab.io import parquet
from simgrab.errors import RunError

threads = lambda: {path.name for path in pathlib.Path("/proc/self/task").iterdir()}
pa.table({"a": [1.0]})
before = threads()
file = pathlib.Path(sys.argv[1])
parquet.read_table(file, RunError)
parquet.read_table(file, RunError, columns=["a"])
list(parquet.groups(file))
datasets.read(sys.argv[2])
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
    with file.open("rb") as handle:
        assert parquet.parse_table(handle, RecordError, "x") == whole
        assert not handle.closed
    assert (
        parquet.read_table(file, RecordError, columns=["c", "a"]).column_names
        == pq.ParquetFile(file).read(["c", "a"]).column_names
    )
    assert [group.num_rows for group in parquet.groups(file)] == [2000, 2000, 1000]
    assert pa.concat_tables(parquet.groups(file)) == whole


def test_texts_are_what_was_written(tmp_path):
    texts = ["é", None, "", "é", "x" * 1000] * 20
    kinds = (pa.string(), pa.large_string(), pa.string_view(), pa.dictionary(pa.int32(), pa.string()))
    table = pa.table({str(kind): pa.array(texts, kind) for kind in kinds} | {"b": pa.array(texts, pa.binary())})
    table = table.replace_schema_metadata({"of": "all"})
    pq.write_table(table, tmp_path / "a.parquet", row_group_size=30)
    found = parquet.read_table(tmp_path / "a.parquet", RecordError)
    assert found.schema.metadata == table.schema.metadata
    for name in found.column_names[:-1]:
        assert found[name].to_pylist() == texts
    assert found["b"] == table["b"]


MANY = 30_000_000


def shared(value, rows):
    return pa.DictionaryArray.from_arrays(pa.array(np.zeros(rows, np.int32)), pa.array([value]))


BOMBS = {
    "text": lambda: shared("x" * 1_000_000, 1000),
    "bytes": lambda: shared(b"x" * 1_000_000, 1000),
    "list": lambda: pa.array([np.zeros(MANY, np.int8)]),
    "list of nothing": lambda: pa.ListArray.from_arrays([0, MANY], pa.nulls(MANY)),
    "list of lists": lambda: pa.ListArray.from_arrays([0, 1], pa.array([np.zeros(MANY, np.int8)])),
    "struct": lambda: pa.array([{"b": "x" * 100_000}] * 1000),
}
LIMITED = """
import resource, sys
from pathlib import Path
import pyarrow as pa
from simgrab.io import parquet
from simgrab.errors import RecordError

parquet.read_table(Path(sys.argv[1]) / "sound", RecordError)
status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
limit = int(status["VmSize"].split()[0]) * 1024 + 600 * 2**20
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
for path in sorted(Path(sys.argv[1]).iterdir()):
    try:
        parquet.rows(parquet.read_table(path, RecordError), RecordError, "x")
    except RecordError as problem:
        print(path.name, problem, sep=": ")
assert pa.default_memory_pool().max_memory() < 400 * 2**20
"""
# As for simgrab's commands. Arrow's own pool reserves 1 GiB of address space at once, so that no limit would be felt;
# the system's takes some 420 MiB of it for the 320 MiB of these tables.
LIMITED_IN = os.environ | {"ARROW_DEFAULT_MEMORY_POOL": "system"}


def test_a_few_bytes_do_not_take_much_memory(tmp_path):
    for name, column in BOMBS.items():
        pq.write_table(pa.table({"a": column()}), tmp_path / name, compression="zstd", store_schema=False)
        assert (tmp_path / name).stat().st_size < 10_000
    pq.write_table(pa.table({"a": ["x"]}), tmp_path / "sound")
    for name, size in (("hole", 3 * 2**30), ("larger hole", parquet.MOST_BYTES + 1)):
        with (tmp_path / name).open("wb") as file:
            file.truncate(size)
    command = [sys.executable, "-c", LIMITED, str(tmp_path)]
    done = subprocess.run(command, env=LIMITED_IN, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = dict(line.split(": ", 1) for line in done.stdout.splitlines())
    assert found.keys() == {*BOMBS, "hole", "larger hole"}
    assert "not a parquet file" in found.pop("hole")
    assert "the limit is 4096 MiB" in found.pop("larger hole")
    assert "has the unsupported type" in found.pop("list of nothing")  # which takes none
    for name, problem in found.items():
        assert problem.endswith("bytes of memory"), name


def test_rows_are_counted_before_they_are_read(file, monkeypatch):
    monkeypatch.setattr(parquet, "MOST_ROWS", 4999)
    monkeypatch.setattr("pyarrow.parquet.ParquetFile.read", None)
    with pytest.raises(RecordError, match="it has 5000 rows; the limit is 4999"):
        parquet.read_table(file, RecordError)


def test_no_thread_is_started(file, dataset):
    """One of Arrow's that lets go of Python's bytes while Python ends aborts the process, now and then."""
    subprocess.run([sys.executable, "-c", COUNT, str(file), str(dataset)], check=True)


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
        (pa.table({"a": [[["x"]]]}), "x: column a has the unsupported type list<.*"),
        (pa.table({"a": [{"b": 1}]}), "x: column a has the unsupported type struct<b: int64>"),
        (pa.Table.from_arrays([pa.array([1])] * 3, ["a", "b", "a"]), "x: duplicate column a"),
    ],
    ids=["text", "date", "list", "struct", "twice"],
)
def test_a_column_that_python_cannot_hold_is_named(table, problem):
    with pytest.raises(RecordError, match=problem):
        parquet.rows(table, RecordError, "x")


def test_a_changed_byte_is_read_or_refused(tmp_path):
    """In a process of its own, which a fault of Arrow would abort."""
    pq.write_table(pa.table({"text": ["left", "right", None] * 20}), tmp_path / "a.parquet", compression="none")
    done = subprocess.run(
        [sys.executable, "-c", CHANGE, str(tmp_path / "a.parquet")], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-10:] + done.stderr
    assert {"read", "refused"} <= set(done.stdout.split())


CHANGE = """
import pathlib, sys
from simgrab.io import parquet
from simgrab.errors import RecordError

path = pathlib.Path(sys.argv[1])
whole = path.read_bytes()
for i in range(len(whole)):
    print(i, end=" ")
    path.write_bytes(whole[:i] + bytes([whole[i] ^ 0x05]) + whole[i + 1 :])
    try:
        parquet.read_table(path, RecordError).to_pylist()
        print("read")
    except RecordError:
        print("refused")
"""
