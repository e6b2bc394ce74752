"""Measure a live stream on this machine with injected faults; print how soon each is reported, time and memory.

    scripts/python -m scripts.live_faults [--minutes 480] [--faults 20] [--work runs/live-faults]

A server sends a crane's work in real time, 9 small pictures a second as MPEG-TS, and appends what a controller reports
to a CSV file. A picture shows its number, by which detector and reader look up the true grab centre, with 1.3 px of
noise at 1920 px, and the length: times are those of the pipeline behind detector and reader. Faults follow each other
at equal distances of at least 50 s. Knocks move the grab centre in the picture. `faketime -f '+0s x4' scripts/python …`
shows eight hours in two; the time per frame is then four times too long.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import multiprocessing
import socket
import threading
import time
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import click
import numpy as np
import psutil
import tomli_w

from simgrab.dataset.tables import calibration_of
from simgrab.instrument import video
from simgrab.instrument.controller_feed import ControllerFeed
from simgrab.instrument.pipeline import Pipeline
from simgrab.instrument.run.run import run
from simgrab.model import calibration, scenes
from simgrab.model.geometry import to_camera
from simgrab.model.records.observations import Detection, Reading
from simgrab.model.rng import stream
from simgrab.world.trajectory.trajectory import Trajectory

RATE, SIZE, BITS, BLOCK = 9, (480, 270), 20, 24
FOCAL_PX, NOISE_PX = 1644.82 * SIZE[0] / 1920, 1.3 * SIZE[0] / 1920
KNOCK_DEG, OUT_S, QUIET_S = 1.5, 45.0, 20.0  # the grab is out of view, or nothing is sent, so long
FAULTS = {  # in turn, and the kinds of event by which they count as reported
    "knock": ["camera"], "lost": ["source", "picture"], "out": ["grab"], "night": ["exposure"], "jump": ["source"],
    "stops": ["controller"], "stall": ["source", "picture"], "clock": ["controller"],
}  # fmt: skip


def simulate(work: Path, minutes: float, faults: int) -> None:
    """Simulate the work, and write what detector, reader and server need of it."""
    frames, gap_s = round(minutes * 60 * RATE), minutes * 60 / (faults + 1)
    changes: dict[str, Any] = {
        "frames": frames, "camera.width_px": SIZE[0], "camera.height_px": SIZE[1], "camera.mount": {"model": "fixed"},
        "camera.focal": {"model": "pixels", "focal_length_px": FOCAL_PX}, "display.layout": "two-by-four",
    }  # fmt: skip
    scenario = scenes.load("work-cycles", changes)
    trajectory, camera, rows = Trajectory(scenario), scenario.camera, []
    for moment in map(trajectory.at, range(frames)):
        assert moment.jib is not None
        place = moment.grab.jib_from_grab.translation[None]
        centre = to_camera(place, moment.tilt.jib_from_camera[None], np.asarray(camera.offset_m))
        pixel = camera.intrinsics.project(centre)[0]
        rows.append([*pixel, moment.grab.rope_length, np.degrees(moment.jib.slew), moment.jib.radius])
    truth, time_s = np.array(rows), np.arange(frames) / RATE
    np.save(work / "reported.npy", truth[:, 2:])
    for begin, kind in zip(gap_s * np.arange(1, faults + 1), itertools.cycle(FAULTS), strict=False):
        if kind == "knock":
            truth[time_s >= begin, 0] += FOCAL_PX * np.tan(np.radians(KNOCK_DEG)) * (-1) ** round(begin / gap_s / 8)
        if kind == "out":
            truth[(time_s >= begin) & (time_s < begin + OUT_S), 0] = np.nan
    np.save(work / "shown.npy", truth[:, :3])
    calibration_of(scenario).save(work / "camera.toml")
    one = {"rate_hz": float(RATE), "resolution": 0.01}
    facts = {"time": {"column": "t"}} | {name: {"column": name, **one} for name in ("rope", "slew", "radius")}
    (work / "crane.toml").write_text(tomli_w.dumps(facts))
    (work / "crane.csv").write_text("t,rope,slew,radius\n")


class Oracle:
    """Detector and reader that look up what the picture's number stands for."""

    name = "true centres with noise"

    def __init__(self, work: Path) -> None:
        self.shown, self.noise = np.load(work / "shown.npy"), stream(0, 0, "noise")
        self.constant_m = calibration.load(work / "camera.toml").display_constant_m

    def row(self, picture: np.ndarray[Any, Any]) -> Any:
        """Read the number."""
        middle = picture[BLOCK // 2, BLOCK // 2 : BITS * BLOCK : BLOCK].mean(axis=-1)
        return self.shown[((middle > picture[BLOCK * 3 :].mean()) << np.arange(BITS)).sum()]

    def __call__(self, picture: np.ndarray[Any, Any]) -> Detection:
        """Detect the grab."""
        centre = self.row(picture)[:2] + self.noise.normal(0, NOISE_PX, 2)
        if not np.isfinite(centre).all():
            return Detection("none", "nothing found", 0.0)
        box = np.concatenate([centre - 7, centre + 7])
        return Detection("found", "", 0.9, box, centre, 0.0, np.ones(4), np.full(2, NOISE_PX), 0.0)

    def read(self, picture: np.ndarray[Any, Any], _layout: Any) -> Reading:
        """Read the display."""
        hoist = round(float(self.row(picture)[2]), 2) - self.constant_m
        return Reading("read", "", f"{round(100 * hoist):04d}", "2000", hoist)


def serve(work: Path, port: int, faults: int, gap_s: float) -> None:
    """Send pictures and append rows in real time, with faults."""
    reported, injected, due = np.load(work / "reported.npy"), list[tuple[str, float]](), iter(itertools.cycle(FAULTS))
    level, stamp_s, clock_s, quiet_until, silent_until = 1.0, 5000.0, 1000.0, 0.0, 0.0
    listening: socket.socket | None = socket.create_server(("127.0.0.1", port))
    (work / "listening").touch()
    assert listening is not None
    client: socket.socket | None = listening.accept()[0]
    muxer: Any = None
    begun = time.monotonic()
    for i in range(len(reported)):
        time.sleep(max(0.0, begun + i / RATE - time.monotonic()))
        now = i / RATE
        if len(injected) < faults and now >= (len(injected) + 1) * gap_s:
            injected.append((kind := next(due), time.monotonic()))
            (work / "injected.json").write_text(json.dumps(injected))
            level = 1.2 - level if kind == "night" else level
            stamp_s, muxer = (stamp_s + 3600, None) if kind == "jump" else (stamp_s, muxer)
            clock_s += 900 if kind == "clock" else 0
            silent_until = now + QUIET_S if kind == "stops" else silent_until
            quiet_until = now + QUIET_S if kind in ("lost", "stall") else quiet_until
            if kind == "lost" and listening and client:
                client.shutdown(socket.SHUT_RDWR)
                listening.close()
                client = muxer = listening = None
        if now >= silent_until:
            with (work / "crane.csv").open("a") as file:
                file.write(",".join(f"{value:.2f}" for value in (now + clock_s, *reported[i])) + "\n")
        if now < quiet_until:
            continue
        if listening is None:
            listening = socket.create_server(("127.0.0.1", port))
        listening.settimeout(0)
        with contextlib.suppress(BlockingIOError):
            client, muxer = listening.accept()[0], None
        if client is None:
            continue
        rgb = np.full((*SIZE[::-1], 3), 120 * level, np.uint8)
        for bit in range(BITS):
            rgb[:BLOCK, bit * BLOCK : (bit + 1) * BLOCK] = np.uint8(level * (200 if i >> bit & 1 else 40))
        picture = av.VideoFrame.from_ndarray(rgb, format="rgb24")
        picture.pts, picture.time_base = round((now + stamp_s) * 90_000), Fraction(1, 90_000)
        try:
            if muxer is None:
                client.settimeout(5)
                muxer = av.open(client.makefile("wb", buffering=0), "w", format="mpegts")
                coded = muxer.add_stream("libx264", rate=RATE, options={"tune": "zerolatency", "g": "9"})
                coded.width, coded.height, coded.pix_fmt = *SIZE, "yuv420p"
            muxer.mux(muxer.streams.video[0].encode(picture))
        except (OSError, av.error.FFmpegError):
            client = muxer = None


@click.command()
@click.option("--minutes", default=480.0, show_default=True)
@click.option("--faults", default=20, show_default=True, help="How many of them.")
@click.option("--work", type=click.Path(path_type=Path), default=Path("runs/live-faults"), show_default=True)
def main(minutes: float, faults: int, work: Path) -> None:
    """Print a row for each fault, and what the run needed."""
    work.mkdir(parents=True)
    simulate(work, minutes, faults)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    arguments = work, port, faults, minutes * 60 / (faults + 1)
    multiprocessing.get_context("spawn").Process(target=serve, args=arguments, daemon=True).start()
    while not (work / "listening").exists():
        time.sleep(1)
    video.GIVE_UP_S = 2 * QUIET_S  # after the end
    oracle: Any = Oracle(work)
    events, memory = list[tuple[float, str]](), list[float]()

    def sample() -> None:
        while True:
            memory.append(psutil.Process().memory_info().rss / 2**20)
            time.sleep(10)

    def note(line: str) -> None:
        events.append((time.monotonic(), line))
        print(line, flush=True)

    threading.Thread(target=sample, daemon=True).start()
    pipeline = Pipeline(oracle, oracle, feed=ControllerFeed(work / "crane.csv"))
    run(f"tcp://127.0.0.1:{port}", calibration.load(work / "camera.toml"), work / "run", pipeline, report=note)
    print("| fault | reported after, s | by |\n|---|---|---|")
    injected = [*json.loads((work / "injected.json").read_text()), ("", np.inf)]
    for (kind, at), (_, until) in itertools.pairwise(injected):
        hits = [event for event in events if at <= event[0] < until and event[1].split(": ")[1] in FAULTS[kind]]
        print(f"| {kind} | {hits[0][0] - at:.1f} | {hits[0][1]} |" if hits else f"| {kind} | never | |")
        events = [event for event in events if event not in hits]
    print(f"other events: {[line for _, line in events]}")
    parts = [json.loads(path.read_text()) for path in sorted(work.glob("run*/run.json"))]
    p99 = max(part["speed"]["latency_p99_s"] for part in parts)
    at = ", ".join(f"{memory[int(x * (len(memory) - 1))]:.0f}" for x in (0, 0.1, 0.5, 1))
    print(
        f"{sum(part['speed']['frames'] for part in parts)} frames, {sum(part['counts']['ok'] for part in parts)} with "
        f"an angle, in {len(parts)} parts; time per frame, 99 %: {1e3 * p99:.0f} ms in the slowest part; memory at "
        f"first, after a tenth, half and all of the run: {at} MB"
    )


if __name__ == "__main__":
    main()
