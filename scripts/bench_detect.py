"""How long an instrument takes from a 1080p picture to box, centre and rope length; see `scripts.bench`."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from simgrab import layouts, scenes
from simgrab.instrument.detect import detector
from simgrab.instrument.read import Reader
from simgrab.world.frames import frames

PICTURES = 12


def detect(yolo: Path | None, rounds: int = 20) -> None:
    """Print milliseconds a picture; what is compared takes turns on each picture, so that a noisy machine cancels."""
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
    took: dict[str, list[float]] = {name: [] for name in acts}
    for number in range(1 + rounds):
        for picture in pictures:
            for name, act in acts.items():
                start = time.perf_counter()
                act(picture)
                if number:  # the first round warms up
                    took[name].append(time.perf_counter() - start)
    height, width = pictures[0].shape[:2]
    print(f"milliseconds from a picture of {width}x{height}, {rounds} times {len(pictures)} pictures, two threads")
    for name, seconds in took.items():
        ms = 1e3 * np.array(seconds)
        print(f"  {name:24s} median {np.median(ms):6.1f}   95 % {np.quantile(ms, 0.95):6.1f}")
