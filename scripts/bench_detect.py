"""How long an instrument takes from a 1080p picture to box, centre and rope length; see `scripts.bench`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from scripts.bench_measure import in_turns, milliseconds
from scripts.bench_results import Quantity
from simgrab.instrument.detect import detector
from simgrab.instrument.read import Reader
from simgrab.model import layouts, scenes
from simgrab.world.frames import frames

PICTURES, ROUNDS = 12, 20


def detect(yolo: Path | None) -> Iterator[Quantity]:
    """Measure milliseconds a picture, with two threads."""
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
    yield from (milliseconds(name, seconds) for name, seconds in took.items())
