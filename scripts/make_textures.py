"""Write the bundled textures into assets/textures: `scripts/python -m scripts.make_textures`."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from scripts.textures import ground, steel
from scripts.textures.noise import Image

FOLDER = Path(__file__).resolve().parents[1] / "assets" / "textures"


def write(name: str, picture: Image, *options: int) -> None:
    """Write a picture, RGB from 0 to 255, as JPEG; the same bytes each time."""
    rgb = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
    cv2.imwrite(str(FOLDER / f"{name}.jpg"), rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88, *options])


if __name__ == "__main__":
    FOLDER.mkdir(parents=True, exist_ok=True)
    for seed, (name, make) in enumerate(ground.TEXTURES.items(), start=100):
        write(name, make(np.random.default_rng(seed)))
    for make_steel in steel.TEXTURES:
        write(make_steel.__name__, make_steel(), cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)
