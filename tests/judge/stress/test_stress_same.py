"""A replication is the same alone, in a batch, on any worker, and after a kill."""

import functools
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from stress_runs import small

from simgrab.errors import StressError
from simgrab.judge.stress import catalogue, geometric, laboratory, replay
from simgrab.judge.stress.axes import AXES
from simgrab.judge.stress.laboratory import PARTIAL, TRIALS
from simgrab.judge.stress.study import situation
from simgrab.judge.stress.work import Part, make, parts

STUDY = """
name = "small"
title = "Everything at once"
estimators = ["paper-iteration", "mean-ray", "geometric-median", "rope-aware", "zero-tilt"]
n = 3000
replications = 20
[given]
noise = 1.0
noise-slow = 1.0
missing = 0.1
vibration = 0.1
rope-lag = 1.0
rope-range = 20.0
[[axes]]
axis = "offset-along"
values = [0.0, 0.5, 1.0]
[[axes]]
axis = "gamma-towards"
values = [0.0, 0.3]
"""


@functools.cache
def bundled():
    return [catalogue.load(name) for name in catalogue.names()]


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(STUDY, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", [n for n, a in AXES.items() if n not in ("motion", "mount")])
def test_a_replication_depends_on_its_number_alone(name):
    study = next(s for s in bundled() if any(x.axis == name for x in s.axes))
    for point in (study.points[0], study.points[-1]):
        here = situation(small(study, n=30), point)
        together, alone = geometric.draw(here, 3, [4, 11, 2]), geometric.draw(here, 3, [11])
        for field in ("pixels", "rope", "alpha", "probe_pixels", "probe_rope", "sigma"):
            np.testing.assert_array_equal(getattr(together, field)[1], getattr(alone, field)[0])


def test_physics_too():
    here = situation(small("motion", n=20), ("work-cycles",))
    together, alone = geometric.draw(here, 3, [0, 2]), geometric.draw(here, 3, [2])
    np.testing.assert_array_equal(together.pixels[1], alone.pixels[0])


def test_rows_are_the_same_in_parts_of_any_size_and_in_a_replay(file):
    study = catalogue.load(file)
    whole = make(study, Part(3, 0, 12)).to_pylist()
    pieces = [row for first in (0, 1, 5) for row in make(study, Part(3, first, {0: 1, 1: 5, 5: 12}[first])).to_pylist()]
    by = {(r["trial"], r["estimator"]): r for r in pieces}
    assert all(by[r["trial"], r["estimator"]] == r for r in whole)
    again = replay.replay(study, 7, study.points[3])
    for row in whole:
        if row["trial"] == 7:
            ours = again.rows[row["estimator"]]
            assert all(ours[k] == row[k] for k in ours)


@pytest.mark.slow
def test_any_number_of_workers_and_a_kill_give_the_same_bytes(file, tmp_path):
    log = tmp_path / "log"

    def start(out, *options):
        with log.open("w") as said:
            return subprocess.Popen(
                [sys.executable, "-m", "simgrab", "stress", str(file), "--out", str(out), "--quiet", *options],
                env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[3])}, stdout=said, stderr=subprocess.STDOUT,
            )  # fmt: skip

    one, killed = tmp_path / "one", tmp_path / "killed"
    process = start(one, "--workers", "1")
    assert process.wait() == 0, log.read_text()
    process = start(killed, "--workers", "2")
    total = len(parts(catalogue.load(file)))
    while len(list((killed / "small" / PARTIAL).glob("*.parquet"))) < 3:
        assert process.poll() is None, log.read_text()
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert len(list((killed / "small" / PARTIAL).glob("*.parquet"))) < total
    assert not (killed / "small" / TRIALS).exists()
    refused = start(killed)
    assert refused.wait() == 2
    assert "--resume" in log.read_text()
    process = start(killed, "--workers", "2", "--resume")
    assert process.wait() == 0, log.read_text()
    expected = (one / "small" / TRIALS).read_bytes()
    assert (killed / "small" / TRIALS).read_bytes() == expected
    table = pq.read_table(one / "small" / TRIALS)
    assert table.num_rows == 6 * 20 * 5
    assert (one / "small" / "summary.csv").read_bytes() == (killed / "small" / "summary.csv").read_bytes()


@pytest.mark.slow
def test_a_study_killed_while_it_cleaned_up_is_finished(tmp_path):
    study = small("focal", (0.0,), replications=2, n=20)
    laboratory.run([study], tmp_path)
    before = (tmp_path / "focal" / TRIALS).stat().st_mtime_ns
    report = (tmp_path / laboratory.REPORT).read_bytes()
    (tmp_path / "focal" / PARTIAL).mkdir()
    counted = []
    laboratory.run([study], tmp_path, resume=True, progress=lambda *counts: counted.append(counts))
    assert counted == [(2, 2)]
    assert not (tmp_path / "focal" / PARTIAL).exists()
    assert (tmp_path / "focal" / TRIALS).stat().st_mtime_ns == before
    assert (tmp_path / laboratory.REPORT).read_bytes() == report


def test_a_folder_of_another_study_is_left_alone(tmp_path):
    study = small("focal", (0.0,), replications=2, n=20)
    laboratory.run([study], tmp_path)
    before = (tmp_path / "focal" / TRIALS).read_bytes()
    with pytest.raises(StressError, match="settings differ"):
        laboratory.run([small("focal", (0.0,), replications=3, n=20)], tmp_path, resume=True)
    with pytest.raises(StressError, match="already"):
        laboratory.run([study], tmp_path)
    laboratory.run([study], tmp_path, resume=True)
    assert (tmp_path / "focal" / TRIALS).read_bytes() == before
    (tmp_path / "lean-along").mkdir()
    (tmp_path / "lean-along" / "letter.txt").write_text("mine")
    with pytest.raises(StressError, match="something other than"):
        laboratory.run([small("lean-along", (0.0,), replications=2, n=20)], tmp_path)


def test_more_replications_begin_with_the_fewer():
    few, many = (make(small("noise", (1.0,), n=50, replications=m), Part(0, 0, m)).to_pylist() for m in (3, 9))
    assert [r for r in many if r["trial"] < 3] == few


def test_a_second_run_into_a_folder_is_refused_and_the_first_goes_on(tmp_path):
    study = small("focal", (0.0,), replications=2, n=20)
    refused = []

    def second(*_):
        with pytest.raises(StressError) as problem:
            laboratory.run([study], tmp_path, resume=True)
        refused.append(str(problem.value))

    laboratory.run([study], tmp_path, progress=second)
    assert set(refused) == {f"{tmp_path} is being written by another simgrab"}
    assert (tmp_path / "focal" / TRIALS).exists()
