"""Kill commands at random moments, run them again, and compare with undisturbed runs.

``scripts/python -m scripts.kill_runs [--kills 100] [--seed 0] [--only COMMAND] [--keep FOLDER]``

A kill is a signal to the command (SIGINT, SIGTERM, SIGHUP or SIGKILL), or SIGKILL to one of its workers, at a moment
drawn over the time that the command takes. Prints a table, and exits with 1 if after any kill

- the exit status is another than that of the signal, a traceback is printed, or the command does not end;
- a file has its final name and other bytes than the undisturbed run's;
- a process is left that the command started;
- the command, run again (with --resume where it has that), fails, or leaves other files, other bytes or a draft.

Wall times differ from run to run, and are left out of the comparison. So is the checkpoint of a training, which holds
one; the net that is made of it is compared.
"""

from __future__ import annotations

import hashlib
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
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import click
import psutil
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
WALL_TIMES = {
    "run.json": rb'"speed": *\{[^}]*\}', "check.json": rb'"seconds": *\{[^}]*\}', "junit.xml": rb'time="[0-9.]+"',
    "report.html": rb"<th[^>]*>speed</th>.*?</tr>",
    "reader.json": rb'"seconds": *[0-9.e-]+', "reader.md": rb"for [0-9.]+ minutes",
}  # fmt: skip
SMALL = {
    "camera.width_px": 480, "camera.height_px": 270, "camera.focal": '{model="pixels", focal_length_px=411.2}',
    "image.samples": 0, "image.shadow_map_px": 0, "place": '{model="plain"}',
}  # fmt: skip
_SMALL = [part for key, value in SMALL.items() for part in ("--set", f"{key}={value}")]
INSTRUMENT = """
from simgrab.instrument.contract import Measurement


class Mine:
    name = "mine"

    def __call__(self, frames, calibration):
        return [Measurement(status="ok", alpha=0.05, centre=(240.0, 135.0)) for _ in frames]
"""
SUITE = f"""
name = "kills"
instrument = "mine:Mine"
[changes]
{chr(10).join(f'"{key}" = {value}' for key, value in SMALL.items())}
[limits]
"frames.ok" = {{ lower = 4 }}
[scenes.calm]
scene = "quay-day"
frames = 4
"""


class Case(NamedTuple):
    """A command, run in a folder of its own, whose outputs lie in ``out`` there.

    ``resume``: whether it takes that option. ``once``: output that a finished run is refused to write again.
    """

    arguments: tuple[str, ...]
    resume: bool = True
    once: str = ""
    workers: bool = True


def cases(place: Path) -> dict[str, Case]:
    """Commands to kill, on inputs in ``place``."""
    render = ("render", "quay-day", *_SMALL, "--quiet", "--workers", "2")
    clips = ("--set", "clip.clip_frames=3", "--frames", "9", "--video", "out/swing.mp4")
    data = str(place / "data")
    run = ("run", data, "--instrument", "mine:Mine", "--quiet", "--out", "out/run")
    train = ("train", "reader", data, "--epochs", "4", "--batch", "32", "--quiet", "--out", "out")
    check = ("check", str(place / "kills.toml"), "--cache", "out/cache", "--workers", "2", "--quiet", "--out", "out")
    return {
        "render": Case((*render, "--frames", "8", "--out", "out")),
        "video": Case((*render, *clips)),
        "run": Case(run, resume=False, once="run", workers=False),
        "train": Case(train, workers=False),
        "check": Case(check, resume=False),
        "stress": Case(("stress", "focal", "--quick", "--workers", "2", "--quiet", "--out", "out")),
    }


