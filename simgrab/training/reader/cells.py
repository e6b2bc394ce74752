"""Cells of rendered displays: digits with their labels, and what is no digit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.dataset.datasets import MANIFEST, Dataset
from simgrab.errors import DatasetError
from simgrab.instrument.read.crops import Picture, around, cut
from simgrab.instrument.read.reader import NO_DIGIT
from simgrab.model import scenes
from simgrab.model.layouts import Layout, Rectangle
from simgrab.model.records.frame_files import picture
from simgrab.model.rng import stream
from simgrab.model.scenario import variants

SPARE_PX = 8  # around a cell's margin, for shifts and larger scales
ELSEWHERE = 3  # boxes of each picture that lie off the display
HALVES = 2  # boxes of each picture that lie half off a digit


@dataclass(frozen=True, eq=False)
class Cells:
    """Boxes out of pictures, what they show, and where they are from."""

    boxes: tuple[Picture, ...]  # (h, w), grey cells with their margin and `SPARE_PX` more
    digits: NDArray[np.int64]  # (n,), 0 … 9, or `NO_DIGIT`
    frames: NDArray[np.int64]  # (n,), boxes of one number are of one picture, and as large
    weather: tuple[str, ...]  # of each picture


def gather(datasets: Sequence[Dataset], split: str, seed: int) -> Cells:
    """Cut the cells of a split out of the pictures, and by the seed some off the display.

    Torn pictures and those without a display are left out.

    Raises `DatasetError` if no picture of the split shows a display, or one cannot be read.
    """
    boxes: list[Picture] = []
    digits: list[int] = []
    frames: list[int] = []
    weather: list[str] = []
    for dataset in datasets:
        drawn = variants(scenes.load(dataset.path / MANIFEST))
        layouts = {frame: one.scenario.display_layout for one, span in drawn for frame in span}
        for row in dataset.rows:
            if row.split != split or row.rope_text is None or row.torn_row_px is not None:
                continue
            layout = layouts[row.frame]
            assert layout is not None  # it shows lengths
            rng = stream(seed, len(weather), "cells")
            grey = cv2.cvtColor(picture(dataset.image(row), row), cv2.COLOR_RGB2GRAY)
            found, shown = _cells(grey, layout, row.rope_text, rng)
            boxes += found
            digits += shown
            frames += [len(weather)] * len(shown)
            weather.append(dataset.weather(row))
    if not weather:
        given = ", ".join(str(dataset.path) for dataset in datasets)
        raise DatasetError(f"{given}: no frame of the split {split!r} shows rope lengths; render with a display.layout")
    return Cells(tuple(boxes), np.array(digits), np.array(frames), tuple(weather))


def _cells(picture: Picture, layout: Layout, text: str, rng: np.random.Generator) -> tuple[list[Picture], list[int]]:
    """Boxes of a picture and what they show."""
    cells = layout.cells
    places = [*cells, *_halves(cells, rng), *_elsewhere(layout, rng)]
    shown = [int(c) for c in text if c.isdigit()]
    return [cut(picture, around(p, SPARE_PX)) for p in places], shown + [NO_DIGIT] * (len(places) - len(shown))


def _halves(cells: Sequence[Rectangle], rng: np.random.Generator) -> list[Rectangle]:
    """Cells half a digit away, along one axis."""
    found = []
    for i in rng.integers(0, len(cells), HALVES):
        x0, y0, x1, y1 = cells[i]
        share = rng.uniform(0.4, 0.6) * rng.choice([-1, 1])
        dx, dy = (round(share * (x1 - x0)), 0) if rng.random() < 0.5 else (0, round(share * (y1 - y0)))
        found.append((x0 + dx, y0 + dy, x1 + dx, y1 + dy))
    return found


def _elsewhere(layout: Layout, rng: np.random.Generator) -> list[Rectangle]:
    """Cells that meet neither digit nor clock."""
    w, h = layout.digit_width_px, layout.digit_height_px
    taken = np.array([*layout.cells, *layout.points, *layout.clock.cells])
    found: list[Rectangle] = []
    for _ in range(100):
        x, y = int(rng.integers(0, layout.width_px - w + 1)), int(rng.integers(0, layout.height_px - h + 1))
        x0, y0, x1, y1 = taken.T
        if not ((x0 < x + w) & (x < x1) & (y0 < y + h) & (y < y1)).any():
            found.append((x, y, x + w, y + h))
        if len(found) == ELSEWHERE:
            break
    return found
