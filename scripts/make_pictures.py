"""Render the pictures of README and docs: a frame of each place and weather, worlds of `training`, sheets.

python -m scripts.make_pictures
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

import simgrab
from scripts import grab_sheets
from simgrab.dataset.preview import captioned
from simgrab.io.pictures import encode, read

DOCS = Path(__file__).parents[1] / "docs"
SHOWN = {"quay-day": 6, "quay-truck": 3, "hold-coal": 5, "hold-grain": 2, "water-side": 4, "paper-ideal": 1}
WEATHERS = {
    "calm-day": 5, "windy-day": 1, "night-light-snow": 5, "heavy-snow": 5, "rain": 5,
    "fog": 5, "dust": 7, "glare": 8, "qingdao-night-snow": 3, "qingdao-heavy-snow": 3,
}  # fmt: skip
TILE_WIDTH = 640
WORLDS, ABREAST, WORLD_WIDTH = 24, 4, 320


def scenes(shown: dict[str, int], file: str) -> None:
    """Draw one frame a scene, two abreast, each with its name."""
    tiles = []
    for name, frame in shown.items():
        (made,) = simgrab.frames(name, [frame], buffers=False)
        tile = _reduced(made.rgb[..., ::-1], TILE_WIDTH)
        tiles.append(captioned(tile, name))
    rows = [np.hstack(tiles[i : i + 2]) for i in range(0, len(tiles), 2)]
    (DOCS / file).write_bytes(encode(np.vstack(rows), "jpeg", 82))


def training() -> None:
    """Draw a frame of each of the first worlds of `training`."""
    scenario = simgrab.load("training")
    first = (world * scenario.clip.clip_frames for world in range(1, WORLDS + 1))  # the very first is dense fog
    tiles = [_reduced(frame.rgb[..., ::-1], WORLD_WIDTH) for frame in simgrab.frames(scenario, first, buffers=False)]
    rows = [np.hstack(tiles[i : i + ABREAST]) for i in range(0, WORLDS, ABREAST)]
    (DOCS / "training.jpg").write_bytes(encode(np.vstack(rows), "jpeg", 82))


def assembled_grabs() -> None:
    """Render the sheet of assembled grabs, smaller."""
    sheet = _reduced(grab_sheets.sheet(grab_sheets.drawn("assembled")), 1200)
    (DOCS / "assembled.jpg").write_bytes(encode(sheet, "jpeg", 82))


def contact_sheet() -> None:
    """Render the README's command and keep its preview, smaller."""
    scenario = simgrab.load("quay-day", {"camera.beta_deg": 5.0, "swing.alpha.sigma_deg": 2.0, "frames": 16})
    with tempfile.TemporaryDirectory() as folder:
        simgrab.render(scenario, Path(folder) / "sheet")
        sheet = _reduced(read(Path(folder) / "sheet" / "preview.jpg")[..., ::-1], 1920)
    (DOCS / "preview.jpg").write_bytes(encode(sheet, "jpeg", 82))


def _reduced(picture: NDArray[np.uint8], width: int) -> NDArray[np.uint8]:
    scale = width / picture.shape[1]
    return cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)


if __name__ == "__main__":
    scenes(SHOWN, "scenes.jpg")
    scenes(WEATHERS, "weather.jpg")
    training()
    assembled_grabs()
    contact_sheet()
