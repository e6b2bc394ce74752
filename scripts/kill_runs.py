"""Kill commands at random moments, run them again, and compare with undisturbed runs.

``python -m scripts.kill_runs [--kills 100] [--seed 0] [--only COMMAND] [--keep FOLDER]``

A kill is a signal to the command (SIGINT, SIGTERM, SIGHUP or SIGKILL), or SIGKILL to one of its workers, at a moment
drawn over the time that the command takes. Prints a table, and exits with 1 if after any kill

- the exit status is another than that of the signal, a traceback is printed, or the command does not end;
- a file has its final name and other bytes than the undisturbed run's;
- a process is left that the command started;
- the command, run again (with --resume where it has that), fails, or leaves other files, other bytes or a draft.

Wall times differ from run to run. These are left out of the comparison: ``speed`` of run.json and the row of the speed
in the run's report.html; ``seconds`` of check.json and ``time`` of junit.xml; ``seconds`` of the reader's card, the
minutes in its Markdown, and ``seconds`` in checkpoint.pt.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.table import Table

MARK = "SIMGRAB_KILL_RUNS"  # in the environment of every process of a run, by which those left are found
HANGS_S = 120.0
LINGERS_S = 30.0  # that processes may take to be gone
WORKER = "worker"
TMP = "tmp"  # for what would lie in /tmp
KINDS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGKILL", WORKER)
OURS = ("main()", "Process Spawn", "processes.py")  # in a traceback that is not of Python's own start
FAULTS = ("status", "traceback", "half", "left", "again", "lost", "differs", "draft")
SMALL = {
    "camera.width_px": 480, "camera.height_px": 270, "camera.focal": '{model="pixels", focal_length_px=411.2}',
    "image.samples": 0, "image.shadow_map_px": 0, "place": '{model="plain"}',
}  # fmt: skip
INSTRUMENT = """
from simgrab.instrument.contract import Measurement


class Mine:
    name = "mine"

    def __call__(self, frames, calibration):
        return [Measurement(status="ok", alpha=0.05, centre=(240.0, 135.0)) for _ in frames]
