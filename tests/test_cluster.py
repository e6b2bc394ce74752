"""Clusters: those that are not there, and one on this machine that loses a process, a node and its driver."""

import importlib.util
import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

import simgrab
from simgrab.dataset.render import render
from simgrab.errors import ClusterError, DatasetError, WorkerError
from simgrab.runtime import cluster, versions
from simgrab.runtime.cluster import ClusterPool, open_pool
from simgrab.runtime.processes import Pool, RemoteError, tick
from tests.s3_server import folder_contents

pytestmark = pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="Ray is not installed")


def free_port():
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


@pytest.mark.parametrize(
    ("address", "why"),
    [
        ("", "a cluster's address is auto, ray://HOST:10001 or HOST:6379, got ''"),
        ("nonsense", "a cluster's address is auto"),
        ("http://a:1/b", "a cluster's address is auto"),
        ("127.0.0.1:99999", "no Ray cluster answers at 127.0.0.1:99999"),
        ("ray://127.0.0.1:FREE", "no Ray cluster answers at ray://127.0.0.1"),
        ("127.0.0.1:FREE", "simgrab cluster up --local 2"),
        ("no-such-host.invalid:6379", "no Ray cluster answers at no-such-host.invalid:6379"),
    ],
)
def test_a_cluster_that_is_not_there_is_refused_in_one_line(tmp_path, address, why):
    address = address.replace("FREE", str(free_port()))
    with pytest.raises(ClusterError, match=re.escape(why)) as problem:
        render("quay-day", tmp_path / "new", cluster=address)
    assert "\n" not in str(problem.value)
    assert list(tmp_path.iterdir()) == []


def test_without_ray_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ClusterError, match=r"pip install 'simgrab\[cluster\]'"):
        ClusterPool("auto")


def test_without_a_cluster_work_is_done_by_processes():
    with open_pool(1, None) as pool:
        assert isinstance(pool, Pool)


def test_other_versions_are_named():
    here = versions.everything()
    assert here.keys() >= {"Python", "simgrab's source", "mujoco", "numpy"}
    assert cluster._versions_problem(here) is None
    problem = str(cluster._versions_problem(here | {"numpy": "1.0", "mujoco": "9.9"}))
    assert f"numpy {here['numpy']} instead of 1.0" in problem
    assert f"mujoco {here['mujoco']} instead of 9.9" in problem
    assert socket.gethostname() in problem


def doubled(item):
    """Work on an item."""
    if item < 0:
        raise DatasetError(f"no {item}")
    tick()
    return 2 * item


def dying(item):
    """End the process, which is done again elsewhere."""
    os._exit(item)


CHECKS = """
import sys
from tests.test_cluster import checks
checks(*sys.argv[1:])
"""


def renders(folder, there, **where):
    """Render and study the same wherever it is done."""
    scene = simgrab.load("quay-day", {"frames": 4, "image.samples": 0}, size=(480, 270))
    render(scene, (folder / f"{there}-shards").as_uri(), shard_frames=2, **where)
    if importlib.util.find_spec("simgrab.lab"):
        from simgrab.lab.stress import catalogue, laboratory
        from simgrab.lab.stress.study import quickened

        study = msgspec.structs.replace(quickened(catalogue.load(catalogue.names()[0])), replications=2)
        with laboratory.worker_pool(1, **where) as pool:
            jobs = [(study, part) for part in laboratory.parts(study)]
            tables = sorted(table for _, _, table in pool.map(laboratory.made, jobs))
        (folder / f"{there}-stress").write_bytes(b"".join(tables))


def checks(address, folder):
    """What is tested in a process of its own, which Ray may leave threads in."""
    renders(Path(folder), "there", cluster=address)
    counts = []
    with ClusterPool(address) as pool:
        assert sorted(pool.map(doubled, range(20), ticked=counts.append)) == list(range(0, 40, 2))
        assert counts == list(range(1, 21))
        assert list(pool.map(doubled, [])) == []
        with pytest.raises(DatasetError, match="no -1") as problem:
            list(pool.map(doubled, [-1]))
        assert isinstance(problem.value.__cause__, RemoteError)
        assert "in doubled" in str(problem.value.__cause__)
        cluster.RETRIES = 1
        with pytest.raises(WorkerError, match="shard 3: processes died processing it 2 times"):
            list(pool.map(dying, [3], name=lambda item: f"shard {item}"))
        known = versions.everything()
        versions.everything = lambda: known | {"numpy": "1.0"}
        with pytest.raises(ClusterError, match=r"machine .* has numpy .* instead of 1\.0: install the same"):
            list(pool.map(doubled, [1]))
    with (
        ClusterPool(address, memory_bytes=10**15) as pool,
        pytest.raises(ClusterError, match="that a process needs"),
    ):
        list(pool.map(doubled, [1]))


@pytest.mark.skipif(not os.environ.get("SIMGRAB_TEST_CLUSTER"), reason="SIMGRAB_TEST_CLUSTER=1 starts a Ray cluster")
def test_work_on_a_cluster(tmp_path):
    renders(tmp_path, "here")
    with cluster.local_cluster(2, 1) as address:
        subprocess.run([sys.executable, "-c", CHECKS, address, str(tmp_path)], check=True, timeout=240)
    assert folder_contents(tmp_path / "here-shards") == folder_contents(tmp_path / "there-shards")
    assert (tmp_path / "here-stress").read_bytes() == (tmp_path / "there-stress").read_bytes()