class Killer:
    """Kills commands in a folder of its own; ``notes`` says what was found wrong."""

    def __init__(self, place: Path, only: Sequence[str] = ()) -> None:
        self.place = place.resolve()
        every = cases(self.place)
        self.cases = {name: every[name] for name in only or every}
        self.seconds: dict[str, float] = {}
        self.expected: dict[str, dict[str, str]] = {}  # by command, the undisturbed run's files with their digests
        # By command, kind and what: "kills", "ended" (of these, the commands that were not done before), or a fault.
        self.counts, self.notes = Counter[tuple[str, str, str]](), list[str]()

    def prepare(self) -> None:
        """Make the inputs, and run each command undisturbed."""
        (self.place / "mine.py").write_text(INSTRUMENT)
        (self.place / "kills.toml").write_text(SUITE)
        if not {"run", "train"}.isdisjoint(self.cases) and not (self.place / "data" / "manifest.json").exists():
            display = ("--set", "display.layout=two-by-four", "--frames", "40", "--quiet", "--out", "data")
            command = [sys.executable, "-m", "simgrab", "render", "quay-day", *_SMALL, *display]
            subprocess.run(command, cwd=self.place, check=True)
        for name, case in self.cases.items():
            folder = self.place / "reference" / name
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
            begun = time.monotonic()
            if self._start(case, folder).wait() != 0:
                raise click.ClickException(f"{name}, undisturbed: {_said(folder)}")
            self.seconds[name] = time.monotonic() - begun
            self.expected[name] = contents(folder / "out")

    def kill(self, name: str, kind: str, moment: float) -> None:
        """Start a command, kill it after a share of the time that it takes, and run it again."""
        folder = self.place / "killed"
        shutil.rmtree(folder, ignore_errors=True)
        (folder / TMP).mkdir(parents=True)
        self.counts[name, kind, "kills"] += 1
        process = self._start(self.cases[name], folder)
        ended = self._strike(process, kind, moment * self.seconds[name])
        self.counts[name, kind, "ended"] += ended
        for what, text in self._faults(name, kind, process, ended, folder):
            self.counts[name, kind, what] += 1
            self.notes.append(f"{name}, {kind} at {moment:.2f}: {what}: {text}")

    def _faults(
        self, name: str, kind: str, process: subprocess.Popen[bytes], ended: bool, folder: Path
    ) -> Iterator[tuple[str, str]]:
        """Find what is wrong with a killed command, run it again, and find what is wrong then."""
        case, expected = self.cases[name], self.expected[name]
        yield from _waited(process)
        for line in _left(self._mark):
            yield "left", line
        said, there = _said(folder), contents(folder / "out")
        right = _right_statuses(kind, ended, there not in ({}, expected))
        if process.returncode not in right:
            yield "status", f"{process.returncode} instead of {' or '.join(map(str, right))}: {said}"
        if kind != "SIGKILL" and "Traceback" in said and any(sign in said for sign in OURS):
            yield "traceback", said
        for file, digest in there.items():
            if not _is_draft(file) and expected.get(file, digest) != digest:
                yield "half", file
            if kind not in ("SIGKILL", WORKER) and ".draft" in file and ".partial" not in file:
                yield "draft", f"{file}, before it was run again"
        if not (case.once and (folder / "out" / case.once).exists()):
            process = self._start(case, folder, *(["--resume"] if case.resume else []))
            yield from _waited(process)
            if process.returncode != 0:
                yield "again", f"status {process.returncode}: {_said(folder)}"
            there = contents(folder / "out")
        for file in sorted(contents(folder / TMP)) if kind != "SIGKILL" else ():
            yield "draft", f"{TMP}/{file}"
        for file in sorted(expected.keys() - there.keys()):
            yield "lost", file
        for file in sorted(there):
            if _is_draft(file):
                yield "draft", file
            elif expected.get(file) != there[file]:
                yield "differs", file

    def _start(self, case: Case, folder: Path, *more: str) -> subprocess.Popen[bytes]:
        self._mark = uuid.uuid4().hex
        environment = os.environ | {MARK: self._mark, "PYTHONPATH": os.pathsep.join([str(self.place), str(Path.cwd())])}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)  # else every process compiles all that it imports
        if (folder / TMP).exists():
            environment["TMPDIR"] = str(folder / TMP)
        command = [sys.executable, "-m", "simgrab", *case.arguments, *more]
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

    def table(self) -> Table:
        """One row for each command and kind of kill, and one for all."""
        columns = ("kills", "ended", *FAULTS)
        table = Table("command", "kill", *columns)
        for name, kind in sorted({(name, kind) for name, kind, _ in self.counts}):
            table.add_row(name, kind, *(str(self.counts[name, kind, what]) for what in columns))
        whole = (sum(count for (*_, of), count in self.counts.items() if of == what) for what in columns)
        table.add_row("all", "", *map(str, whole), style="bold")
        return table


def _waited(process: subprocess.Popen[bytes]) -> Iterator[tuple[str, str]]:
    try:
        process.wait(HANGS_S)
    except subprocess.TimeoutExpired:
        yield "status", "it does not end"
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def _said(folder: Path) -> str:
    return (folder / "said").read_text(errors="replace").strip()[-2000:]


def _right_statuses(kind: str, ended: bool, begun: bool) -> tuple[int, ...]:
    """Exit statuses that a killed command may have.

    Where nothing is ``begun``, or all is done, the signal may have met Python itself, starting or ending.
    """
    if kind == WORKER or not ended:
        return (0,)
    number = int(signal.Signals[kind])
    early = () if begun else (-number, 1) if kind == "SIGINT" else (-number,)
    return (0, -number) if kind == "SIGKILL" else (0, 128 + number, *early)


def _is_draft(file: str) -> bool:
    return any(part.endswith((".draft", ".partial")) or part.startswith("draft-") for part in Path(file).parts)


def _workers(parent: int) -> list[int]:
    """Find the processes that a process started, but for the one that looks after shared memory."""
    try:
        return [child.pid for child in psutil.Process(parent).children() if "spawn_main" in " ".join(child.cmdline())]
    except psutil.Error:  # one is gone meanwhile
        return []


def _left(mark: str) -> list[str]:
    """Find processes that stay when a run has ended; zombies, whose environment is gone, are none."""
    until = time.monotonic() + LINGERS_S
    while left := [
        p for p in psutil.process_iter(["environ", "cmdline"]) if (p.info["environ"] or {}).get(MARK) == mark
    ]:
        if time.monotonic() > until:
            return [f"process {one.pid}: {' '.join(one.info['cmdline'] or ())}" for one in left]
        time.sleep(0.1)
    return []


def contents(folder: Path) -> dict[str, str]:
    """Digest of every file below a folder, wall times left out; locks, which are empty, are no content."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.name not in ("lock", ".lock", "checkpoint.pt") and path.suffix != ".lock":
            data = path.read_bytes()
            if path.name in WALL_TIMES and not _is_draft(str(path)):
                data = re.sub(WALL_TIMES[path.name], b"", data, flags=re.DOTALL)
            found[str(path.relative_to(folder))] = hashlib.sha256(data).hexdigest()
    return found


def plan(kills: int, seed: int, killer: Killer) -> Iterator[tuple[str, str, float]]:
    """Draw what is killed, how, and after which share of its time: each command and kind as often as the others."""
    rng = random.Random(seed)
    pairs = [(name, kind) for name, case in killer.cases.items() for kind in KINDS if case.workers or kind != WORKER]
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
            known = len(killer.notes)
            killer.kill(name, kind, moment)
            for note in killer.notes[known:]:
                click.echo(note)
            click.echo(f"{number} of {kills}: {name}, {kind} at {moment:.2f}", err=True)
    Console(width=120).print(killer.table())
    sys.exit(1 if killer.notes else 0)


if __name__ == "__main__":
    main()
