"""Measure a live stream on this machine with injected faults; print how soon each is reported, time and memory.

    python -m scripts.live_faults [--minutes 480] [--faults 20] [--work runs/live-faults]

A server sends a crane's work in real time, 9 small pictures a second as MPEG-TS, and appends what a controller reports
to a CSV file. A picture shows its number, by which detector and reader look up the true grab centre, with 1.3 px of
noise at 1920 px, and the length: times are those of the pipeline behind detector and reader. Faults follow each other
at equal distances. Knocks move the grab centre in the picture.
"""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import resource
import socket
import threading
import time
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import click
import numpy as np

from simgrab.dataset.tables import calibration_of
from simgrab.instrument import video
from simgrab.instrument.controller_feed import ControllerFeed
from simgrab.instrument.pipeline import Pipeline
from simgrab.instrument.run.run import RunOptions, run
from simgrab.model import calibration, scenes
from simgrab.model.geometry import Array, to_camera
from simgrab.model.records.observations import Detection, Reading
from simgrab.model.rng import stream
from simgrab.world.trajectory.trajectory import Trajectory

RATE, SIZE, BITS, BLOCK = 9, (480, 270), 20, 24
NOISE_PX = 1.3 * SIZE[0] / 1920
FAULTS = [  # kind, its size, and the kinds of event by which it counts as reported
    ("knock", 2.0, ["camera"]), ("lost", 20.0, ["source", "picture"]), ("out", 45.0, ["grab"]),
    ("night", 0.2, ["exposure"]), ("jump", 3600.0, ["source"]), ("stops", 25.0, ["controller"]),
    ("stall", 20.0, ["source", "picture"]), ("clock", 900.0, ["controller"]), ("jump", -1800.0, ["source"]),
    ("knock", 1.0, ["camera"]), ("out", 45.0, ["grab"]), ("night", 1.0, ["exposure"]),
    ("lost", 5.0, ["source", "picture"]), ("knock", -3.0, ["camera"]), ("stops", 25.0, ["controller"]),
    ("jump", 60.0, ["source"]), ("out", 45.0, ["grab"]), ("night", 0.2, ["exposure"]),
    ("stall", 20.0, ["source", "picture"]), ("clock", -900.0, ["controller"]),
]  # fmt: skip
LONG_S = 180.0  # that the grab stays out of view, and the controller silent, in a long run
DESCRIPTION = """
[time]
column = "t"
[rope]
column = "rope"
rate_hz = 10.0
resolution = 0.01
[slew]
column = "slew"
rate_hz = 10.0
resolution = 0.05
[radius]
column = "radius"
rate_hz = 10.0
resolution = 0.01
"""


def simulate(work: Path, frames: int) -> None:
    """Simulate the work, and write what detector, reader and server need of it."""
    changes: dict[str, Any] = {
        "frames": frames, "camera.width_px": SIZE[0], "camera.height_px": SIZE[1], "camera.mount": {"model": "fixed"},
        "camera.focal": {"model": "pixels", "focal_length_px": 1644.82 * SIZE[0] / 1920},
        "display.layout": "two-by-four",
    }  # fmt: skip
    scenario = scenes.load("work-cycles", changes)
    trajectory, camera, rows = Trajectory(scenario), scenario.camera, []
    for i in range(frames):
        moment = trajectory.at(i)
        centre = to_camera(
            moment.grab.jib_from_grab.translation[None], moment.tilt.jib_from_camera[None], np.asarray(camera.offset_m)
        )
        assert moment.jib is not None
        jib = (moment.jib.slew, moment.jib.radius)
        rows.append([*camera.intrinsics.project(centre)[0], moment.grab.rope_length, *jib])
    np.save(work / "truth.npy", rows)
    calibration_of(scenario).save(work / "camera.toml")


def draw(number: int, level: float) -> np.ndarray[Any, Any]:
    """Draw a picture that shows a number by its blocks."""
    rgb = np.full((*SIZE[::-1], 3), 120 * level, np.uint8)
    for bit in range(BITS):
        rgb[:BLOCK, bit * BLOCK : (bit + 1) * BLOCK] = np.uint8(level * (200 if number >> bit & 1 else 40))
    return rgb


