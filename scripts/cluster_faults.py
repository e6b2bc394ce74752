"""Kill a worker, a node and the driver of a cluster of three local nodes, and compare what is rendered meanwhile.

python -m scripts.cluster_faults [--frames 60] [--shard-frames 4] [--only worker node driver folder] [--overhead 200]

Each case renders the same small scene on the cluster, strikes when a third of the shards is done, and compares every
byte with the dataset of one process. ``folder`` renders into a folder, through the driver, and kills a worker. The
overhead is the time of an item that does nothing.
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil

from simgrab.io.files import sha256
from simgrab.runtime.cluster import ClusterPool

SCENE = ("quay-day", "--size", "480x270", "--set", "image.samples=0")
NODES = 3
LONGEST_S = 300.0


class Cluster:
    """A cluster of local nodes, of one core each, one of which can be killed."""

    def __init__(self) -> None:
        from ray.cluster_utils import Cluster as Nodes

        self._nodes: Any = Nodes(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
        self._others = [self._nodes.add_node(num_cpus=1) for _ in range(NODES - 1)]
        self.address = str(self._nodes.address)

    def kill_node(self) -> None:
        """Kill a node with its processes, and put a new one in its place."""
        self._nodes.remove_node(self._others.pop(), allow_graceful=False)
        self._others.append(self._nodes.add_node(num_cpus=1))

    def close(self) -> None:
        """End the cluster."""
        self._nodes.shutdown()


@contextmanager
def cluster() -> Iterator[Cluster]:
    """Run a cluster."""
    running = Cluster()
    try:
        yield running
    finally:
        running.close()


def kill_worker() -> None:
    """Kill a process that works on an item, with SIGKILL."""
    busy = [p for p in psutil.process_iter(["cmdline"]) if (p.info["cmdline"] or [""])[0].startswith("ray::_do")]
    if not busy:
        raise RuntimeError("no process works on an item")
    busy[0].kill()


def contents(folder: Path) -> dict[str, str]:
    """SHA-256 of each file by its path."""
    return {str(path.relative_to(folder)): sha256(path) for path in folder.rglob("*") if path.is_file()}


def render(out: str, *options: str) -> subprocess.Popen[bytes]:
    """Start `simgrab render`."""
    command = [sys.executable, "-m", "simgrab", "render", *SCENE, "--out", out, "--quiet", *options]
    return subprocess.Popen(command)


def strike(process: subprocess.Popen[bytes], done: Callable[[], int], least: int, act: Callable[[], object]) -> bool:
    """Act when so much is done; whether that was before the end."""
    until = time.monotonic() + LONGEST_S
    while process.poll() is None and time.monotonic() < until:
        if done() >= least:
            act()
            return True
        time.sleep(0.02)
    return False


def case(name: str, here: Cluster, frames: int, shard_frames: int, folder: Path, known: dict[str, str]) -> bool:
    """Render once with a fault, print what came of it; whether all bytes are as known."""
    out = folder / name
    counted = out / (".partial/rows" if name == "folder" else "labels")
    least = frames // 3 if name == "folder" else frames // shard_frames // 3

    def done() -> int:
        return len([path for path in counted.glob("*") if not path.name.startswith(".")])

    place = str(out) if name == "folder" else out.as_uri()
    options = ["--frames", str(frames), "--cluster", here.address]
    if name != "folder":
        options += ["--shard-frames", str(shard_frames)]
    process = render(place, *options)
    acts: dict[str, Callable[[], object]] = {
        "worker": kill_worker, "folder": kill_worker, "node": here.kill_node, "driver": process.kill,
    }  # fmt: skip
    struck = strike(process, done, least, acts[name])
    status = process.wait(LONGEST_S)
    after = ""
    if name == "driver":
        killed = status == -signal.SIGKILL
        begun = contents(out)
        named = [key for key in begun if key != "unfinished.json" and not Path(key).name.startswith(".")]  # else drafts
        half = [key for key in named if known.get(key) != begun[key]]
        status = render(place, *options, "--resume").wait(LONGEST_S)
        after = f", killed {killed}, {len(half)} files half there, then resumed"
        struck = struck and killed and not half
    found = contents(out)
    missing, different = known.keys() - found.keys(), [k for k in known.keys() & found.keys() if known[k] != found[k]]
    extra = found.keys() - known.keys()
    good = struck and status == 0 and not missing and not different and not extra
    counts = f"{len(found)} files, {len(missing)} missing, {len(different)} different, {len(extra)} too many"
    print(f"{name:>7}: struck {struck}{after}, status {status}: {counts}", flush=True)
    return good


def nothing(item: int) -> int:
    """Do nothing."""
    return item


def overhead(here: Cluster, items: int) -> None:
    """Print the time to connect, and that of items which do nothing."""
    start = time.perf_counter()
    with ClusterPool(here.address) as pool:
        connected = time.perf_counter()
        list(pool.map(nothing, range(NODES)))  # starts the processes
        warm = time.perf_counter()
        found = sorted(pool.map(nothing, range(items)))
        end = time.perf_counter()
    assert found == list(range(items))
    print(
        f"overhead: {connected - start:.1f} s to connect, {warm - connected:.1f} s to start processes, "
        f"then {(end - warm) / items * 1e3:.1f} ms an item"
    )


def main() -> None:
    """Parse and run."""
    cases = ("worker", "node", "driver", "folder")
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--shard-frames", type=int, default=4)
    parser.add_argument("--only", nargs="*", choices=cases, default=cases)
    parser.add_argument("--overhead", type=int, default=200, help="Items that do nothing; 0 measures none.")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary, cluster() as here:
        folder = Path(temporary)
        frames = ["--frames", str(chosen.frames), "--workers", "1"]
        known: dict[str, dict[str, str]] = {}
        if {"worker", "node", "driver"} & set(chosen.only):
            shards = folder / "shards"
            assert render(shards.as_uri(), *frames, "--shard-frames", str(chosen.shard_frames)).wait() == 0
            known["shards"] = contents(shards)
        if "folder" in chosen.only:
            assert render(str(folder / "files"), *frames).wait() == 0
            known["files"] = contents(folder / "files")
        good = [
            case(
                name, here, chosen.frames, chosen.shard_frames, folder, known["files" if name == "folder" else "shards"]
            )
            for name in chosen.only
        ]
        if chosen.overhead:
            overhead(here, chosen.overhead)
    raise SystemExit(not all(good))


if __name__ == "__main__":
    main()
