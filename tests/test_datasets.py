import shutil
import subprocess
import sys

import pyarrow.parquet as pq
import pytest

from simgrab import datasets
from simgrab.errors import DatasetError


@pytest.fixture
def copy(dataset, tmp_path):
    shutil.copytree(dataset, tmp_path / "copy")
    return tmp_path / "copy"


def test_a_dataset_reads_as_it_lies(copy):
    found = datasets.read(copy)
    assert [row.frame for row in found.rows] == list(range(6))
    assert found.data.scenario == "quay-day"
    for row in found.rows:
        label = (copy / row.file.replace("images", "labels")).with_suffix(".txt").read_text()
        assert found.is_labelled(row) == bool(label)


def test_what_is_no_dataset_is_refused(copy, tmp_path):
    with pytest.raises(DatasetError, match="not a dataset"):
        datasets.read(tmp_path)
    with pytest.raises(DatasetError, match="no dataset given"):
        datasets.read_all([])
    with pytest.raises(DatasetError, match="no frames in the split 'moon'"):
        datasets.read_all([copy], "moon")
    picture = copy / datasets.read(copy).rows[3].file
    picture.unlink()
    with pytest.raises(DatasetError, match="frame 3 has labels and no picture"):
        datasets.read(copy)
    labels = copy / "labels.parquet"
    table = pq.read_table(labels)
    pq.write_table(table.slice(0, 0), labels)
    with pytest.raises(DatasetError, match="no frames in labels"):
        datasets.read(copy)
    pq.write_table(table.drop_columns(["alpha_deg"]), labels)
    with pytest.raises(DatasetError, match="not a simgrab dataset"):
        datasets.read(copy)
    labels.unlink()
    with pytest.raises(DatasetError, match="not a dataset"):
        datasets.read(copy)
    (copy / ".partial").mkdir()
    with pytest.raises(DatasetError, match="unfinished"):
        datasets.read(copy)


def test_reading_starts_no_threads(dataset):
    """One of Arrow's that lets go of Python's bytes while Python ends aborts the process, now and then."""
    counts = (
        "import os, sys; from simgrab import datasets; count = lambda: len(os.listdir('/proc/self/task'));"
        "before = count(); datasets.read(sys.argv[1]); print(before, count())"
    )
    told = subprocess.run([sys.executable, "-c", counts, str(dataset)], capture_output=True, text=True, check=True)
    before, after = told.stdout.split()
    assert before == after
