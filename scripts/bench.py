"""Measure simgrab on this machine. Ratios are taken pair by pair within one run, so that a noisy machine cancels.

scripts/python -m scripts.bench render --scene quay-day       # a finished frame beside other renderers
scripts/python -m scripts.bench scale --scene training        # what a plan of a large run starts from
scripts/python -m scripts.bench dataset --scene training --workers 1,2,4 --reference FOLDER   # from command to manifest
scripts/python -m scripts.bench motion                        # the physics of a clip
scripts/python -m scripts.bench world                         # night, weather, optics and display
scripts/python -m scripts.bench detect --yolo FILE.onnx       # from a picture to box, centre and rope length
scripts/python -m scripts.bench run VIDEO                     # from video to angle

Each takes --json FILE, which keeps every sample with machine, versions and commit. Two such files are compared with

scripts/python -m scripts.bench compare A.json B.json
"""

from __future__ import annotations

import itertools
import resource
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import click
import msgspec
import numpy as np
import psutil
from numpy.typing import NDArray

from scripts import bench_results
from scripts.bench_results import Quantity, Results, ResultsError
from scripts.renderers import compared
from simgrab.cli import main as run_command
from simgrab.model import layouts, scenes

T = TypeVar("T")
COUNT = click.IntRange(min=1)
WARM_UP = 2  # frames
MEMORY_AFTER = 2000  # frames of a video
PICTURES, ROUNDS = 12, 20  # of the detector


def _counts(_context: click.Context, _parameter: click.Parameter, text: str) -> tuple[int, ...]:
    try:
        counts = tuple(map(int, text.split(",")))
    except ValueError:
        counts = ()
    if not counts or min(counts) < 1:
        raise click.BadParameter(f"must be numbers of 1 or more, by commas, got {text!r}")
    return counts


def in_turns(acts: Mapping[str, Callable[[T], Any]], items: Iterable[T], warm_up: int) -> dict[str, list[float]]:
    """Time all acts on one item, then on the next, so that what slows the machine slows them alike.

    The first ``warm_up`` items are not timed. Returns seconds, by the acts' names.
    """
    took: dict[str, list[float]] = {name: [] for name in acts}
    for number, item in enumerate(items):
        for name, act in acts.items():
            start = time.perf_counter()
            act(item)
            if number >= warm_up:
                took[name].append(time.perf_counter() - start)
    return took


def scale(scene: str, size: tuple[int, int] | None, frames: int) -> Iterator[Quantity]:
    """Measure frames one after another in one process: worlds, rendering, labels and encoding, without writing.

    CPU time is that of all threads of the process, OpenGL's included where the CPU renders. The bytes of labels are
    those of a shard of all frames and of one of the first half: what the other half adds, and what a file begins with.
    """
    from simgrab.dataset import shards, stored, tables
    from simgrab.dataset.shard_reader import table as shard_labels
    from simgrab.io.stores import Store
    from simgrab.world.frames import FrameGenerator

    scenario = scenes.load(scene, {"frames": max(frames, 2)}, size=size)
    worlds, times, images, records = [], [], [], []
    packed = list[shards.Packed]()
    with FrameGenerator(scenario) as generator:
        variant = None
        for frame in range(scenario.frames):
            began = _now()
            if variant != generator.recipe.variant_number(frame):
                variant = generator.recipe.variant_number(frame)
                generator.scene(frame)
                worlds.append(_now() - began)
                began = _now()
            made = stored.make(generator, frame)
            times.append(_now() - began)
            images.append(sum(map(len, made.files.values())) / 1e3)
            records.append(len(msgspec.json.encode(made.record)) / 1e3)
            row, mask = made.record.truth, made.record.mask
            packed.append(shards.Packed(row, mask if tables.is_labelled(row, scenario) else None, {row.file: b""}))

    def labels_bytes(some: list[shards.Packed]) -> int:
        store = Store("memory://scale")
        shards.write(store, 0, some, scenario, made.record.rendered_by)
        return store.sizes("labels")[shard_labels(0)]

    half = len(packed) // 2
    whole = labels_bytes(packed)
    each = (whole - labels_bytes(packed[:half])) / (len(packed) - half)
    for name, taken in (("world", np.array(worlds)), ("frame", np.array(times))):
        yield Quantity.ms(f"{name}: time", taken[:, 0])
        yield Quantity.ms(f"{name}: CPU time", taken[:, 1])
    yield Quantity.of("frame: image", "kB", *images)
    yield Quantity.of("frame: labels and mask as JSON", "kB", *records)
    yield Quantity.of("frame: labels in a table", "kB", each / 1e3)
    yield Quantity.of("table of labels: beside its frames", "kB", (whole - each * len(packed)) / 1e3)


def _now() -> NDArray[np.float64]:
    return np.array([time.perf_counter(), time.process_time()])


