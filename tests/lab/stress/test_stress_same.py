"""A replication is the same alone, in a batch, on any worker, and after a kill."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from stress_runs import bundled, small

from simgrab.errors import StressError
from simgrab.lab.stress import catalogue, geometric, laboratory, replay
from simgrab.lab.stress.axes import AXES
from simgrab.lab.stress.laboratory import PARTIAL, TRIALS, ReplicationBatch, make, parts
from simgrab.lab.stress.study import situation

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


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(STUDY, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", AXES)
def test_a_replication_depends_on_its_number_alone(name):
    study = next(s for s in map(bundled, catalogue.names()) if any(x.axis == name for x in s.axes))
    for point in (study.points[0], study.points[-1]):
        here = situation(small(study, n=30), point)
        together, alone = geometric.draw(here, 3, [4, 11, 2]), geometric.draw(here, 3, [11])
        for field in ("pixels", "rope", "alpha", "probe_pixels", "probe_rope", "sigma"):
            np.testing.assert_array_equal(getattr(together, field)[1], getattr(alone, field)[0])


def test_rows_are_the_same_in_parts_of_any_size_and_in_a_replay(file):
    study = catalogue.load(file)
    whole = make(study, ReplicationBatch(3, 0, 12)).to_pylist()
    pieces = [
        row
        for first in (0, 1, 5)
        for row in make(study, ReplicationBatch(3, first, {0: 1, 1: 5, 5: 12}[first])).to_pylist()
    ]
    by = {(r["trial"], r["estimator"]): r for r in pieces}
    assert all(by[r["trial"], r["estimator"]] == r for r in whole)
    again = replay.replay(study, 7, study.points[3])
    for row in whole:
        if row["trial"] == 7:
            ours = again.rows[row["estimator"]]
            assert all(ours[k] == row[k] for k in ours)


@pytest.mark.slow
def test_any_number_of_workers_and_a_kill_give_the_same_bytes(file, tmp_path):
    study, log, killed = catalogue.load(file), tmp_path / "log", tmp_path / "killed"
    command = [sys.executable, "-m", "simgrab", "stress", str(file), "--out", str(killed), "--quiet", "--workers", "2"]
    with log.open("w") as said:
        process = subprocess.Popen(
            command, env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[3])}, stdout=said, stderr=said
        )
    while len(list((killed / "small" / PARTIAL / "rows").glob("*.parquet"))) < 3:
        assert process.poll() is None, log.read_text()
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert len(list((killed / "small" / PARTIAL / "rows").glob("*.parquet"))) < len(parts(study))
    assert not (killed / "small" / TRIALS).exists()
    (killed / "small" / PARTIAL / "draft-1-torn").write_bytes(b"half")
    with pytest.raises(StressError, match="--resume"):
        laboratory.run([study], killed)
    counted = []
    laboratory.run([study], killed, resume=True, progress=lambda done, _: counted.append(done))
    assert 0 < counted[0] < counted[-1] == 6 * 20
    laboratory.run([study], tmp_path / "one")
    for name in (TRIALS, "summary.csv"):
        assert (killed / "small" / name).read_bytes() == (tmp_path / "one" / "small" / name).read_bytes()
    assert pq.read_table(killed / "small" / TRIALS).num_rows == 6 * 20 * 5


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A finished study, its folder, and what a second run into that folder was told meanwhile."""
    study, folder, refused = small("focal", (0.0,), replications=2, n=20), tmp_path_factory.mktemp("finished"), []

    def second(*_):
        with pytest.raises(StressError) as problem:
            laboratory.run([study], folder, resume=True)
        refused.append(str(problem.value))

    laboratory.run([study], folder, progress=second)
    return study, folder, refused


def test_a_second_run_into_a_folder_is_refused_and_the_first_goes_on(finished):
    _, folder, refused = finished
    assert set(refused) == {f"{folder} is being written by another simgrab"}
    assert (folder / "focal" / TRIALS).exists()


def test_a_study_killed_while_it_cleaned_up_is_finished(finished, tmp_path):
    study, folder, _ = finished
    out = shutil.copytree(folder, tmp_path / "out")
    before = (out / "focal" / TRIALS).stat().st_mtime_ns
    report = (out / laboratory.REPORT).read_bytes()
    (out / "focal" / PARTIAL).mkdir()
    counted = []
    laboratory.run([study], out, resume=True, progress=lambda *counts: counted.append(counts))
    assert counted == [(2, 2)]
    assert not (out / "focal" / PARTIAL).exists()
    assert (out / "focal" / TRIALS).stat().st_mtime_ns == before
    assert (out / laboratory.REPORT).read_bytes() == report


def test_a_study_goes_on_only_with_the_estimator_it_began_with(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    file = tmp_path / "own_estimator_of_a_study.py"
    file.write_text("from simgrab.instrument.estimate import MeanRay\n\n\nclass Mine(MeanRay): ...\n")
    study = small("focal", (0.0,), replications=2, n=20, estimators=("own_estimator_of_a_study:Mine",))
    laboratory.run([study], tmp_path / "out")
    laboratory.run([study], tmp_path / "out", resume=True)
    with file.open("a") as source:
        source.write("# and changed\n")
    with pytest.raises(StressError, match=r"sources\.own_estimator_of_a_study:Mine differs"):
        laboratory.run([study], tmp_path / "out", resume=True)


def test_a_folder_of_another_study_is_left_alone(finished, tmp_path, monkeypatch):
    study, folder, _ = finished
    before = (folder / "focal" / TRIALS).read_bytes()
    with pytest.raises(StressError, match=r"study\.replications differs"):
        laboratory.run([small("focal", (0.0,), replications=3, n=20)], folder, resume=True)
    with pytest.raises(StressError, match="a finished study"):
        laboratory.run([study], folder)
    monkeypatch.setattr(geometric, "made_with", lambda: "another renderer")
    with pytest.raises(StressError, match="made_with differs"):
        laboratory.run([study], folder, resume=True)
    assert (folder / "focal" / TRIALS).read_bytes() == before
    (tmp_path / "lean-along").mkdir()
    (tmp_path / "lean-along" / "letter.txt").write_text("mine")
    with pytest.raises(StressError, match="something other than"):
        laboratory.run([small("lean-along", (0.0,), replications=2, n=20)], tmp_path)
