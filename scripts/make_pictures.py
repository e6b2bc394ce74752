"""Draw the pictures of the README: a frame of each place and weather, worlds of `training`, a contact sheet.

python -m scripts.make_pictures
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

import simgrab
from simgrab.world.frames import Studio, encode
from simgrab.world.output.preview import captioned

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
        with Studio(simgrab.load(name)) as studio:
            made = studio.make(frame)
        tile = _decode(made.files[made.record.truth.file], TILE_WIDTH)
        tiles.append(captioned(tile, name))
    rows = [np.hstack(tiles[i : i + 2]) for i in range(0, len(tiles), 2)]
    (DOCS / file).write_bytes(encode(np.vstack(rows), "jpeg", 82))


def training() -> None:
    """Draw a frame of each of the first worlds of `training`."""
    scenario = simgrab.load("training")
    tiles = []
    with Studio(scenario) as studio:
        for world in range(1, WORLDS + 1):  # the very first is dense fog without a grab
            made = studio.make(world * scenario.clip.clip_frames)
            tiles.append(_decode(made.files[made.record.truth.file], WORLD_WIDTH))
    rows = [np.hstack(tiles[i : i + ABREAST]) for i in range(0, WORLDS, ABREAST)]
    (DOCS / "training.jpg").write_bytes(encode(np.vstack(rows), "jpeg", 82))


def contact_sheet() -> None:
    """Render the README's command and keep its preview, smaller."""
    scenario = simgrab.load("quay-day", {"camera.beta_deg": 5.0, "swing.alpha.sigma_deg": 2.0, "frames": 16})
    with tempfile.TemporaryDirectory() as folder:
        simgrab.render(scenario, Path(folder) / "sheet")
        sheet = _decode((Path(folder) / "sheet" / "preview.jpg").read_bytes(), 1920)
    (DOCS / "preview.jpg").write_bytes(encode(sheet, "jpeg", 82))


def _decode(data: bytes, width: int) -> NDArray[np.uint8]:
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    scale = width / picture.shape[1]
    return cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)


if __name__ == "__main__":
    scenes(SHOWN, "scenes.jpg")
    scenes(WEATHERS, "weather.jpg")
    training()
    contact_sheet()