def dataset(
    scene: str, size: tuple[int, int] | None, frames: int, workers: tuple[int, ...], reference: Path | None
) -> Iterator[Quantity]:
    """Measure frames a second from command to manifest, by the number of worker processes.

    With a reference, a dataset of the same scene, seed and size that another machine rendered, frames of both are
    compared: on a GPU, pictures may differ.
    """
    from simgrab.dataset.render import render as rendered

    scenario = scenes.load(scene, {"frames": frames}, size=size)
    for count in workers:
        with tempfile.TemporaryDirectory() as folder:
            path, began = Path(folder) / "dataset", time.perf_counter()
            rendered(scenario, path, workers=count)
            yield Quantity.of(f"{count} worker processes", "frames/s", frames / (time.perf_counter() - began))
            if reference and count == workers[0]:
                yield from _differences(reference, path)


def _differences(one: Path, other: Path) -> Iterator[Quantity]:
    """Compare labels and pictures of the frames that two datasets have in common."""
    import pyarrow.parquet as pq

    from simgrab.io import pictures

    tables = [pq.read_table(path / "labels.parquet") for path in (one, other)]
    common = min(table.num_rows for table in tables)
    first, second = (table.slice(0, common).to_pylist() for table in tables)
    files = [(a.pop("image_sha256"), b.pop("image_sha256")) for a, b in zip(first, second, strict=True)]
    unlike = sum(a != b for a, b in zip(first, second, strict=True))
    yield Quantity.of(f"frames of {common} whose labels differ", "", unlike)
    yield Quantity.of(f"frames of {common} whose image files differ", "", sum(a != b for a, b in files))
    off = []
    for a, b in zip(first, second, strict=True):
        shown = [pictures.read(path / row["file"]).astype(np.int16) for path, row in ((one, a), (other, b))]
        off.append(float(np.abs(shown[0] - shown[1]).mean()))
    yield Quantity.of("mean difference of a picture", "of 255", *off)


def motion() -> Iterator[Quantity]:
    """Measure how much faster than real time the physics runs, and how memory grows with a clip's length."""
    from simgrab.world.trajectory.clip import ClipMotion

    for name in ("free-swing", "work-cycles", "wind-only", "isotropic-forcing"):
        moments = iter(ClipMotion(scenes.load(name, {"frames": 10_000_000}), 0))
        for _ in itertools.islice(moments, 2000):  # the first blocks warm up
            pass
        began, clock = time.process_time(), next(moments).time
        last = next(itertools.islice(moments, 2700, None)).time
        assert clock is not None
        assert last is not None
        speed = (last - clock) / (time.process_time() - began)
        yield Quantity.of(f"{name}: speed of the physics, one core", "× real time", speed)
    moments = iter(ClipMotion(scenes.load("work-cycles", {"frames": 10_000_000, "swing.wind.mean_m_s": 5.0}), 0))
    for hours in (0.25, 1.0, 4.0):
        next(moment for moment in moments if moment.time is not None and moment.time >= 3600 * hours)
        yield Quantity.of(f"memory after {hours:g} h of a clip", "MB", psutil.Process().memory_info().rss / 1e6)


def world(repeats: int = 7) -> Iterator[Quantity]:
    """Measure what night, weather, optics and display cost a 1080p frame, once it is rendered."""
    from simgrab.world.frames import FrameGenerator

    for name in ("calm-day", "windy-day", "night-light-snow", "heavy-snow", "rain", "fog", "dust", "glare"):
        with FrameGenerator(scenes.load(name)) as generator:
            drawn = ((scene := generator.scene(i), scene.draw(generator.project(i), labelled=False)) for i in range(99))
            took = in_turns(
                {name: lambda one: one[0].develop(one[1])}, itertools.islice(drawn, repeats + WARM_UP), WARM_UP
            )
        yield Quantity.ms(f"{name}: developing a frame", took[name])


def detect(yolo: Path | None) -> Iterator[Quantity]:
    """Measure milliseconds a 1080p picture to box, centre and rope length, with two threads."""
    from simgrab.instrument.detect import detector
    from simgrab.instrument.read import Reader
    from simgrab.world.frames import frames

    scene = scenes.load("exam-calm", {"clip.clip_frames": 4, "display.layout": "two-by-four"})
    pictures = [np.ascontiguousarray(frame.rgb) for frame in frames(scene, range(PICTURES), buffers=False)]
    layout, reader, bundled = layouts.load("two-by-four"), Reader(), detector("bundled")
    acts: dict[str, Callable[[Any], Any]] = {
        "detect": bundled,
        "read": lambda picture: reader.read(picture, layout),
        "detect and read": lambda picture: (bundled(picture), reader.read(picture, layout)),
    }
    if yolo is not None:
        acts[f"detect with {yolo.name}"] = detector(str(yolo))
    took = in_turns(acts, (1 + ROUNDS) * pictures, warm_up=PICTURES)
    yield from (Quantity.ms(name, seconds) for name, seconds in took.items())