class Oracle:
    """Detector and reader that look up what the picture's number stands for."""

    name = "true centres with noise"

    def __init__(self, work: Path) -> None:
        self.truth, self.noise = np.load(work / "truth.npy", mmap_mode="r"), stream(0, 0, "noise")
        self.shown = np.load(work / "shown.npy", mmap_mode="r")  # shift of the centre, px; NaN where it is out of view

    def row(self, picture: np.ndarray[Any, Any]) -> int:
        """Read the number."""
        middle = picture[BLOCK // 2, BLOCK // 2 : BITS * BLOCK : BLOCK].mean(axis=-1)
        return int(((middle > picture[BLOCK * 3 :].mean()) << np.arange(BITS)).sum())

    def __call__(self, picture: np.ndarray[Any, Any]) -> Detection:
        """Detect the grab."""
        i = self.row(picture)
        centre = self.truth[i, :2] + self.noise.normal(0, NOISE_PX, 2) + (self.shown[i], 0.0)
        if not np.isfinite(centre).all():
            return Detection("none", "nothing found", 0.0)
        box = np.concatenate([centre - 7, centre + 7])
        return Detection("found", "", 0.9, box, centre, 0.0, np.ones(4), np.full(2, NOISE_PX), 0.0)

    def read(self, picture: np.ndarray[Any, Any], _layout: Any, *, display_constant_m: float) -> Reading:
        """Read the display."""
        length = round(float(self.truth[self.row(picture), 2]), 2)
        hoist = length - display_constant_m
        return Reading("read", "", f"{round(100 * hoist):04d}", "2000", np.ones(8), hoist, 20.0, length)


class Server:
    """Sends pictures and controller rows in real time, with faults."""

    def __init__(self, work: Path, port: int, count: int, gap_s: float) -> None:
        self.work, self.port, self.count, self.gap_s = work, port, count, gap_s
        self.truth, self.level, self.stamp_s, self.clock_s = np.load(work / "truth.npy"), 1.0, 0.0, 1000.0
        self.until = dict.fromkeys(("lost", "stall", "stops"), 0.0)
        self.listening: socket.socket | None = None
        self.client: socket.socket | None = None
        self.muxer: Any = None

    def serve(self) -> None:
        """Send all frames."""
        self.listen()
        assert self.listening is not None
        self.listening.settimeout(60)
        (self.work / "listening").touch()
        self.client = self.listening.accept()[0]
        self.listening.settimeout(0)
        begun, rows = time.monotonic(), 0
        injected: list[tuple[str, float]] = []
        with (self.work / "crane.csv").open("a") as file:
            for i in range(len(self.truth)):
                time.sleep(max(0.0, begun + i / RATE - time.monotonic()))
                now = i / RATE
                if len(injected) < self.count and now >= (len(injected) + 1) * self.gap_s:
                    kind, size, _ = FAULTS[len(injected)]
                    injected.append((kind, time.monotonic()))
                    (self.work / "injected.json").write_text(json.dumps(injected))
                    self.inject(kind, size, now)
                while rows / 10 <= now:
                    self.report(file, rows / 10)
                    rows += 1
                file.flush()
                self.send(i, now)
        if self.client:
            self.client.close()

    def inject(self, kind: str, size: float, now: float) -> None:
        """Begin a fault."""
        if kind in self.until:
            self.until[kind] = now + (min(LONG_S, self.gap_s / 2) if kind == "stops" and self.gap_s > LONG_S else size)
        if kind == "lost":
            for one in (self.client, self.listening):
                if one:
                    one.close()
            self.client = self.listening = self.muxer = None
        self.level = size if kind == "night" else self.level
        self.clock_s += size if kind == "clock" else 0.0
        if kind == "jump":
            self.stamp_s, self.muxer = self.stamp_s + size, None

    def listen(self) -> None:
        """Open the port."""
        self.listening = socket.create_server(("127.0.0.1", self.port))
        self.listening.settimeout(0)

    def report(self, file: Any, now: float) -> None:
        """Append a row of the controller."""
        if now < self.until["stops"]:
            return
        *_, rope, slew, radius = [np.interp(now * RATE, np.arange(2) + int(now * RATE), c) for c in self.rows_at(now)]
        slew_deg = round(float(np.degrees(slew)) / 0.05) * 0.05
        file.write(f"{now + self.clock_s:.2f},{rope:.2f},{slew_deg:.2f},{radius:.2f}\n")

    def rows_at(self, now: float) -> Array:
        """Columns of the two frames about a moment."""
        i = min(int(now * RATE), len(self.truth) - 2)
        return np.asarray(self.truth[i : i + 2].T)

    def send(self, i: int, now: float) -> None:
        """Send a picture, if somebody is connected."""
        if now < max(self.until["lost"], self.until["stall"]):
            return
        if self.listening is None:
            self.listen()
        assert self.listening is not None
        with contextlib.suppress(BlockingIOError):
            self.client, self.muxer = self.listening.accept()[0], None
        if self.client is None:
            return
        try:
            if self.muxer is None:
                self.client.settimeout(5)
                self.muxer = av.open(self.client.makefile("wb", buffering=0), "w", format="mpegts")
                coded = self.muxer.add_stream("libx264", rate=RATE, options={"tune": "zerolatency", "g": "9"})
                coded.width, coded.height, coded.pix_fmt = *SIZE, "yuv420p"
            coded = self.muxer.streams.video[0]
            picture = av.VideoFrame.from_ndarray(draw(i, self.level), format="rgb24")
            picture.pts, picture.time_base = round((now + 5000 + self.stamp_s) * 90_000), Fraction(1, 90_000)
            for packet in coded.encode(picture):
                self.muxer.mux(packet)
        except (OSError, av.error.FFmpegError):
            self.client = self.muxer = None


def shown(frames: int, count: int, gap_s: float) -> Array:
    """Shift of the grab centre in each frame, px, by knocks; NaN where the grab is out of view."""
    found, time_s = np.zeros(frames), np.arange(frames) / RATE
    for number, (kind, size, _) in enumerate(FAULTS[:count], 1):
        begin = number * gap_s
        if kind == "knock":
            found[time_s >= begin] += 1644.82 * SIZE[0] / 1920 * np.tan(np.radians(size))
        if kind == "out":
            found[(time_s >= begin) & (time_s < begin + min(LONG_S, max(size, gap_s / 3)))] = np.nan
    return found


def _serve(work: Path, port: int, count: int, gap_s: float) -> None:
    Server(work, port, count, gap_s).serve()


def memory_mb() -> float:
    """Resident memory of this process."""
    fields = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return float(fields["VmRSS"].split()[0]) / 1024


@click.command()
@click.option("--minutes", default=480.0, show_default=True)
@click.option("--faults", default=len(FAULTS), show_default=True, help="How many of them.")
@click.option("--work", type=click.Path(path_type=Path), default=Path("runs/live-faults"), show_default=True)
def main(minutes: float, faults: int, work: Path) -> None:
    """Print a row for each fault, and what the run needed."""
    work.mkdir(parents=True, exist_ok=False)
    frames, gap_s = round(minutes * 60 * RATE), minutes * 60 / (faults + 1)
    simulate(work, frames)
    np.save(work / "shown.npy", shown(frames, faults, gap_s))
    (work / "crane.toml").write_text(DESCRIPTION)
    (work / "crane.csv").write_text("t,rope,slew,radius\n")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    server = multiprocessing.get_context("spawn").Process(target=_serve, args=(work, port, faults, gap_s), daemon=True)
    server.start()
    while not (work / "listening").exists():
        time.sleep(1)
    video.GIVE_UP_S = 40.0  # after the end
    oracle, events, memory = Oracle(work), list[tuple[float, str]](), list[float]()
    ended = threading.Event()

    def sample() -> None:
        while not ended.wait(10):
            memory.append(memory_mb())

    threading.Thread(target=sample, daemon=True).start()
    pipeline = Pipeline(oracle, oracle, feed=ControllerFeed(work / "crane.csv"))  # type: ignore[arg-type]

    def note(line: str) -> None:
        events.append((time.monotonic(), line))
        print(line, flush=True)

    run(
        f"tcp://127.0.0.1:{port}", calibration.load(work / "camera.toml"), work / "run", pipeline, RunOptions(),
        report=note,
    )  # fmt: skip
    ended.set()
    parts = [json.loads(path.read_text()) for path in sorted(work.glob("run*/run.json"))]
    measured = sum(part["speed"]["frames"] for part in parts)
    injected = json.loads((work / "injected.json").read_text())
    print("| fault | size | reported after, s | by |\n|---|---|---|---|")
    used = set[int]()
    for k, ((kind, at), (_, size, kinds)) in enumerate(zip(injected, FAULTS, strict=False)):
        until = injected[k + 1][1] if k + 1 < len(injected) else np.inf
        hits = [n for n, (t, line) in enumerate(events) if at <= t < until and line.split(": ")[1] in kinds]
        first = events[hits[0]] if hits else None
        used.update(hits)
        print(
            f"| {kind} | {size:g} | {first[0] - at:.1f} | {first[1]} |" if first else f"| {kind} | {size:g} | never | |"
        )
    others = [line for n, (_, line) in enumerate(events) if n not in used and not line.startswith("written")]
    print(f"other events: {others}")
    cpu = resource.getrusage(resource.RUSAGE_SELF)
    p99 = max(part["speed"]["latency_p99_s"] for part in parts)
    ok = sum(part["counts"]["ok"] for part in parts)
    print(
        f"{measured} frames, {ok} with an angle; time per frame, 99 %: {1e3 * p99:.0f} ms in the slowest part; "
        f"CPU per frame {1e3 * (cpu.ru_utime + cpu.ru_stime) / measured:.1f} ms; memory after 10 s, a tenth, half and "
        f"all of the run: {', '.join(f'{memory[int(x * (len(memory) - 1))]:.0f}' for x in (0, 0.1, 0.5, 1))} MB, "
        f"at most {max(memory):.0f} MB; in {len(parts)} parts"
    )


if __name__ == "__main__":
    main()