"""
SUITE = """
name = "kills"
instrument = "mine:Mine"
[changes]
"camera.width_px" = 480
"camera.height_px" = 270
"camera.focal" = { model = "pixels", focal_length_px = 411.2 }
"image.samples" = 0
"image.shadow_map_px" = 0
place = { model = "plain" }
[limits]
"frames.ok" = { lower = 4 }
[scenes.calm]
scene = "quay-day"
frames = 4
"""


@dataclass(frozen=True)
class Case:
    """A command, run in a folder of its own, whose outputs lie in ``out`` there.

    Attributes
    ----------
    arguments : tuple of str
    resume : bool
        Whether it takes ``--resume``.
    once : str
        Output that a finished run is refused to write again; empty where it is not.
    workers : bool
        Whether it has processes that work for it.
    """

    arguments: tuple[str, ...]
    resume: bool = True
    once: str = ""
    workers: bool = True

    def command(self, *, again: bool = False) -> list[str]:
        """Arguments of the process."""
        resume = ["--resume"] if again and self.resume else []
        return [sys.executable, "-m", "simgrab", *self.arguments, *resume]


def cases(place: Path) -> dict[str, Case]:
    """Commands to kill, on inputs in ``place``."""
    small = [part for key, value in SMALL.items() for part in ("--set", f"{key}={value}")]
    render = ("render", "quay-day", *small, "--quiet", "--workers", "2")
    clips = ("--set", "clip.clip_frames=3", "--frames", "9", "--video", "out/swing.mp4")
    data = str(place / "data")
    train = ("train", "reader", data, "--epochs", "4", "--batch", "32", "--quiet", "--out", "out")
    check = ("check", str(place / "kills.toml"), "--cache", "out/cache", "--workers", "2", "--quiet", "--out", "out")
    stress = ("stress", "focal", "--quick", "--workers", "2", "--quiet", "--out", "out")
    return {
        "render": Case((*render, "--frames", "8", "--out", "out")),
        "video": Case((*render, *clips)),
        "run": Case(
            ("run", data, "--instrument", "mine:Mine", "--quiet", "--out", "out/run"),
            resume=False, once="run", workers=False,
        ),
        "train": Case(train, workers=False),
        "check": Case(check, resume=False),
        "stress": Case(stress),
    }  # fmt: skip


@dataclass
class Kills:
    """What came of kills.

    Attributes
    ----------
    counts : counter of (command, kind, what)
        What is ``kills``, ``ended`` (of those, the commands that were not done before) or one of `FAULTS`.
    notes : list of str
        What was found wrong.
    """

    counts: Counter[tuple[str, str, str]] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)

    @property
    def sound(self) -> bool:
        """Whether nothing was found wrong."""
        return not self.notes

    def table(self) -> Table:
        """One row for each command and kind of kill."""
        table = Table(*("command", "kill", "kills", "ended", *FAULTS))
        for name, kind in sorted({(name, kind) for name, kind, _ in self.counts}):
            table.add_row(name, kind, *(str(self.counts[name, kind, what]) for what in ("kills", "ended", *FAULTS)))
        whole = Counter[str]()
        for (_, _, what), count in self.counts.items():
            whole[what] += count
        table.add_row("all", "", *(str(whole[what]) for what in ("kills", "ended", *FAULTS)), style="bold")
        return table


class Killer:
    """Kills commands in a folder of its own.

    Parameters
    ----------
    place : Path
        Gets inputs, undisturbed runs and the run at hand.
    only : sequence of str
        Names of commands; all by default.
    """

    def __init__(self, place: Path, only: Sequence[str] = ()) -> None:
        self.place, self.found = place.resolve(), Kills()
        every = cases(self.place)
        self.cases = {name: every[name] for name in only or every}
        self.seconds: dict[str, float] = {}
        self.expected: dict[str, dict[str, str]] = {}

    def prepare(self) -> None:
        """Make the inputs, and run each command undisturbed."""
        (self.place / "mine.py").write_text(INSTRUMENT)
        (self.place / "kills.toml").write_text(SUITE)
        if not {"run", "train"}.isdisjoint(self.cases) and not (self.place / "data" / "manifest.json").exists():
            small = [part for key, value in SMALL.items() for part in ("--set", f"{key}={value}")]
            display = ("--set", "display.layout=two-by-four", "--frames", "40", "--quiet", "--out", "data")
            command = [sys.executable, "-m", "simgrab", "render", "quay-day", *small, *display]
            subprocess.run(command, cwd=self.place, check=True)
        for name, case in self.cases.items():
            folder = self.place / "reference" / name
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
            begun = time.monotonic()
            process = self._start(case.command(), folder)
            if process.wait() != 0:
                raise click.ClickException(f"{name}, undisturbed: {_said(folder)}")
            self.seconds[name] = time.monotonic() - begun
            self.expected[name] = contents(folder / "out")

    def kill(self, name: str, kind: str, moment: float) -> None:
        """Start a command, kill it after a share of the time that it takes, and run it again."""
        case, folder = self.cases[name], self.place / "killed"
        shutil.rmtree(folder, ignore_errors=True)
        (folder / TMP).mkdir(parents=True)
        self.found.counts[name, kind, "kills"] += 1

        def fault(what: str, text: str) -> None:
            self.found.counts[name, kind, what] += 1
            self.found.notes.append(f"{name}, {kind} at {moment:.2f}: {what}: {text}")

        process = self._start(case.command(), folder)
        ended = self._strike(process, kind, moment * self.seconds[name])
        self.found.counts[name, kind, "ended"] += ended
        self._wait(process, fault)
        for line in _left(self._mark):
            fault("left", line)
        said = _said(folder)
        expected, there = self.expected[name], contents(folder / "out")
        for text in _status_faults(process.returncode, kind, ended, there not in ({}, expected)):
            fault("status", f"{text}: {said}")
        if kind != "SIGKILL" and "Traceback" in said and any(sign in said for sign in OURS):
            fault("traceback", said)
        for file, digest in there.items():
            if _final(file) and expected.get(file, digest) != digest:
                fault("half", file)
        if kind not in ("SIGKILL", WORKER):
            for file in there:
                if ".draft" in file and ".partial" not in file:
                    fault("draft", f"{file}, before it was run again")
        if not (case.once and (folder / "out" / case.once).exists()):
            process = self._start(case.command(again=True), folder)
            self._wait(process, fault)
            if process.returncode != 0:
                fault("again", f"status {process.returncode}: {_said(folder)}")
            there = contents(folder / "out")
        for file in sorted(contents(folder / TMP)) if kind != "SIGKILL" else ():
            fault("draft", f"{TMP}/{file}")
        for file in sorted(expected.keys() - there.keys()):
            fault("lost", file)
        for file in sorted(there):
            if _is_draft(file):
                fault("draft", file)
            elif expected.get(file) != there[file]:
                fault("differs", file)

    def _start(self, command: list[str], folder: Path) -> subprocess.Popen[bytes]:
        self._mark = uuid.uuid4().hex
        environment = os.environ | {MARK: self._mark, "PYTHONPATH": os.pathsep.join([str(self.place), str(Path.cwd())])}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)  # else every process compiles all that it imports
        if (folder / TMP).exists():
            environment["TMPDIR"] = str(folder / TMP)
        with (folder / "said").open("wb") as said:
            return subprocess.Popen(
                command, cwd=folder, env=environment, stdout=said, stderr=said, start_new_session=True
            )

    def _strike(self, process: subprocess.Popen[bytes], kind: str, after_s: float) -> bool:
        """Kill at the moment, or a worker as soon as there is one then; False if all was done before."""
        until = time.monotonic() + after_s
        while process.poll() is None:
            workers = _workers(process.pid) if kind == WORKER else []
            if time.monotonic() >= until and (kind != WORKER or workers):
                victim = random.Random(after_s).choice(workers) if workers else process.pid
                try:
                    os.kill(victim, signal.SIGKILL if workers else signal.Signals[kind])
                except ProcessLookupError:
                    return False
                return True
            time.sleep(0.005)
        return False

    def _wait(self, process: subprocess.Popen[bytes], fault: Callable[[str, str], None]) -> None:
        try:
            process.wait(HANGS_S)
        except subprocess.TimeoutExpired:
            fault("status", "it does not end")
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def _said(folder: Path) -> str:
    return (folder / "said").read_text(errors="replace").strip()[-2000:]


def _status_faults(status: int, kind: str, ended: bool, begun: bool) -> Iterator[str]:
    """Say what is wrong with an exit status.

    Where nothing is ``begun``, or all is done, the signal may have met Python itself, starting or ending.
    """
    number = 0 if kind == WORKER or not ended else int(signal.Signals[kind])
    right = {0} if not number else {0, -number} if kind == "SIGKILL" else {0, 128 + number}
    if status == -number and not begun:
        return
    if status == 1 and kind == "SIGINT" and not begun:  # Python says so while it starts
        return
    if status not in right:
        yield f"{status} instead of {' or '.join(map(str, sorted(right)))}"


def _final(file: str) -> bool:
    """Whether a file has its final name, and is not one that grows from epoch to epoch."""
    return not _is_draft(file) and Path(file).name != "checkpoint.pt"


def _is_draft(file: str) -> bool:
    return any(part.endswith((".draft", ".partial")) or part.startswith("draft-") for part in Path(file).parts)


def _workers(parent: int) -> list[int]:
    """Find the processes that a process started, but for the one that looks after shared memory."""
    try:
        children = Path(f"/proc/{parent}/task/{parent}/children").read_text().split()
    except OSError:
        return []
    return [int(pid) for pid in children if b"spawn_main" in _of(pid, "cmdline")]


def _of(pid: str, file: str) -> bytes:
    """Read a file of /proc about a process; empty where it is gone."""
    try:
        return Path("/proc", pid, file).read_bytes()
    except OSError:
        return b""


def _left(mark: str) -> list[str]:
    """Find processes that stay when a run has ended; zombies, whose environment is gone, are none."""
    until = time.monotonic() + LINGERS_S
    while left := [p.name for p in Path("/proc").glob("[0-9]*") if f"{MARK}={mark}".encode() in _of(p.name, "environ")]:
        if time.monotonic() > until:
            return [f"process {pid}: {_of(pid, 'cmdline').decode(errors='replace')}" for pid in left]
        time.sleep(0.1)
    return []


def contents(folder: Path) -> dict[str, str]:
    """Digest of every file below a folder, wall times left out; locks, which are empty, are no content."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(_timeless(path)).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "lock" and path.suffix != ".lock" and path.name != ".lock"
    }