def run(video: Path, detector: str, frames: int, live_frames: int) -> Iterator[Quantity]:
    """Measure speed and memory of a whole record, and the latency of a live one; the video is repeated."""
    from simgrab.instrument.contract import Frame
    from simgrab.instrument.pipeline import assemble
    from simgrab.instrument.source import camera_beside, fitting, open_source
    from simgrab.model import calibration

    camera = calibration.load(camera_beside(video))
    source, pipeline = open_source(video), assemble(detector=detector)
    decoding, memory = list[float](), list[float]()

    def loop(count: int) -> Iterator[Frame]:
        """Give so many frames, time going on, and note how long each took to decode."""
        decoding.clear()
        last, step = 0.0, 1 / 9
        while True:
            shift = last + step
            began = time.perf_counter()
            for frame in fitting(iter(source), camera):
                assert frame.time_s is not None
                last = shift + frame.time_s
                decoding.append(time.perf_counter() - began)
                if len(decoding) in (MEMORY_AFTER, count):
                    memory.append(psutil.Process().memory_info().rss / 1e6)
                yield Frame(frame.picture, last, frame.reason)
                if len(decoding) >= count:
                    return
                began = time.perf_counter()

    first = next(iter(source)).picture
    assert first is not None
    pipeline.detector(first)  # the first detection warms up
    began = _now()
    record = pipeline.record(loop(frames), camera)
    seconds, cpu = _now() - began
    yield Quantity.of(
        "whole record: frames with an angle", "frames", sum(m.status == "ok" for m in record.measurements)
    )
    yield Quantity.of("whole record: speed", "frames/s", frames / seconds)
    yield Quantity.of("whole record: CPU time of a frame", "ms", 1e3 * cpu / frames)
    for at, used in zip(sorted({min(MEMORY_AFTER, frames), frames}), memory, strict=True):
        yield Quantity.of(f"memory after {at} frames", "MB", used)
    yield Quantity.of("peak memory", "MB", resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1.024e-3)
    latencies = [one.seconds for one in pipeline.live(loop(live_frames), camera)]
    yield Quantity.ms("live: latency, decoding included", np.array(latencies) + decoding[: len(latencies)])
    yield Quantity.ms("live: decoding", decoding)


VERBS: dict[str, tuple[Callable[..., Iterator[Quantity]], list[click.Parameter]]] = {
    "render": (compared, [
        click.Option(["--scene"], default="quay-day", show_default=True),
        click.Option(["--size"], help="WIDTHxHEIGHT in pixels; the scene's own unless given."),
        click.Option(["--frames"], default=30, show_default=True, type=COUNT),
        click.Option(["--pyrender"], is_flag=True, help="Include pyrender."),
        click.Option(["--blender"], metavar="PYTHON", help="Include Blender, by an interpreter that can import bpy."),
        click.Option(["--traced"], default=4, show_default=True, type=COUNT, help="Frames by Blender."),
    ]),
    "scale": (scale, [
        click.Option(["--scene"], default="training", show_default=True),
        click.Option(["--size"], help="WIDTHxHEIGHT in pixels; the scene's own unless given."),
        click.Option(["--frames"], default=48, show_default=True, type=COUNT),
    ]),
    "dataset": (dataset, [
        click.Option(["--scene"], default="training", show_default=True),
        click.Option(["--size"], help="WIDTHxHEIGHT"),
        click.Option(["--frames"], default=640, show_default=True, type=COUNT),
        click.Option(["--workers"], default="2", show_default=True, callback=_counts, help="One or more, by commas."),
        click.Option(["--reference"], type=click.Path(path_type=Path, exists=True), help="Dataset to compare with."),
    ]),
    "motion": (motion, []),
    "world": (world, []),
    "detect": (detect, [click.Option(["--yolo"], type=click.Path(path_type=Path), help="Another detector.")]),
    "run": (run, [
        click.Argument(["video"], type=click.Path(path_type=Path, exists=True)),
        click.Option(["--detector"], default="bundled", show_default=True),
        click.Option(["--frames"], default=20_000, show_default=True, type=COUNT),
        click.Option(["--live-frames"], default=1000, show_default=True, type=COUNT),
    ]),
}  # fmt: skip


@click.group(help=(__doc__ or "").replace("\n\n", "\n\n\b\n"))
def main() -> None:
    """Measure, or compare two files."""


@main.command()
@click.argument("a", type=click.Path(path_type=Path))
@click.argument("b", type=click.Path(path_type=Path))
def compare(a: Path, b: Path) -> None:
    """Print the ratios of B's medians to A's with their spread."""
    for line in bench_results.compare(bench_results.load(a), bench_results.load(b)):
        click.echo(line)


def command(verb: str) -> click.Command:
    """Make the command of a verb."""
    measure, parameters = VERBS[verb]

    def act(out: Path | None, **options: Any) -> None:
        if out and out.is_dir():  # before minutes of measuring
            raise ResultsError(f"cannot write {out}: it is a folder")
        if options.get("size"):
            options["size"] = scenes.parse_size(options["size"])
        measured = []
        for quantity in measure(**options):
            click.echo(quantity)
            measured.append(quantity)
        results = Results.of_this_run(verb, options, measured)
        click.echo(f"{results.commit}, {', '.join(results.machine.values())}")
        if out:
            results.save(out)

    keep = click.Option(["--json", "out"], type=click.Path(path_type=Path), help="File that keeps the results.")
    return click.Command(verb, params=[*parameters, keep], callback=act, help=measure.__doc__)


for _verb in VERBS:
    main.add_command(command(_verb))

if __name__ == "__main__":
    run_command(main)
