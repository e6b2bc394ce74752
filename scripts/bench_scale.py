"""Measure what a plan of a large run starts from: time, CPU time and bytes of a frame; see `scripts.bench`."""

from __future__ import annotations

import time
from collections.abc import Iterator

import msgspec

from scripts.bench_measure import milliseconds, single
from scripts.bench_results import Quantity
from simgrab.dataset import shards, stored, tables
from simgrab.dataset.shard_reader import table as shard_labels
from simgrab.dataset.shards import Packed
from simgrab.dataset.stores import Store
from simgrab.model import scenes
from simgrab.model.scenario import Scenario
from simgrab.world.frames import FrameGenerator
from simgrab.world.gl import Fingerprint


def scale(scene: str, size: tuple[int, int] | None, frames: int) -> Iterator[Quantity]:
    """Measure frames one after another in one process: worlds, rendering, labels and encoding, without writing.

    CPU time is that of all threads of the process, OpenGL's included where the CPU renders. The bytes of labels are
    those of a shard of all frames and of one of the first half: what the other half adds, and what a file begins with.
    """
    scenario = scenes.load(scene, {"frames": max(frames, 2)}, size=size)
    worlds: list[tuple[float, float]] = []
    times: list[tuple[float, float]] = []
    images, records, packed = [], [], list[Packed]()
    with FrameGenerator(scenario) as generator:
        variant = None
        for frame in range(scenario.frames):
            began = _now()
            if variant != generator.recipe.variant_number(frame):
                variant = generator.recipe.variant_number(frame)
                generator.scene(frame)
                worlds.append(_since(began))
                began = _now()
            made = stored.make(generator, frame)
            times.append(_since(began))
            images.append(sum(map(len, made.files.values())) / 1e3)
            records.append(len(msgspec.json.encode(made.record)) / 1e3)
            row, mask = made.record.truth, made.record.mask
            packed.append(Packed(row, mask if tables.is_labelled(row, scenario) else None, {row.file: b""}))
    half = len(packed) // 2
    whole, less = (_labels_bytes(some, scenario, made.record.rendered_by) for some in (packed, packed[:half]))
    each = (whole - less) / (len(packed) - half)
    for name, taken in (("world", worlds), ("frame", times)):
        yield milliseconds(f"{name}: time", (wall for wall, _ in taken))
        yield milliseconds(f"{name}: CPU time", (cpu for _, cpu in taken))
    yield Quantity("frame: image", "kB", tuple(images))
    yield Quantity("frame: labels and mask as JSON", "kB", tuple(records))
    yield single("frame: labels in a table", each / 1e3, "kB")
    yield single("table of labels: beside its frames", (whole - each * len(packed)) / 1e3, "kB")


def _labels_bytes(frames: list[Packed], scenario: Scenario, rendered_by: Fingerprint) -> int:
    """Bytes of the labels of a shard."""
    store = Store("memory://scale")
    shards.write(store, 0, frames, scenario, rendered_by)
    return store.sizes("labels")[shard_labels(0)]


def _now() -> tuple[float, float]:
    return time.perf_counter(), time.process_time()


def _since(began: tuple[float, float]) -> tuple[float, float]:
    wall, cpu = _now()
    return wall - began[0], cpu - began[1]