def _timeless(path: Path) -> bytes:
    """Content of a file without wall times."""
    name, data = path.name, path.read_bytes()
    if _is_draft(str(path)):
        return data
    if name in ("run.json", "check.json", "reader.json"):
        plain = json.loads(data)
        plain.pop("speed" if name == "run.json" else "seconds")
        return json.dumps(plain).encode()
    if name == "checkpoint.pt":
        return repr(_plain(_checkpoint(path))).encode()
    for file, pattern in (
        ("report.html", rb"<tr><td>[^<]*(?:speed|frames/s|seconds)[^<]*</td>.*?</tr>"),
        ("junit.xml", rb'time="[0-9.]+"'),
        ("reader.md", rb"for [0-9.]+ minutes"),
    ):
        if name == file:
            data = re.sub(pattern, b"", data)
    return data


def _checkpoint(path: Path) -> dict[str, Any]:
    import torch

    state: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
    state.pop("seconds")
    return state


def _plain(value: Any) -> Any:
    """Tensors, within whatever holds them, by the digest of their bytes."""
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if hasattr(value, "numpy"):
        return hashlib.sha256(np.ascontiguousarray(value.numpy()).tobytes()).hexdigest()
    return value


def plan(kills: int, seed: int, killer: Killer) -> Iterator[tuple[str, str, float]]:
    """Draw what is killed, how, and after which share of its time: each command and kind as often as the others."""
    rng = random.Random(seed)
    pairs = [
        (name, kind) for name, case in killer.cases.items() for kind in KINDS if case.workers or kind != WORKER
    ]  # fmt: skip
    bag: list[tuple[str, str]] = []
    for _ in range(kills):
        bag = bag or rng.sample(pairs, len(pairs))
        yield (*bag.pop(), rng.uniform(0, 1))


@click.command()
@click.option("--kills", default=100, show_default=True)
@click.option("--seed", default=0, show_default=True)
@click.option(
    "--only", multiple=True, type=click.Choice([*cases(Path())]), help="As often as wanted.  [default: all six]"
)
@click.option("--keep", type=click.Path(path_type=Path), help="Folder to work in.  [default: a temporary one]")
def main(kills: int, seed: int, only: tuple[str, ...], keep: Path | None) -> None:
    """Kill commands, and print what came of it."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # which a shell ignores for what it starts with &
    with tempfile.TemporaryDirectory() as temporary:
        place = keep or Path(temporary)
        place.mkdir(parents=True, exist_ok=True)
        killer = Killer(place, only)
        killer.prepare()
        for number, (name, kind, moment) in enumerate(plan(kills, seed, killer), 1):
            known = len(killer.found.notes)
            killer.kill(name, kind, moment)
            for note in killer.found.notes[known:]:
                click.echo(note)
            click.echo(f"{number} of {kills}: {name}, {kind} at {moment:.2f}", err=True)
    Console(width=120).print(killer.found.table())
    sys.exit(0 if killer.found.sound else 1)


if __name__ == "__main__":
    main()
